// The panel beside the map: the verdict, the hypotheses, the pose, what is known, layers, marks.

import { chooseHypothesis, LOOKING, METHODS } from "./actions.js";
import { $, make, say } from "./dom.js";
import { degrees, fixed, percent, poseWords, robotOf } from "./geometry.js";
import { isKnown, knownWords } from "./known.js";
import { KINDS, reason } from "./scan.js";
import { change, HAND, NOWHERE, numberOf, state, TRACKER, watch } from "./state.js";

const GLYPHS = { unique: "✓", ambiguous: "?", "no-match": "✕", invalid: "–", lost: "✕" };
const LISTED = 20; // hypotheses
const SHOWN = 6000; // milliseconds that a note stays
const TITLES = { [HAND]: "Pose set by hand", [TRACKER]: "Pose by the tracker", [NOWHERE]: "No pose was found: drag the scan to one" };
let fading = 0;

/** One or two sentences about an answer. */
function sentence({ verdict, hypotheses, elsewhere, counted, counts }) {
  const [best, second] = hypotheses;
  if (verdict === "invalid") return `Only ${counts.valid} readings are distances to something.`;
  if (!best) return isKnown(state.known) ? "No allowed pose fits this scan." : "No pose on this map fits this scan.";
  const mass = percent(best.mass), distances = ["agrees", "orientation", "visibility", "unexplained"];
  const of = counted && distances.reduce((sum, kind) => sum + (counted[kind] ?? 0), 0);
  const held = of ? `; ${percent((counted.agrees ?? 0) / of)} of the readings end on a wall there` : "";
  if (verdict === "unique") return `One pose holds ${mass} of the probability${held}.`;
  if (verdict === "no-match") return `Even the best pose does not explain the scan. The chance that it was taken elsewhere is ${percent(elsewhere)}.`;
  return second
    ? `Several poses fit: the best holds ${mass} of the probability, the second ${percent(second.mass)}.`
    : `The best pose holds ${mass} of the probability.`;
}

const WITHHELD = {
  blind: "this scan says nothing",
  wide: "its standard deviation is above the limit",
  unconfirmed: "too few scans along too short a way agree with it yet",
};

/** What the tracker believes, in a sentence. */
function beliefWords({ verdict, pose, withheld, mass }) {
  if (pose) return `The robot is at ${poseWords(pose)}.`;
  if (withheld) return `One place holds ${percent(mass)}, but ${WITHHELD[withheld] ?? withheld}.`;
  return verdict === "lost" ? "The scans fit no place that the tracker knows." : `Several places fit: the best holds ${percent(mass)} of the probability.`;
}

let told = ""; // of the tracker, to those who listen

function showVerdict() {
  const { answer, set, map, index, beliefs, busy } = state, belief = beliefs[index], box = $("verdict");
  if (answer && answer.index !== index) return; // that of this scan is on its way
  const verdict = answer?.verdict ?? belief?.verdict;
  box.className = verdict ?? "";
  box.classList.toggle("waiting", busy === LOOKING && !state.following);
  $("glyph").textContent = GLYPHS[verdict] ?? "";
  if (answer) {
    say($("word"), answer.verdict);
    say($("why"), sentence(answer));
    const pose = answer.pose ? ` The sensor is at ${poseWords(answer.pose)}.` : "";
    // Once for each answer: the share of the readings comes later.
    say($("live"), `Scan ${numberOf()}: ${answer.verdict}. ${sentence({ ...answer, counted: null })}${pose}`);
  } else if (belief) {
    say($("word"), belief.verdict);
    say($("why"), beliefWords(belief));
    // Whoever listens hears of changes, and of the end, not of each scan.
    if (told !== belief.verdict || !state.following) say($("live"), `Scan ${numberOf()}: the tracker says ${belief.verdict}. ${beliefWords(belief)}`);
    told = belief.verdict;
  } else {
    const word = state.refused && busy !== LOOKING ? "No answer" : "Looking …";
    say($("word"), map ? (set ? word : "No scan yet") : "No map yet");
    if (map && set && word === "No answer") say($("live"), `Scan ${numberOf()}: no answer.`);
    say($("why"), map && !set ? "Drop a file of scans on the map." : "");
  }
  if (!state.following) told = "";
  $("hints").replaceChildren(...state.hints.map((text) => make("li", {}, text)));
  say($("tracked"), belief && answer ? `Tracker: ${belief.verdict}. ${beliefWords(belief)}` : "");
}

function showHypotheses() {
  const { answer, chosen } = state, list = $("hypotheses");
  const rows = (answer?.hypotheses ?? []).slice(0, LISTED).map((h, k) => {
    const bar = make("span", { class: "bar", "aria-hidden": "true" }, make("span"));
    bar.firstChild.style.width = `${100 * h.mass}%`;
    const place = `${fixed(h.x, 2)}, ${fixed(h.y, 2)} m`.replaceAll(" ", "\u00a0"); // breaks before the heading only
    const where = `${place}\u2002${fixed(degrees(h.theta), 1)}°`;
    return make("li", {}, make("button", {
      type: "button", "aria-pressed": String(k === chosen), onclick: () => chooseHypothesis(k),
      "aria-label": `Hypothesis ${k + 1}: ${percent(h.mass)}, ${poseWords(h)}`,
    }, make("span", { class: "rank" }, String(k + 1)), make("span", { class: "where" }, where), bar, make("span", { class: "mass" }, percent(h.mass))));
  });
  list.replaceChildren(...rows);
  const more = (answer?.evidence.found ?? 0) - rows.length, words = [];
  if (more > 0) {
    const unseen = answer.hypotheses.slice(rows.length).reduce((sum, h) => sum + h.mass, 0);
    words.push(`${more} more with ${percent(answer.evidence.unlisted + unseen)} together.`);
  }
  if (rows.length) words.push(`Elsewhere: ${percent(answer.elsewhere)}.`);
  say($("more"), words.join(" "));
  $("answer").hidden = !rows.length;
}

/** By how much a pose fits worse than the best hypothesis, as odds. */
function comparison() {
  const { fit, answer, scan, index, chosen } = state, best = answer?.hypotheses[0];
  if (!best || answer.index !== index || fit.of !== scan || fit.log_likelihood === null) return "";
  if (answer.parameters?.method !== "fused" || chosen === 0) return "";
  const nats = fit.log_likelihood - best.log_likelihood;
  const worth = Math.exp(Math.min(50, Math.abs(nats) / answer.evidence.temperature));
  const times = worth < 1.05 ? "as likely as" : `${worth < 999 ? Number(worth.toPrecision(3)) : "more than 1000"} times ${nats < 0 ? "less" : "more"} likely than`;
  return `${fixed(nats, 1)} nats against hypothesis 1: ${times} it.`;
}

function showPose() {
  const { pose, fit, scan, chosen, marks, index } = state;
  $("pose").hidden = !pose || !scan;
  if (!pose || !scan) return;
  say($("pose-title"), chosen >= 0 ? `Hypothesis ${chosen + 1}` : TITLES[chosen]);
  const { mount } = scan.given;
  say($("pose-where"), `Sensor: ${poseWords(pose)}`);
  say($("pose-robot"), mount ? `Robot: ${poseWords(robotOf(pose, mount))}` : "");
  say($("pose-score"), fit && fit.per_reading !== null ? `Fit ${fixed(fit.per_reading, 2)} of ${fixed(fit.best, 2)} (log-likelihood per reading).` : "");
  say($("pose-against"), fit ? comparison() : "");
  say($("pose-stands"), fit && !fit.stands ? "No sensor can be here: it is in a wall, or off the map." : "");
  const counts = fit?.counts ?? {}, total = Math.max(1, Object.values(counts).reduce((sum, n) => sum + n, 0));
  for (const kind of Object.keys(KINDS)) {
    const n = counts[kind] ?? 0;
    say($(`count-${kind}`), fit ? String(n) : "");
    $(`share-${kind}`).style.width = `${(100 * n) / total}%`;
    $(`row-${kind}`).hidden = n === 0 && (kind === "no_return" || kind === "invalid");
  }
  $("mark").setAttribute("aria-pressed", String(Boolean(marks[index])));
}

function showKnown() {
  const { known } = state;
  say($("known-words"), knownWords(known));
  $("clearance").value = known.clearance > 0 ? known.clearance : "";
  $("near").hidden = !known.near;
  if (known.near) {
    $("radius").value = known.near[3];
    $("turn").value = Math.round(degrees(known.near[4]));
  }
  $("forget").disabled = !isKnown(known);
  $("save-region").hidden = !known.region;
}

function showLayerRow() {
  const { layer, picture, slice } = state, likely = METHODS.includes(layer), range = $("slice");
  $("slices").hidden = !likely || !picture;
  if (likely && picture) {
    range.max = picture.slices - 1;
    range.value = slice;
    const words = slice < 0 ? "best of all headings" : `heading ${fixed(degrees(picture.theta), 0)}°`;
    say($("slice-words"), words);
    range.setAttribute("aria-valuetext", words);
  }
  const scaled = picture && layer !== "vmap";
  $("scale").hidden = !scaled;
  if (scaled) {
    const unit = layer === "distance" ? " m" : "";
    say($("scale-low"), likely ? "least likely" : `${fixed(picture.low, 1)}${unit}`);
    say($("scale-high"), likely ? "most" : `${fixed(picture.high, 1)}${unit}`);
  }
  $("atlas-key").hidden = layer !== "atlas" || !state.spots.length;
  $("legend").hidden = $("scale").hidden && $("atlas-key").hidden;
  const hints = { visibility: "Point at the map: what is seen from there.", vmap: "Colour is the direction from which a wall is seen." };
  const needs = (likely || layer === "atlas") && !state.scan ? "It is of a scan: open one." : "";
  say($("layer-hint"), needs || (hints[layer] ?? ""));
}

function showMarks() {
  const count = state.marks.filter(Boolean).length;
  say($("marked"), count ? `${count} of ${state.set?.scans ?? 0} scans have a true pose.` : "No scan has a true pose yet.");
  $("save").disabled = !count;
}

/** The key of colours and shapes, with how many readings are of each. */
function makeKey() {
  const shapes = { agrees: "●", orientation: "◆", visibility: "✕", unexplained: "○", no_return: "╵", invalid: "·" };
  $("kinds").replaceChildren(...Object.entries(KINDS).map(([kind, words]) => make(
    "li", { id: `row-${kind}`, class: kind },
    make("span", { class: "shape", "aria-hidden": "true" }, shapes[kind]), make("span", {}, words),
    make("span", { class: "bar", "aria-hidden": "true" }, make("span", { id: `share-${kind}` })),
    make("span", { class: "count", id: `count-${kind}` }),
  )));
}

/** What the reading under the pointer says, beside it. */
export function showTip(view) {
  const { scan, pose, fit, reading } = state, tip = $("tip");
  tip.hidden = reading < 0 || !scan || !pose;
  if (tip.hidden) return;
  const [head, why] = reason(scan, fit, reading);
  say($("tip-head"), head);
  say($("tip-why"), why);
  const turn = pose.theta + scan.angles[reading], range = Number.isFinite(scan.ranges[reading]) ? scan.ranges[reading] : 0;
  const [x, y] = view.pixel(pose.x + range * Math.cos(turn), pose.y + range * Math.sin(turn));
  const wide = tip.offsetWidth, high = tip.offsetHeight;
  tip.style.left = `${Math.max(8, Math.min(view.width - wide - 8, x + 14))}px`;
  tip.style.top = `${Math.max(8, y + 14 + high > view.height - 8 ? y - high - 14 : y + 14)}px`;
}

/** Paint the shapes of the key, and the panel from now on. */
export function startPanel() {
  makeKey();
  watch(["answer", "refused", "beliefs", "index", "busy", "map", "set", "following", "hints"], showVerdict);
  watch(["answer", "chosen"], showHypotheses);
  watch(["pose", "fit", "scan", "chosen", "answer", "marks", "index"], showPose);
  watch(["known"], showKnown);
  watch(["layer", "picture", "slice", "spots", "scan"], showLayerRow);
  watch(["marks", "set"], showMarks);
  watch(["blank"], () => {
    say($("blank"), state.blank);
    $("blank").hidden = !state.blank;
  });
  watch(["waiting"], () => {
    say($("working-words"), state.waiting);
    $("working").hidden = !state.waiting;
  });
  watch(["trouble"], () => {
    say($("trouble-words"), state.trouble);
    $("trouble").hidden = !state.trouble;
  });
  watch(["busy", "note", "waiting"], () => {
    const busy = state.busy && !state.waiting, words = busy ? `${state.busy} …` : state.note;
    say($("note"), words);
    $("note").hidden = !words;
    clearTimeout(fading);
    if (!busy && words) fading = setTimeout(() => change({ note: "" }), SHOWN);
  });
  for (const show of [showVerdict, showHypotheses, showPose, showKnown, showLayerRow, showMarks]) show();
}
