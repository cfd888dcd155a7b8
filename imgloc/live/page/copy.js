// What is seen, as a command and as Python: the same answer without the page.

import { METHODS, surveyOf, takenOf } from "./actions.js";
import { degrees } from "./geometry.js";
import { isKnown } from "./known.js";
import { HAND, numberOf } from "./state.js";

/** A word of a POSIX shell, in quotes where it needs them. */
export function quoted(word) {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`;
}

const python = (text) => JSON.stringify(text);
const number = (value) => String(Number(value.toFixed(4)));
export const REGION = "region.png"; // what the image of a region is called

/** The files of what is seen: where they are, as far as the page can know. None looks like an option. */
function filesOf({ map, set }) {
  const there = (file) => (file.startsWith("-") ? `./${file}` : file);
  return { map: there(map.path ?? map.file ?? map.name), scans: set && there(set.name) };
}

/** How a file is read, as options of a command; words of a shell. */
const typedOf = (options) => options.map(([typed]) => quoted(typed));

/** The same as further arguments of a call in Python. */
const passedOf = (options) => options.map(([, passed]) => `, ${passed}`).join("");
/** The options of how the scans are read, as they were opened, and were taken, as the page says. */
const takenOptions = ({ taken, set }) => [
  ...typedOf(set?.options ?? []),
  ...Object.entries(takenOf(taken)).map(([key, value]) => (value === true ? `--${key}` : `--${key.replace("_", "-")}=${value}`)),
];

/** The options of what is known. */
function knownOptions({ near, region, clearance }) {
  const out = [];
  if (near) out.push(`--near=${near.map(number).join(",")}`);
  if (region) out.push("--region", REGION);
  if (clearance > 0) out.push("--clearance", number(clearance));
  return out;
}

/** Commands that show what the page shows. */
export function command(state) {
  const { map, set, scan, method, known, layer } = state, files = filesOf(state), index = numberOf();
  const taken = takenOptions(state), reading = typedOf(map.options);
  const line = (...words) => words.filter((word) => word !== "").join(" ");
  const lines = [];
  if (set) {
    const how = method === "fused" ? [] : ["--method", method];
    lines.push(line("imgloc localize", quoted(files.map), quoted(files.scans), "--scans-index", index, ...reading, ...taken, ...how, ...knownOptions(known)));
  }
  const show = ["imgloc map show", quoted(files.map), ...reading];
  if (["bmap", "vmap", "distance"].includes(layer)) lines.push(line(...show, "--what", layer, "--out", `${layer}.png`));
  if (layer === "visibility" && state.seen) {
    lines.push(line(...show, "--what visibility", `--at=${state.seen.at.map(number).join(",")}`, "--out visibility.png"));
  }
  if (METHODS.includes(layer) && set) {
    const drawn = line(...show, "--what likelihood", "--scans", quoted(files.scans), "--scans-index", index, "--method", layer, "--out", `${layer}.png`);
    lines.push(taken.length ? `# imgloc map show takes the scan only as the file has it; “Copy as Python” has ${layer} of this scan.` : drawn);
  }
  if (layer === "atlas" && scan) {
    const { step, headings } = surveyOf(map, scan), wide = Math.max(...scan.angles) - Math.min(...scan.angles);
    const laser = ["--rays", scan.angles.length, "--fov-deg", number(Math.min(360, degrees(wide)))];
    if (Number.isFinite(scan.high)) laser.push("--range-max", number(scan.high));
    lines.push(line("imgloc atlas", quoted(files.map), ...reading, "--step", step, "--headings", headings, ...laser, "--out atlas.png"));
  }
  if (state.beliefs.length) lines.push(line("imgloc track", quoted(files.map), quoted(files.scans), ...reading, ...taken));
  if (!lines.length) lines.push(line("imgloc map check", quoted(files.map), ...reading));
  return `${lines.join("\n")}\n`;
}

/** Python that answers what the page shows. */
export function script(state) {
  const { map, set, method, known, pose, chosen, layer } = state, files = filesOf(state), index = numberOf();
  const lines = ["import imgloc", ""];
  if (known.clearance > 0 && set) lines.splice(1, 0, "from imgloc.search.priors import prior_of");
  if (known.region && set) lines.splice(1, 0, "import numpy as np", "from skimage.draw import polygon2mask");
  lines.push(`grid = imgloc.load_map(${python(files.map)}${passedOf(map.options)})`, "features = imgloc.prepare(grid)");
  if (!set) return `${lines.join("\n")}\n`;
  lines.push(...scanLines(state, files.scans, index));
  const options = method === "fused" ? [] : [`method=${python(method)}`];
  if (map.calibrated) {
    lines.splice(1, 0, "from imgloc.io.calibration import calibration_path, load_calibrations");
    lines.push(`calibrations, shared = load_calibrations(calibration_path(${python(files.map)}), grid)`);
    options.push(`calibration=calibrations.get(${python(method)})`, "shared=shared");
  }
  if (isKnown(known)) {
    const said = [];
    if (known.near) {
      const [x, y, yaw, radius, turn] = known.near.map(number);
      said.push(`imgloc.near(grid, ${x}, ${y}, ${yaw}, radius=${radius}, tolerance=${turn})`);
    }
    if (known.clearance > 0) said.push(`prior_of(imgloc.Known(clearance=${number(known.clearance)}), grid)`);
    if (known.region) {
      lines.push(...regionLines(map, known.region));
      said.push("imgloc.region(grid, cells)");
    }
    options.push(`prior=${said.join(" & ")}`);
  }
  lines.push(`answer = imgloc.localize(features, scan, imgloc.Options(${options.join(", ")}))`, "print(answer.verdict, answer.pose)");
  if (METHODS.includes(layer)) lines.push(`stack = imgloc.likelihood(features, scan, ${python(layer)})  # (theta, y, x)`);
  if (pose && chosen === HAND) lines.push(...poseLines(pose));
  return `${lines.join("\n")}\n`;
}

/** The scan as it was taken: what `load_scans` does not do, is done after it. */
function scanLines({ taken: { flipped, range_max: cut, range_scale: scale, sensor }, set }, file, index) {
  const reach = cut && String(Number(cut) / Number(scale || 1)); // in the unit of the file
  const given = [...(cut ? [["", `range_max=${reach}`]] : []), ...(sensor ? [["", `sensor=imgloc.Pose2D(${sensor})`]] : [])];
  const lines = [`scans = imgloc.load_scans(${python(file)}${passedOf([...set.options, ...given])})`, `scan = scans[${index}]`];
  if (scale) lines.push(`scan = scan.scaled(${scale})  # metres`);
  if (flipped) lines.push("scan = scan.flipped");
  if (cut) lines.push("from dataclasses import replace", `scan = replace(scan, range_max=min(scan.range_max, ${cut}))`);
  return lines;
}

/** The cells whose centres are in a region. */
function regionLines(map, region) {
  const corners = region.map(([x, y]) => `(${number(x)}, ${number(y)})`).join(", ");
  const { x, y, theta } = map.origin;
  return [
    `corners = np.array([${corners}])  # map frame, metres`,
    `c, s = np.cos(${number(theta)}), np.sin(${number(theta)})`,
    `xy = (corners - (${number(x)}, ${number(y)})) @ np.array([[c, -s], [s, c]])`,
    "rows_columns = xy[:, ::-1] / grid.resolution - 0.5",
    "cells = polygon2mask(grid.occupied.shape, rows_columns)",
  ];
}

/** What the readings say at a pose that was set by hand. */
function poseLines({ x, y, theta }) {
  return [
    "",
    "from imgloc.answers.explain import explain_rays",
    "from imgloc.geometry import in_grid_frame",
    "",
    `by_hand = imgloc.Pose2D(${number(x)}, ${number(y)}, ${number(theta)})  # ${number(degrees(theta))} deg`,
    "rays = explain_rays(in_grid_frame(by_hand, grid), scan, features, imgloc.Options().fused.model)",
    "print(rays.counts)",
  ];
}
