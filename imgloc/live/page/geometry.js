// Poses, angles, and numbers as people read them. Metres and radians, map frame.

export const degrees = (radians) => (radians * 180) / Math.PI;
export const radians = (degrees) => (degrees * Math.PI) / 180;

/** An angle in (-pi, pi]. */
export const wrap = (angle) => angle - 2 * Math.PI * Math.ceil((angle - Math.PI) / (2 * Math.PI));

/** A pose, or a point, given in the frame of `base`, in the frame that `base` is given in. */
export function compose(base, { x, y, theta = 0 }) {
  const c = Math.cos(base.theta), s = Math.sin(base.theta);
  return { x: base.x + c * x - s * y, y: base.y + s * x + c * y, theta: wrap(base.theta + theta) };
}

/** The pose of the robot, whose sensor sits at `mount` on it and is at a pose. */
export function robotOf(pose, mount) {
  const theta = wrap(pose.theta - mount.theta), { x, y } = compose({ x: 0, y: 0, theta }, mount);
  return { x: pose.x - x, y: pose.y - y, theta };
}

/** A pose of the map frame in the frame of `base`. */
export function inside(base, { x, y, theta = 0 }) {
  const c = Math.cos(base.theta), s = Math.sin(base.theta), dx = x - base.x, dy = y - base.y;
  return { x: c * dx + s * dy, y: c * dy - s * dx, theta: wrap(theta - base.theta) };
}

/** The corners of a part of a map: its columns, and its rows counted from the top. */
export function corners(map, [left, top, right, bottom] = [0, 0, map.width, map.height]) {
  return [[left, bottom], [right, bottom], [right, top], [left, top]]
    .map(([column, row]) => compose(map.origin, { x: column * map.resolution, y: (map.height - row) * map.resolution }));
}

/** Whether a point is on a map. */
export function holds(map, point) {
  const { x, y } = inside(map.origin, point);
  return x >= 0 && y >= 0 && x < map.width * map.resolution && y < map.height * map.resolution;
}

/** The box around points: {x, y, width, height}. */
export function boxOf(points) {
  const xs = points.map((p) => p.x), ys = points.map((p) => p.y);
  const x = Math.min(...xs), y = Math.min(...ys);
  return { x, y, width: Math.max(...xs) - x, height: Math.max(...ys) - y };
}

/** A number with a true minus sign, and never "−0". */
export function fixed(value, digits) {
  const text = value.toFixed(digits);
  return Number(text) === 0 ? (0).toFixed(digits) : text.replace("-", "−");
}

/** A share in per cent: 0.9991 is more than 99.9, not 100. */
export function percent(share) {
  if (share > 0.9995 && share < 1) return ">\u202f99.9\u202f%";
  if (share > 0 && share < 0.0005) return "<\u202f0.1\u202f%";
  return `${(100 * share).toFixed(share > 0.0995 && share < 0.9 ? 0 : 1)}\u202f%`;
}

/** A pose in words. */
export const poseWords = ({ x, y, theta }) =>
  `x ${fixed(x, 2)} m, y ${fixed(y, 2)} m, heading ${fixed(degrees(theta), 1)}°`;
