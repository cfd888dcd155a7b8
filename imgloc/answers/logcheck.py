"""A look into a log of scans, and at its likely faults, before it is used.

>>> from imgloc.model import LaserScan
>>> scan = LaserScan(np.full(90, 5000.0), np.linspace(-1.5, 1.5, 90))
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

from imgloc.answers.causes import AGREE, Cause, Given, cause
from imgloc.answers.diagnose import doubts, misread, place_words, too_few, units_cause, units_of
from imgloc.answers.scanmotion import (
    AGREES,
    POOR,
    TRIED,
    Way,
    agreement,
    odd_laser,
    overlap,
    straightening,
)
from imgloc.answers.truth import poses_fit
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import evenly
from imgloc.io.scanset import ScanSet
from imgloc.model import VERDICTS, FloatArray, LaserScan, Localization, Pose2D, base_of, compose
from imgloc.numbers import number
from imgloc.options import MAX_BAD, RADIUS, TOLERANCE, Options, Trust
from imgloc.pipeline import localize, localize_many
from imgloc.pose import difference
from imgloc.robot.recording import Recording

_LOG = logging.getLogger("imgloc")
_SPIKE, _BIN, _OFTEN, _WIDE, _VALUES = number("logcheck.code")
_SECONDS, _TIMES, _METRES = number("logcheck.gap")
_LEAP, _BEYOND = number("logcheck.jump")
_FAST, _SPARSE = number("logcheck.fast")
_REPEATED, _TWICE = number("logcheck.repeats")
_BODY = number("logcheck.body")
_FEW, _CLOSE = number("logcheck.few")
_STANDS = number("logcheck.stands")
_BARS = 40  # of the picture of the ranges
MANY = number("logcheck.many")
_OLD = number("logcheck.old")
FOLLOWED: float = number("logcheck.followed")
"""Share of unique poses from which a robot counts as followed, so that nothing is looked for."""
_UNDONE = {"units", "flipped", "few", "two-lasers", "view"}  # with which no scan fits a map


@dataclass(frozen=True, eq=False)
class LogReport:
    """The contents of a log, and its likely faults."""

    facts: Mapping[str, Any]  #: plain values, by name; metres, seconds, degrees as names say
    findings: tuple[Cause, ...]
    histogram: tuple[FloatArray, FloatArray]  #: readings (N,) between edges (N + 1,), metres
    path: FloatArray | None = None  #: (M, 3) odometry, or known poses without any
    scan: int = 0  #: a scan that sees much

    @property
    def options(self) -> str:
        """The arguments that mend what was found, in backquotes."""
        return " ".join(dict.fromkeys(f.options for f in self.findings if f.options))

    @property
    def can_be_followed(self) -> bool:
        """True if the log has odometry of a robot that moves, and nothing serious is unmended."""
        moves = self.facts.get("odometry") is not None and self.facts["odometry"]["metres"] > 1
        return moves and not any(f.serious and not f.options for f in self.findings)


def check_log(scans: ScanSet, notes: Sequence[Cause] = (), given: Given | None = None) -> LogReport:
    """Look at the scans, stamps and odometry of a log; no map is needed.

    Parameters
    ----------
    scans : ScanSet
    notes : sequence of Cause
        What the reader of the file has found.
    given : Given, optional
        What was stated about the scans.
    """
    findings = list(notes)
    times = _about_stamps(scans)
    facts: dict[str, Any] = {"scans": len(scans), **_about_readings(scans, findings)}
    facts["stamps"] = times
    if times and not times["seconds"]:
        _add(findings, "stamps")
        times = None
    if times and 0 < (pace := times["per_second"] or 0.0) < 1 / _SPARSE:
        units = {"milliseconds": 1e4, "microseconds": 1e7, "nanoseconds": math.inf}
        unit = next(name for name, below in units.items() if 1 / pace < below)
        _add(findings, "stamps/unit", step=1 / pace, unit=unit)
    if times and (back := times["back"]):
        stamps = "a stamp goes" if back == 1 else f"{back:,} stamps go"
        _add(findings, "order", stamps=stamps)
    path = scans.odom if scans.odom is not None else scans.poses
    known = np.zeros(0, bool) if path is None else np.isfinite(path).all(axis=1)
    poses = "odometry" if scans.poses_are_odometry else scans.poses is not None
    facts |= {"odometry": None, "poses": poses, "agreement": None, "straightened": None}
    if scans.odom is not None:
        facts["odometry"] = _about_odometry(scans, findings)
    if path is not None and known.sum() > 1:
        some = scans.take(np.flatnonzero(known).tolist())
        path = np.asarray(path[known])
        _about_gaps(some, path, times, findings, np.flatnonzero(known).tolist())
        if "odometry-zero" not in {f.code for f in findings} or path[:, :2].any():
            facts["agreement"] = _about_motion(some, path, findings, given)
            facts["straightened"] = straightening(some, path)
    facts["recording"] = asdict(scans.recording) if scans.recording.taken else None
    _about_sources(scans.recording, findings)
    _about_repeats(scans, path, findings)
    _about_lasers(scans, findings)
    edges = np.linspace(0.0, max(facts["longest"] or 1.0, 1e-6), _BARS + 1)
    histogram = np.histogram(_seen(scans), edges)[0].astype(np.float64), edges
    best = int(np.argmax([scan.directions for scan in scans.scans[:MANY]]))
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
    """The report, with the findings on a map: whether scans and poses fit it, and how much is new.

    A few scans are located; what keeps them from fitting is tried.
    """
    some, answers = located(features, scans, options)
    facts, findings = dict(report.facts), list(report.findings)
    facts["on_map"] = {v: sum(a.verdict == v for a in answers) for v in VERDICTS}
    sure = [answer.explained for answer in answers if answer.verdict == "unique"]
    unsure = 2 * len(sure) < len(answers)
    facts["not_on_map"] = 1 - float(np.median(sure)) if sure else None
    said = [(answer.verdict, answer.evidence) for answer in answers]
    if not _undone(findings) - {"units"}:
        about = features, some, said, options, given, scans
        for found in (f for f in _causes(*about) if unsure or f.code != "bent"):
            code = "map" if found.code not in _UNDONE else found.code
            code = "flipped" if found.code == "mirrored" else code
            code = "mirrored" if found.code == "mirrored" and not found.options else code
            told = {"units"} | ({"disagree"} if found.code == "scale" else set())
            findings = [f for f in findings if f.code not in told]  # the map decides
            findings.append(replace(found, code=code, serious=code != "map" or not sure))
    facts["poses_fit"] = facts["odometry_fits"] = None
    if not _undone(findings):
        if scans.poses is not None:
            facts["poses_fit"] = poses_fit(features.grid, scans.scans, scans.poses)
            if facts["poses_fit"] is False and sure:
                findings.append(cause("poses"))
                if scans.odom is None:  # as who follows the robot takes them
                    moved = replace(scans, odom=scans.poses)
                    facts["odometry"] = _about_odometry(moved, findings)
        if scans.odom is not None and np.isfinite(scans.odom).all():
            at = sensor_poses(scans)
            facts["odometry_fits"] = poses_fit(features.grid, scans.scans, at)
        if unsure and not {"map", "mirrored", "flipped"} & {f.code for f in findings}:
            besides = ", and the recorded poses do not fit it" * (facts["poses_fit"] is False)
            findings.append(cause("map/undecided", sure=len(sure) or "none", besides=besides))
    return replace(report, facts=facts, findings=tuple(_sorted(findings)))


def _undone(findings: Sequence[Cause]) -> set[str]:
    """Codes of what keeps scans from fitting any map; a further laser of the log does not."""
    return _UNDONE & {finding.code for finding in findings if finding.serious}


def _causes(*about: Any) -> list[Cause]:
    """Causes that keep scans from fitting a map, by :func:`doubts` and :func:`misread`.

    They are without ``thick``, whose advice is to follow the robot.
    """
    causes = doubts(*about)
    found = misread(*about) if {found.code for found in causes} <= {"bent"} else None
    return [found] if found else [found for found in causes if found.code != "thick"]


def located(
    features: MapFeatures, scans: ScanSet, options: Options
) -> tuple[ScanSet, list[Localization]]:
    """A few scans of a log that see enough, from all of it, and their answers.

    They are more unless each is ``unique``.
    """
    some = [k for k, s in enumerate(scans.scans) if s.directions >= options.trust.readings]
    for most in (TRIED, 3 * TRIED):
        few = scans.take([some[k] for k in evenly(len(some), most).tolist()])
        answers = list(localize_many(features, few.scans, options))
        if all(answer.verdict == "unique" for answer in answers):
            break
    return few, answers


def doubt_of_log(
    features: MapFeatures, scans: ScanSet, options: Options, given: Given,
    followed: float = 0.0, start: Pose2D | None = None,
) -> Cause | None:  # fmt: skip
    """Say what most likely keeps a robot from being followed through a log; None if nothing is.

    Findings of scans and odometry without a map come first if it keeps scans from fitting
    any map. Then a few scans are located: either they do not fit this map, or the `start` (map
    frame), the odometry or the place of the sensor is wrong. `followed` is the share of the scans
    with a unique pose along the way: if it is not small, a map that they do not fit is an old one.
    """
    report = check_log(scans, given=given)
    told = [f for f in report.findings if f.serious or f.code == "disagree"]
    if first := next((f for f in told if f.code in _UNDONE - {"units", "few"}), None):
        return first
    some, answers = located(features, scans, options)
    said = [(answer.verdict, answer.evidence) for answer in answers]
    found = next(iter(_causes(features, some, said, options, given, scans)), None)
    if found is not None and found.code == "map" and followed >= _OLD:
        return cause("old/followed", share=followed)
    found = found or (None if start is None else _started(features, scans, options, start))
    return found or next(iter(told), None)


def _started(
    features: MapFeatures, scans: ScanSet, options: Options, start: Pose2D
) -> Cause | None:
    """The first scan fits at one place, far from where the robot was said to start."""
    answer = localize(features, scans[0], options)
    if answer.verdict != "unique" or answer.pose is None:
        return None
    at = base_of(answer.pose, scans[0].mount)
    away, turned = difference(at, start)
    if away <= RADIUS and turned <= TOLERANCE:
        return None
    return cause("start", at=place_words(at), away=away)


def _add(findings: list[Cause], key: str, **values: Any) -> None:
    if (found := cause(key, None, **values)).code not in {finding.code for finding in findings}:
        findings.append(found)


def _sorted(findings: Sequence[Cause]) -> list[Cause]:
    return sorted(findings, key=lambda finding: not finding.serious)


def _some(scans: ScanSet) -> Sequence[LaserScan]:
    """At most so many scans of a log, from all of it."""
    return scans.scans[:: max(1, len(scans) // MANY)]


def _seen(scans: ScanSet) -> FloatArray:
    """The valid ranges of some scans, metres."""
    return np.concatenate([scan.ranges[scan.valid] for scan in _some(scans)])


def _about_readings(scans: ScanSet, findings: list[Cause]) -> dict[str, Any]:
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
    if (found := units_of(some))[1]:
        findings.append(units_cause(*found))
        return facts
    if (code := _code(seen)) is not None:
        low, top = code
        which = f"exactly {top:g} m" if low == top else f"{low:g} to {top:g} m"
        _add(findings, "codes", share=np.mean(seen >= low), which=which, low=low)
    few = np.median([scan.directions for scan in some]) < Trust().readings
    if few or total["valid"] < _FEW * count:
        findings.append(too_few(some))
    elif total["too_close"] > _CLOSE * count:
        zeros = float(np.mean(raw == 0))
        near = f"{total['too_close'] / count:.0%} of the readings are closer than range_min"
        what = f"{zeros:.0%} of the readings are 0" if zeros > _CLOSE else near
        _add(findings, "too-close", what=what)
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


def _about_body(some: Sequence[LaserScan], findings: list[Cause]) -> None:
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
    metres = np.median(middle[body])
    _add(findings, "own-body", count=len(at), first=at[0], last=at[-1], metres=metres)


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


def _about_odometry(scans: ScanSet, findings: list[Cause]) -> dict[str, Any] | None:
    assert scans.odom is not None
    known = np.isfinite(scans.odom).all(axis=1)
    if known.any() and np.mean(~known) > MAX_BAD:
        _add(findings, "odometry-part", count=np.count_nonzero(~known))
    odom = scans.odom[known]
    if len(odom) <= 1:
        return None
    steps = np.hypot(*np.diff(odom[:, :2], axis=0).T)
    turns = np.abs(np.remainder(np.diff(odom[:, 2]) + math.pi, math.tau) - math.pi)
    if not np.ptp(odom, axis=0).any() and _changes(scans):
        _add(findings, "odometry-zero")
    still = (steps < _STANDS) & (turns < _STANDS)
    return {
        "metres": float(steps.sum()),
        "turned_deg": math.degrees(float(turns.sum())),
        "still": float(still.mean()),
        "longest_step": float(steps.max()),
    }


def _changes(scans: ScanSet) -> bool:
    """Return whether the last scans see something else than the first ones."""
    pairs = ((0, -1), (0, len(scans) // 2), (len(scans) // 3, -1))
    alike = [(scans[a], scans[b]) for a, b in pairs if scans[a].laser == scans[b].laser]
    shares = [overlap(one, other, Pose2D(0.0, 0.0)) for one, other in alike]
    return bool(np.nanmin([1.0, *shares]) < AGREES)


def _about_gaps(
    scans: ScanSet, path: FloatArray, times: Mapping[str, Any] | None, findings: list[Cause],
    at: Sequence[int],
) -> None:  # fmt: skip
    """Steps of the path that are too long: the log has a gap, or the odometry jumps.

    `at` (N,) are the indices of these scans in the log.
    """
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    usual = float(np.sort(steps)[-1 - min(len(steps) - 1, max(2, len(steps) // 100))])
    moving = float(np.median(steps[steps > _STANDS])) if (steps > _STANDS).any() else 0.0
    waited, usually = np.full(len(steps), np.nan), math.nan
    if times is not None and scans.stamps is not None:
        waited = np.diff(scans.stamps)
        usually = max(float(np.nanmedian(waited)), 1e-6)
        speeds = (steps / np.maximum(waited, 1e-6))[steps > _STANDS]
        fast = float(np.nanmedian(speeds)) if moving else 0.0
    else:
        fast = moving
    if fast > _FAST and scans.odom is not None:
        _add(findings, "odometry-units", fast=fast, each="/s" if times else " from scan to scan")
        return
    paused = waited > max(_SECONDS, _TIMES * usually) if times else np.zeros(len(steps), bool)
    if (gaps := np.flatnonzero(paused & (steps > _METRES) & (np.diff(at) == 1))).size:
        j = int(gaps[waited[gaps].argmax()])
        _add(findings, "gap", seconds=waited[j], scan=at[j], metres=steps[j])
    k = int(np.where(paused, 0.0, steps).argmax())
    if times and steps[k] < usual * waited[k] / usually:
        return  # scans between were left out
    if steps[k] > max(_BEYOND * usual, _LEAP):
        _add(findings, "jump", metres=steps[k], scan=at[k])


def _about_motion(
    scans: ScanSet, path: FloatArray, findings: list[Cause], given: Given | None
) -> float | None:
    """Return whether scans and odometry agree."""
    if {"units", "odometry-units", "few"} & {finding.code for finding in findings}:
        return None
    found = agreement(scans, path)
    if len(scans.lasers) > 1 and (odd := odd_laser(scans, path)) is not None:
        others = ",".join(name for name in scans.lasers if name != odd[0])
        about = dict(zip(("laser", "share", "better", "how"), odd, strict=True))
        findings.append(cause("two-lasers/odd", None, others=others, **about))
    elif found.two_lasers:
        _add(findings, "two-lasers/moved")
    elif found.best is not None:
        findings.append(_mended(found.best, scans, given))
    elif found.share < (POOR if scans[0].T_base_laser else (POOR + AGREES) / 2):
        _add(findings, "disagree", share=found.share, usual=AGREES)
    return None if math.isnan(found.share) else found.share


def _mended(way: Way, scans: ScanSet, given: Given | None) -> Cause:
    """The cause that makes scans and odometry agree when it is undone."""
    if way.then is not None:
        one = _mended(replace(way, then=None), scans, given)
        other = _mended(way.then, scans, given)
        more = other.text.removeprefix(AGREE).replace("with the sensor", "the sensor is").strip()
        both = f"{one.options} {other.options}"
        advice = (given or Given()).advice(both.strip())
        return replace(one, text=f"{one.text}, and {more}", options=both, advice=advice)
    view = math.degrees(float(np.ptp(scans[0].angles)))
    mount = scans[0].mount
    yaw = math.degrees(Pose2D(0.0, 0.0, mount.theta + way.value).theta)
    unit = "s" if scans.stamps is not None else "scans"
    stated = given is not None and given.view_of(scans[0]) is not None
    key = way.code + {"units": "/moved", "view": "/stated" * stated}.get(way.code, "")
    return cause(
        key, given, factor=way.value, lead=AGREE,
        unit="millimetres" if way.value < 0.005 else "centimetres", turn=math.degrees(way.value),
        sensor=f"{mount.x:g},{mount.y:g},{round(yaw, 2) + 0.0:g}deg", view=view,
        right=view * way.value, late=abs(way.value),
        side=f"{unit} {'after' if way.value > 0 else 'before'}",
    )  # fmt: skip


def sensor_poses(scans: ScanSet) -> FloatArray:
    """Poses (N, 3) of the sensors in the odometry's frame."""
    assert scans.odom is not None
    pairs = zip(scans.odom, scans.scans, strict=True)
    return np.array([[*compose(Pose2D(*pose), scan.mount)] for pose, scan in pairs])


def _about_sources(log: Recording, findings: list[Cause]) -> None:
    """Poses of a log that are not used: those of another robot, further ones of this one."""
    for names, what in (
        (log.others, "further odometry of this robot"),
        (log.robots, "odometry of another robot, or of nothing that carries the laser"),
        (log.truths, "poses that the robot cannot know of itself, no odometry"),
    ):
        if names:
            findings.append(cause("odometries", names=", ".join(names), what=what, first=names[0]))


def _about_repeats(scans: ScanSet, path: FloatArray | None, findings: list[Cause]) -> None:
    """Scans that are the one before again, while the robot moves."""
    if len(scans) < _BIN:
        return
    ranges = [scan.ranges.tobytes() for scan in scans.scans]
    again = np.array([a == b for a, b in itertools.pairwise(ranges)])
    if path is not None and len(path) == len(scans):
        again &= np.hypot(*np.diff(path[:, :2], axis=0).T) > _STANDS
    if again.mean() >= _REPEATED:
        _add(findings, "repeats", share=again.mean())
    twice = 1 - len(set(ranges)) / len(ranges) - float(again.mean())
    if twice > _TWICE:
        _add(findings, "twice", share=twice)


def _about_lasers(scans: ScanSet, findings: list[Cause]) -> None:
    """Several lasers in one file, by their rays, whose places are not in it."""
    kinds = Counter[tuple[int, float]]()
    for scan in scans.scans:
        steps = np.abs(np.diff(scan.angles))
        kinds[len(scan.angles), round(float(np.median(steps)), 4) if len(steps) else 0.0] += 1
    mounts = {scan.T_base_laser for scan in scans.scans}
    some = [n for n in kinds.values() if n > _REPEATED * len(scans)]
    if len(mounts) == 1 and 2 <= len(some) <= 4 and sum(some) > 0.9 * len(scans):
        _add(findings, "two-lasers", count=len(some))
