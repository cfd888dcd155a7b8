"""Odometry beside scans: poses between those recorded."""

import numpy as np

from imgloc.model import FloatArray

_GAP = 1.0  # seconds that a scan may be from the nearest pose


def odometry_at(at: FloatArray, stamps: FloatArray, poses: FloatArray) -> FloatArray | None:
    """Poses (N, 3) at the times `at`, on straight lines between `poses` (M, 3) at `stamps` (M,).

    None if there is no pose within a second of each of the times.

    Examples
    --------
    >>> odometry_at(np.array([0.5]), np.array([0.0, 1.0]), np.array([[0, 0, 3.0], [2, 0, -3.0]]))
    array([[1.        , 0.        , 3.14159265]])
    """
    if not len(stamps) or not np.all(np.isfinite(at)):
        return None
    order = np.argsort(stamps, kind="stable")
    times, ordered = stamps[order], poses[order]
    after = np.clip(np.searchsorted(times, at), 1, max(len(times) - 1, 1)) % len(times)
    before = np.maximum(after - 1, 0)
    if np.minimum(np.abs(at - times[before]), np.abs(at - times[after])).max() > _GAP:
        return None
    columns = [np.interp(at, times, ordered[:, k]) for k in (0, 1)]
    heading = np.interp(at, times, np.unwrap(ordered[:, 2]))
    return np.stack([*columns, np.arctan2(np.sin(heading), np.cos(heading))], axis=1)
