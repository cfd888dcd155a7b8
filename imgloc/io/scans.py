"""Scan files: the format follows from the ending of the name; NPZ is the one that is written.

An NPZ is read by its headers first: an archive of 2 MB may claim arrays of 2 GB.

>>> from tempfile import TemporaryDirectory
>>> from imgloc.model import LaserScan
>>> with TemporaryDirectory() as folder:
...     save_scans(f"{folder}/a.npz", ScanSet((LaserScan([1.0, 2.5], [0.0, 0.5]),)))
...     load_scans(f"{folder}/a.npz")[0].ranges.tolist()
[1.0, 2.5]
"""

import contextlib
import io
import logging
import math
import os
import re
import tokenize
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from imgloc.errors import ConfigError, ScanError, expect
from imgloc.io.badlines import warned
from imgloc.io.bags import NO_CLOUDS, bag_size, choose_topic, read_bag
from imgloc.io.carmen import placed, read_carmen
from imgloc.io.clouds import Height, pcd_size, read_pcd
from imgloc.io.csvscans import is_number, read_csv
from imgloc.io.echo import read_echo
from imgloc.io.files import (
    OTHERS,
    PathLike,
    display,
    is_file,
    is_folder,
    is_there,
    open_file,
    open_regular,
    read_file,
    reason,
    write_bytes_atomic,
)
from imgloc.io.lasers import lasers_of, together
from imgloc.io.remote import local
from imgloc.io.scanset import (
    KEYS,
    MAX_READINGS,
    ScanSet,
    ScansSize,
    check_size,
    covers,
    numbers,
    scan_set,
    stated,
    wrong,
)
from imgloc.io.text import open_text, unmarked
from imgloc.io.textscans import read_jsonl, text_size
from imgloc.model import FloatArray, Pose2D
from imgloc.options import MAX_BAD, Logs

_LOG = logging.getLogger("imgloc")
_MAX_BYTES = 16 * MAX_READINGS


def load_scans(
    path: PathLike, *, topic: str | None = None, fov: float | None = None, max_bad: float = MAX_BAD,
    height: Height | None = None, odom: str | None = None, range_max: float | None = None,
    sensor: Pose2D | None = None,
) -> ScanSet:  # fmt: skip
    r"""Load laser scans: at least one, each with at least one reading, all angles finite.

    ScanError names the file, the line or key, what was found and what was expected.

    Parameters
    ----------
    path : path
        ``.npz`` (:func:`read_npz`), ``.csv`` (:func:`~imgloc.io.csvscans.read_csv`), ``.jsonl``,
        ``.ndjson`` or ``.json`` (:func:`~imgloc.io.textscans.read_jsonl`), ``.log``, ``.clf`` or
        ``.carmen`` (:func:`~imgloc.io.carmen.read_carmen`), ``.yaml`` or ``.yml``
        (:func:`~imgloc.io.echo.read_echo`), ``.bag``, ``.db3``, ``.mcap`` or the folder of a ROS 2
        recording (:func:`~imgloc.io.bags.read_bag`). A name without an ending, or with ``.txt``,
        is read by its content; ``.gz`` may follow the ending of a file of text. Ranges
        are metres, angles radians in the sensor's frame, counter-clockwise, 0 forward.
        Ranges stay as recorded; :class:`~imgloc.model.LaserScan` defines NaN, +inf and codes.
    topic : str, optional
        Which laser of a file with several: a topic, a CARMEN message, or the name of a frame.
    fov : float, optional
        Angle from the first to the last ray, radians, for a CSV or a log that does not state it,
        or whose angles contradict each other.
    max_bad : float
        Share of the lines of a text, or of the messages of a bag, 0 to 1, that may be broken: they
        are left out, with a warning that names them. ScanError if there are more.
    height : (float, float), optional
        Lowest and highest point, metres above the sensor, of the slice of a point cloud that
        is a scan. Clouds are sensor_msgs/PointCloud2 of a bag, where there is no LaserScan or
        `topic` names them, and ``.pcd`` (:func:`~imgloc.io.clouds.read_pcd`).
    odom : str, optional
        Topic or frame of the odometry of a bag, see :func:`~imgloc.io.bags.read_bag`; ``scans``
        for none, because the motion is found by the scans.
    range_max : float, optional
        Reach of the sensor, in the unit of the file, where that of the file cannot be: 0, or NaN.
    sensor : Pose2D, optional
        Where the sensor sits on the robot, in place of what the file contains.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> rows = "laser,angle_deg,range", "front,0,1", "front,90,2", "rear,0,3", "rear,90,4"
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "two.csv").write_text("\n".join(rows))
    ...     load_scans(f"{folder}/two.csv", topic="rear")[0].ranges.tolist()
    [3.0, 4.0]
    """
    how = Logs(topic, fov, max_bad=max_bad, height=height, odom=odom, range_max=range_max)
    path = local(path)
    kind, lasers = _kind_of(path), lasers_of(topic or "")
    with stated(how, sensor):
        if len(lasers) < 2:
            return _read(kind, path, how)
        sets = {laser: _read(kind, path, replace(how, topic=laser)) for laser in lasers}
        sets = {t: placed(s) for t, s in sets.items()} if kind is _CARMEN else sets
        return together(sets, display(path))


def _read(kind: "_Kind", path: PathLike, how: Logs) -> ScanSet:
    """The scans of one laser, or of several whose places are known; what is not used is named."""
    name, named = display(path), has_topics(path)
    given = {key: v for key in kind.takes if (v := getattr(how, key)) is not None}
    if not named:
        given.pop("topic", None)
    scans = kind.read(path, **given)
    if how.height is not None and "height" not in kind.takes:
        _LOG.warning(NO_CLOUDS, name, "the file", extra={"code": "unused"})
    first = scans[0].angles
    if how.fov is not None and not covers(first, how.fov):
        text = "%s: `fov` is not used: the file contains its angles, %.4g to %.4g degrees"
        _LOG.warning(text, name, *np.rad2deg(first[[0, -1]]), extra={"code": "unused"})
    lasers = Counter(scan.laser for scan in scans.scans if scan.laser)
    apart = kind is not _NPZ and any(scan.T_base_laser is None for scan in scans.scans)
    if named or (how.topic is None and not (apart and len(lasers) > 1)):
        return scans
    if len(lasers) < 2:
        raise ScanError(f"{name}: has one laser, expected no topic, got {how.topic}: leave it out")
    chosen = choose_topic(lasers, how.topic, name)
    return scans.take([k for k, scan in enumerate(scans.scans) if scan.laser == chosen])


def lasers_of_table(path: PathLike) -> Counter[str]:
    r"""Count the scans of each laser that a table names; none where it cannot be read alone.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> sides, angles = ("left", "right") * 4, range(0, 90, 3)
    >>> rows = [f"{side},{angle},1" for side in sides for angle in angles]
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "two.csv").write_text("\n".join(["laser,angle_deg,range", *rows]))
    ...     lasers_of_table(f"{folder}/two.csv")["right"]
    4
    """
    with warned(), contextlib.suppress(ScanError):
        return Counter(scan.laser for scan in read_csv(path).scans if scan.laser)
    return Counter()


def scans_size(
    path: PathLike, *, topic: str | None = None, height: Height | None = None
) -> ScansSize:
    """Upper bounds of what :func:`load_scans` would load; errors are those that headers show."""
    kind = _kind_of(path)
    how = {} if kind in _TEXTS else {"topic": topic, "height": height}
    return kind.size(path, **{key: value for key, value in how.items() if key in kind.takes})


def save_scans(path: PathLike, scans: ScanSet, *, force: bool = False) -> None:
    """Write scans as NPZ, whole or not at all; the same scans give the same bytes.

    Parameters
    ----------
    path : path
        ConfigError if it does not end in ``.npz``; OutputError if it cannot be written.
    scans : ScanSet
        ConfigError if there is none, or they differ in their number of readings.
    force : bool
        Overwrite a file that exists, otherwise an OutputError.
    """
    expect(scans, ScanSet, "scans")
    if Path(path).suffix.lower() != ".npz":
        raise ConfigError(f"{display(path)}: expected a name that ends in .npz")
    write_bytes_atomic(path, write_npz(scans), force=force)


def read_npz(path: PathLike) -> ScanSet:
    """Read scans from an NPZ.

    Keys: ``ranges`` (N, B) or (B,); ``angles`` (B,) or (N, B), or else ``angle_min`` with
    ``angle_increment`` or ``angle_max``; optionally ``range_min`` (default 0), ``range_max``
    (default infinite) and ``time_increment`` (seconds from a reading to the next, default 0), one
    number or (N,); ``poses`` (N, 3), ``stamps`` (N,), ``odom`` (N, 3); ``mount`` (3,) or (N, 3),
    where the sensor sits on the robot, NaN where that is not known; ``laser`` (N,), a number for
    each of several lasers. Other keys are not read. Arrays of objects are refused, as are more than
    MAX_READINGS.
    """
    name = display(path)
    data = read_file(path, limit=_MAX_BYTES, error=ScanError, what="scan file")
    return scan_set(_members(data, name), name)


def write_npz(scans: ScanSet) -> bytes:
    """Return the bytes of an NPZ that :func:`read_npz` reads back; see :func:`save_scans`."""
    lengths = {len(scan.ranges) for scan in scans.scans}
    if len(lengths) != 1:
        raise ConfigError(f"scans of {sorted(lengths)} readings cannot be one array in an NPZ")
    arrays: dict[str, Any] = {"ranges": np.stack([scan.ranges for scan in scans.scans])}
    for key in ("angles", "range_min", "range_max", "time_increment"):
        values = np.stack([getattr(scan, key) for scan in scans.scans])
        arrays[key] = values[0] if (values == values[0]).all() else values
    if not np.any(arrays["time_increment"]):
        del arrays["time_increment"]
    own = np.array([scan.stamp for scan in scans.scans])
    stamps = own if scans.stamps is None else scans.stamps
    mounts = [scan.T_base_laser for scan in scans.scans]
    mount = np.array([(m.x, m.y, m.theta) if m else (np.nan,) * 3 for m in mounts])
    names = scans.lasers
    if len(names) > 1:
        arrays["laser"] = np.array([names.index(scan.laser) for scan in scans.scans])
    beside = {"poses": scans.poses, "odom": scans.odom}
    beside |= {key: a for key, a in (("stamps", stamps), ("mount", mount)) if np.isfinite(a).any()}
    arrays |= {key: value for key, value in beside.items() if value is not None}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # all members are stamped 1980
    return buffer.getvalue()


class _Kind(NamedTuple):
    """A kind of file: what it is called, how it is read, and how its size is known before."""

    name: str
    read: Callable[..., ScanSet]
    takes: Sequence[str]  #: fields of Logs that reading takes
    size: Callable[..., ScansSize]


_NPZ = _Kind("NPZ", read_npz, (), lambda path: _npz_size(path))
_BETWEEN = partial(text_size, between=b",;\t| ")
_CSV = _Kind("CSV", read_csv, ("fov", "max_bad"), _BETWEEN)
_JSON = _Kind("JSON", read_jsonl, ("topic", "odom", "max_bad"), text_size)
_ECHO = _Kind("echo of a topic", read_echo, ("max_bad",), partial(text_size, between=b"\n"))
_CARMEN = _Kind("CARMEN log", read_carmen, ("topic", "fov", "max_bad"), _BETWEEN)
_BAG = _Kind("bag", read_bag, ("topic", "height", "odom", "max_bad"), bag_size)
_PCD = _Kind("PCD", read_pcd, ("height",), lambda path, **_: pcd_size(path))
_TEXTS = _CSV, _JSON, _ECHO, _CARMEN  # which may be packed by gzip
_KINDS = {
    ".npz": _NPZ, ".csv": _CSV, ".tsv": _CSV, ".jsonl": _JSON, ".ndjson": _JSON, ".json": _JSON,
    ".yaml": _ECHO, ".yml": _ECHO, ".log": _CARMEN, ".clf": _CARMEN, ".carmen": _CARMEN,
    ".bag": _BAG, ".db3": _BAG, ".mcap": _BAG, ".pcd": _PCD,
}  # fmt: skip
#: Endings of scan files in a folder. A YAML file there is taken for a map's.
SCAN_ENDINGS = (*(ending for ending in _KINDS if ending not in (".yaml", ".yml")), ".gz")
# What files begin with whose name does not tell.
_MAGIC = (
    (rb"PK\x03\x04", _NPZ), (rb"#ROSBAG V2", _BAG), (rb"SQLite format 3", _BAG),
    (rb"\x89MCAP", _BAG), (rb"(?s).{,200}^VERSION .{,200}^FIELDS ", _PCD),
    (rb"(?s).*?^(PARAM|ODOM|[FR]LASER|ROBOTLASER\d|RAWLASER\d|Odometry|[LO]) ", _CARMEN),
    (rb"\s*\[[\s\[]*[-\dinf][^\s,]*\s+[-\dinf]", _CSV),  # as NumPy prints arrays
    (rb"\s*(\{|\[\s*[\d{[])", _JSON), (rb"(?s).*?^(header|angle_min|ranges):", _ECHO),
    (rb"(?:\s*(?:[#%\[]|//)[^\n]*\n)*\s*([-+.\w|\"\[]|[\xc3-\xe9][\x80-\xbf])", _CSV),
    (rb"(?s).*?\b(angle|theta)\s*[:=]\s*[-\d]", _CSV),
)  # fmt: skip
_HEAD = 4096  # bytes that tell the kind


def format_of(path: PathLike) -> str:
    """Name of the format of a file: by the ending of its name, else by how it begins."""
    return _kind_of(path).name


def has_topics(path: PathLike) -> bool:
    """Return whether a file may hold several lasers, each with a name.

    A bag and a CARMEN log may, as may JSON that names topics.
    """
    kind = _kind_of(path)
    if kind is not _JSON:
        return "topic" in kind.takes
    return b'"topic"' in _head_of(path)


def _kind_of(path: PathLike) -> _Kind:
    """The kind of a file by the ending of its name, else by how it begins."""
    name, lower, file = display(path), str(path).lower(), Path(path)
    ending = Path(lower.removesuffix(".gz")).suffix
    if is_folder(file) and ending not in _KINDS:
        if any(file.glob("*.mcap")) or any(file.glob("*.db3")) or is_there(file / "metadata.yaml"):
            return _BAG
        hint = "expected a file of scans; imgloc batch takes folders"
        raise ScanError(f"{name}: is a folder, {hint}")
    if ending in _KINDS:
        kind = _KINDS[ending]
        if ending == ".bag" and is_there(file) and not lower.endswith(".gz"):
            with os.fdopen(open_regular(path, ScanError, "bag"), "rb") as opened:
                if re.match(rb"#ROSBAG V1|#ROSRECORD", opened.read(_HEAD)):
                    hint = "rosbag fix old.bag new.bag of ROS 1 makes one of version 2.0"
                    raise ScanError(f"{name}: is a bag of a version before 2.0; {hint}")
        if lower.endswith(".gz") and kind not in _TEXTS:
            raise ScanError(f"{name}: cannot be read packed: unpack it with gunzip")
        if kind in (_CARMEN, _CSV, _ECHO, _NPZ) and is_file(file):
            # A field alone that ros2 topic echo prints is no YAML.
            kind = _CSV if _refuse_spoken(path).startswith(b"array(") else kind
        return kind
    for known, hint in OTHERS["scans"].items():
        if lower.endswith((known, f"{known}.gz", f"{known}.zip")):
            raise ScanError(f"{name}: cannot be read: {hint}")
    head = _refuse_spoken(path)
    if told := ending in ("", ".txt", ".dat", ".md", ".scan"):
        for pattern, kind in _MAGIC:
            if re.match(pattern, head, re.MULTILINE):
                return kind
    found = "no known scan format" if told else f"ending {display(ending)!r} is no scan format"
    table = "a table of numbers, such as lines 90.0,1230 below one of angle_deg,distance_mm"
    raise ScanError(f"{name}: {found}, expected {', '.join(_KINDS)} or {table}")


def why_no_scans(path: PathLike) -> str:
    """Why a file of a folder is not taken for one of scans; empty if it is.

    Without an ending that decides, the first lines do: notes are no table of numbers.
    """
    if Path(path).suffix.lower() in SCAN_ENDINGS:
        return ""
    try:
        kind, head = _kind_of(path), _head_of(path)
    except ScanError as error:
        return str(error).removeprefix(f"{display(path)}: ").partition(", expected")[0]
    if kind is _ECHO:
        return "" if b"ranges:" in head else "no scans of ros2 topic echo"
    lines = map(str.strip, head.decode(errors="replace").splitlines())
    words = [re.split(r"[\s,;|]+", line) for line in lines if line and line[0] != "#"]
    tables = sum(2 * sum(map(is_number, line)) >= len(line) for line in words)
    return "" if kind is not _CSV or 2 * tables >= max(len(words), 1) else "no table of numbers"


def _head_of(path: PathLike) -> bytes:
    """The first bytes of a file, unpacked, without a byte-order mark."""
    with open_text(path) as (file, _):
        return unmarked(file.read(_HEAD))


def _refuse_spoken(path: PathLike) -> bytes:
    """First bytes; ScanError for a program's text that is not read, with what would do."""
    head = _head_of(path)
    for pattern, hint in OTHERS["texts"].items():
        if re.match(pattern.encode(), head, re.MULTILINE | re.DOTALL):
            raise ScanError(f"{display(path)}: cannot be read: {hint}")
    return head


def _npz_size(path: PathLike) -> ScansSize:
    """Size of what :func:`read_npz` would read, by the headers of the arrays."""
    name = display(path)
    with (
        open_file(path, limit=_MAX_BYTES, error=ScanError, what="scan file") as (file, length),
        _explained(name),
        zipfile.ZipFile(file) as archive,
    ):
        shapes = {key: shape for key, _, shape, _, _ in _headers(archive, name)}
    ranges = shapes.get("ranges", ())
    scans = ranges[0] if len(ranges) == 2 else 1
    check_size(scans, math.prod(ranges[-1:]), name)
    return ScansSize(scans, sum(math.prod(shape) for shape in shapes.values()), length)


def _members(data: bytes, name: str) -> dict[str, FloatArray]:
    """The arrays of an archive, each by its header first."""
    arrays: dict[str, FloatArray] = {}
    with _explained(name), zipfile.ZipFile(io.BytesIO(data)) as archive:
        # The end record counts the members; zipfile does not compare, and a damaged
        # entry can swallow those after it.
        end = data.rfind(b"PK\5\6")
        count = int.from_bytes(data[end + 10 : end + 12], "little")
        if count not in (len(archive.infolist()), 0xFFFF):  # ZIP64 counts elsewhere
            raise zipfile.BadZipFile("members are missing")
        for key, file, shape, fortran, dtype in _headers(archive, name):
            if key in arrays:
                raise ScanError(f"{name}: {key}: in the archive twice, expected once")
            value = np.frombuffer(file.read(), dtype)
            value = value.reshape(shape, order="F" if fortran else "C")
            arrays[key] = numbers(value, name, key, ndim=(0, 1, 2))
        if "ranges" not in arrays:
            expected = "ranges among them, and angles in radians"
            raise wrong(f"{name}: ranges", ", ".join(archive.namelist())[:200], expected)
    return arrays


def _headers(
    archive: zipfile.ZipFile, name: str
) -> Iterator[tuple[str, IO[bytes], tuple[int, ...], bool, np.dtype[Any]]]:
    """Key, open file, shape, order and type of the arrays that are read; others are opened only.

    Opening compares the name with the one at the data, so that a damaged "range_max" is not taken
    for somebody else's array.
    """
    for info in archive.infolist():
        key = info.filename.removesuffix(".npy")
        with archive.open(info) as file:
            if key in KEYS:
                yield key, file, *_check_header(file, info.file_size, name, key)


@contextlib.contextmanager
def _explained(name: str) -> Iterator[None]:
    """Say of an archive that cannot be opened what is wrong with it."""
    try:
        yield
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as e:
        raise ScanError(f"{name}: damaged NPZ ({reason(e)}); copy the file again") from None
    except (RuntimeError, NotImplementedError, ValueError) as e:
        # Encrypted, compressed in an unknown way, or offsets that lead out of the file.
        raise ScanError(f"{name}: NPZ that cannot be opened: {reason(e)}") from None


def _check_header(
    file: IO[bytes], size: int, name: str, key: str
) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Check type and shape of a member before its data are inflated; return the header."""
    form = np.lib.format
    read = {(1, 0): form.read_array_header_1_0, (2, 0): form.read_array_header_2_0}
    try:
        shape, fortran, dtype = read[form.read_magic(file)](file)
    except (ValueError, KeyError, SyntaxError, TypeError, MemoryError, tokenize.TokenError):
        raise ScanError(f"{name}: {key}: damaged header, expected a NumPy array") from None
    if dtype.hasobject:
        hint = "expected numbers (save rows of equal length, padded with NaN)"
        raise ScanError(f"{name}: {key}: contains pickled objects, which are never loaded; {hint}")
    if dtype.kind not in "fiu":
        raise wrong(f"{name}: {key}", f"type {str(dtype)[:60]}", "numbers")
    if not all(type(n) is int and n >= 0 for n in shape):  # NumPy lets a bool pass
        raise ScanError(f"{name}: {key}: damaged header, expected a NumPy array")
    count = math.prod(shape)
    if count > MAX_READINGS:
        found = " x ".join(f"{n}" if n < 1e12 else "more" for n in shape[:3])
        raise ScanError(f"{name}: {key}: {found} numbers, expected at most {MAX_READINGS:,}")
    if (expected := file.tell() + count * dtype.itemsize) != size:
        hint = f"expected {expected:,} for shape {str(shape)[:60]}; copy the file again"
        raise ScanError(f"{name}: {key}: {size:,} bytes, {hint}")
    return tuple(shape), fortran, dtype
