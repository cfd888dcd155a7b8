"""Scan files: the format follows from the ending of the name."""

from collections.abc import Callable
from pathlib import Path

from imgloc.errors import ConfigError, ScanError
from imgloc.io.csvscans import read_csv
from imgloc.io.entries import text_size
from imgloc.io.files import PathLike, display, write_bytes_atomic
from imgloc.io.jsonscans import read_jsonl
from imgloc.io.npz import npz_size, read_npz, write_npz
from imgloc.io.scanset import ScanSet, ScansSize

__all__ = ["READERS", "ScanSet", "load_scans", "save_scans", "scans_size"]

READERS: dict[str, Callable[[PathLike], ScanSet]] = {
    ".npz": read_npz,
    ".csv": read_csv,
    ".jsonl": read_jsonl,
    ".ndjson": read_jsonl,
    ".json": read_jsonl,
}
"""Reader of each ending, in lower case."""


def load_scans(path: PathLike) -> ScanSet:
    """Load laser scans.

    Parameters
    ----------
    path : path
        ``.npz`` (:func:`~imgloc.io.npz.read_npz`), ``.csv``
        (:func:`~imgloc.io.csvscans.read_csv`), ``.jsonl``, ``.ndjson`` or ``.json``
        (:func:`~imgloc.io.jsonscans.read_jsonl`). Ranges are metres, angles radians in the
        sensor's frame, counter-clockwise, 0 forward. Ranges are kept as recorded; NaN, +inf
        and codes are what :class:`~imgloc.model.LaserScan` says they are.

    Returns
    -------
    ScanSet
        At least one scan, each with at least one reading, angles finite.

    Raises
    ------
    ScanError
        Naming the file, the line or key, what was found and what was expected.
    """
    return _reader(path)(path)


def scans_size(path: PathLike) -> ScansSize:
    """How much :func:`load_scans` would load, at most; nothing of it is kept in memory.

    Raises
    ------
    ScanError
        As :func:`load_scans`, but for what only the numbers show.
    """
    return npz_size(path) if _reader(path) is read_npz else text_size(path)


def _reader(path: PathLike) -> Callable[[PathLike], ScanSet]:
    reader = READERS.get(Path(path).suffix.lower())
    if reader is None:
        raise ScanError(
            f"{display(path)}: ending {display(Path(path).suffix)!r} is no scan format, "
            f"expected {', '.join(READERS)}"
        )
    return reader


def save_scans(path: PathLike, scans: ScanSet, *, force: bool = False) -> None:
    """Write scans as NPZ, whole or not at all; the same scans give the same bytes.

    Raises
    ------
    ConfigError
        `path` does not end in ``.npz``, or the scans differ in their number of readings.
    OutputError
        The file exists (without `force`) or cannot be written.
    """
    if Path(path).suffix.lower() != ".npz":
        raise ConfigError(f"{display(path)}: expected a name that ends in .npz")
    write_bytes_atomic(path, write_npz(scans), force=force)
