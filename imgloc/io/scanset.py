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
    """How much a file of scans holds at most, known before it is read."""

    scans: int
    numbers: int  #: ranges, angles, and what was recorded beside them
    file_bytes: int
    text: bool = False  #: whether the file is one


@dataclass(frozen=True)
class ScanSet:
    """Scans, with what was recorded beside them."""

    scans: tuple[LaserScan, ...]  #: in the order of the file
    #: (N, 3), known pose of the **sensor** in the map frame (x, y in metres, theta in radians)
    poses: FloatArray | None = None
    stamps: FloatArray | None = None  #: (N,), seconds
    odom: FloatArray | None = None  #: (N, 3), pose of the sensor in the odometry's frame

    def __post_init__(self) -> None:
        object.__setattr__(self, "scans", tuple(self.scans))
        n = len(self.scans)
        for key, shape in (("poses", (n, 3)), ("stamps", (n,)), ("odom", (n, 3))):
            if getattr(self, key) is not None:
                array = np.array(getattr(self, key), dtype=np.float64)
                if array.shape != shape:
                    raise ValueError(f"{key} {array.shape} must be {shape}: one per scan")
                array.flags.writeable = False
                object.__setattr__(self, key, array)

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
    hint = "finite radians (a reading without a direction has to be left out)"
    check_finite(angles, name, "angles", hint)
    worst = angles.flat[np.abs(angles).argmax()] if angles.size else 0.0
    if abs(worst) > _MAX_ANGLE:
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


def check_finite(
    array: npt.NDArray[Any], name: str, key: str, expected: str = "a finite number"
) -> None:
    """Refuse an array with an entry that is NaN or infinite."""
    for at in np.argwhere(~np.isfinite(array))[:1]:
        raise ScanError(f"{name}: {key}{at.tolist()}: got {array[tuple(at)]}, expected {expected}")
