"""The report of `imgloc inspect` on a log: lines of text, and a picture."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imgloc.answers.logcheck import LogReport
from imgloc.answers.scanmotion import AGREES, POOR
from imgloc.errors import as_options
from imgloc.features.scanpoints import scan_xy
from imgloc.io.kinds import Kind
from imgloc.model import FloatArray, LaserScan, plain
from imgloc.output.canvas import INK, PALETTE, TRUTH, Colour, Picture
from imgloc.output.plots import blank, ink, words
from imgloc.output.tables import percent

_FIRST = ("LaserScan", "PointCloud2", "Odometry", "OccupancyGrid", "TFMessage")
_FINDING = ("code", "text", "options", "serious")
_SHOWN = 8  # kinds of lines, or topics


def log_row(
    name: str, form: str, kinds: Sequence[Kind], report: LogReport, command: str
) -> dict[str, Any]:
    """The contents of a log as plain values: an object of `imgloc inspect --json`."""
    counts, edges = report.histogram
    said = ((f.code, as_options(f.text), as_options(f.options), f.serious) for f in report.findings)
    return {
        "file": name,
        "format": form,
        "kinds": [{"name": k.name, "type": k.type or None, "count": k.count} for k in kinds],
        **plain(report.facts),
        "histogram": {"counts": counts.tolist(), "edges": edges.tolist()},
        "findings": [dict(zip(_FINDING, finding, strict=True)) for finding in said],
        "next": command,
    }


def log_text(name: str, form: str, kinds: Sequence[Kind], report: LogReport, command: str) -> str:
    """The contents of a log as lines of text."""
    facts = report.facts
    lines = [("format", form)]
    if kinds:
        seconds = (facts["stamps"] or {}).get("seconds") or math.inf
        order = sorted(kinds, key=lambda k: (k.type.rpartition("/")[2] not in _FIRST, -k.count))
        some = [f"{k.name} ({_about(k, seconds)})" for k in order[:_SHOWN]]
        more = f" and {len(kinds) - _SHOWN} more" if len(kinds) > _SHOWN else ""
        lines.append(("contains", ", ".join(some) + more))
    if (log := facts["recording"]) is not None:
        odometry = f"odometry {log['odometry']} ({log['why']})"
        taken = f"scans {log['taken']}, {odometry if log['odometry'] else 'no odometry'}"
        lines.append(("taken", taken))
    shares = (f"{key.replace('_', ' ')} {percent(n)}" for key, n in facts["shares"].items())
    lines += [
        ("scans", f"{facts['scans']:,} of {_rays(facts)}"),
        ("ranges", _ranges(facts)),
        ("readings", ", ".join(shares)),
        ("stamps", _stamps(facts["stamps"])),
        ("odometry", _odometry(facts["odometry"])),
        ("poses", _poses(facts)),
        ("sensor", _sensor(facts["sensor"])),
    ]
    if facts["agreement"] is not None:
        share = f"{100 * facts['agreement']:.0f} % of the readings of a scan fall on an earlier one"
        verdict = ("poor", "fair", "good")[sum(facts["agreement"] >= x for x in (POOR, AGREES))]
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


def _about(kind: Kind, seconds: float) -> str:
    """The count, type and rate of a kind of message."""
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
        fits_too = facts.get("odometry_fits")
        return "the odometry fits the map, too" if fits_too else "none but odometry"
    if facts["poses"] == "odometry":
        return "the same as the odometry" + ("" if "on_map" in facts else "; a map tells more")
    fits = {
        True: "; they fit the map",
        False: "; they do not fit the map, and are taken for odometry",
        None: "",
    }
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
    sure, none = (2 * facts["on_map"][verdict] > tried for verdict in ("unique", "no-match"))
    agrees = "good" if sure else "poor" if none else "undecided"
    out = f"{agrees}, {tried} scan{'s' if tried > 1 else ''} tried: {verdicts}{ends}"
    if way := facts.get("followed"):
        out += f"; followed for {way['metres']:.0f} m: {way['unique']} of {way['scans']} unique"
    return out


def draw_log(name: str, report: LogReport, scan: LaserScan) -> Picture:
    """Draw the path of the odometry, one scan, and the histogram of ranges."""
    figure, pixels = blank(14.4, 5.6, layout="constrained")
    figure.suptitle(words(name[-120:]))
    way, seen, ranges = figure.subplots(1, 3)
    path, (counts, edges) = report.path, report.histogram
    metres = 0.0
    if path is not None and len(path) > 1:
        metres = float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum())
        way.plot(*path[:, :2].T, color=ink(PALETTE[1]), label="way")
        _pose(way, path[0], PALETTE[2], "first pose")
        _pose(way, path[-1], PALETTE[0], "last pose")
    what = "odometry" if report.facts["odometry"] else "poses"
    way.set_title("no odometry" if path is None else f"{what}: {metres:.1f} m")
    seen.plot(*scan_xy(scan)[scan.valid].T, ".", color=ink(INK), markersize=3, label="readings")
    _pose(seen, (0.0, 0.0, 0.0), PALETTE[3], "sensor")
    seen.set_title(f"scan {report.scan}: {int(scan.valid.sum()):,} readings")
    for axes in (way, seen):
        axes.set(xlabel="x / m", ylabel="y / m", aspect="equal", adjustable="datalim")
    ranges.stairs(counts, edges, fill=True, color=ink(INK))
    ranges.set(title="ranges", xlabel="range / m", ylabel="readings", xlim=(0.0, edges[-1] * 1.03))
    if scan.range_max <= edges[-1] * 1.02:
        ranges.axvline(scan.range_max, color=ink(TRUTH), label="range_max")
    figure.legend(loc="outside lower left", ncols=6, frameon=False)
    return Picture(pixels())


def _pose(axes: Any, pose: Sequence[float] | FloatArray, colour: Colour, label: str) -> None:
    """A triangle that points where the robot looks."""
    x, y, theta = (float(value) for value in pose)
    marker = (3, 0, math.degrees(theta) - 90)
    axes.plot([x], [y], linestyle="", marker=marker, markersize=13, color=ink(colour), label=label)
