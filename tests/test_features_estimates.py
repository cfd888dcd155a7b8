"""What simulating and drawing take is known beforehand: bounds, and not by far."""

import pytest
from test_features_budget import office, peak

from imgloc.cli.maps import Subject, draw_subject
from imgloc.draw.canvas import default_scale
from imgloc.experiments.finegrid import fine_factor, refine_grid
from imgloc.experiments.scansets import Sensor, simulate_set
from imgloc.features.budget import surface_count
from imgloc.features.estimates import picture_bytes, simulate_bytes
from imgloc.features.mapfeatures import MapFeatures

SLACK = 40  # MiB of buffers of a fixed size


@pytest.mark.parametrize(("rooms", "count"), [(2, 2000), (8, 2), (20, 2)])
def test_simulating_takes_no_more_than_estimated(rooms: int, count: int) -> None:
    grid = office(rooms)
    taken = peak(lambda: simulate_set(grid, count, 0, Sensor(rays=91)))
    cells, factor = grid.occupied.size, fine_factor(grid)
    need = simulate_bytes(cells, factor**2 * cells, count * 91)
    assert taken <= need <= 3 * taken


def test_the_fine_image_is_as_large_as_said() -> None:
    grid = office(1)
    factor = fine_factor(grid, 0.02)
    height, width = grid.occupied.shape
    assert factor == 2
    assert refine_grid(grid, 0.02).occupied.shape == (factor * height, factor * width)


@pytest.mark.parametrize("what", list(Subject))
@pytest.mark.parametrize("rooms", [1, 8])
def test_drawing_takes_no_more_than_estimated(what: Subject, rooms: int) -> None:
    grid = office(rooms)
    features = MapFeatures(grid, cell=grid.resolution)
    shape, scale = grid.occupied.shape, default_scale(grid.info)
    taken = peak(lambda: draw_subject(features, what, None))
    need = picture_bytes(
        what.value, shape, scale**2 * grid.occupied.size, points=surface_count(grid)
    )
    assert taken <= need
    assert need <= 3 * taken + (SLACK << 20)
