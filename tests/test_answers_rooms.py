"""A building of equal rooms: each is listed, and drawn as often as the others."""

import numpy as np
import pytest

from imgloc import Options, localize, prepare, simulate
from imgloc.answers.sample import sample_poses
from imgloc.model import OccupancyGrid

WIDE, HIGH, CELL, MANY = 80, 60, 0.05, 8


@pytest.fixture(scope="module")
def building():
    room = np.ones((HIGH, WIDE), bool)
    room[2:-2, 2:-2] = False
    walls = np.pad(np.tile(room, (MANY, MANY)), 2, constant_values=True)
    return prepare(OccupancyGrid(walls, ~walls, CELL))


def rooms_of(poses) -> np.ndarray:
    """Number of poses (M, 3) in each room."""
    x, y = np.floor((np.asarray(poses)[:, :2].T - 2 * CELL) / [[WIDE * CELL], [HIGH * CELL]])
    inside = (x >= 0) & (x < MANY) & (y >= 0) & (y < MANY)
    return np.bincount((MANY * y + x)[inside].astype(int), minlength=MANY * MANY)


@pytest.mark.parametrize("seed", [1, 2])
def test_each_of_64_equal_rooms_is_listed_and_drawn_alike(building, seed) -> None:
    scan = simulate(building.grid, 1, seed=seed)[0]
    answer = localize(building, scan, Options(top=500))
    assert answer.verdict == "ambiguous"
    poses = [(h.pose.x, h.pose.y, h.pose.theta) for h in answer.hypotheses]
    assert (rooms_of(poses) == 2).all()  # a rectangle looks alike after half a turn
    drawn = rooms_of(sample_poses(building, scan, 6400, np.random.default_rng(0)))
    assert drawn.min() > 0.6 * drawn.mean()
    assert drawn.max() < 1.4 * drawn.mean()
