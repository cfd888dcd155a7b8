"""Measures how well a filter finds and keeps a robot along logs with known poses.

A start is a robot that is switched on somewhere in a log. A kidnapping joins two distant pieces of
a log, with odometry that misses the move. Several rules of success are reported side by side:
shares of right poses against metres driven, and the rules of ENM-MCL, F3Loc, and Fox, Burgard and
Thrun (JAIR 11).
"""

import argparse
import hashlib
import io
import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import imgloc
from imgloc import ConfigError, Every, Filter, MapFeatures, Options, ScanSet, follow, make_filter
from imgloc.filters.belief import LOST, UNIQUE, deviations_of
from imgloc.filters.evidence import Places, search
from imgloc.filters.follow import robot_poses
from imgloc.filters.motion import compose_poses, increments
from imgloc.geometry import transform_poses
from imgloc.io.files import write_bytes_atomic, write_text_atomic
from imgloc.lab.evaluation import share
from imgloc.live.policy import LastPose
from imgloc.live.settings import Settings
from imgloc.model import FloatArray, LaserScan, OccupancyGrid, Pose2D, to_json
from tools.recorded import RIGHT
from tools.script import parser_of
from tools.trust.precision import REGION, TRUTH, difference, squared

AT = (0.0, 1.0, 2.0, 5.0, 10.0)  #: metres driven after which shares are reported
WRONG = (1.0, RIGHT[1])
"""``unique`` and farther off than this, metres or radians, is confidently wrong."""
ENM = (0.3, 20.0)  #: ENM-MCL: RMSE in metres, from so many seconds on
F3LOC = (10, (1.0, 0.5, 0.3, 0.2))  #: F3Loc: the last frames, within so many metres
CARRIED = (10.0, 3.0)  #: a kidnapping: metres driven before and after it, and at least in it
GIVEN = ("there", "turned", "twin")
"""Where a robot is said to start: where it does, turned by 180 degrees, or at the best other place
of its first scan."""
JAIR = (0.45, 10.0)  #: JAIR 11: recovered, within metres for more than so many seconds


@dataclass(frozen=True, eq=False)
class Run:
    """The beliefs of a filter along one piece of a log: arrays of N moments."""

    seconds: FloatArray  #: since the start
    metres: FloatArray  #: driven since the start
    error: FloatArray  #: (N, 2) metres and radians of the best pose; infinite without one
    unique: FloatArray  #: 1 where the verdict is ``unique``
    lost: FloatArray  #: 1 where it is ``lost``
    cost: float  #: processor seconds of the run
    #: (N, 2) standard deviations of the best pose: metres along its longest axis, and radians
    spread: FloatArray
    #: (N,) squared Mahalanobis distance of the best pose from the true one
    square: FloatArray
    holds: FloatArray  #: 1 where `~/status` of the node calls the robot localized
    jump: int | None = None  #: moment at which the robot was carried off

    @property
    def right(self) -> FloatArray:
        """Whether the best pose is right: 1 or 0."""
        return np.asarray(np.all(self.error <= RIGHT, axis=1), dtype=np.float64)


class Searches:
    """Searches of scans, each done only once, because a search does not depend on the belief.

    The clock counts a repeated search as if it were done again. They are most of the work: in a
    `folder` they are kept for another day. What was found by other code, on another map or with
    other options is not taken for them.
    """

    def __init__(self, features: MapFeatures, options: Options, folder: Path | None = None) -> None:
        self.features, self.options = features.thinner(options.shared.thinner), options
        self.clock = 0.0  #: processor seconds of all searches, repeated ones included
        self._kept: dict[str, FloatArray] = {}  # by digest of a scan: seconds, and its places
        self._file = folder and folder / f"{_digest(features.grid, options)}.npz"
        if self._file is not None and self._file.exists():
            with np.load(self._file) as old:
                self._kept = dict(old)

    def __call__(self, scan: LaserScan) -> Places:
        """The places of a scan."""
        limits = np.array([scan.range_min, scan.range_max])
        content = b"".join(a.tobytes() for a in (scan.ranges, scan.angles, limits))
        key = hashlib.sha256(content).hexdigest()
        if key not in self._kept:
            places, seconds = self.anew(scan)
            rows = np.column_stack((places.poses, places.spread.reshape(-1, 9)))
            self._kept[key] = np.vstack((np.full(12, seconds), rows))
        rows = self._kept[key][1:]
        self.clock += float(self._kept[key][0, 0])
        return Places(rows[:, :3], rows[:, 3:].reshape(-1, 3, 3))

    def anew(self, scan: LaserScan) -> tuple[Places, float]:
        """Search a scan anew: its places, and the processor seconds of the search."""
        start = time.process_time()
        places = search(self.features, scan, self.options)
        return places, time.process_time() - start

    def save(self) -> None:
        """Keep what was found, with the time that it took, if there is a folder for it."""
        if self._file is not None:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            buffer = io.BytesIO()
            np.savez(buffer, allow_pickle=False, **self._kept)
            write_bytes_atomic(self._file, buffer.getvalue(), force=True)


def _digest(grid: OccupancyGrid, options: Options) -> str:
    """What a search depends on but its scan: the code, the map and the options."""
    package, rooms = Path(imgloc.__file__).parent, ("features", "likelihoods", "search")
    code = [path for room in rooms for path in sorted((package / room).glob("*.py"))]
    code += [package / "pipeline.py", package / "options.py"]
    about = repr((options, grid.info, Places.__match_args__)).encode()
    about += grid.occupied.tobytes() + grid.free.tobytes()
    about += b"".join(path.read_bytes() for path in code)
    return hashlib.sha256(about).hexdigest()[:20]


def drive(
    features: MapFeatures,
    scans: ScanSet,
    robot: Filter,
    every: Every,
    searches: Searches,
    jump: int | None = None,
    start: Pose2D | None = None,
) -> Run:
    """Run a new filter along a log with poses and odometry."""
    truth = robot_poses(scans)
    if truth is None:
        raise ConfigError("expected the true pose of each scan")
    begin, before, rows, last = time.process_time(), searches.clock, [], LastPose()
    own = np.diag(np.square(TRUTH))
    for moment in follow(features, scans, robot, every=every, start=start):
        error, spread, square = (np.inf, np.inf), (np.inf, np.inf), np.inf
        if moment.best is not None:
            best = np.array([moment.best.x, moment.best.y, moment.best.theta])
            apart = difference(best, truth[moment.index])
            error = float(np.hypot(*apart[:2])), abs(float(apart[2]))
            spread = deviations_of(moment.covariance)
            square = squared(apart, moment.covariance + own)
        verdict = moment.belief.verdict
        holds = last.take(moment, sure=verdict == UNIQUE, longest=Settings().max_age)
        rows.append((
            *(moment.stamp, moment.metres), *error, *(verdict == UNIQUE, verdict == LOST),
            *spread, square, holds,
        ))  # fmt: skip
    cost = time.process_time() - begin + searches.clock - before
    table = np.array(rows, dtype=np.float64)
    return Run(
        table[:, 0] - table[0, 0], table[:, 1], table[:, 2:4], table[:, 4], table[:, 5], cost,
        table[:, 6:8], table[:, 8], table[:, 9], jump,
    )  # fmt: skip


def piece(scans: ScanSet, *parts: range) -> ScanSet:
    """Join parts of a log. Time and odometry go on without a jump between the parts.

    A scan that comes again has new noise: a sensor that repeats one to the bit is frozen.
    """
    index = np.concatenate([np.asarray(part) for part in parts])
    stamps = np.arange(len(scans), dtype=np.float64) if scans.stamps is None else scans.stamps
    gaps, steps = np.diff(stamps, prepend=stamps[0]), np.zeros((len(scans), 3))
    if scans.odom is not None and len(scans) > 1:
        steps[1:] = increments(scans.odom)
    gap, step = gaps[index], steps[index]
    gap[0], step[0] = 0.0, 0.0
    joints = np.cumsum([len(part) for part in parts])[:-1]
    gap[joints], step[joints] = np.median(gaps), 0.0  # carried, with the wheels in the air
    odom = [np.zeros(3)]
    for one in step[1:]:
        odom.append(compose_poses(odom[-1], one))
    return ScanSet(
        tuple(_each_new(scans[k] for k in index)),
        None if scans.poses is None else scans.poses[index],
        np.cumsum(gap),
        np.array(odom),
    )


def _each_new(scans: Iterable[LaserScan]) -> Iterator[LaserScan]:
    """The scans; one that has come before has a millimetre more of noise."""
    before, rng = set[int](), np.random.default_rng(0)
    for scan in scans:
        if (now := id(scan)) in before:
            noise = rng.normal(0.0, 0.001, len(scan.ranges)) * scan.valid
            scan = replace(scan, ranges=scan.ranges + noise)
        before.add(now)
        yield scan


def driven(scans: ScanSet) -> FloatArray:
    """Metres (N,) driven up to each scan, by the true poses."""
    if scans.poses is None:
        raise ConfigError("expected the true pose of each scan")
    steps = np.hypot(*np.diff(scans.poses[:, :2], axis=0).T)
    return np.concatenate(([0.0], np.cumsum(steps)))


def starts(
    scans: ScanSet, count: int, rng: np.random.Generator, *, ahead: float, seconds: float = 30.0
) -> list[int]:
    """Scans at which a robot is switched on: one each 30 s and `count` at random.

    From each start the log goes on for at least `ahead` metres, if it is long enough. No scan is
    drawn twice if there are enough, because a repeated run gives the same result.
    """
    way = driven(scans)
    last = int(np.searchsorted(way, max(0.0, way[-1] - ahead), side="right"))
    stamps = np.arange(len(scans), dtype=np.float64) if scans.stamps is None else scans.stamps
    long = stamps[max(0, last - 1)] - stamps[0]
    marks = stamps[0] + seconds * np.arange(int(long // seconds) + 1 if seconds < np.inf else 0)
    regular = np.searchsorted(stamps, marks).tolist()
    random = rng.choice(max(1, last), count, replace=count > last).tolist()
    return [int(k) for k in (*random, *regular)]


def from_starts(scans: ScanSet, at: Iterable[int], metres: float) -> Iterator[ScanSet]:
    """The pieces of a log that begin with the scans `at` and are `metres` long."""
    way = driven(scans)
    for first in at:
        end = int(np.searchsorted(way, way[first] + metres, side="right"))
        yield piece(scans, range(first, max(first + 1, end)))


def kidnappings(
    scans: ScanSet, count: int, rng: np.random.Generator
) -> Iterator[tuple[ScanSet, int]]:
    """Yield pieces of a log in which the robot is carried off, each with the moment of that.

    :data:`CARRIED` has the metres that the robot drives before and after, and is carried at least.
    """
    (metres, least), way = CARRIED, driven(scans)
    places = np.zeros((len(scans), 3)) if scans.poses is None else scans.poses
    last = max(1, int(np.searchsorted(way, max(0.0, way[-1] - metres), side="right")))
    for _ in range(count):
        for _ in range(100):
            first, other = (int(k) for k in rng.integers(0, last, 2))
            end, final = (
                int(np.searchsorted(way, way[k] + metres, side="right")) for k in (first, other)
            )
            if np.hypot(*(places[other] - places[end - 1])[:2]) >= least:
                break
        else:
            continue
        before, after = range(first, max(first + 1, end)), range(other, max(other + 1, final))
        yield piece(scans, before, after), len(before)


def given_at(kind: str, scans: ScanSet, features: MapFeatures, found: Places) -> Pose2D | None:
    """The pose, map frame, that a robot is given at the start of a log; `kind` is of :data:`GIVEN`.

    `found` are the places of its first scan, grid frame. None if nothing else is among them.
    """
    truth = np.asarray(robot_poses(scans))[:1]
    others = transform_poses(features.grid.origin, found.poses)
    twins = others[np.hypot(*(others - truth)[:, :2].T) > WRONG[0]]
    some = {"there": truth, "turned": truth + (0.0, 0.0, np.pi), "twin": twins}[kind]
    return Pose2D(*some[0].tolist()) if len(some) else None


def parser_of_logs(name: str, about: str | None) -> argparse.ArgumentParser:
    """The parser of a tool that measures along the logs of some folders, and writes rows."""
    parser = parser_of(f"tools.{name}", about, seed=0)
    parser.add_argument("folders", nargs="+", type=Path, help="with map.yaml and scans.npz")
    parser.add_argument("--out", type=Path, default=Path(name))
    parser.add_argument("--searches", type=Path, help="folder that keeps what searches found")
    return parser


def write_rows(folder: Path, name: str, rows: Sequence[Mapping[str, Any]], page: str) -> None:
    """Write rows as ``NAME.jsonl`` and ``NAME.md``, anew each time: what is stopped has some."""
    lines = "".join(to_json(row) + "\n" for row in rows)
    write_text_atomic(folder / f"{name}.jsonl", lines, force=True)
    write_text_atomic(folder / f"{name}.md", page, force=True)


@dataclass(frozen=True)
class Trials:
    """The runs on one log."""

    starts: int = 50  #: number of random starts, besides one start each `seconds`
    metres: float = 15.0  #: metres driven from each start
    kidnaps: int = 20
    seed: int = 0
    seconds: float = 30.0
    reset_by: str = "ght-v"  #: method whose p(x | z) new particles are drawn from
    every: Every = field(default_factory=Every)
    given: str = ""  #: pose that a run is given at the start, of :data:`GIVEN`; empty: none

    def at(self, scans: ScanSet) -> list[int]:
        """The starts in a log."""
        rng = np.random.default_rng(self.seed)
        return starts(scans, self.starts, rng, ahead=max(AT), seconds=self.seconds)

    def count(self, scans: ScanSet) -> int:
        """Number of runs in a log."""
        return len(self.at(scans)) + self.kidnaps


def measure(
    features: MapFeatures,
    scans: ScanSet,
    name: str,
    trials: Trials,
    options: Options,
    *,
    searches: "Searches | None" = None,
    advance: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Measure the filter called `name` on a log with poses and odometry.

    `searches` has the searches of earlier measurements of the same scans. `advance` is called after
    each run.
    """
    found = searches or Searches(features, options)
    how: dict[str, Any] = {"seed": trials.seed, "reset_by": trials.reset_by, "find": found}
    runs, kidnaps = list[Run](), list[Run]()
    rng = np.random.default_rng((trials.seed, 1))
    alone = ((runs, part, None) for part in from_starts(scans, trials.at(scans), trials.metres))
    carried = ((kidnaps, *some) for some in kidnappings(scans, trials.kidnaps, rng))
    for into, part, jump in itertools.chain(alone, carried):
        robot, start = make_filter(name, features, options, **how), None
        if trials.given:
            start = given_at(trials.given, part, features, found(part[0]))
        into.append(drive(features, part, robot, trials.every, found, jump, start))
        advance()
    return summarise_runs(runs, kidnaps)


def _after(run: Run, metres: float) -> int | None:
    """First moment at which so many metres were driven; None if the run is shorter."""
    k = int(np.searchsorted(run.metres, metres - 1e-9))
    return k if k < len(run.metres) else None


def recovered(run: Run) -> float | None:
    """Metres from the kidnapping until it is recovered from by JAIR's rule; None if never."""
    if run.jump is None:
        return None
    radius, long = JAIR
    near = run.error[run.jump :, 0] <= radius
    seconds, metres = run.seconds[run.jump :], run.metres[run.jump :] - run.metres[run.jump]
    for k in np.flatnonzero(near & ~np.append(False, near[:-1])):
        until = k + int(np.argmin(np.append(near[k:], False)))
        # To the end of the run, if that comes first.
        if seconds[until - 1] - seconds[k] > long or until == len(near):
            return float(metres[k])
    return None


def summarise_runs(runs: Sequence[Run], kidnaps: Sequence[Run] = ()) -> dict[str, Any]:
    """Summarise runs, at least one, and kidnappings, in plain values: those of JSON."""
    right, stays, published = {}, {}, {}
    for metres in AT:
        at = [(run, k) for run in runs if (k := _after(run, metres)) is not None]
        right[f"{metres:g}"] = _of(bool(run.right[k]) for run, k in at)
        stays[f"{metres:g}"] = _of(bool(run.right[k:].all()) for run, k in at)
        published[f"{metres:g}"] = _of(bool(run.right[k] and run.unique[k]) for run, k in at)
    rmse, after = ENM
    long = [run.error[run.seconds >= after, 0] for run in runs if run.seconds[-1] > after]
    frames, radii = F3LOC
    last = [run.error[-frames:, 0] for run in runs if len(run.seconds) >= frames]
    # A verdict may be withdrawn later, but the pose has to be right from there on.
    first = [int(np.argmax(run.unique * for_good(run.right) > 0)) for run in runs]
    done = [
        (run, k) for run, k in zip(runs, first, strict=True)
        if run.unique[k] and run.right[k:].all()
    ]  # fmt: skip
    errors = [run.error[k:][run.unique[k:] > 0] for run, k in done]
    whole = np.concatenate(errors) if errors else np.full((1, 2), np.nan)
    everything = [*runs, *kidnaps]
    off = [(run.error > WRONG).any(axis=1) for run in everything]
    bad = [(run.unique > 0) & b for run, b in zip(everything, off, strict=True)]
    held = [(run.holds > 0) & b for run, b in zip(everything, off, strict=True)]
    spans = [np.diff(run.seconds, append=run.seconds[-1]) for run in everything]
    back = [recovered(run) for run in kidnaps]
    total = float(sum(run.seconds[-1] for run in everything))
    ends = [[(np.diff(v) < 0).sum() for v in (run.unique, run.holds)] for run in runs]
    minutes = max(1e-9, sum(run.seconds[-1] for run in runs) / 60)
    return {
        "runs": len(runs),
        "right": right,  # after so many metres
        "stays": stays,  # and at every later moment of the run
        "published": published,  # right and ``unique`` after so many metres
        # Success by ENM-MCL's rule, among the runs that are long enough; by F3Loc's, within metres.
        "enm": _of(bool(np.sqrt(np.mean(np.square(e))) <= rmse) for e in long),
        "f3loc": {f"{radius:g}": _of(bool((e <= radius).all()) for e in last) for radius in radii},
        # Medians until ``unique`` and right for good, seconds and metres.
        "seconds": _median([float(run.seconds[k]) for run, k in done]),
        "metres": _median([float(run.metres[k]) for run, k in done]),
        # Root mean square error of ``unique`` right poses after that: metres, radians.
        "rmse": tuple(np.sqrt(np.mean(np.square(whole), axis=0)).tolist()),
        # ``unique`` poses whose 95 % region holds the true pose, of all runs.
        "inside": _of(
            bool(square <= REGION) for run in everything for square in run.square[run.unique > 0]
        ),
        # Seconds ``unique`` and more than :data:`WRONG` off, of all runs, and such moments.
        "wrong": float(sum(span[b].sum() for span, b in zip(spans, bad, strict=True))),
        "wrong_moments": int(sum(b.sum() for b in bad)),
        "total": total,  # seconds of all runs
        # Times a minute, if not kidnapped, that unique, localized end.
        "falls": tuple((np.sum(ends, axis=0) / minutes).tolist()),
        # Seconds localized and more than :data:`WRONG` off, of all runs.
        "held": float(sum(span[b].sum() for span, b in zip(spans, held, strict=True))),
        "kidnapped": _of(b is not None for b in back),  # recovered by JAIR's rule
        "kidnap_metres": _median([b for b in back if b is not None]),  # until right for good
        "speed": total / max(1e-9, sum(run.cost for run in everything)),  # log for one processor
    }


def _of(hits: Iterable[bool]) -> dict[str, Any]:
    return vars(share(hits))


def for_good(good: FloatArray) -> FloatArray:
    """Whether this and all later moments are good: 1 or 0 each, (N,)."""
    return np.asarray(np.minimum.accumulate(good[::-1])[::-1])


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else float("nan")
