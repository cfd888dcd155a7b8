"""Trajectories in TUM's format: a line ``stamp x y z qx qy qz qw`` for each pose."""

import math

import numpy as np

from imgloc.errors import ScanError
from imgloc.io.badlines import BadLines
from imgloc.io.files import PathLike, display
from imgloc.io.text import read_text
from imgloc.model import FloatArray
from imgloc.options import MAX_BAD

_WORDS = "stamp x y z qx qy qz qw"
_LENGTH = 0.9, 1.1  # of a quaternion that was rounded


def load_tum(path: PathLike, max_bad: float = MAX_BAD) -> tuple[FloatArray, FloatArray]:
    r"""Read a trajectory, the reference of `evo_ape tum` for example.

    Parameters
    ----------
    path : path
        Words with spaces or commas between; lines that begin with # are comments.
    max_bad : float
        Share of the lines, 0 to 1, that may be broken: these are left out, with a warning.

    Returns
    -------
    stamps : (N,) float array
        Seconds, in rising order.
    poses : (N, 3) float array
        x and y in metres, and the yaw in radians; z, roll and pitch are left out.

    Raises
    ------
    ScanError
        If the file cannot be read, or more lines than that have not eight finite numbers, the last
        four of them a quaternion of length 1.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "a.tum")
    ...     _ = file.write_text("# stamp x y z q\n1.5 2 3 0 0 0 0.6 0.8\n")
    ...     load_tum(file)
    (array([1.5]), array([[2.        , 3.        , 1.28700222]]))
    """
    rows, bad = list[tuple[float, float, float, float]](), BadLines(display(path), max_bad)
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        where = f"{display(path)}: line {number}"
        try:
            rows.append(_pose_of(words))
        except ValueError as e:
            bad.skip(ScanError(f"{where}: got {line[:60]!r}, expected {e}"))
    bad.check(len(rows))
    if not rows:
        raise ScanError(f"{display(path)}: no pose, expected a line {_WORDS} for each")
    found = np.array(rows)
    found = found[np.argsort(found[:, 0], kind="stable")]
    return found[:, 0], found[:, 1:]


def _pose_of(words: list[str]) -> tuple[float, float, float, float]:
    """Stamp, x, y and yaw of a line; a ValueError has what was expected."""
    try:
        stamp, x, y, _, qx, qy, qz, qw = values = [float(word) for word in words]
    except ValueError:
        raise ValueError(_WORDS) from None
    if not all(map(math.isfinite, values)):
        raise ValueError(f"{_WORDS}, all finite")
    length = math.hypot(qx, qy, qz, qw)
    if not _LENGTH[0] <= length <= _LENGTH[1]:
        raise ValueError(f"a quaternion qx qy qz qw of length 1, not {length:.3g}")
    yaw = math.atan2(2 * (qw * qz + qx * qy), length**2 - 2 * (qy * qy + qz * qz))
    return stamp, x, y, yaw
