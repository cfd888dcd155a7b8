"""What `imgloc inspect` writes of a log: lines of text, and a picture."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imgloc.answers.causes import Cause
from imgloc.answers.logcheck import LogReport
from imgloc.answers.scanmotion import AGREES
from imgloc.errors import as_options
from imgloc.features.scanpoints import scan_xy
from imgloc.io.kinds import Kind
from imgloc.model import FloatArray, LaserScan, plain
from imgloc.output.canvas import (
    INK,
    PALETTE,
    SHADE,
    TRUTH,
    Canvas,
    Image,
    legend,
    round_length,
    scale_bar,
    text,
    text_width,
)
from imgloc.output.pictures import Picture
from imgloc.output.tables import percent

_FIRST = ("LaserScan", "PointCloud2", "Odometry", "OccupancyGrid", "TFMessage")
_SHOWN = 8  # kinds of lines, or topics
_PANEL, _GAP, _TITLE = 460, 20, 30  # pixels


def log_row(
    name: str, form: str, kinds: Sequence[Kind], report: LogReport, command: str
) -> dict[str, Any]:
    """What is in a log, as plain values: an object of `imgloc inspect --json`."""
    counts, edges = report.histogram
    return {
        "file": name,
        "format": form,
        "kinds": [{"name": k.name, "type": k.type or None, "count": k.count} for k in kinds],
        **plain(report.facts),
        "histogram": {"counts": counts.tolist(), "edges": edges.tolist()},
        "findings": [_finding(finding) for finding in report.findings],
        "next": command,
    }


def _finding(finding: Cause) -> dict[str, Any]:
    return {
        "code": finding.code,
        "text": as_options(finding.text),
        "options": as_options(finding.options),
        "serious": finding.serious,
    }


def log_text(name: str, form: str, kinds: Sequence[Kind], report: LogReport, command: str) -> str:
    """What is in a log, as lines of text."""
    facts = report.facts
    lines = [("format", form)]
    if kinds:
        seconds = (facts["stamps"] or {}).get("seconds") or math.inf
        order = sorted(kinds, key=lambda k: (k.type.rpartition("/")[2] not in _FIRST, -k.count))
        some = [f"{k.name} ({_about(k, seconds)})" for k in order[:_SHOWN]]
        more = f" and {len(kinds) - _SHOWN} more" if len(kinds) > _SHOWN else ""
        lines.append(("contains", ", ".join(some) + more))
    if (log := facts["recording"]) is not None:
        lines.append(("taken", _taken(log)))
    lines += [
        ("scans", f"{facts['scans']:,} of {_rays(facts)}"),
        ("ranges", _ranges(facts)),
        (
            "readings",
            ", ".join(f"{k.replace('_', ' ')} {percent(v)}" for k, v in facts["shares"].items()),
        ),
        ("stamps", _stamps(facts["stamps"])),
        ("odometry", _odometry(facts["odometry"])),
        ("poses", _poses(facts)),
        ("sensor", _sensor(facts["sensor"])),
    ]
    if facts["agreement"] is not None:
        share = f"{100 * facts['agreement']:.0f} % of the readings of a scan fall on an earlier one"
        verdict = "good" if facts["agreement"] >= AGREES else "poor"
        lines.append(("agreement", f"{verdict}: {share}, moved by the odometry"))
    if facts["straightened"] is not None:
        ways = (f"{100 * share:.0f} % with `straighten={way}`"
                for way, share in facts["straightened"].items())  # fmt: skip
        lines.append(("sweeps", as_options(f"take time: {', '.join(ways)}")))
    if "on_map" in facts:
        lines.append(("on the map", _on_map(facts)))
    found = "none" if not report.findings else str(len(report.findings))
    out = [name, *(f"  {key:<11} {value}" for key, value in lines), f"  {'findings':<11} {found}"]
    out += [f"    {f.code}: {as_options(f.said)}" for f in report.findings]
    return "\n".join([*out, f"  {'next':<11} {command}"])


def _taken(log: Mapping[str, Any]) -> str:
    """Which laser and which odometry, and why."""
    odometry = f"odometry {log['odometry']} ({log['why']})" if log["odometry"] else "no odometry"
    return f"scans {log['taken']}, {odometry}"


def _about(kind: Kind, seconds: float) -> str:
    """How many, of which type, how often."""
    rate = f", {kind.count / seconds:.3g}/s" if kind.count > 1 and seconds < math.inf else ""
    return f"{kind.count:,}" + (f" {kind.type.rpartition('/')[2]}" if kind.type else "") + rate


def _rays(facts: Mapping[str, Any]) -> str:
    rays = facts["rays"]
    count = f"{rays[0]:,} to {rays[1]:,}" if isinstance(rays, list) else f"{rays:,}"
    return f"{count} rays, {facts['first_deg']:.4g} to {facts['last_deg']:.4g} degrees"


def _ranges(facts: Mapping[str, Any]) -> str:
    reach = facts["range_max"]
    most = f"range_max {reach:g} m" if math.isfinite(reach) else "no range_max"
    if facts["median"] is None:
        return f"no valid reading, {most}"
    return f"half below {facts['median']:.2f} m, the longest {facts['longest']:.2f} m, {most}"


def _stamps(times: Mapping[str, Any] | None) -> str:
    if times is None:
        return "none"
    rate = times["per_second"]
    said = f"{times['seconds']:.1f} s" + ("" if rate is None else f", usually {rate:.3g} scans/s")
    said += f", longest gap {times['longest_gap']:.3g} s after scan {times['gap_after']}"
    said += f", {times['back']:,} go back" if times["back"] else ""
    return said + (f", {times['equal']:,} equal" if times["equal"] else "")


def _odometry(odometry: Mapping[str, Any] | None) -> str:
    if odometry is None:
        return "none"
    turned = f"turns {odometry['turned_deg']:.0f} degrees"
    still = f"stands still {percent(odometry['still'])} of the time"
    step = f"longest step {odometry['longest_step']:.2g} m"
    return f"{odometry['metres']:.1f} m, {turned}, {still}, {step}"


def _poses(facts: Mapping[str, Any]) -> str:
    if not facts["poses"]:
        return (
            "the odometry fits the map, too" if facts.get("odometry_fits") else "none but odometry"
        )
    if facts["poses"] == "odometry":
        return "the same as the odometry" + ("" if "on_map" in facts else "; a map tells more")
    fits = {True: "; they fit the map", False: "; they do not fit the map", None: ""}
    beside = "recorded, beside the odometry" if facts["odometry"] else "recorded"
    return beside + fits[facts.get("poses_fit")]


def _sensor(sensor: Sequence[float] | None) -> str:
    if sensor is None:
        return "its place on the robot is not recorded"
    x, y, turn = (round(value, 4) + 0.0 for value in sensor)  # no minus before zero
    return f"on the robot at x {x:.3g} m, y {y:.3g} m, turned by {turn:.4g} degrees"


def _on_map(facts: Mapping[str, Any]) -> str:
    verdicts = ", ".join(f"{n} {verdict}" for verdict, n in facts["on_map"].items() if n)
    new, tried = facts["not_on_map"], sum(facts["on_map"].values())
    if not tried:
        return "no scan to try"
    ends = "" if new is None else f"; {100 * new:.0f} % of their rays end where the map is empty"
    return f"{tried} scan{'s' if tried > 1 else ''} tried: {verdicts}{ends}"


def draw_log(name: str, report: LogReport, scan: LaserScan) -> Picture:
    """Draw the path of the odometry, one scan, and the histogram of ranges."""
    panels = [
        _titled(_path(report.path), _path_title(report)),
        _titled(_scan(scan), f"scan {report.scan}: {int(scan.valid.sum()):,} readings"),
        _titled(_bars(report, scan.range_max, shown=_shows(report, scan)), "ranges, metres"),
    ]
    gap = np.full((panels[0].shape[0], _GAP, 3), 255, np.uint8)
    row = np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)
    head = np.full((_TITLE, row.shape[1], 3), 255, np.uint8)
    text(head, name[-120:], 8, 20)
    colours = [(PALETTE[1], "way"), (PALETTE[2], "first pose"), (PALETTE[0], "last pose; sensor"),
               (INK, "readings")]  # fmt: skip
    colours += [(TRUTH, "range_max")] if _shows(report, scan) else []
    return Picture(legend(np.concatenate((head, row)), colours))


def _shows(report: LogReport, scan: LaserScan) -> bool:
    """Whether range_max is on the axis of the ranges."""
    return bool(scan.range_max <= report.histogram[1][-1] * 1.02)


def _path_title(report: LogReport) -> str:
    if report.path is None:
        return "no odometry"
    metres = float(np.hypot(*np.diff(report.path[:, :2], axis=0).T).sum())
    return f"{'odometry' if report.facts['odometry'] else 'poses'}: {metres:.1f} m"


def _titled(image: Image, title: str) -> Image:
    head = np.full((_TITLE, image.shape[1], 3), 255, np.uint8)
    text(head, title, 4, 20)
    return np.concatenate((head, image))


def _panel(xy: FloatArray) -> tuple[Canvas, FloatArray]:
    """A canvas that points (N, 2) fit, and where its lower left corner is."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    side = max(float((high - low).max()) * 1.1, 1.0)
    image = np.full((_PANEL, _PANEL, 3), 255, np.uint8)
    image[[0, -1]] = SHADE
    image[:, [0, -1]] = SHADE
    return Canvas(image, _PANEL / side), (low + high) / 2 - side / 2


def _path(path: FloatArray | None) -> Image:
    if path is None or len(path) < 2:
        return _panel(np.zeros((1, 2)))[0].image
    canvas, corner = _panel(path[:, :2])
    at = path[:, :2] - corner
    canvas.lines(at[None], PALETTE[1], 2)
    for k, colour in ((0, PALETTE[2]), (-1, PALETTE[0])):
        canvas.robot(at[k, 0], at[k, 1], path[k, 2], colour, 6)
    scale_bar(canvas)
    return canvas.image


def _scan(scan: LaserScan) -> Image:
    xy = np.concatenate((np.zeros((1, 2)), scan_xy(scan)))
    canvas, corner = _panel(xy)
    canvas.dots(xy[1:] - corner, INK, 1.6)
    canvas.robot(-corner[0], -corner[1], 0.0, PALETTE[0], 6)
    scale_bar(canvas)
    return canvas.image


def _bars(report: LogReport, range_max: float, *, shown: bool) -> Image:
    counts, edges = report.histogram
    image = np.full((_PANEL, _PANEL, 3), 255, np.uint8)
    base, left, wide = _PANEL - 30, 10, _PANEL - 20
    scale = wide / max(float(edges[-1]), 1e-9)
    tall = (base - 20) / max(float(counts.max(initial=0.0)), 1.0)
    for count, low, high in zip(
        counts.tolist(), edges[:-1].tolist(), edges[1:].tolist(), strict=True
    ):
        x0, x1 = (left + round(edge * scale) for edge in (low, high))
        image[base - round(count * tall) : base, x0 : max(x0 + 1, x1 - 1)] = INK
    image[base : base + 2, left : left + wide] = INK
    step = round_length(max(float(edges[-1]), 1e-6) / 3)
    for k in range(int(edges[-1] / step + 1e-9) + 1):
        x = left + round(k * step * scale)
        image[base : base + 7, min(x, _PANEL - 1)] = INK
        label = f"{k * step:g}"
        text(image, label, min(x, _PANEL - 4 - text_width(label)), base + 22)
    if shown:
        image[20:base, min(left + round(range_max * scale), _PANEL - 2)] = TRUTH
    return image
