"""The bundled worlds: what they promise, at any resolution."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from imgloc import ConfigError, Pose2D, load_map
from imgloc.geometry import cell_of, transform_points
from imgloc.simulation.worlds import NICHE, NICHES, WORLDS, World, render
from tools.make_maps import make_maps

MAPS = Path(__file__).resolve().parents[1] / "maps"


def square(x0, y0, x1, y1):
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], dtype=float)


def test_cells_of_a_room_with_a_block():
    world = World(
        "t", (0.7, 0.5), (square(0.1, 0.1, 0.6, 0.4),), (square(0.3, 0.2, 0.5, 0.3),), 0.1
    )
    picture = np.where(render(world, 0.1).occupied, 2, render(world, 0.1).free)
    expected = [
        [2, 2, 2, 2, 2, 2, 2],
        [2, 1, 1, 1, 1, 1, 2],
        [2, 1, 1, 2, 2, 1, 2],
        [2, 1, 1, 1, 1, 1, 2],
        [2, 2, 2, 2, 2, 2, 2],
    ]
    assert picture.tolist() == expected


def test_rooms_that_overlap_open_into_each_other_and_beyond_is_unknown():
    world = World("t", (2.0, 1.0), (square(0.3, 0.3, 1.0, 0.7), square(0.9, 0.3, 1.5, 0.7)))
    grid = render(world, 0.1)
    assert grid.free[3:7, 3:15].all()
    assert grid.unknown[:, 18:].all()
    assert grid.occupied[5, 15:17].all()


@pytest.mark.parametrize("name", WORLDS)
def test_the_resolution_changes_cells_and_not_walls(name):
    world = WORLDS[name]()
    coarse, fine = render(world, 0.1), render(world, 0.05)
    assert coarse.resolution == 0.1
    assert np.array(fine.occupied.shape).tolist() == [2 * n for n in coarse.occupied.shape]
    again = np.repeat(np.repeat(coarse.occupied, 2, axis=0), 2, axis=1)
    # Only outlines that run through cells may differ, and by one fine cell at most.
    kernel = np.ones((3, 3), dtype=np.uint8)
    edge = cv2.morphologyEx(fine.occupied.astype(np.uint8), cv2.MORPH_GRADIENT, kernel) > 0
    assert not np.any((again != fine.occupied) & ~edge)


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_is_closed_and_its_free_space_is_one_piece(name):
    grid = render(WORLDS[name](), 0.1)
    assert not grid.free[[0, -1]].any()
    assert not grid.free[:, [0, -1]].any()
    pieces, labels = cv2.connectedComponents(grid.free.astype(np.uint8), connectivity=4)
    sizes = np.bincount(labels.ravel(), minlength=pieces)[1:]
    assert sizes.max() == sizes.sum()
    # No free cell touches an unknown one: a wall is between them.
    grown = cv2.dilate(grid.unknown.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0
    assert not np.any(grown & grid.free)


def test_the_niches_of_double_wall_share_an_outline_and_not_a_side():
    grid = render(WORLDS["double_wall"](), 0.02)
    middle = (NICHE[1:] + NICHE[:-1]) / 2
    along = np.diff(NICHE, axis=0) / np.hypot(*np.diff(NICHE, axis=0).T)[:, None]
    inward = np.column_stack((-along[:, 1], along[:, 0]))
    assert np.all(np.sum(inward * ((1.5, 0.0) - middle), axis=1) > 0)
    for k, niche in enumerate(NICHES):
        for step, solid in ((-0.35, 0), (-0.25, 1), (-0.05, 1), (0.05, 2), (0.25, 2), (0.35, 0)):
            row, column = cell_of(transform_points(Pose2D(*niche), middle + step * inward), 0.02).T
            assert grid.occupied[row, column].all() == (solid == (1 if k == 0 else 2))
            assert grid.free[row, column].all() == (solid != (1 if k == 0 else 2))


def test_the_rooms_of_visibility_differ_by_the_screen_alone():
    grid = render(WORLDS["visibility"](), 0.1)
    difference = grid.occupied & ~grid.occupied[::-1, ::-1]
    rows, columns = np.nonzero(difference)
    assert (rows.min(), rows.max()) == (56, 57)
    assert (columns.min(), columns.max()) == (101, 181)


def test_the_double_walls_of_large_leave_a_gap_of_four_cells():
    grid = render(WORLDS["large"](), 0.1)
    assert np.flatnonzero(grid.occupied[100, 230:260]).tolist() == [12, 13, 18, 19]
    assert np.flatnonzero(grid.occupied[170:205, 200]).tolist() == [14, 15, 20, 21]


def test_a_curved_world_has_normals_in_every_direction():
    grid = render(WORLDS["curved"](), 0.05)
    image = cv2.GaussianBlur(grid.free.astype(np.float32), (0, 0), 3)
    gx, gy = cv2.Sobel(image, cv2.CV_32F, 1, 0), cv2.Sobel(image, cv2.CV_32F, 0, 1)
    strong = np.hypot(gx, gy) > 0.3
    share, _ = np.histogram(np.arctan2(gy, gx)[strong], bins=12)
    assert share.min() > 0.03 * share.sum()


@pytest.mark.parametrize("resolution", [0.0, -1.0, np.nan, np.inf])
def test_resolution_must_make_sense(resolution):
    with pytest.raises(ConfigError, match="resolution"):
        render(WORLDS["curved"](), resolution)


@pytest.mark.parametrize("name", WORLDS)
def test_the_bundled_map_is_the_world(name):
    bundled, drawn = load_map(MAPS / f"{name}.yaml"), render(WORLDS[name](), 0.1)
    np.testing.assert_array_equal(bundled.occupied, drawn.occupied)
    np.testing.assert_array_equal(bundled.free, drawn.free)
    assert bundled.info == drawn.info


def test_make_maps_writes_them_all_again(tmp_path):
    paths = make_maps(tmp_path / "new")
    assert [path.stem for path in paths] == list(WORLDS)
    for path in paths:
        assert path.read_bytes() == (MAPS / path.name).read_bytes()
        assert load_map(path).info == load_map(MAPS / path.name).info
