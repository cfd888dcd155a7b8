"""Trajectories in TUM's format: a line ``stamp x y z qx qy qz qw`` for each pose."""

import math

import numpy as np

from imgloc.errors import ScanError
from imgloc.io.files import PathLike, display
from imgloc.io.text import read_text
from imgloc.model import FloatArray

_WORDS = "stamp x y z qx qy qz qw"


def load_tum(path: PathLike) -> tuple[FloatArray, FloatArray]:
    r"""Read a trajectory, the reference of `evo_ape tum` for example.

    Parameters
    ----------
    path : path
        Words with spaces or commas between; lines that begin with # are comments.

    Returns
    -------
    stamps : (N,) float array
        Seconds, in rising order.
    poses : (N, 3) float array
        x and y in metres, and the yaw in radians; z, roll and pitch are left out.

    Raises
    ------
    ScanError
        If the file cannot be read, or a line has not eight numbers.

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
    rows = list[tuple[float, float, float, float]]()
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        where = f"{display(path)}: line {number}"
        try:
            stamp, x, y, _, qx, qy, qz, qw = map(float, words)
        except ValueError:
            raise ScanError(f"{where}: got {line[:60]!r}, expected {_WORDS}") from None
        yaw = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        rows.append((stamp, x, y, yaw))
    found = np.array(rows).reshape(-1, 4)
    if not len(found) or not np.isfinite(found).all():
        raise ScanError(f"{display(path)}: expected a line {_WORDS} for each pose, all finite")
    found = found[np.argsort(found[:, 0], kind="stable")]
    return found[:, 0], found[:, 1:]
