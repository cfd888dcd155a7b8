"""Filters along recorded logs: who finds the robot, and who keeps it.

Run it with the folders of logs, each with ``map.yaml`` and ``scans.npz`` (poses, and odometry if
it was recorded)::

    python -m tools.sequences ../data/fr079_half ../data/duke_loop5 --out sequences

It writes a table (``sequences.md``, and every number in ``sequences.jsonl``). *Localized* is what
``~/status`` of ``imgloc node`` says.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from imgloc import LaserScan, OccupancyGrid, Options, ScanSet, load_map, load_scans, prepare
from imgloc.filters.follow import with_odometry
from imgloc.geometry import wrap
from tools.filters import GIVEN, Searches, Trials, measure, parser_of_logs, write_rows
from tools.recorded import scans_in
from tools.script import progress, table_lines

NEAR, VIEW, STOPPED = 5.0, float(np.deg2rad(90.0)), 0.3
LAG = 0.4  # seconds
_GRID_CELL = 0.2


@dataclass(frozen=True)
class Case:
    """A filter, and what is done to the scans."""

    name: str
    filter: str = "tracker"
    scans: str = "as recorded"
    reset_by: str = "ght-v"
    given: str = ""


CASES = (
    Case("tracker"),
    Case("tracker, 5 m and 90 deg", scans="near"),
    Case("tracker, 30 % stopped short", scans="stopped"),
    Case("tracker, odometry lags", scans="lagging"),
    *(Case(f"tracker, given {where}", given=where) for where in GIVEN),
    Case("particle, GHT-V", "particle"),
    Case("particle, CBML", "particle", reset_by="cbml"),
    Case("grid", "grid"),
)


def near(scan: LaserScan, _: np.random.Generator) -> LaserScan:
    """The scan of a sensor that sees 5 m far and 90 degrees wide."""
    seen = np.abs(scan.angles) <= VIEW / 2
    reach = min(scan.range_max, NEAR)
    return replace(scan, ranges=scan.ranges[seen], angles=scan.angles[seen], range_max=reach)


def stopped(scan: LaserScan, rng: np.random.Generator) -> LaserScan:
    """The scan with 30 % of its readings stopped short, anywhere on their way."""
    ranges = scan.ranges.copy()
    hit = (rng.random(len(ranges)) < STOPPED) & scan.valid
    ranges[hit] *= rng.uniform(0.1, 1.0, int(hit.sum()))
    return replace(scan, ranges=ranges)


def lagging(scans: ScanSet) -> ScanSet:
    """The log of a robot whose odometry gives a heading of some time ago."""
    if scans.odom is None or scans.stamps is None:
        return scans
    turned = np.unwrap(scans.odom[:, 2])
    late = wrap(np.interp(scans.stamps - LAG, scans.stamps, turned))
    return replace(scans, odom=np.column_stack((scans.odom[:, :2], late)))


_CHANGES: Mapping[str, Callable[[LaserScan, np.random.Generator], LaserScan]] = {
    "as recorded": lambda scan, _: scan, "near": near, "stopped": stopped,
}  # fmt: skip


def changed(scans: ScanSet, how: str, seed: int) -> ScanSet:
    """The scans as they would have been under other conditions."""
    if how == "lagging":
        return lagging(scans)
    rng = np.random.default_rng(seed)
    return replace(scans, scans=tuple(_CHANGES[how](scan, rng) for scan in scans.scans))


def load_log(folder: Path, seed: int = 0) -> tuple[OccupancyGrid, ScanSet, str]:
    """A map, scans of the sensor where it sits, with odometry, and where that is from."""
    return load_map(folder / "map.yaml"), *with_odometry(scans_in(folder), seed)


def measure_log(
    folder: Path,
    cases: Sequence[Case],
    trials: Trials,
    advance: Callable[[], None],
    keep: Path | None = None,
) -> Iterator[dict[str, Any]]:
    """The rows of one log."""
    options, (grid, recorded, odometry) = Options(), load_log(folder, trials.seed)
    fine, coarse = prepare(grid, folder.name), prepare(grid, folder.name, cell=_GRID_CELL)
    kept: dict[str, tuple[ScanSet, Searches]] = {}
    for case in cases:
        if case.scans not in kept:
            some = changed(recorded, case.scans, trials.seed)
            kept[case.scans] = some, Searches(fine, options, keep)
        scans, searches = kept[case.scans]
        features = coarse if case.filter == "grid" else fine
        how = replace(trials, reset_by=case.reset_by, given=case.given)
        try:
            summary = measure(
                features, scans, case.filter, how, options, searches=searches, advance=advance
            )
        finally:  # who stops it goes on from there another day
            searches.save()
        about = {"map": folder.name, "filter": case.name}
        yield about | summary | {"odometry": odometry}


def page(rows: Sequence[Mapping[str, Any]], trials: Trials) -> str:
    """The table, in Markdown."""
    right = " | ".join(f"{m} m" for m in rows[0]["right"])
    head = (
        f"log | filter | runs | {right} | stays, 2 m | 10 m | unique, 10 m | s, m to converge | "
        "RMSE m, deg | in 95 % region | s unique, wrong | s localized, wrong | unique, localized "
        "end, times a minute | kidnapped: back | after m | ENM-MCL | "
        "F3Loc 1, .5, .3, .2 m | x real time"
    )
    cells = (
        (row["map"], row["filter"], row["runs"],
         *map(_share, row["right"].values()),
         _share(row["stays"]["2"]), _share(row["stays"]["10"]), _share(row["published"]["10"]),
         f"{row['seconds']:.0f}, {row['metres']:.1f}",
         f"{row['rmse'][0]:.3f}, {np.rad2deg(row['rmse'][1]):.2f}",
         _share(row["inside"]),
         f"{row['wrong']:.1f} of {row['total']:.0f}", f"{row['held']:.1f}",
         ", ".join(f"{each:.2f}" for each in row["falls"]),
         f"{row['kidnapped']['hits']} of {row['kidnapped']['trials']}",
         f"{row['kidnap_metres']:.1f}", _share(row["enm"]),
         ", ".join(map(_share, row["f3loc"].values())), f"{row['speed']:.1f}")
        for row in rows
    )  # fmt: skip
    kinds = sorted({f"{row['map']} {row['odometry']}" for row in rows})
    return (
        f"Starts: {trials.starts} at random and one each {trials.seconds:g} s, "
        f"{trials.metres:g} m each; {trials.kidnaps} kidnappings; seed {trials.seed}. Odometry: "
        + "; ".join(kinds)
        + ".\n\n"
        + "\n".join(table_lines(head, cells))
        + "\n"
    )


def _share(share: Mapping[str, Any]) -> str:
    return "-" if not share["trials"] else f"{share['value']:.2f}"


def main() -> None:
    """Measure, and write the table."""
    parser = parser_of_logs("sequences", __doc__)
    parser.add_argument("--starts", type=int, default=50, help="at random (default 50)")
    parser.add_argument("--seconds", type=float, default=30.0, help="between regular starts")
    parser.add_argument("--kidnaps", type=int, default=20)
    parser.add_argument("--metres", type=float, default=15.0)
    parser.add_argument("--cases", default="*", help="only those: patterns with ; between")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    trials = Trials(given.starts, given.metres, given.kidnaps, given.seed)
    trials = replace(trials, seconds=given.seconds)
    wanted = given.cases.split(";")
    cases = [c for c in CASES if any(fnmatchcase(c.name, pattern) for pattern in wanted)]
    rows: list[dict[str, Any]] = []
    for folder in given.folders:
        count = len(cases) * trials.count(load_scans(folder / "scans.npz"))
        with progress(folder.name, count) as advance:
            for row in measure_log(folder, cases, trials, advance, given.searches):
                rows.append(row)
                write_rows(given.out, "sequences", rows, page(rows, trials))
    print((given.out / "sequences.md").read_text())


if __name__ == "__main__":
    main()
