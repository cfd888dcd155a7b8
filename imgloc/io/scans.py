"""Scan files: the format follows from the ending of the name."""

from collections.abc import Callable
from pathlib import Path

from imgloc.errors import ConfigError, ScanError
from imgloc.io.csvscans import read_csv
from imgloc.io.files import PathLike, display
from imgloc.io.jsonscans import read_jsonl
from imgloc.io.npz import read_npz, write_npz
from imgloc.io.output import write_bytes_atomic
from imgloc.io.scanset import ScanSet

__all__ = ["READERS", "ScanSet", "load_scans", "save_scans"]

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
    reader = READERS.get(Path(path).suffix.lower())
    if reader is None:
        raise ScanError(
            f"{display(path)}: ending {display(Path(path).suffix)!r} is no scan format, "
            f"expected {', '.join(READERS)}"
        )
    return reader(path)


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
