"""Outlines of walls: those of scikit-image, vertex for vertex."""

import numpy as np
import pytest
import skimage.measure
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from imgloc.features import contours
from imgloc.features.contours import outlines


def reference(occupied):
    """What find_contours says, in the coordinates of `outlines`."""
    image = np.pad(occupied, 1).astype(float)
    found = skimage.measure.find_contours(
        image, 0.5, fully_connected="high", positive_orientation="high"
    )
    vertices = np.concatenate([np.zeros((0, 2)), *found])[:, ::-1] - 0.5
    return vertices, np.array([len(contour) for contour in found], np.int64)


def check(occupied):
    for ours, theirs in zip(outlines(occupied), reference(occupied), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@settings(max_examples=200, deadline=None)
@given(arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_every_vertex_is_that_of_scikit_image(occupied):
    check(occupied)


@pytest.mark.parametrize("density", [0.02, 0.3, 0.5, 0.7, 0.98])
@pytest.mark.parametrize("band", [1, 3, 1024])
def test_bands_of_rows_change_nothing(monkeypatch, density, band):
    monkeypatch.setattr(contours, "_BAND", band)
    check(np.random.default_rng(7).random((60, 45)) < density)


def test_a_long_cycle():
    """A snake: the outline of its one wall visits most cells."""
    occupied = np.ones((41, 30), bool)
    occupied[1::2] = False
    occupied[1::4, 0] = occupied[3::4, -1] = True
    assert outlines(occupied)[1].max() > occupied.size
    check(occupied)


def test_corners_hold_together():
    _, size = outlines(np.eye(3, dtype=bool))
    assert size.tolist() == [13]  # twelve sides of cells, and back


def test_the_wall_is_on_the_right():
    vertices, _ = outlines(np.array([[True]]))
    x, y = (vertices - 0.5).T
    turn = x[:-1] * y[1:] - x[1:] * y[:-1]
    assert (turn < 0).all()  # clockwise around a wall


@pytest.mark.parametrize("shape", [(0, 4), (3, 0), (2, 3)])
def test_nothing_occupied(shape):
    vertices, size = outlines(np.zeros(shape, bool))
    assert vertices.shape == (0, 2)
    assert size.tolist() == []


def test_the_image_may_be_a_view():
    occupied = np.random.default_rng(3).random((30, 20)) < 0.5
    check(occupied.T)
    check(occupied[::-1, ::2])


def test_a_real_map(shared):
    import cv2

    data = np.fromfile(shared / "data" / "fr079" / "map.png", np.uint8)
    check(cv2.imdecode(data, cv2.IMREAD_UNCHANGED) == 0)
