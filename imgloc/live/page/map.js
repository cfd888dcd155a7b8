// The map and what is laid over it as an image: cells in the colours of the scheme, heat.

import { colours, HEAT } from "./colours.js";
import { compose } from "./geometry.js";

const FREE = 254, WALL = 0, UNKNOWN = 205;

/** The grey of each pixel of an image (H * W). */
function greys(image) {
  const canvas = new OffscreenCanvas(image.width, image.height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  const { data } = context.getImageData(0, 0, image.width, image.height);
  const out = new Uint8Array(data.length / 4);
  for (let k = 0; k < out.length; k += 1) out[k] = data[4 * k];
  return out;
}

/** An image of greys, in which grey v has the colour `colourOf(v)`: [r, g, b, alpha]. */
function painted(width, height, values, colourOf) {
  const canvas = new OffscreenCanvas(width, height), context = canvas.getContext("2d");
  const table = new Uint32Array(Uint8ClampedArray.from(Array.from({ length: 256 }, (_, v) => colourOf(v)).flat()).buffer);
  const image = context.createImageData(width, height), pixels = new Uint32Array(image.data.buffer);
  for (let k = 0; k < pixels.length; k += 1) pixels[k] = table[values[k]];
  context.putImageData(image, 0, 0);
  return canvas;
}

/** The cells of a map, to be painted anew when the scheme changes; `walls` go over a layer. */
export class Cells {
  constructor(image) {
    Object.assign(this, { width: image.width, height: image.height, greys: greys(image) });
    this.known = this.knownBox();
    this.repaint();
  }

  /** The columns and rows that hold all that is known: [left, top, right, bottom]. */
  knownBox() {
    let left = this.width, top = this.height, right = 0, bottom = 0;
    for (let k = 0; k < this.greys.length; k += 1) {
      if (this.greys[k] === UNKNOWN) continue;
      const x = k % this.width, y = (k - x) / this.width;
      left = Math.min(left, x);
      right = Math.max(right, x + 1);
      top = Math.min(top, y);
      bottom = y + 1;
    }
    return right > left ? [left, top, right, bottom] : [0, 0, this.width, this.height];
  }

  repaint() {
    const { paper, ink, shade } = colours();
    const { width, height } = this, paint = (colourOf) => painted(width, height, this.greys, colourOf);
    this.walls ??= paint((grey) => [255, 255, 255, grey === WALL ? 190 : 0]);
    this.image = paint((grey) => [...(grey === FREE ? paper : grey === WALL ? ink : shade), 255]);
  }
}

/** A layer: the brighter a grey, the hotter. */
export function heat(image) {
  return painted(image.width, image.height, greys(image), (grey) => [...HEAT[grey], 255]);
}

/** Draw an image whose cells have a side of `resolution` metres and a corner at `origin`. */
export function drawCells(context, view, image, origin, resolution) {
  const top = compose(origin, { x: 0, y: image.height * resolution });
  context.save();
  view.apply(context);
  context.translate(top.x, top.y);
  context.rotate(origin.theta);
  context.scale(resolution, -resolution);
  context.imageSmoothingEnabled = resolution * view.scale < 1;
  context.drawImage(image, 0, 0);
  context.restore();
}

/** A round length for the scale bar: [metres, text]. */
export function rule(view, most = 120) {
  const longest = most / view.scale;
  const power = 10 ** Math.floor(Math.log10(longest));
  const length = [5, 2, 1].find((step) => step * power <= longest) * power;
  if (length >= 1) return [length, `${length} m`];
  return length >= 0.01 ? [length, `${Math.round(length * 100)} cm`] : [length, `${Math.round(length * 1000)} mm`];
}
