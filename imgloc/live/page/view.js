// Which part of the plane is on the screen: metres of the map frame to CSS pixels, and back.
// y points up on the map and down on the screen; it is turned round here and nowhere else.

const LEAST = 0.02, MOST = 5000; // pixels a metre

export class View {
  constructor() {
    Object.assign(this, { x: 0, y: 0, scale: 20, width: 1, height: 1 });
  }

  /** A point of the map frame in pixels. */
  pixel(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  /** A pixel as a point of the map frame. */
  point(px, py) {
    return { x: this.x + (px - this.width / 2) / this.scale, y: this.y - (py - this.height / 2) / this.scale };
  }

  /** Let a context draw in metres, y up. */
  apply(context) {
    const s = this.scale;
    context.transform(s, 0, 0, -s, this.width / 2 - this.x * s, this.height / 2 + this.y * s);
  }

  /** Move by pixels. */
  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
  }

  /** Enlarge by a factor; the point under a pixel stays there. */
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const before = this.point(px, py);
    this.scale = Math.min(MOST, Math.max(LEAST, this.scale * factor));
    const after = this.point(px, py);
    this.x += before.x - after.x;
    this.y += before.y - after.y;
  }

  /** Show a box with a margin around it: pixels at the sides, above (the buttons) and below (the scale bar). */
  fit(box, side = 24, above = 56, below = 40) {
    const across = (this.width - 2 * side) / Math.max(box.width, 0.1);
    const up = (this.height - above - below) / Math.max(box.height, 0.1);
    const scale = Math.min(MOST, Math.max(LEAST, Math.min(across, up)));
    this.fitted = { x: box.x + box.width / 2, y: box.y + box.height / 2 + (above - below) / 2 / scale, scale };
    Object.assign(this, this.fitted);
  }

  /** Whether nobody has moved or enlarged the map since it was fitted. */
  get untouched() {
    const { x, y, scale } = this.fitted ?? {};
    return x === this.x && y === this.y && scale === this.scale;
  }

  /** Bring a point into view, if it is out of it. */
  reveal({ x, y }, margin = 40) {
    const [px, py] = this.pixel(x, y);
    const within = px >= margin && px <= this.width - margin && py >= margin && py <= this.height - margin;
    if (!within) Object.assign(this, { x, y });
  }

  /** What is in view, as corners in the map frame. */
  corners() {
    return [[0, this.height], [this.width, this.height], [this.width, 0], [0, 0]]
      .map(([px, py]) => this.point(px, py));
  }
}
