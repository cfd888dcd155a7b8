"""Sums under a scan at some poses, against loops."""

import numpy as np
import pytest

from imgloc.search.lookups import sums_under


@pytest.mark.parametrize("readings", [0, 1, 7, 300])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32])
def test_sums_are_those_of_loops(readings, kind):
    rng = np.random.default_rng(readings)
    size = np.dtype(kind).itemsize
    bytes_of = [rng.integers(0, 256, (900, size)).astype(np.uint8) for _ in range(2)]
    images = [b.view(kind).ravel() for b in bytes_of]
    offsets = rng.integers(0, 400, (5, readings))
    k, base = rng.integers(0, 5, 260), rng.integers(0, 500, 260)
    lanes = [b[:, lane].tolist() for b in bytes_of for lane in range(size)]
    expected = [
        [sum(lane[place + o] for o in offsets[heading].tolist()) for lane in lanes]
        for heading, place in zip(k.tolist(), base.tolist(), strict=True)
    ]
    found = sums_under(images, offsets, k, base)
    assert found.tolist() == expected
    assert found.shape == (260, 2 * size)


def test_no_poses():
    none = np.empty(0, np.int64)
    assert sums_under([np.zeros(4, np.uint32)], np.zeros((1, 2), int), none, none).shape == (0, 4)
