// Mouse, pen and fingers on the map: what is under them is dragged, turned, drawn, or looked at.

import { chooseHypothesis, know, look, place } from "./actions.js";
import { wrap } from "./geometry.js";
import { RADIUS, TURN } from "./known.js";
import { handleOf } from "./paint.js";
import { readingAt } from "./scan.js";
import { change, state } from "./state.js";
import { closeRegion, rectangle, setCorner } from "./tools.js";

const TAP = 6; // pixels that a finger may shake
const CLOSE = 12; // pixels around the first corner, in which a click closes the region
const apart = ([ax, ay], [bx, by]) => Math.hypot(ax - bx, ay - by);

/** Drag the scan: its pose follows the pointer. */
function moving(view, start) {
  const { pose } = state, from = view.point(...start);
  return { move: (at) => {
    const to = view.point(...at);
    place({ ...pose, x: pose.x + to.x - from.x, y: pose.y + to.y - from.y });
  } };
}

/** Turn the scan: its heading follows the pointer. */
function turning(view) {
  return { move: (at) => {
    const { pose } = state, to = view.point(...at);
    place({ ...pose, theta: Math.atan2(to.y - pose.y, to.x - pose.x) });
  } };
}

/** Draw a region: a rectangle by dragging, corner after corner by clicks. */
function drawingRegion(view, start, sketch) {
  const first = view.point(...start), from = [first.x, first.y];
  let box = [];
  return {
    move: (at) => {
      const { x, y } = view.point(...at);
      box = rectangle(from, [x, y]);
      sketch({ region: box });
    },
    tap: () => setCorner(first, CLOSE / view.scale),
    end: () => {
      sketch(null);
      if (box.length) closeRegion(box);
    },
  };
}

/** Draw an arrow: where it begins is the place, where it points the heading; a tap has no heading. */
function drawingArrow(view, start, sketch) {
  const { x, y } = view.point(...start);
  let near = [x, y, 0, RADIUS, Math.PI];
  sketch({ near });
  return {
    move: (at) => {
      const to = view.point(...at);
      if (apart(start, at) > TAP) near = [x, y, wrap(Math.atan2(to.y - y, to.x - x)), RADIUS, TURN];
      sketch({ near });
    },
    end: () => {
      sketch(null);
      know({ near });
    },
  };
}

/** What a press begins: an object with `move`, and perhaps `end` and `tap`. */
function begin(view, at, touch, sketch) {
  if (state.tool === "region") return drawingRegion(view, at, sketch);
  if (state.tool === "arrow") return drawingArrow(view, at, sketch);
  const reach = touch ? 24 : 14, { pose, scan } = state;
  if (scan && pose) {
    if (apart(at, handleOf(view, pose)) < reach) return turning(view);
    if (apart(at, view.pixel(pose.x, pose.y)) < reach + 4) return moving(view, at);
  }
  const shown = (state.answer?.hypotheses ?? []).slice(0, 20);
  const hit = shown.findIndex((h) => apart(at, view.pixel(h.x, h.y)) < reach);
  let before = at;
  return {
    move: (now) => {
      view.pan(now[0] - before[0], now[1] - before[1]);
      before = now;
    },
    tap: () => {
      if (hit >= 0) chooseHypothesis(hit);
      else if (state.layer === "visibility") look(view.point(...at));
      else if (scan && pose) change({ reading: readingAt(view, scan, pose, ...at, touch ? 22 : 12) });
    },
  };
}

/**
 * Listen to pointers on a canvas.
 *
 * `redraw` is called when the view has moved, `sketch` with what is being drawn by hand.
 */
export function listen(canvas, view, { redraw, sketch }) {
  const down = new Map(); // pointers that are down: id to [x, y]
  let drag = null, start = null, spread = 0;
  const where = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const pair = () => {
    const [[ax, ay], [bx, by]] = [...down.values()];
    return { at: [(ax + bx) / 2, (ay + by) / 2], spread: Math.hypot(ax - bx, ay - by) };
  };
  let middle = null;

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 0) return;
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, where(event));
    if (down.size === 2) { // two fingers move and enlarge the map, whatever one has begun
      drag = null;
      sketch(null);
      ({ at: middle, spread } = pair());
    } else if (down.size === 1) {
      start = where(event);
      drag = begin(view, start, event.pointerType === "touch", sketch);
    }
  });
  canvas.addEventListener("pointermove", (event) => {
    const at = where(event);
    if (!down.has(event.pointerId)) {
      hover(at);
      return;
    }
    down.set(event.pointerId, at);
    if (down.size === 2) {
      const now = pair();
      view.pan(now.at[0] - middle[0], now.at[1] - middle[1]);
      view.zoom(now.spread / Math.max(1, spread), ...now.at);
      ({ at: middle, spread } = now);
    } else if (drag && (drag.moved || apart(at, start) > (event.pointerType === "touch" ? TAP : 2))) {
      drag.moved = true;
      drag.move(at);
    }
    redraw();
  });
  const up = (event) => {
    if (!down.delete(event.pointerId) || !drag) return;
    if (event.type === "pointerup") {
      if (!drag.moved) drag.tap?.();
      drag.end?.();
    } else {
      sketch(null);
    }
    drag = null;
    redraw();
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("pointerleave", (event) => {
    if (!down.size && event.pointerType === "mouse") change({ reading: -1 });
  });
  canvas.addEventListener("dblclick", (event) => {
    if (state.tool === "region" && state.drawn.length) closeRegion();
    if (!state.scan || state.tool !== "move") return;
    const { x, y } = view.point(...where(event));
    place({ x, y, theta: state.pose?.theta ?? 0 });
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 20 : 1;
    view.zoom(Math.exp(-0.0015 * lines * event.deltaY), ...where(event));
    redraw();
  }, { passive: false });

  function hover(at) {
    const { scan, pose, tool } = state;
    if (state.layer === "visibility") look(view.point(...at));
    if (tool !== "move") {
      canvas.dataset.cursor = "draw";
      if (state.drawn.length) change({ cursor: view.point(...at) });
      return;
    }
    const turn = scan && pose && apart(at, handleOf(view, pose)) < 14;
    const take = scan && pose && apart(at, view.pixel(pose.x, pose.y)) < 18;
    canvas.dataset.cursor = turn || take ? "take" : "";
    change({ reading: scan && pose && !turn && !take ? readingAt(view, scan, pose, ...at) : -1 });
  }
}
