"""A set of scans, and the checks that every scan format shares; all raise ScanError."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from imgloc.errors import ScanError
from imgloc.model import FloatArray, LaserScan

MAX_READINGS = 50_000_000
"""Readings a scan file may hold: 400 MB as float64."""
# Twice around: whatever lies beyond was not meant in radians.
_MAX_ANGLE = 4 * np.pi


@dataclass(frozen=True)
class ScansSize:
    """How much a file of scans holds at most, known before it is read.

    Parameters
    ----------
    scans : int
    numbers : int
        Ranges, angles, and what was recorded beside them.
    file_bytes : int
        Length of the file.
    text : bool
        Whether it is a text.
    """

    scans: int
    numbers: int
    file_bytes: int
    text: bool = False


@dataclass(frozen=True)
class ScanSet:
    """Scans, with what was recorded beside them.

    Parameters
    ----------
    scans : tuple of LaserScan
        In the order of the file.
    poses : (N, 3) float array or None
        Known pose of the **sensor** in the map frame (x, y in metres, theta in radians).
    stamps : (N,) float array or None
        Seconds.
    odom : (N, 3) float array or None
        Pose of the sensor in the odometry's frame.
    """

    scans: tuple[LaserScan, ...]
    poses: FloatArray | None = None
    stamps: FloatArray | None = None
    odom: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "scans", tuple(self.scans))
        n = len(self.scans)
        for key, shape in (("poses", (n, 3)), ("stamps", (n,)), ("odom", (n, 3))):
            value = getattr(self, key)
            if value is None:
                continue
            array = np.array(value, dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, key, array)
            if array.shape != shape:
                raise ValueError(f"{key} {array.shape} must be {shape}: one per scan")

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, index: int) -> LaserScan:
        return self.scans[index]


def numbers(value: Any, name: str, key: str, *, ndim: Sequence[int]) -> FloatArray:
    """Return `value` as a float array; it must be numeric, not ragged, of a dimension in `ndim`."""
    expected = f"numbers of dimension {' or '.join(map(str, ndim))}"
    try:
        array = np.asarray(value)
    except (ValueError, OverflowError):
        raise ScanError(f"{name}: {key}: rows of different length, expected {expected}") from None
    if array.dtype.kind not in "fiu":
        raise ScanError(f"{name}: {key}: got type {array.dtype}, expected {expected}")
    if array.ndim not in ndim:
        raise ScanError(f"{name}: {key}: got shape {array.shape}, expected {expected}")
    return array.astype(np.float64)


def check_angles(angles: FloatArray, name: str) -> None:
    """Refuse angles that cannot be directions in radians."""
    bad = np.argwhere(~np.isfinite(angles))
    if len(bad):
        raise ScanError(
            f"{name}: angles{bad[0].tolist()}: got {angles[tuple(bad[0])]}, expected finite "
            "radians (a reading without a direction has to be left out)"
        )
    if angles.size and float(np.abs(angles).max()) > _MAX_ANGLE:
        worst = float(angles.flat[int(np.abs(angles).argmax())])
        raise ScanError(
            f"{name}: angles: got {worst:g}, expected radians; are these degrees? "
            "multiply them by pi / 180"
        )


def check_limits(range_min: float, range_max: float, name: str) -> None:
    """Refuse limits unless ``0 <= range_min < range_max``; range_max may be infinite."""
    if not (0 <= range_min < np.inf):
        raise ScanError(f"{name}: range_min: got {range_min:g}, expected metres, 0 or more")
    if not range_max > range_min:
        raise ScanError(
            f"{name}: range_max: got {range_max:g}, expected metres, more than "
            f"range_min = {range_min:g}"
        )


def check_finite(array: npt.NDArray[Any], name: str, key: str) -> None:
    """Refuse an array with an entry that is NaN or infinite."""
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        raise ScanError(
            f"{name}: {key}{bad[0].tolist()}: got {array[tuple(bad[0])]}, expected a finite number"
        )
