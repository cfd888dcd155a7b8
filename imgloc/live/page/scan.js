// A scan on the map: where its readings end, how they are drawn, and what one of them says.

import { colours } from "./colours.js";
import { degrees, fixed } from "./geometry.js";

/** What a reading can be, in the order in which they are drawn and counted. */
export const KINDS = {
  agrees: "ends on a wall",
  orientation: "wall faces away",
  visibility: "through a wall",
  unexplained: "ends in the open",
  no_return: "met nothing",
  invalid: "no reading",
};
const ENDS = ["unasked", "unexplained", "agrees", "orientation", "visibility"];

/** A number of JSON that may be "inf", "nan" or null. */
const number = (value) => (typeof value === "number" ? value : value === "inf" ? Infinity : NaN);

/** A scan as the service gives it, ready to be drawn: ranges and angles as numbers. */
export function prepared(given) {
  const high = number(given.range_max ?? "inf");
  return {
    given, ranges: Float64Array.from(given.ranges, number), angles: Float64Array.from(given.angles),
    low: given.range_min ?? 0, high: Number.isNaN(high) ? Infinity : high,
  };
}

/** Whether reading k is a distance to something. */
export const valid = (scan, k) => scan.ranges[k] > scan.low && scan.ranges[k] < scan.high && Number.isFinite(scan.ranges[k]);

/** Where reading k ends, seen from a pose, metres. */
export function end(scan, pose, k) {
  const turn = pose.theta + scan.angles[k];
  return { x: pose.x + scan.ranges[k] * Math.cos(turn), y: pose.y + scan.ranges[k] * Math.sin(turn) };
}

/** The ends of all valid readings at a pose. */
export function ends(scan, pose) {
  const out = [];
  for (let k = 0; k < scan.ranges.length; k += 1) if (valid(scan, k)) out.push(end(scan, pose, k));
  return out;
}

/** Add the shape of a kind around a pixel to a path. */
export function shape(path, kind, x, y, r) {
  if (kind === "orientation") {
    path.moveTo(x, y - 1.4 * r);
    path.lineTo(x + 1.4 * r, y);
    path.lineTo(x, y + 1.4 * r);
    path.lineTo(x - 1.4 * r, y);
    path.closePath();
  } else if (kind === "visibility") {
    path.moveTo(x - r, y - r);
    path.lineTo(x + r, y + r);
    path.moveTo(x + r, y - r);
    path.lineTo(x - r, y + r);
  } else {
    path.moveTo(x + r, y);
    path.arc(x, y, r, 0, 2 * Math.PI);
  }
}

/** Draw the ends of some readings in the shape and colour of their kind. */
function drawEnds(context, kind, pixels, r) {
  const palette = colours(), path = new Path2D(), dot = kind === "agrees" || kind === "unasked";
  for (const [x, y] of pixels) shape(path, kind, x, y, dot ? 0.75 * r : r);
  context.lineWidth = kind === "visibility" ? 2 : 1.4;
  context.strokeStyle = palette[kind];
  context.fillStyle = kind === "unexplained" ? palette.halo : palette[kind];
  if (kind !== "visibility") context.fill(path);
  if (!dot) context.stroke(path);
}

/** Draw a scan at a pose; `fit` says what each reading is, or nothing is known of that yet. */
export function drawScan(context, view, scan, pose, fit) {
  const palette = colours(), start = view.pixel(pose.x, pose.y);
  const r = Math.min(4, Math.max(2.2, 0.05 * view.scale));
  const groups = Object.fromEntries(ENDS.map((kind) => [kind, []]));
  const misses = new Path2D();
  for (let k = 0; k < scan.ranges.length; k += 1) {
    if (valid(scan, k)) {
      const kind = fit?.rays.kind[k] ?? "unasked", at = end(scan, pose, k);
      groups[kind].push(view.pixel(at.x, at.y));
    } else if (scan.ranges[k] === Infinity || scan.ranges[k] >= scan.high) {
      const turn = pose.theta + scan.angles[k];
      misses.moveTo(start[0] + 20 * Math.cos(turn), start[1] - 20 * Math.sin(turn));
      misses.lineTo(start[0] + 27 * Math.cos(turn), start[1] - 27 * Math.sin(turn));
    }
  }
  context.save();
  context.strokeStyle = palette.no_return;
  context.lineWidth = 1;
  context.stroke(misses);
  for (const kind of ENDS) {
    const path = new Path2D();
    for (const [x, y] of groups[kind]) {
      path.moveTo(...start);
      path.lineTo(x, y);
    }
    context.strokeStyle = palette[kind];
    context.lineWidth = 0.7;
    context.globalAlpha = groups[kind].length > 400 ? 0.12 : 0.22;
    context.stroke(path);
  }
  context.globalAlpha = 1;
  for (const kind of ENDS) drawEnds(context, kind, groups[kind], r);
  context.restore();
}

/** Draw one reading in full: its ray, and where a wall is in its way. */
export function drawReading(context, view, scan, pose, fit, k) {
  if (!valid(scan, k)) return;
  const palette = colours(), kind = fit?.rays.kind[k] ?? "unasked";
  const from = view.pixel(pose.x, pose.y), at = end(scan, pose, k), to = view.pixel(at.x, at.y);
  context.save();
  context.strokeStyle = palette[kind];
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
  context.beginPath();
  context.arc(...to, 7, 0, 2 * Math.PI);
  context.stroke();
  const wall = fit?.rays.wall[k];
  if (kind === "visibility" && Number.isFinite(wall)) {
    const share = Math.min(1, wall / scan.ranges[k]);
    context.fillStyle = palette.line;
    context.beginPath();
    context.arc(from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1]), 4, 0, 2 * Math.PI);
    context.fill();
  }
  context.restore();
}

/** The reading whose end is nearest to a pixel, within `reach` pixels; -1 without one. */
export function readingAt(view, scan, pose, px, py, reach = 12) {
  let best = -1, least = reach * reach;
  for (let k = 0; k < scan.ranges.length; k += 1) {
    if (!valid(scan, k)) continue;
    const at = end(scan, pose, k), [x, y] = view.pixel(at.x, at.y);
    const away = (x - px) ** 2 + (y - py) ** 2;
    if (away < least) [best, least] = [k, away];
  }
  return best;
}

/** What a reading says, in sentences: [what it is, why]. */
export function reason(scan, fit, k) {
  const angle = `${fixed(degrees(scan.angles[k]), 1)}°`;
  const head = valid(scan, k)
    ? `Reading ${k}: ${scan.ranges[k].toFixed(2)} m at ${angle}`
    : `Reading ${k} at ${angle}`;
  const kind = fit?.rays.kind[k], away = fit?.rays.distance?.[k], wall = fit?.rays.wall[k];
  const near = Number.isFinite(away) ? `${(100 * away).toFixed(0)} cm from the nearest wall` : "off the map";
  const why = {
    agrees: `The map explains it: it ends ${near}.`,
    orientation: `It ends ${near}, but that wall faces another way.`,
    visibility: Number.isFinite(wall)
      ? `The map has a wall in its way, ${wall.toFixed(2)} m from the sensor.`
      : "The map has a wall in its way.",
    unexplained: `It ends ${near}: the map has nothing there.`,
    no_return: "It met nothing within reach. Where the map has a wall, several side by side count against the pose.",
    invalid: "It is no distance, and has no say.",
  }[kind];
  return [head, why ?? ""];
}
