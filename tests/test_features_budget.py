"""Memory is known beforehand: the estimates bound what is really taken, and not by far."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imgloc import ALL_METHODS, METHODS, ConfigError, LaserScan, MapFeatures, OccupancyGrid, Options
from imgloc.features.budget import (
    MIB,
    available_bytes,
    features_bytes,
    fused_bytes,
    stack_bytes,
    surface_count,
)
from imgloc.pipeline import localize
from imgloc.search.asked import answer_bytes

FIXED = fused_bytes((1, 1))  # what is assumed whatever the sizes


def office(rooms: int, resolution: float = 0.05) -> OccupancyGrid:
    """Square rooms of 5 m with doors, two walls to each cell of the pattern."""
    side = round(5 / resolution)
    room = np.zeros((side, side), dtype=bool)
    room[:2] = room[:, :2] = True
    room[side // 2 : side // 2 + 20, :2] = room[:2, side // 3 : side // 3 + 20] = False
    walls = np.tile(room, (rooms, rooms))
    return OccupancyGrid(walls, ~walls, resolution)


def scan() -> LaserScan:
    angles = np.linspace(-np.pi, np.pi, 90)
    return LaserScan(np.full(90, 2.0) + 0.2 * np.cos(3 * angles), angles, range_max=10.0)


def peak(work: Callable[[], object]) -> int:
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_preparing_takes_no_more_than_estimated() -> None:
    grid = office(8)
    names = ("walls", "field", "standable", "pyramid", "surface")
    features = MapFeatures(grid)
    taken = peak(lambda: [getattr(features, name) for name in names])
    need = features.bytes_for("fused")
    assert need == features_bytes(grid.occupied.shape, points=surface_count(grid), factor=2)
    assert taken <= need
    assert need <= 6 * taken


def test_unknown_cells_have_no_surface() -> None:
    walls = np.eye(5, dtype=bool)
    assert surface_count(OccupancyGrid(walls, np.zeros((5, 5), bool), 1.0)) == 0


@pytest.mark.parametrize("method", METHODS)
def test_a_stack_takes_no_more_than_estimated(method: str) -> None:
    features = MapFeatures(office(6, 0.1), n_psi=24, n_rays=48)
    if method == "ght-v":
        _ = features.visibility
    _ = features.surface, features.bmap, features.field, features.walls, features.free
    options = Options(method=method, theta_step=2 * np.pi / 24)
    taken = peak(lambda: localize(features, scan(), options))
    need = stack_bytes(method, features.lattice.shape, 24, n_rays=48)
    assert taken <= need
    assert need - FIXED <= 3 * taken


@pytest.mark.parametrize("method", ALL_METHODS)
def test_features_and_answer_take_no_more_than_estimated(method: str) -> None:
    grid = office(4)
    features, options = MapFeatures(grid, n_rays=48), Options(method=method, theta_step=np.pi / 6)
    taken = peak(lambda: localize(features, scan(), options))
    assert taken <= features.bytes_for(method) + answer_bytes(features, options)


def test_the_budget_of_the_options_is_that_of_the_ray_distances(monkeypatch):
    monkeypatch.setattr("imgloc.features.budget.available_bytes", lambda: 0)
    features = MapFeatures(office(1, 0.1), n_rays=24)
    with pytest.raises(ConfigError, match=r"24 directions x 50 x 50 cells, needs 1 MiB of memory"):
        _ = features.ray_distances
    allowed = Options(method="beam", theta_step=2 * np.pi / 24, memory_budget=1 << 42)
    assert localize(features, scan(), allowed).hypotheses
    assert len(MapFeatures(features.grid, n_rays=24, memory_budget=1 << 20).ray_distances) == 24


def test_available_memory_of_linux(tmp_path: Path) -> None:
    meminfo = tmp_path / "meminfo"
    meminfo.write_text("MemTotal:  9000 kB\nMemFree:  100 kB\nMemAvailable:    2048 kB\n")
    assert available_bytes(meminfo, tmp_path) == 2 * MIB


@pytest.mark.parametrize(
    ("limit", "used", "expected"),
    [(str(3 * MIB), str(2 * MIB), MIB), ("max", "5", 2 * MIB), ("5", "9", 0)],
)
def test_a_container_may_leave_less(tmp_path: Path, limit: str, used: str, expected: int) -> None:
    (tmp_path / "meminfo").write_text("MemAvailable: 2048 kB\n")
    (tmp_path / "memory.max").write_text(limit + "\n")
    (tmp_path / "memory.current").write_text(used + "\n")
    assert available_bytes(tmp_path / "meminfo", tmp_path) == expected


@pytest.mark.parametrize("text", ["", "MemAvailable:\n", "MemAvailable: many kB\n"])
def test_other_systems(tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "meminfo").write_text(text)
    pages = {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 1000}
    monkeypatch.setattr("os.sysconf", pages.__getitem__, raising=False)
    assert available_bytes(tmp_path / "meminfo", tmp_path) == 2_048_000
    monkeypatch.delattr("os.sysconf")
    assert available_bytes(tmp_path / "meminfo", tmp_path) == 4096 * MIB
