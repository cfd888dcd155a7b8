// Draws what the state says: the map, a layer over it, what is known, the poses, and the scan.

import { colours, verdictColour } from "./colours.js";
import { compose, degrees } from "./geometry.js";
import { drawCells, rule } from "./map.js";
import { drawReading, drawScan, shape } from "./scan.js";

const HANDLE = 46; // pixels from the sensor to the handle that turns it
const SHOWN = 20; // places of a belief, and hypotheses, that are drawn

/** Where the handle of a pose is, pixels. */
export function handleOf(view, pose) {
  const [x, y] = view.pixel(pose.x, pose.y);
  return [x + HANDLE * Math.cos(pose.theta), y - HANDLE * Math.sin(pose.theta)];
}

/** A disc with a nose, and what it is called. */
function robot(context, [x, y], theta, label, { fill, size = 10, alpha = 1 }) {
  const { halo } = colours();
  context.save();
  context.globalAlpha = alpha;
  context.translate(x, y);
  context.rotate(-theta);
  const path = new Path2D();
  path.arc(0, 0, size, 0, 2 * Math.PI);
  path.moveTo(0.35 * size, -size);
  path.lineTo(1.9 * size, 0);
  path.lineTo(0.35 * size, size);
  context.lineWidth = 3;
  context.strokeStyle = halo;
  context.stroke(path);
  context.fillStyle = fill;
  context.fill(path);
  context.rotate(theta);
  context.fillStyle = halo;
  context.font = `600 ${Math.max(9.5, 1.25 * size)}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(label, 0, 0.5);
  context.restore();
}

/** A cross: a pose that was marked as true. */
function cross(context, [x, y], theta) {
  const { line, halo } = colours(), path = new Path2D();
  path.moveTo(x - 11, y - 11);
  path.lineTo(x + 11, y + 11);
  path.moveTo(x + 11, y - 11);
  path.lineTo(x - 11, y + 11);
  path.moveTo(x, y);
  path.lineTo(x + 20 * Math.cos(theta), y - 20 * Math.sin(theta));
  for (const [style, width] of [[halo, 6], [line, 2.4]]) {
    context.strokeStyle = style;
    context.lineWidth = width;
    context.stroke(path);
  }
}

function polygon(context, view, points, { fill, stroke, dash = [] }) {
  const path = new Path2D();
  for (const [x, y] of points) path.lineTo(...view.pixel(x, y));
  path.closePath();
  context.save();
  context.globalAlpha = 0.16;
  context.fillStyle = fill;
  context.fill(path);
  context.globalAlpha = 1;
  context.strokeStyle = stroke;
  context.lineWidth = 1.6;
  context.setLineDash(dash);
  context.stroke(path);
  context.restore();
}

/** The disc and the wedge of headings in which the pose is known to be. */
function drawNear(context, view, [x, y, yaw, radius, turn]) {
  const { known } = colours(), at = view.pixel(x, y), r = radius * view.scale;
  context.save();
  context.fillStyle = known;
  context.strokeStyle = known;
  context.lineWidth = 1.6;
  context.beginPath();
  context.arc(...at, r, 0, 2 * Math.PI);
  context.globalAlpha = 0.12;
  context.fill();
  context.globalAlpha = 1;
  context.setLineDash([5, 4]);
  context.stroke();
  if (turn < Math.PI - 1e-6) {
    const long = Math.max(30, r);
    context.setLineDash([]);
    context.beginPath();
    context.moveTo(...at);
    context.arc(...at, long, -yaw - turn, -yaw + turn);
    context.closePath();
    context.globalAlpha = 0.25;
    context.fill();
    context.globalAlpha = 1;
    context.beginPath();
    context.moveTo(...at);
    context.lineTo(at[0] + long * Math.cos(yaw), at[1] - long * Math.sin(yaw));
    context.stroke();
  }
  context.restore();
}

/** What is drawn corner by corner, and where the keys point. */
function drawDrawn(context, view, { drawn, cursor, tool, layer }) {
  const { known, halo } = colours(), points = cursor && tool !== "move" ? [...drawn, [cursor.x, cursor.y]] : drawn;
  if (drawn.length) polygon(context, view, points, { fill: known, stroke: known });
  for (const [x, y] of drawn) {
    const [px, py] = view.pixel(x, y);
    context.fillStyle = known;
    context.fillRect(px - 4, py - 4, 8, 8);
  }
  if (!cursor || (tool === "move" && layer !== "visibility")) return;
  const [x, y] = view.pixel(cursor.x, cursor.y), path = new Path2D();
  for (const [dx, dy] of [[1, 0], [0, 1]]) {
    path.moveTo(x - 12 * dx, y - 12 * dy);
    path.lineTo(x + 12 * dx, y + 12 * dy);
  }
  for (const [style, width] of [[halo, 4], [known, 1.6]]) {
    context.strokeStyle = style;
    context.lineWidth = width;
    context.stroke(path);
  }
}

function drawRule(context, view) {
  const { line, halo } = colours(), [length, text] = rule(view), wide = length * view.scale;
  const x = 14, y = view.height - 14, path = new Path2D();
  path.moveTo(x, y - 5);
  path.lineTo(x, y);
  path.lineTo(x + wide, y);
  path.lineTo(x + wide, y - 5);
  context.save();
  for (const [style, width] of [[halo, 4], [line, 1.5]]) {
    context.strokeStyle = style;
    context.lineWidth = width;
    context.stroke(path);
  }
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "left";
  context.lineWidth = 3;
  context.strokeStyle = halo;
  context.strokeText(text, x + 4, y - 7);
  context.fillStyle = line;
  context.fillText(text, x + 4, y - 7);
  context.restore();
}

const SPOTS = { unique: "agrees", ambiguous: "orientation", "no-match": "unexplained", wrong: "visibility" };
const WORST = Object.keys(SPOTS);

/** The atlas: at each place the worst that one scan says there, in the shapes of readings. */
function drawSpots(context, view, spots) {
  const palette = colours(), worst = new Map();
  for (const { x, y, kind } of spots) {
    const key = `${x},${y}`, old = worst.get(key);
    if (!old || WORST.indexOf(kind) > WORST.indexOf(old.kind)) worst.set(key, { x, y, kind });
  }
  for (const kind of WORST) {
    const path = new Path2D();
    for (const spot of worst.values()) if (spot.kind === kind) shape(path, SPOTS[kind], ...view.pixel(spot.x, spot.y), 4.5);
    context.lineWidth = 2;
    context.strokeStyle = palette[SPOTS[kind]];
    context.fillStyle = palette[SPOTS[kind]];
    if (kind === "unique" || kind === "ambiguous") context.fill(path);
    else context.stroke(path);
  }
}

/** Where the tracker was sure to be, along the whole log. */
function drawTrail(context, view, beliefs) {
  const path = new Path2D();
  for (const belief of beliefs) {
    if (!belief?.pose) continue;
    const [x, y] = view.pixel(belief.pose.x, belief.pose.y);
    path.moveTo(x + 1.8, y);
    path.arc(x, y, 1.8, 0, 2 * Math.PI);
  }
  context.fillStyle = verdictColour("unique");
  context.fill(path);
}

/** The places of the tracker's belief: as large as they are likely. */
function drawBelief(context, view, belief) {
  const { soft } = colours(), fill = belief.verdict === "lost" ? soft : verdictColour(belief.verdict);
  for (const place of (belief.places ?? []).slice(0, SHOWN).reverse()) {
    const size = 5 + 6 * Math.sqrt(place.mass);
    robot(context, view.pixel(place.x, place.y), place.theta, "", { fill, size, alpha: 0.35 + 0.6 * place.mass });
  }
}

/** Draw all of it. `sketch` is what is being drawn by hand: a region or an arrow. */
export function paint(context, view, state, { cells, layer, sketch }) {
  const palette = colours(), { map, scan, pose, known } = state;
  const fit = state.fit?.of === scan ? state.fit : null, answer = state.answer?.index === state.index ? state.answer : null;
  context.clearRect(0, 0, view.width, view.height);
  if (map && cells) drawCells(context, view, cells.image, map.origin, map.resolution);
  if (map && layer) {
    drawCells(context, view, layer.image, map.origin, layer.resolution);
    if (cells) drawCells(context, view, cells.walls, map.origin, map.resolution);
  }
  drawSpots(context, view, state.spots);
  if (state.seen) {
    polygon(context, view, state.seen.polygon, { fill: palette.accent, stroke: palette.accent });
    const [x, y] = view.pixel(...state.seen.at);
    context.fillStyle = palette.line;
    context.fillRect(x - 3, y - 3, 6, 6);
  }
  if (known.region) polygon(context, view, known.region, { fill: palette.known, stroke: palette.known, dash: [5, 4] });
  if (known.near) drawNear(context, view, known.near);
  if (sketch?.region) polygon(context, view, sketch.region, { fill: palette.known, stroke: palette.known });
  if (sketch?.near) drawNear(context, view, sketch.near);
  drawDrawn(context, view, state);
  const belief = state.beliefs[state.index];
  drawTrail(context, view, state.beliefs);
  if (belief) drawBelief(context, view, belief);
  if (scan && pose) {
    drawScan(context, view, scan, pose, fit);
    if (state.reading >= 0) drawReading(context, view, scan, pose, fit, state.reading);
  }
  const others = (answer?.hypotheses ?? []).slice(0, SHOWN).map((h, k) => [h, k]).reverse();
  for (const [h, k] of others) {
    if (k === state.chosen) continue;
    const size = 6 + 4 * Math.sqrt(h.mass), alpha = 0.5 + 0.5 * Math.sqrt(h.mass);
    robot(context, view.pixel(h.x, h.y), h.theta, String(k + 1), { fill: palette.soft, size, alpha });
  }
  const mark = state.marks[state.index];
  if (mark) cross(context, view.pixel(mark.x, mark.y), mark.theta);
  if (scan && pose) {
    const at = view.pixel(pose.x, pose.y), handle = handleOf(view, pose);
    context.strokeStyle = palette.line;
    context.lineWidth = 1.4;
    context.beginPath();
    context.moveTo(...at);
    context.lineTo(...handle);
    context.stroke();
    context.beginPath();
    context.arc(...handle, 7, 0, 2 * Math.PI);
    context.fillStyle = palette.halo;
    context.fill();
    context.lineWidth = 2;
    context.stroke();
    const label = state.chosen >= 0 ? String(state.chosen + 1) : "";
    robot(context, at, pose.theta, label, { fill: palette.line, size: 11 });
  }
  drawRule(context, view);
}

/** A line under the scans of a log: the verdict of each that was looked at. */
export function paintStrip(canvas, state) {
  const ratio = devicePixelRatio, wide = Math.round(canvas.clientWidth * ratio), high = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== wide) canvas.width = wide;
  if (canvas.height !== high) canvas.height = high;
  const context = canvas.getContext("2d"), count = state.set?.scans ?? 0;
  context.clearRect(0, 0, wide, high);
  const each = wide / Math.max(1, count), { truth } = colours();
  const bar = (k, from, share, fill) => {
    context.fillStyle = fill;
    context.fillRect(Math.floor(k * each), from * high, Math.max(1, Math.ceil(each)), share * high);
  };
  state.verdicts.forEach((verdict, k) => verdict && bar(k, 0, 0.4, verdictColour(verdict)));
  state.beliefs.forEach((belief, k) => belief && bar(k, 0.5, 0.3, verdictColour(belief.verdict)));
  state.marks.forEach((mark, k) => mark && bar(k, 0.85, 0.15, truth));
}
