"""Is a robot found, and kept, on a map that others drew long ago? The tracker along recorded logs.

Run it with the folders of sets, each with ``map.yaml`` and ``scans.npz`` (poses, odometry, and the
number of its log for each scan)::

    python -m tools.old_maps ../data/wean --starts 8
    python -m tools.old_maps ../data/wean --starts 8 --calibrated
    python -m tools.old_maps ../data/wean --one-scan 60
    python -m tools.old_maps ../data/gh25 --thicker 2 --starts 4
    python -m tools.old_maps ../data/gh25 --thicker 2 --scale 1.05 --fit

It prints a row for each log from its true start, and a row for starts spread over it from anywhere.
The root mean square error and the mean normalised estimation error squared (3 if the claims are
right) are of the ``unique`` poses. With ``--thicker N`` each wall is N cells thicker on each side,
with ``--scale F`` all ranges are F times as long.

With ``--calibrated`` the tracker begins with what ``imgloc calibrate --scans`` finds in the set.
With ``--fit`` it prints what that command finds if no odometry joins the scans.
With ``--one-scan N`` it locates each of N scans by itself, with the walls as drawn and with what
``imgloc calibrate --scans`` finds in the whole set. A log without odometry gets that of its poses,
with noise.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from imgloc import Options, Pose2D, ScanSet, load_map, load_scans, make_filter, prepare
from imgloc.filters.follow import robot_poses
from imgloc.lab.calibrate import fit_along, fit_shared
from imgloc.options import Chosen, Every, Shared
from tools.filters import Run, Searches, drive, driven, from_starts
from tools.plans.measure import Row, judge
from tools.recorded import logs_of
from tools.script import at_least_one, ended, parser_of, show, table_lines
from tools.trust.disturb import dilated

RIGHT = 1.0  # metres
FOUND = 30.0  # metres driven after which a robot should be found
PIECE = 35.0  # metres of a run from anywhere
ONE = "set | walls | scans | first | unique | unique and wrong | no-match | lists the pose"
FIT = "set | cells thicker | ranges times | found: ranges times | +- | cells thinner | fit"
HEAD = "log | start | within 1 m | unique | unique and wrong | right after 30 m | RMSE m | NEES"


def row_of(log: str, start: str, runs: list[Run]) -> tuple[str, ...]:
    """The cells of a table: what became of some runs."""
    off, unique, nees = map(
        np.concatenate,
        zip(*((run.error[:, 0], run.unique > 0, run.square) for run in runs), strict=True),
    )
    near = off <= RIGHT
    last = [run.error[run.metres >= FOUND, 0] for run in runs]
    found = [errors[0] <= RIGHT for errors in last if len(errors)]
    wrong = f"{np.count_nonzero(unique & ~near)} of {len(near)}"
    shares = f"{near.mean():.2f}", f"{unique.mean():.2f}"
    exact = np.sqrt(np.square(off).mean(where=unique)), nees.mean(where=unique)
    return log, start, *shares, wrong, f"{sum(found)} of {len(found)}", *map("{:.3g}".format, exact)


def rows_of(folder: Path, how: argparse.Namespace) -> Iterator[tuple[str, ...]]:
    """The rows of a set."""
    grid = dilated(load_map(folder / "map.yaml"), np.random.default_rng(0), how.thicker)
    features, options = prepare(grid, folder.name), Options()
    if how.calibrated:
        logs = [scans for _, scans in logs_of(folder)]
        options = Options(shared=fit_along(features, logs).shared)
    for name, recorded in logs_of(folder):
        scans = replace(recorded, scans=tuple(scan.scaled(how.scale) for scan in recorded.scans))
        make = partial(make_filter, "tracker", features, options)
        poses = robot_poses(scans)
        known = Searches(features, options)  # its clock; the tracker searches by itself
        if poses is not None:
            begin = Pose2D(*poses[0])
            run = drive(features, scans, make(), Every(), known, start=begin)
            yield row_of(name, "true", [run])
        runs = [drive(features, p, make(), Every(), known) for p in pieces_of(scans, how.starts)]
        yield row_of(name, f"{how.starts} from anywhere", runs)


def pieces_of(scans: ScanSet, starts: int) -> Iterator[ScanSet]:
    """Pieces of a log, spread over it."""
    last = int(np.searchsorted(driven(scans), max(0.0, driven(scans)[-1] - FOUND - 2)))
    yield from from_starts(scans, np.linspace(0, last, starts).astype(int).tolist(), PIECE)


def fitted_row(folder: Path, how: argparse.Namespace) -> tuple[object, ...]:
    """The row of the error that the scans of a set share, one by one."""
    grid = dilated(load_map(folder / "map.yaml"), np.random.default_rng(0), how.thicker)
    scans = [scan.scaled(how.scale) for scan in load_scans(folder / "scans.npz").scans]
    found = fit_shared(prepare(grid, folder.name), scans)
    scale, thinner = found.shared.scale, found.shared.thinner
    fit = f"{found.used} of {found.asked}"
    cells = f"{scale:.4f}", f"{found.deviation:.4f}", thinner, fit
    return folder.name, how.thicker, f"{how.scale:g}", *cells


def one_scan_rows(folder: Path, n: int, seed: int) -> Iterator[tuple[object, ...]]:
    """The rows of a set whose scans are located one by one."""
    grid, recorded = load_map(folder / "map.yaml"), load_scans(folder / "scans.npz")
    some = recorded.take(Chosen(sample=n, seed=seed).of(len(recorded), folder.name))
    features = prepare(grid, folder.name)
    walls = {"as drawn": Shared(), "calibrated": fit_along(features, [recorded]).shared}
    for name, shared in walls.items():
        judge(grid, some, row := Row(folder.name, name), options=Options(shared=shared))
        counts = row.scans, row.right, row.unique, row.wrong, row.nothing, row.among
        yield folder.name, name, *counts


def main() -> int:
    """Print the table."""
    parser = parser_of("tools.old_maps", __doc__, seed=1)
    parser.add_argument("folders", nargs="+", type=Path, help="with map.yaml and scans.npz")
    parser.add_argument("--starts", type=int, default=8, help="from anywhere, in each log")
    parser.add_argument("--calibrated", action="store_true", help="begin with fitted walls")
    parser.add_argument("--thicker", type=int, default=0, metavar="CELLS", help="walls, a side")
    parser.add_argument("--scale", type=float, default=1.0, help="factor on all ranges")
    parser.add_argument("--fit", action="store_true", help="print what calibrate finds")
    parser.add_argument("--one-scan", type=int, metavar="N", help="locate N scans one by one")
    given = parser.parse_args()

    def work() -> int:
        if given.one_scan is not None:
            at_least_one(one_scan=given.one_scan)
            ones = (one_scan_rows(f, given.one_scan, given.seed) for f in given.folders)
            return show(table_lines(ONE, chain.from_iterable(ones)))
        if given.fit:
            return show(table_lines(FIT, (fitted_row(f, given) for f in given.folders)))
        at_least_one(starts=given.starts)
        rows = chain.from_iterable(rows_of(folder, given) for folder in given.folders)
        return show(table_lines(HEAD, rows))

    return ended("tools.old_maps", work)


if __name__ == "__main__":
    raise SystemExit(main())
