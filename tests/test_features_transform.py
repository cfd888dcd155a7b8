"""The distance transform is exact, and the same for any number of threads."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from imgloc.features.distance import FARTHEST_CELLS, distance_transform


@pytest.fixture(autouse=True)
def _restore_threads() -> Iterator[None]:
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def test_equals_the_distance_to_every_wall() -> None:
    rng = np.random.default_rng(3)
    image = (rng.random((61, 83)) > 0.01).astype(np.uint8)
    rows, columns = np.indices(image.shape)
    walls = np.argwhere(image == 0)
    squares = np.min([(rows - r) ** 2 + (columns - c) ** 2 for r, c in walls], axis=0)
    np.testing.assert_array_equal(distance_transform(image), np.sqrt(squares).astype(np.float32))


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_far_from_a_single_wall_it_is_exact_and_then_capped(threads: int) -> None:
    cv2.setNumThreads(threads)
    image = np.ones((420, 640), np.uint8)
    image[17, 30] = 0
    rows, columns = np.indices(image.shape)
    squares = (rows - 17) ** 2 + (columns - 30) ** 2
    expected = np.minimum(np.sqrt(squares), FARTHEST_CELLS).astype(np.float32)
    assert squares.max() > FARTHEST_CELLS**2
    np.testing.assert_array_equal(distance_transform(image), expected)


def test_without_a_wall_everything_is_far() -> None:
    assert np.all(distance_transform(np.ones((4, 5), np.uint8)) == FARTHEST_CELLS)


def test_the_argument_is_left_alone() -> None:
    image = np.eye(5, dtype=np.uint8)
    distance_transform(image)
    np.testing.assert_array_equal(image, np.eye(5))
