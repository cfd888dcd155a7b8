"""Pictures of tracks: where a robot was carried, a dashed line leads from one way to the next."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from imgloc import Belief, Moment, OccupancyGrid, Pose2D, prepare
from imgloc.filters.belief import UNIQUE
from imgloc.output.tracks import OFF, Video, draw_track


def moments(ways: list[list[float]]) -> list[Moment]:
    """A robot that drives along x, 0.5 m from scan to scan, on each of some ways."""
    out = list[Moment]()
    for way in ways:
        for x in way:
            poses, k = np.array([[x, 2.0, 0.0]]), len(out)
            belief = Belief(poses, np.ones(1), np.eye(3)[None] * 1e-4, 0.0, UNIQUE, 1.0)
            about = (k, float(k), 0.0, True, 0.5 * k, belief, "", Pose2D(x, 2.0))
            out.append(Moment(*about, np.eye(3) * 1e-4, (0.01, 0.01), None))
    return out


def test_a_kidnapping_is_a_dashed_line_from_way_to_way() -> None:
    wall = np.pad(np.zeros((36, 116), bool), 2, constant_values=True)
    grid = OccupancyGrid(wall, ~wall, 0.1)
    carried = moments([[1.0, 1.5, 2.0, 2.5], [8.0, 8.5, 9.0]])
    image = draw_track(grid, carried).image
    row, column = np.nonzero((image == OFF).all(axis=2))
    scale = 9  # pixels of a cell, of 40 rows; below are a tick and the legend
    drawn = np.flatnonzero(np.bincount(column[row < 40 * scale + 40], minlength=image.shape[1]))
    assert drawn.max() - drawn.min() == np.clip(drawn.max() - drawn.min(), 45 * scale, 56 * scale)
    assert 0.3 < len(drawn) / (drawn.max() - drawn.min()) < 0.8  # dashes
    driven = draw_track(grid, moments([[1.0, 1.5, 2.0, 2.5, 3.0]])).image
    assert not (driven == OFF).all(axis=2).any()
    missed = [m if k < 4 else replace(m, metres=m.metres + 5.5) for k, m in enumerate(carried)]
    assert not (draw_track(grid, missed).image == OFF).all(axis=2).any()  # it drove there unseen
    video, frames = Video(prepare(grid)), list[np.ndarray]()
    video.close()
    video._writer = SimpleNamespace(write=frames.append)
    for moment in carried:
        video.add(moment)
    off = [bool((frame[: 40 * 8] == OFF).all(axis=2).any()) for frame in frames]
    assert off == [False] * 4 + [True] * 3  # from then on
