"""Scans as NPZ, read by its headers first: an archive of 2 MB may claim arrays of 2 GB."""

import contextlib
import io
import math
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError, ScanError
from imgloc.io.files import PathLike, display, open_file, read_file
from imgloc.io.scanset import (
    MAX_READINGS,
    ScanSet,
    ScansSize,
    check_angles,
    check_finite,
    check_limits,
    numbers,
)
from imgloc.model import FloatArray, LaserScan

_KEYS = ("ranges", "angles", "range_min", "range_max", "poses", "stamps", "odom")
_SPACING = ("angle_min", "angle_increment")
_MAX_BYTES = 16 * MAX_READINGS


def read_npz(path: PathLike) -> ScanSet:
    """Read scans from an NPZ.

    Keys: ``ranges`` (N, B) or (B,); ``angles`` (B,) or (N, B), or else ``angle_min`` and
    ``angle_increment``; optionally ``range_min`` (default 0) and ``range_max`` (default
    infinite), one number or (N,); ``poses`` (N, 3), ``stamps`` (N,), ``odom`` (N, 3). Other
    keys are not read.

    Raises
    ------
    ScanError
        Damaged archive, missing key, pickled or non-numeric array, more than MAX_READINGS,
        shapes that do not agree, angles that are not finite radians.
    """
    name = display(path)
    data = read_file(path, limit=_MAX_BYTES, error=ScanError, what="scan file")
    return _scan_set(_members(data, name), name)


def npz_size(path: PathLike) -> ScansSize:
    """How much :func:`read_npz` would read, as the headers of the arrays say.

    Raises
    ------
    ScanError
        As :func:`read_npz`, but for what only the numbers show.
    """
    name, shapes = display(path), dict[str, tuple[int, ...]]()
    with (
        open_file(path, limit=_MAX_BYTES, error=ScanError, what="scan file") as (file, length),
        _explained(name),
        zipfile.ZipFile(file) as archive,
    ):
        for info in archive.infolist():
            key = info.filename.removesuffix(".npy")
            if key in _KEYS + _SPACING:
                with archive.open(info) as member:
                    shapes[key] = _check_header(member, info.file_size, name, key)
    ranges = shapes.get("ranges", ())
    numbers = sum(math.prod(shape) for shape in shapes.values())
    return ScansSize(ranges[0] if len(ranges) == 2 else 1, numbers, length)


def write_npz(scans: ScanSet) -> bytes:
    """Return the bytes of an NPZ that :func:`read_npz` reads back.

    Raises
    ------
    ConfigError
        If there are no scans, or they differ in their number of readings.
    """
    lengths = {len(scan.ranges) for scan in scans.scans}
    if len(lengths) != 1:
        raise ConfigError(f"scans of {sorted(lengths)} readings cannot be one array in an NPZ")
    angles = np.stack([scan.angles for scan in scans.scans])
    low = np.array([scan.range_min for scan in scans.scans])
    high = np.array([scan.range_max for scan in scans.scans])
    arrays: dict[str, npt.NDArray[Any]] = {
        "ranges": np.stack([scan.ranges for scan in scans.scans]),
        "angles": angles[0] if (angles == angles[0]).all() else angles,
        "range_min": low[0] if (low == low[0]).all() else low,
        "range_max": high[0] if (high == high[0]).all() else high,
    }
    for key in ("poses", "stamps", "odom"):
        value = getattr(scans, key)
        if value is not None:
            arrays[key] = value
    buffer = io.BytesIO()
    # Not np.savez: it stamps members with the time of day, and equal scans are equal bytes.
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
            info = zipfile.ZipInfo(f"{key}.npy")
            archive.writestr(info, member.getvalue(), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _members(data: bytes, name: str) -> dict[str, FloatArray]:
    arrays: dict[str, FloatArray] = {}
    with _explained(name), zipfile.ZipFile(io.BytesIO(data)) as archive:
        # The end record counts the members; zipfile does not compare, and a damaged
        # entry can swallow those after it.
        end = data.rfind(b"PK\5\6")
        if int.from_bytes(data[end + 10 : end + 12], "little") not in (
            len(archive.infolist()),
            0xFFFF,  # ZIP64 counts elsewhere
        ):
            raise zipfile.BadZipFile("members are missing")
        for info in archive.infolist():
            key = info.filename.removesuffix(".npy")
            if key not in _KEYS + _SPACING:
                # Not read; but opening compares the name with the one at the data, so
                # that a damaged "range_max" is not taken for somebody else's array.
                archive.open(info).close()
                continue
            if key in arrays:
                raise ScanError(f"{name}: {key}: in the archive twice, expected once")
            with archive.open(info) as file:
                _check_header(file, info.file_size, name, key)
            with archive.open(info) as file:
                value = np.lib.format.read_array(file, allow_pickle=False)
            arrays[key] = numbers(value, name, key, ndim=(0, 1, 2))
    return arrays


@contextlib.contextmanager
def _explained(name: str) -> Iterator[None]:
    """Say of an archive that cannot be opened what is wrong with it."""
    try:
        yield
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as e:
        raise ScanError(f"{name}: damaged NPZ ({e}); copy the file again") from None
    except (RuntimeError, NotImplementedError, ValueError) as e:
        # Encrypted, compressed in an unknown way, or offsets that lead out of the file.
        raise ScanError(f"{name}: NPZ that cannot be opened: {e}") from None


def _check_header(file: IO[bytes], size: int, name: str, key: str) -> tuple[int, ...]:
    """Check type and shape of a member before its data are inflated; return the shape."""
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    try:
        version = np.lib.format.read_magic(file)
        shape, _, dtype = read[version](file)
    except (ValueError, KeyError, SyntaxError, TypeError, tokenize.TokenError):
        raise ScanError(f"{name}: {key}: damaged header, expected a NumPy array") from None
    if dtype.hasobject:
        raise ScanError(
            f"{name}: {key}: holds pickled objects, which are never loaded; expected numbers "
            "(save rows of equal length, padded with NaN)"
        )
    if dtype.kind not in "fiu":
        raise ScanError(f"{name}: {key}: got type {dtype}, expected numbers")
    count = math.prod(shape)
    if count < 0 or count > MAX_READINGS:
        raise ScanError(
            f"{name}: {key}: {' x '.join(map(str, shape))} numbers, expected at most "
            f"{MAX_READINGS:,}"
        )
    if file.tell() + count * dtype.itemsize != size:
        raise ScanError(
            f"{name}: {key}: {size:,} bytes, expected {file.tell() + count * dtype.itemsize:,} "
            f"for shape {shape}; copy the file again"
        )
    return tuple(shape)


def _scan_set(arrays: dict[str, FloatArray], name: str) -> ScanSet:
    if "ranges" not in arrays:
        raise ScanError(f"{name}: ranges: missing, expected an array (scans, readings)")
    ranges = np.atleast_2d(arrays["ranges"])
    n, readings = ranges.shape
    if not ranges.size:
        raise ScanError(f"{name}: ranges: got shape {ranges.shape}, expected at least one reading")
    angles = _angles(arrays, n, readings, name)
    low, high = (_limit(arrays, key, default, n, name) for key, default in _LIMITS)
    for k in range(n):
        check_limits(float(low[k]), float(high[k]), name)
    extra: dict[str, FloatArray | None] = {"poses": None, "stamps": None, "odom": None}
    for key in extra.keys() & arrays.keys():
        shape = (n,) if key == "stamps" else (n, 3)
        value = arrays[key]
        if n == 1 and value.shape == shape[1:]:
            value = value.reshape(shape)
        if value.shape != shape:
            raise ScanError(f"{name}: {key}: got shape {value.shape}, expected {shape}")
        if key != "stamps":
            check_finite(value, name, key)
        extra[key] = value
    stamps = extra["stamps"] if extra["stamps"] is not None else np.full(n, np.nan)
    scans = tuple(
        LaserScan(ranges[k], angles[k], float(low[k]), float(high[k]), float(stamps[k]))
        for k in range(n)
    )
    return ScanSet(scans, **extra)


_LIMITS = (("range_min", 0.0), ("range_max", math.inf))


def _angles(arrays: dict[str, FloatArray], n: int, readings: int, name: str) -> FloatArray:
    if "angles" not in arrays:
        if not all(key in arrays and arrays[key].size == 1 for key in _SPACING):
            raise ScanError(
                f"{name}: angles: missing, expected {readings} angles in radians "
                "(or the numbers angle_min and angle_increment)"
            )
        first, step = (float(arrays[key].item()) for key in _SPACING)
        arrays["angles"] = first + np.arange(readings, dtype=np.float64) * step
    angles = arrays["angles"]
    if angles.shape not in ((readings,), (n, readings)):
        raise ScanError(
            f"{name}: angles: got shape {angles.shape}, expected {(readings,)}: "
            f"ranges are {n} scans of {readings} readings"
        )
    check_angles(angles, name)
    return np.asarray(np.broadcast_to(angles, (n, readings)), dtype=np.float64)


def _limit(
    arrays: dict[str, FloatArray], key: str, default: float, n: int, name: str
) -> FloatArray:
    value = arrays.get(key, np.array(default))
    if value.size == 1:
        return np.full(n, value.item())
    if value.shape != (n,):
        raise ScanError(f"{name}: {key}: got shape {value.shape}, expected one number or {(n,)}")
    return value
