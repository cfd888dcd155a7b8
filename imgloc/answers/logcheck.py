"""What is in a log of scans, and what is likely to be wrong with it, before it is used.

>>> from imgloc.model import LaserScan
>>> scan = LaserScan(np.full(90, 2000.0), np.linspace(-1.5, 1.5, 90))
>>> report = check_log(ScanSet((scan,)))
>>> report.findings[0].code, report.findings[0].options
('units', '`range_scale=0.001`')
"""

import itertools
import logging
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from imgloc.answers.diagnose import (
    OLD,
    UNITS,
    Doubt,
    Given,
    doubts,
    few_readings,
    mirrored,
    unit_of,
)
from imgloc.answers.scanmotion import (
    AGREES,
    POOR,
    Agreement,
    Way,
    agreement,
    overlap,
    straightening,
)
from imgloc.answers.truth import NOT_TRUE, poses_fit
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import evenly
from imgloc.io.scanset import ScanSet
from imgloc.model import VERDICTS, FloatArray, LaserScan, Localization, Pose2D, base_of, compose
from imgloc.numbers import number
from imgloc.options import RADIUS, TOLERANCE, Options, Trust
from imgloc.pipeline import localize, localize_many
from imgloc.robot.recording import Recording

_LOG = logging.getLogger("imgloc")
_SPIKE, _BIN, _OFTEN, _WIDE, _VALUES = number("logcheck.code")
_SECONDS, _TIMES, _METRES = number("logcheck.gap")
_LEAP, _BEYOND = number("logcheck.jump")
_FAST = number("logcheck.fast")
_REPEATED, _TWICE = number("logcheck.repeats")
_LACKS = number("logcheck.lacks")
_BODY = number("logcheck.body")
_FEW, _CLOSE = number("logcheck.few")
_STANDS = number("logcheck.stands")
_BARS = number("logcheck.bars")
_MANY = number("logcheck.many")
_LOCATED = number("logcheck.located")
MIRRORED = number("logcheck.mirrored")
_OLD = number("logcheck.old")
FOLLOWED: float = number("logcheck.followed")
"""Share of unique poses from which a robot counts as followed, so that nothing is looked for."""
MIRRORED_MAP = (
    "scans fit the map only if mirrored, but agree with the odometry as they are: the image of the "
    "map is mirrored"
)
_UNDONE = {"units", "flipped", "few", "two-lasers", "view"}  # with which no scan fits a map


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a log, most likely."""

    code: str  #: one word that names it, the same in every version
    text: str  #: a sentence or two
    options: str = ""  #: arguments that mend it, in backquotes
    serious: bool = True  #: whether the robot cannot be followed as long as it is so

    @property
    def said(self) -> str:
        """The sentences, and which arguments to pass."""
        if all(option in self.text for option in self.options.split()):
            return self.text
        return f"{self.text}{' ' if self.text.endswith('?') else '. '}Pass {self.options}"


@dataclass(frozen=True, eq=False)
class LogReport:
    """What is in a log, and what is likely to be wrong with it."""

    facts: Mapping[str, Any]  #: plain values, by name; metres, seconds, degrees as names say
    findings: tuple[Finding, ...]
    histogram: tuple[FloatArray, FloatArray]  #: readings (N,) between edges (N + 1,), metres
    path: FloatArray | None = None  #: (M, 3) odometry, or known poses without any
    scan: int = 0  #: a scan that sees much

    @property
    def options(self) -> str:
        """The arguments that mend what was found, in backquotes."""
        return " ".join(dict.fromkeys(f.options for f in self.findings if f.options))

    @property
    def can_be_followed(self) -> bool:
        """Whether the log has odometry of a robot that moves, and nothing serious is unmended."""
        moves = self.facts.get("odometry") is not None and self.facts["odometry"]["metres"] > 1
        return moves and not any(f.serious and not f.options for f in self.findings)


def as_given(report: LogReport, given: Given) -> LogReport:
    """The report of scans that were taken for those of a sensor upside down, if it is `given`."""
    findings = list(report.findings)
    for k, found in enumerate(findings):
        if given.flipped and found.code == "flipped":
            text = found.text.replace("hangs", "does not hang")
            findings[k] = replace(found, text=f"{text}. {given.advice(found.options)}")
    return replace(report, findings=tuple(findings))


def check_log(scans: ScanSet, notes: Sequence[Finding] = ()) -> LogReport:
    """Look at the scans, stamps and odometry of a log; no map is needed.

    Parameters
    ----------
    scans : ScanSet
    notes : sequence of Finding
        What the reader of the file has found.
    """
    findings = list(notes)
    found = {finding.code for finding in findings}
    facts: dict[str, Any] = {"scans": len(scans)}
    facts |= _about_readings(scans, findings)
    times = _about_stamps(scans)
    facts |= {"stamps": times}
    if times and not times["seconds"]:
        _add(findings, "stamps", "all stamps are the same: they are no times", fatal=False)
        times = None
    if times and times["back"]:
        _add(findings, "order", _back_words(times["back"]), fatal=False)
    path = scans.odom if scans.odom is not None else scans.poses
    known = np.zeros(0, bool) if path is None else np.isfinite(path).all(axis=1)
    poses = "odometry" if scans.poses_are_odometry else scans.poses is not None
    facts |= {"odometry": None, "poses": poses, "agreement": None}
    facts["straightened"] = None
    if scans.odom is not None:
        facts["odometry"] = _about_odometry(scans, found, findings)
    if path is not None and known.sum() > 1:
        some = scans.take(np.flatnonzero(known).tolist())
        path = np.asarray(path[known])
        _about_gaps(some, path, times, findings)
        if "odometry-zero" not in {f.code for f in findings} or path[:, :2].any():
            facts["agreement"] = _about_motion(some, path, findings)
            facts["straightened"] = straightening(some, path)
    facts["recording"] = asdict(scans.recording) if scans.recording.taken else None
    _about_sources(scans.recording, findings)
    _about_repeats(scans, path, findings)
    _about_lasers(scans, findings)
    edges = np.linspace(0.0, max(facts["longest"] or 1.0, 1e-6), int(_BARS) + 1)
    seen = _seen(scans)
    histogram = np.histogram(seen, edges)[0].astype(np.float64), edges
    best = int(np.argmax([scan.directions for scan in scans.scans[:_MANY]]))
    return LogReport(facts, tuple(_sorted(findings)), histogram, path, best)


def warn_of(scans: ScanSet, name: str) -> None:
    """Log what is wrong with a log called `name`, where the answers of a command suffer from it."""
    for finding in check_log(scans).findings:
        if finding.serious:
            _LOG.warning("%s: %s", name, finding.said)


def on_map(
    report: LogReport, scans: ScanSet, features: MapFeatures, options: Options,
    given: Given | None = None,
) -> LogReport:  # fmt: skip
    """The report, with what the map tells: whether scans and poses fit it, and how much is new.

    A few scans are located; what keeps them from fitting is tried.
    """
    some, answers = located(features, scans, options)
    facts, findings = dict(report.facts), list(report.findings)
    facts["on_map"] = {v: sum(a.verdict == v for a in answers) for v in VERDICTS}
    sure = [answer.explained for answer in answers if answer.verdict == "unique"]
    facts["not_on_map"] = 1 - float(np.median(sure)) if sure else None
    said = [(answer.verdict, answer.evidence) for answer in answers]
    known, causes = {finding.code for finding in findings}, list[Doubt]()
    if not _UNDONE & known:
        if 2 * len(sure) < len(answers):
            causes = doubts(features, some, said, options, given)
        elif found := mirrored(features, some, said, options, given):
            causes = [found]
    for doubt in causes:
        agrees = facts["agreement"]
        if doubt.code == "mirrored" and agrees is not None and agrees >= MIRRORED:
            findings.append(Finding("mirrored", MIRRORED_MAP, doubt.options))
        elif doubt.code != "thick":  # whose advice is to follow the robot
            code = "flipped" if doubt.code == "mirrored" else "map"
            serious = code == "flipped" or not sure
            findings.append(Finding(code, doubt.text, doubt.options, serious))
    facts["poses_fit"] = facts["odometry_fits"] = None
    if not _UNDONE & {finding.code for finding in findings}:
        if scans.poses is not None:
            facts["poses_fit"] = poses_fit(features.grid, scans.scans, scans.poses)
            if facts["poses_fit"] is False and sure:
                findings.append(Finding("poses", NOT_TRUE, serious=False))
        if scans.odom is not None and np.isfinite(scans.odom).all():
            at = sensor_poses(scans)
            facts["odometry_fits"] = poses_fit(features.grid, scans.scans, at)
    return replace(report, facts=facts, findings=tuple(_sorted(findings)))


def located(
    features: MapFeatures, scans: ScanSet, options: Options
) -> tuple[ScanSet, list[Localization]]:
    """A few scans of a log that see enough, from all of it, and their answers."""
    some = [k for k, s in enumerate(scans.scans) if s.directions >= options.trust.readings]
    few = scans.take([some[k] for k in evenly(len(some), _LOCATED).tolist()])
    return few, list(localize_many(features, few.scans, options))


def doubt_of_log(
    features: MapFeatures, scans: ScanSet, options: Options, given: Given,
    followed: float = 0.0, start: Pose2D | None = None,
) -> Doubt | None:  # fmt: skip
    """Say what most likely keeps a robot from being followed through a log; None if nothing is.

    What the scans and the odometry tell without a map comes first if it keeps scans from fitting
    any map. Then a few scans are located: either they do not fit this map, or the `start` (map
    frame), the odometry or the place of the sensor is wrong. `followed` is the share of the scans
    with a unique pose along the way: if it is not small, a map that they do not fit is an old one.
    """
    report = check_log(scans)
    serious = [finding for finding in report.findings if finding.serious]
    first = next((f for f in serious if f.code in _UNDONE - {"units", "few"}), None)
    some, answers = located(features, scans, options)
    if first is None:
        said = [(answer.verdict, answer.evidence) for answer in answers]
        found = next(iter(doubts(features, some, said, options, given)), None)
        agrees = report.facts["agreement"]
        if found and found.code == "mirrored" and agrees is not None and agrees >= MIRRORED:
            text = f"{MIRRORED_MAP}. {given.advice(found.options)}"
            return Doubt("mirrored", text, "the map is mirrored", found.options)
        if found is not None and found.code == "map" and followed >= _OLD:
            text = (
                f"most scans do not fit this map by themselves, but {100 * followed:.0f} % have a "
                "unique pose along the way: the map may be old. imgloc map changes MAP SCANS shows "
                "where"
            )
            return Doubt("old", text, OLD, found=False)
        if found is not None and found.code != "thick":  # whose advice is to follow the robot
            return found
        if start is not None and (wrong := _started(features, scans, options, start)):
            return wrong
        first = serious[0] if serious else None
    if first is None:
        return None
    end = " " if first.text.endswith("?") else ". "
    mended = f"{end}{given.advice(first.options)}" if first.options else ""
    text = first.text
    if first.code == "flipped" and given.flipped:
        text = text.replace("hangs", "does not hang")
    return Doubt(first.code, f"{text}{mended}", text, first.options)


def _started(
    features: MapFeatures, scans: ScanSet, options: Options, start: Pose2D
) -> Doubt | None:
    """The first scan fits at one place, far from where the robot was said to start."""
    answer = localize(features, scans[0], options)
    if answer.verdict != "unique" or answer.pose is None:
        return None
    at = base_of(answer.pose, scans[0].T_base_laser or Pose2D(0.0, 0.0))
    away = math.hypot(at.x - start.x, at.y - start.y)
    turned = abs(Pose2D(0.0, 0.0, at.theta - start.theta).theta)
    if away <= RADIUS and turned <= TOLERANCE:
        return None
    text = (
        f"the first scan fits this map at x {at.x:.2f} m, y {at.y:.2f} m, theta "
        f"{math.degrees(at.theta):.0f} degrees, {away:.1f} m from `start`: is it right?"
    )
    return Doubt("start", text, "`start` is wrong")


def _back_words(count: int) -> str:
    return "a stamp goes back" if count == 1 else f"{count:,} stamps go back"


def _add(
    findings: list[Finding], code: str, text: str, options: str = "", *, fatal: bool = True
) -> None:
    if code not in {finding.code for finding in findings}:
        findings.append(Finding(code, text, options, fatal))


def _sorted(findings: Sequence[Finding]) -> list[Finding]:
    return sorted(findings, key=lambda finding: not finding.serious)


def _some(scans: ScanSet) -> Sequence[LaserScan]:
    """At most so many scans of a log, from all of it."""
    return scans.scans[:: max(1, len(scans) // _MANY)]


def _seen(scans: ScanSet) -> FloatArray:
    """The valid ranges of some scans, metres."""
    return np.concatenate([scan.ranges[scan.valid] for scan in _some(scans)])


def _about_readings(scans: ScanSet, findings: list[Finding]) -> dict[str, Any]:
    some, seen = _some(scans), _seen(scans)
    first, counts = scans[0], [scan.counts for scan in some]
    total = {key: sum(each[key] for each in counts) for key in counts[0]}
    count = max(1, sum(total.values()))
    rays = sorted({len(scan.ranges) for scan in scans.scans})
    reach = sorted({scan.range_max for scan in scans.scans})
    mount = first.T_base_laser
    facts = {
        "rays": rays[0] if len(rays) == 1 else [rays[0], rays[-1]],
        "first_deg": math.degrees(first.angles[0]),
        "last_deg": math.degrees(first.angles[-1]),
        "range_max": reach[-1],
        "median": float(np.median(seen)) if len(seen) else None,
        "longest": float(seen.max()) if len(seen) else None,
        "shares": {key: n / count for key, n in total.items()},
        "sensor": None if mount is None else [mount.x, mount.y, math.degrees(mount.theta)],
    }
    raw = np.concatenate([scan.ranges for scan in some])
    middle = float(np.median(raw[np.isfinite(raw) & (raw > 0)])) if (raw > 0).any() else 0.0
    if unit := unit_of(middle):
        text = f"half of the ranges are above {middle:.4g} m: are these {unit}?"
        _add(findings, "units", text, f"`range_scale={UNITS[unit]:g}`")
        return facts
    if (code := _code(seen)) is not None:
        low, top = code
        which = f"exactly {top:g} m" if low == top else f"{low:g} to {top:g} m"
        text = (
            f"{np.mean(seen >= low):.1%} of the readings are {which}, and none is longer: it is "
            "the sensor's code for a ray that met nothing"
        )
        _add(findings, "codes", text, f"`range_max={low:g}`")
    few = np.median([scan.directions for scan in some]) < Trust().readings
    if few or total["valid"] < _FEW * count:
        why = "is range_max right?"
        if float(np.mean(raw == 0)) > _CLOSE:
            why = "most are 0, which drivers write where the sensor sees nothing"
        _add(findings, "few", f"few readings can be used: {few_readings(some)}; {why}")
    elif total["too_close"] > _CLOSE * count:
        zeros = float(np.mean(raw == 0))
        what = (
            f"{zeros:.0%} of the readings are 0"
            if zeros > _CLOSE
            else (f"{total['too_close'] / count:.0%} of the readings are closer than range_min")
        )
        text = (
            f"{what}: the driver writes that where the sensor sees nothing, or its view is blocked"
        )
        _add(findings, "too-close", text, fatal=False)
    _about_body(some, findings)
    return facts


def _code(seen: FloatArray) -> tuple[float, float] | None:
    """The least and the greatest of the longest readings, if too many are so far to be distances.

    They are one value, or a few values side by side with a gap below.
    """
    if len(seen) < _BIN:
        return None
    top = float(seen.max())
    for width in (0.0, _WIDE * top):
        there = np.unique(seen[seen >= top - width])
        often = int(np.count_nonzero(seen >= there[0]))
        near = np.count_nonzero((seen < there[0]) & (seen > 0.9 * top))
        if often >= max(_OFTEN, _SPIKE * len(seen), near + 1) and len(there) <= _VALUES:
            return float(there[0]), top
    return None


def _about_body(some: Sequence[LaserScan], findings: list[Finding]) -> None:
    """Rays that see the robot itself: always as near, whatever the others see."""
    if len(some) < _BIN or len({len(scan.ranges) for scan in some}) > 1:
        return
    table = np.where([scan.valid for scan in some], [scan.ranges for scan in some], np.nan)
    there = np.isfinite(table).mean(axis=0) > 0.9
    if not there.any():
        return
    low, middle, high = np.nanpercentile(table[:, there], (5, 50, 95), axis=0)
    near, spread, share = _BODY
    body = (middle < near) & (high - low < spread)
    if body.mean() < share or np.median(high - low) < 4 * spread:
        return
    at = np.flatnonzero(there)[body]
    text = (
        f"{len(at):,} rays, from ray {at[0]} to ray {at[-1]}, always see something "
        f"{np.median(middle[body]):.2f} m away: is it the robot itself? Raise range_min of the "
        "file, or leave these rays out"
    )
    _add(findings, "own-body", text, fatal=False)


def _about_stamps(scans: ScanSet) -> dict[str, Any] | None:
    if scans.stamps is None or np.isfinite(scans.stamps).sum() < 2:
        return None
    stamps = scans.stamps[np.isfinite(scans.stamps)]
    steps = np.diff(stamps)
    middle = float(np.median(steps))
    return {
        "first": float(stamps[0]),
        "seconds": float(stamps.max() - stamps.min()),
        "per_second": 1 / middle if middle > 0 else None,
        "longest_gap": float(steps.max()),
        "gap_after": int(steps.argmax()),
        "back": int(np.count_nonzero(steps < 0)),
        "equal": int(np.count_nonzero(steps == 0)),
    }


def _about_odometry(
    scans: ScanSet, found: set[str], findings: list[Finding]
) -> dict[str, Any] | None:
    assert scans.odom is not None
    known = np.isfinite(scans.odom).all(axis=1)
    if known.any() and np.mean(~known) > _LACKS:
        text = f"{np.count_nonzero(~known):,} scans have no odometry: track leaves them out"
        _add(findings, "odometry-part", text, fatal=False)
    odom = scans.odom[known]
    if len(odom) <= 1:
        return None
    steps = np.hypot(*np.diff(odom[:, :2], axis=0).T)
    turns = np.abs(np.remainder(np.diff(odom[:, 2]) + math.pi, math.tau) - math.pi)
    if not np.ptp(odom, axis=0).any() and "odometry-zero" not in found and _changes(scans):
        text = "the odometry never moves, but the scans change: it was not recorded"
        _add(findings, "odometry-zero", text)
    still = (steps < _STANDS) & (turns < _STANDS)
    return {
        "metres": float(steps.sum()),
        "turned_deg": math.degrees(float(turns.sum())),
        "still": float(still.mean()),
        "longest_step": float(steps.max()),
    }


def _changes(scans: ScanSet) -> bool:
    """Whether the last scans see something else than the first ones."""
    pairs = ((0, -1), (0, len(scans) // 2), (len(scans) // 3, -1))
    shares = [overlap(scans[a], scans[b], Pose2D(0.0, 0.0)) for a, b in pairs]
    return bool(np.nanmin([1.0, *shares]) < AGREES)


def _about_gaps(
    scans: ScanSet, path: FloatArray, times: Mapping[str, Any] | None, findings: list[Finding]
) -> None:
    """Steps of the path that are too long: the log has a gap, or the odometry jumps."""
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    usual = float(np.sort(steps)[-1 - min(len(steps) - 1, max(2, len(steps) // 100))])
    moving = float(np.median(steps[steps > _STANDS])) if (steps > _STANDS).any() else 0.0
    waited, usually = np.full(len(steps), np.nan), math.nan
    if times is not None and scans.stamps is not None:
        waited = np.diff(scans.stamps)
        usually = max(float(np.nanmedian(waited)), 1e-6)
        fast = (
            float(np.nanmedian((steps / np.maximum(waited, 1e-6))[steps > _STANDS]))
            if moving
            else 0.0
        )
    else:
        fast = moving
    if fast > _FAST and scans.odom is not None:
        unit = f"{fast:.4g} m" + ("/s" if times else " from scan to scan")
        text = f"the odometry moves {unit}: are these millimetres or centimetres? Write metres"
        _add(findings, "odometry-units", text)
        return
    paused = waited > max(_SECONDS, _TIMES * usually) if times else np.zeros(len(steps), bool)
    if (gaps := np.flatnonzero(paused & (steps > _METRES))).size:
        j = int(gaps[waited[gaps].argmax()])
        text = (
            f"no scan for {waited[j]:.3g} s after scan {j}, while the robot went {steps[j]:.3g} m: "
            "it may be lost there"
        )
        _add(findings, "gap", text, fatal=False)
    k = int(np.where(paused, 0.0, steps).argmax())
    if times and steps[k] < usual * waited[k] / usually:
        return  # scans between were left out
    if steps[k] > max(_BEYOND * usual, _LEAP):
        text = f"the odometry jumps by {steps[k]:.3g} m after scan {k}: it was reset, or slipped"
        _add(findings, "jump", text, fatal=False)


def _about_motion(scans: ScanSet, path: FloatArray, findings: list[Finding]) -> float | None:
    """Whether scans and odometry agree."""
    if {"units", "odometry-units", "few"} & {finding.code for finding in findings}:
        return None
    found: Agreement = agreement(scans, path)
    if found.two_lasers:
        text = "every other scan is of another laser, which sits elsewhere: keep one of them"
        _add(findings, "two-lasers", text)
    elif found.best is not None:
        _add(findings, *_mended(found.best, scans))
    elif found.share < POOR:
        text = (
            f"only {found.share:.0%} of the readings fall on an earlier scan, as the odometry "
            f"has it ({AGREES:.0%} and more is usual): is it another robot's odometry, poor, or on "
            "another clock, or is the place of the sensor wrong?"
        )
        _add(findings, "disagree", text, fatal=False)
    return None if math.isnan(found.share) else found.share


def _mended(way: Way, scans: ScanSet) -> tuple[str, str, str]:
    """Code, sentence and options of what makes scans and odometry agree."""
    agree = "scans and odometry agree only"
    if way.then is not None:
        code, text, options = _mended(replace(way, then=None), scans)
        _, more, others = _mended(way.then, scans)
        more = more.removeprefix(agree).replace("with the sensor", "the sensor is").strip()
        return code, f"{text}, and {more}", f"{options} {others}"
    if way.code == "flipped":
        text = f"{agree} with the scans mirrored: the sensor hangs upside down"
        return way.code, text, "`flipped=True`"
    if way.code == "odometry-turn":
        return (
            way.code,
            f"{agree} with theta of the odometry negated: left and right are swapped",
            "",
        )
    if way.code == "units":
        unit = "millimetres" if way.value < 0.005 else "centimetres"
        return way.code, f"{agree} if the ranges are {unit}", f"`range_scale={way.value:g}`"
    if way.code == "mounting":
        mount = scans[0].T_base_laser or Pose2D(0.0, 0.0)
        turned = Pose2D(mount.x, mount.y, mount.theta + way.value)
        sensor = f"{turned.x:g},{turned.y:g},{math.degrees(turned.theta):.4g}deg"
        turn = f"{math.degrees(way.value):.0f} degrees"
        text = f"{agree} with the sensor turned by {turn} on the robot"
        return way.code, text, f"`sensor={sensor}`"
    if way.code == "view":
        angles = scans[0].angles
        view = math.degrees(float(np.ptp(angles)))
        text = (
            f"{agree} if the field of view is {view * way.value:.0f} degrees, not {view:.0f}: look "
            "at angle_min, angle_max and angle_increment"
        )
        return way.code, text, ""
    unit = "s" if scans.stamps is not None else "scans"
    side = "after" if way.value > 0 else "before"
    text = (
        f"{agree} with the odometry of about {abs(way.value):.2g} {unit} {side} each scan: their "
        "clocks differ, or one is written late"
    )
    return way.code, text, ""


def sensor_poses(scans: ScanSet) -> FloatArray:
    """Poses (N, 3) of the sensors in the odometry's frame."""
    assert scans.odom is not None
    at = [
        compose(Pose2D(*pose), scan.T_base_laser or Pose2D(0.0, 0.0))
        for pose, scan in zip(scans.odom, scans.scans, strict=True)
    ]
    return np.array([(p.x, p.y, p.theta) for p in at])


def _about_sources(log: Recording, findings: list[Finding]) -> None:
    """Poses of a log that are not used: those of another robot, further ones of this one."""
    for names, what in (
        (log.others, "further odometry of this robot"),
        (log.robots, "odometry of another robot, or of nothing that carries the laser"),
        (log.truths, "poses that the robot cannot know of itself, no odometry"),
    ):
        if names:
            text = f"{', '.join(names)}: {what}; `odom={names[0]}` takes it all the same"
            findings.append(Finding("odometries", text, serious=False))


def _about_repeats(scans: ScanSet, path: FloatArray | None, findings: list[Finding]) -> None:
    """Scans that are the one before again, while the robot moves."""
    if len(scans) < _BIN:
        return
    ranges = [scan.ranges.tobytes() for scan in scans.scans]
    again = np.array([a == b for a, b in itertools.pairwise(ranges)])
    if path is not None and len(path) == len(scans):
        again &= np.hypot(*np.diff(path[:, :2], axis=0).T) > _STANDS
    if again.mean() >= _REPEATED:
        text = f"{again.mean():.0%} of the scans repeat the one before to the last digit"
        _add(findings, "repeats", f"{text}: the driver publishes old buffers", fatal=False)
    twice = 1 - len(set(ranges)) / len(ranges) - float(again.mean())
    if twice > _TWICE:
        text = f"{twice:.0%} of the scans come a second time later: was a log joined to itself?"
        _add(findings, "twice", text, fatal=False)


def _about_lasers(scans: ScanSet, findings: list[Finding]) -> None:
    """Several lasers in one file, by their rays, that do not say where they sit."""
    kinds = Counter[tuple[int, float]]()
    for scan in scans.scans:
        steps = np.abs(np.diff(scan.angles))
        kinds[len(scan.angles), round(float(np.median(steps)), 4) if len(steps) else 0.0] += 1
    mounts = {scan.T_base_laser for scan in scans.scans}
    some = [n for n in kinds.values() if n > _REPEATED * len(scans)]
    if len(mounts) == 1 and 2 <= len(some) <= 4 and sum(some) > 0.9 * len(scans):
        text = f"{len(some)} lasers in one file, and none says where it sits: keep one of them"
        _add(findings, "two-lasers", text)
