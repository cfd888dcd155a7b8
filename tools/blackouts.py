"""What the tracker says while its laser is blind and the robot drives, or is carried off.

Run it with the folders of logs, each with ``map.yaml`` and ``scans.npz`` (poses, and odometry if
it was recorded)::

    python -m tools.blackouts ../data/gh25 ../data/fr079 --out blackouts

A trial drives 8 m from a known start with its sight, then so many metres without, then 10 m with it
again. It writes a table (``blackouts.md``) and every number of it (``blackouts.jsonl``).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from imgloc import Every, LaserScan, Limits, Options, Pose2D, ScanSet, make_filter, prepare
from imgloc.filters.follow import robot_poses
from tools.filters import WRONG, Run, Searches, drive, driven, parser_of_logs, piece, write_rows
from tools.script import progress, table_lines
from tools.sequences import load_log
from tools.trust.precision import REGION

BEFORE, AFTER, BACK = 8.0, 10.0, 5.0  # metres with sight before and after; to be found again within
CARRIED = 10.0  # seconds that a robot is carried for
COVERED = 0.1  # metres: what a covered lens reads


def _every(value: float) -> Callable[[LaserScan, LaserScan], LaserScan]:
    return lambda scan, _: replace(scan, ranges=np.full_like(scan.ranges, value))


def _covered(scan: LaserScan, _: LaserScan) -> LaserScan:
    """Every ray ends on the cover, within the sensor's range."""
    near = np.random.default_rng(len(scan.ranges)).normal(COVERED, 0.01, len(scan.ranges))
    return replace(scan, ranges=near, range_min=0.0)


def _half(scan: LaserScan, _: LaserScan) -> LaserScan:
    half = np.arange(len(scan.ranges)) < len(scan.ranges) / 2
    return replace(scan, ranges=np.where(half, np.nan, scan.ranges))


#: What a blind sensor gives for a scan, and for the last one that it had.
KINDS: Mapping[str, Callable[[LaserScan, LaserScan], LaserScan]] = {
    "NaN": _every(np.nan),
    "inf": _every(np.inf),
    "0.1 m": _covered,
    "frozen": lambda scan, last: replace(scan, ranges=last.ranges, angles=last.angles),
    "half": _half,
}


def blinded(scans: ScanSet, blind: range, kind: str) -> ScanSet:
    """The log with its scans `blind` as a sensor of this kind gives them."""
    some, last = list(scans.scans), scans.scans[max(0, blind.start - 1)]
    for k in blind:
        some[k] = KINDS[kind](some[k], last)
    return replace(scans, scans=tuple(some))


def blackouts(
    scans: ScanSet, metres: float, count: int, rng: np.random.Generator
) -> Iterator[tuple[ScanSet, range]]:
    """Pieces of a log, and the scans in each that are to be blind, over so many metres."""
    way = driven(scans)
    last = int(np.searchsorted(way, way[-1] - BEFORE - metres - AFTER, side="right"))
    for first in rng.choice(last, min(count, last), replace=False) if last > 0 else ():
        marks = way[first] + np.cumsum([BEFORE, metres, AFTER])
        dark, light, end = (int(k) for k in np.searchsorted(way, marks, side="right"))
        yield piece(scans, range(first, end)), range(dark - first, light - first)


def carried(
    scans: ScanSet, count: int, rng: np.random.Generator
) -> Iterator[tuple[ScanSet, range]]:
    """Pieces of a log that jump when the sensor goes blind, for ten seconds."""
    way, poses, stamps = driven(scans), scans.poses, scans.stamps
    assert poses is not None  # driven() has refused it
    if stamps is None:
        return
    last = max(1, int(np.searchsorted(way, way[-1] - BEFORE - AFTER, side="right")))
    for _ in range(count):
        first, other = (int(k) for k in rng.integers(0, last, 2))
        end = int(np.searchsorted(way, way[first] + BEFORE, side="right"))
        if np.hypot(*(poses[other] - poses[end - 1])[:2]) < 3.0:
            continue
        light = int(np.searchsorted(stamps, stamps[other] + CARRIED))
        final = int(np.searchsorted(way, way[min(light, len(way) - 1)] + AFTER, side="right"))
        dark = end - first
        yield (
            piece(scans, range(first, end), range(other, final)),
            range(dark, dark + max(1, light - other)),
        )


def counts_of(run: Run, blind: range, limits: Limits) -> dict[str, Any]:
    """Numbers of one run: of its unique moments, and of the way after it was blind."""
    sure, after = run.unique > 0, run.metres - run.metres[blind.stop - 1]
    wide = (run.spread > (limits.metres, limits.radians)).any(axis=1)
    (back,) = np.nonzero((np.arange(len(after)) >= blind.stop) & (after >= 0) & (after <= BACK))
    return {
        "unique": sure.sum(), "wrong": (sure & (run.error > WRONG).any(axis=1)).sum(),
        "late": (sure & wide).sum(), "dark": sure[blind.start : blind.stop].sum(),
        "moments": len(blind), "worst": run.error[sure, 0].max(initial=0.0),
        "found": run.right[back[-1:]], "published": run.right[back] * run.unique[back],
        "inside": run.square[sure] <= REGION,
    }  # fmt: skip


def row_of(name: str, kind: str, metres: str, runs: Sequence[tuple[Run, range]]) -> dict[str, Any]:
    """Numbers of all runs of one kind."""
    each = [counts_of(run, blind, Limits()) for run, blind in runs]
    row: dict[str, Any] = {"log": name, "kind": kind, "blind": metres, "trials": len(runs)}
    row |= {k: int(sum(c[k] for c in each)) for k in ("unique", "wrong", "late", "dark", "moments")}
    shares: dict[str, Sequence[bool]] = {
        "found": [bool(c["found"][0]) for c in each if len(c["found"])],
        "published": [bool(c["published"].any()) for c in each if len(c["published"])],
        "inside": np.concatenate([c["inside"] for c in each]).tolist(),
    }
    row["worst"] = float(max(c["worst"] for c in each))
    return row | {k: float(np.mean(v)) if len(v) else float("nan") for k, v in shares.items()}


def measure_log(
    folder: Path, kinds: list[str], metres: list[float], count: int, seed: int, keep: Path | None
) -> Iterator[dict[str, Any]]:
    """The rows of one log."""
    options, (grid, scans, _) = Options(), load_log(folder, seed)
    features = prepare(grid, folder.name)

    def run(part: ScanSet, blind: range, kind: str) -> tuple[Run, range]:
        some = blinded(part, blind, kind)
        poses = robot_poses(some)
        assert poses is not None
        start = Pose2D(*poses[0])
        robot = make_filter("tracker", features, options, seed=seed, find=searches)
        return drive(features, some, robot, Every(), searches, start=start), blind

    searches = Searches(features, options, keep)
    for kind in kinds:
        for far in metres:
            rng = np.random.default_rng((seed, int(far)))
            runs = [run(*one, kind) for one in blackouts(scans, far, count, rng)]
            if runs:
                yield row_of(folder.name, kind, f"{far:g} m", runs)
        rng = np.random.default_rng((seed, 1))
        runs = [run(*one, kind) for one in carried(scans, count, rng)]
        if runs:
            yield row_of(folder.name, kind, "carried 10 s", runs)
        searches.save()


HEAD = (
    "log | sensor | blind for | trials | unique moments | and wrong | and too wide | while blind | "
    "worst m | found again | unique again | in 95 % region"
)


def cells(row: Mapping[str, Any]) -> tuple[object, ...]:
    """The cells of a row of the table."""
    return (
        row["log"], row["kind"], row["blind"], row["trials"], row["unique"], row["wrong"],
        row["late"], f"{row['dark']} of {row['moments']}", f"{row['worst']:.2f}",
        f"{row['found']:.2f}", f"{row['published']:.2f}", f"{row['inside']:.2f}",
    )  # fmt: skip


def main() -> None:
    """Measure, and write the table."""
    parser = parser_of_logs("blackouts", __doc__)
    parser.add_argument("--trials", type=int, default=10, help="of each kind (default 10)")
    parser.add_argument("--metres", default="10,30,60", help="without sight (default 10,30,60)")
    parser.add_argument("--kinds", default=",".join(KINDS), help=f"some of {', '.join(KINDS)}")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    far = [float(word) for word in given.metres.split(",")]
    kinds = given.kinds.split(",")
    for folder in given.folders:
        with progress(folder.name, len(kinds) * (len(far) + 1)) as advance:
            for row in measure_log(folder, kinds, far, given.trials, given.seed, given.searches):
                rows.append(row)
                advance()
                page = "\n".join(table_lines(HEAD, map(cells, rows))) + "\n"
                write_rows(given.out, "blackouts", rows, page)
    print((given.out / "blackouts.md").read_text())


if __name__ == "__main__":
    main()
