"""What a simulation, and an answer in several processes, take is known beforehand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command import call
from test_features_budget import office, peak

from imgloc import ConfigError, Options, Pose2D, Sensor, prepare, simulate
from imgloc.features.budget import PROCESS
from imgloc.runs.opening import Desk, ScanFiles


def least(check: Callable[[Desk], None]) -> int:
    """The least budget, bytes, that a check lets pass."""
    low, high = 0, 1 << 40
    while high - low > 1:
        middle = (low + high) // 2
        try:
            check(Desk(memory_budget=middle))
            high = middle
        except ConfigError:
            low = middle
    return high


def test_each_process_takes_the_answer_itself_and_the_map() -> None:
    features = prepare(office(2), ready=False)
    one, three = (
        least(lambda desk, n=n: desk.check_answer(features, Options(), "office", workers=n))  # type: ignore[misc]
        for n in (1, 3)
    )
    grid = features.grid
    assert three == 3 * (one + PROCESS + grid.occupied.nbytes + grid.free.nbytes)


@pytest.mark.parametrize(("rooms", "count"), [(2, 2000), (8, 2)])
def test_scans_that_are_simulated_at_once_take_no_more_than_estimated(rooms, count):
    grid = office(rooms)
    taken = peak(lambda: simulate(grid, count, 0, Sensor(rays=91)))
    need = least(lambda desk: desk.check_simulation(grid, "office", count, 91))
    assert taken <= need <= 3 * taken


def test_scans_that_are_simulated_in_parts_take_less_by_the_rays_of_the_rest() -> None:
    grid = office(2)
    parts, whole = (
        least(lambda desk, n=n: desk.check_simulation(grid, "office", 2000, 91, at_once=n))  # type: ignore[misc]
        for n in (500, 9000)
    )
    every = least(lambda desk: desk.check_simulation(grid, "office", 2000, 91))
    assert whole == every
    # A part takes what simulating its scans alone takes; only the ranges of the others are kept.
    alone = least(lambda desk: desk.check_simulation(grid, "office", 500, 91))
    ranges_and_angles = 2 * np.dtype(float).itemsize * 1500 * 91
    assert alone + ranges_and_angles <= parts <= alone + 2 * ranges_and_angles
    assert parts < whole / 2


def test_a_simulation_beyond_the_budget_is_refused_by_the_command(tmp_path: Path) -> None:
    out = tmp_path / "sim.npz"
    ask = ("simulate", "visibility", "-n", "5000", "--rays", "1081", "--out", out)
    call(*ask, "--memory-budget", "500M").ends(2, "simulating 5,000 scans of 1,081 rays")
    assert not out.exists()


def test_a_sensor_far_from_its_robot_is_refused() -> None:
    with pytest.raises(ConfigError, match="centimetres"):
        ScanFiles(mount=Pose2D(100.0, 0.0))
