"""What `imgloc track` says at its end of a robot that it could not follow: one cause."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import Run, call, rows

import imgloc
from imgloc import LaserScan, OccupancyGrid, ScanSet


@pytest.fixture(scope="module")
def whole(shared: Path) -> ScanSet:
    return imgloc.load_scans(shared / "data" / "raw" / "fr079.log").take(range(60))


@pytest.fixture(scope="module")
def recorded(whole: ScanSet) -> ScanSet:
    """With each fourth ray alone: these are enough, and cost less."""
    return each(whole, lambda s: replace(s, ranges=s.ranges[::4], angles=s.angles[::4]))


@pytest.fixture(scope="module")
def few(recorded: ScanSet) -> ScanSet:
    return recorded.take(range(28))


@pytest.fixture(scope="module")
def place(shared: Path) -> OccupancyGrid:
    return imgloc.load_map(shared / "data" / "fr079" / "map.yaml", free_thresh=0.196)


def followed(place: OccupancyGrid, scans: ScanSet, folder: Path, *options: object) -> Run:
    imgloc.save_map(folder / "map.yaml", place, force=True)
    imgloc.save_scans(folder / "log.npz", scans, force=True)
    return call("track", folder / "map.yaml", folder / "log.npz", "--json", *options).ends(0)


def hints(run: Run) -> list[str]:
    lines = [line.removeprefix("imgloc: ") for line in run.err.splitlines()]
    return [line for line in lines if " scans, " not in line]


def share(run: Run) -> float:
    return float(np.mean([row["verdict"] == "unique" for row in rows(run.out)]))


def each(scans: ScanSet, change: Callable[[LaserScan], LaserScan]) -> ScanSet:
    return replace(scans, scans=tuple(map(change, scans.scans)))


def scaled(by: float) -> Callable[[LaserScan], LaserScan]:
    return lambda s: replace(s, ranges=by * s.ranges, range_max=by * s.range_max)


@pytest.mark.parametrize(
    ("change", "count", "said"),
    [
        (lambda s: s.flipped, 40, "the sensor hangs upside down. Try --flipped"),
        (scaled(0.5), 24, "agree with the odometry, if ranges are multiplied by 2: "),
    ],
)  # fmt: skip
def test_a_cause_is_named_and_its_remedy_helps(recorded, place, tmp_path, change, count, said):
    scans = each(recorded.take(range(count)), change)
    run = followed(place, scans, tmp_path)
    (hint,) = hints(run)
    assert said in hint
    options = re.search(r"Try (--[^,]+)", hint)[1].split()
    mended = followed(place, scans, tmp_path, *options)
    assert not hints(mended)
    assert share(mended) > max(0.8, share(run))


def test_nothing_is_said_of_a_robot_that_is_followed(few, place, tmp_path):
    run = followed(place, few, tmp_path)
    assert not hints(run)
    words = run.err.splitlines()[-1]
    early = [row for row in rows(run.out) if row["withheld"] == "unconfirmed"]
    assert f"({len(early)} of the ambiguous ones at one place that is not confirmed yet)" in words
    assert 0 < len(early) == sum(row["verdict"] == "ambiguous" for row in rows(run.out))
    plain = call("track", tmp_path / "map.yaml", tmp_path / "log.npz")
    assert len(re.findall("ambiguous: unconfirmed", plain.out)) == len(early)


def test_a_mirrored_map_is_told_from_a_sensor_upside_down(recorded, place, tmp_path):
    mirrored = OccupancyGrid(place.occupied[::-1], place.free[::-1], place.resolution)
    (hint,) = hints(followed(mirrored, recorded, tmp_path))
    assert "the image of the map is mirrored. Mirror it" in hint
    (hint,) = hints(followed(place, recorded.take(range(40)), tmp_path, "--flipped"))
    assert hint.endswith("the sensor does not hang upside down. Leave out --flipped")


def test_another_building_and_an_old_map_are_told_apart(shared, whole, few, place, tmp_path):
    other = imgloc.load_map(shared / "data" / "gh25" / "map.yaml", free_thresh=0.196)
    (hint,) = hints(followed(other, few.take(range(12)), tmp_path))
    assert hint.startswith("most scans do not fit this map: is it the map of this place?")
    rng = np.random.default_rng(1)
    occupied, free = place.occupied.copy(), place.free.copy()
    spots = np.argwhere(free)
    for row, column in spots[rng.choice(len(spots), 300)]:
        box = slice(row, row + 10), slice(column, column + 10)
        occupied[box], free[box] = True, False
    height, width = occupied.shape
    gone = np.kron(rng.random((height // 20 + 1, width // 20 + 1)) < 0.35, np.ones((20, 20), bool))
    walls = gone[:height, :width] & place.occupied
    old = OccupancyGrid(occupied & ~walls, free | walls, place.resolution, place.origin)
    (hint,) = hints(followed(old, whole.take(range(46)), tmp_path))
    assert "the map may be old. imgloc map changes MAP SCANS shows where" in hint
