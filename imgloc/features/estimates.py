"""How many bytes reading, simulating and drawing take, known before they are taken.

As in :mod:`imgloc.features.budget`: upper bounds. Those of what is loaded were measured as the
peak resident memory of a process of its own, those of the rest with :mod:`tracemalloc`.
"""

from imgloc.features.budget import prepare_bytes

_DRAWN = {"map": 12, "bmap": 54, "vmap": 96, "surface": 12, "visibility": 12, "distance": 44}
_PIXEL = 16  # bytes: three colours twice, and what is searched for a place for the scale bar
_ARROW = 500  # bytes per surface point with its normal, as Python numbers
_MARK = 1000  # bytes per pose of an atlas, as rows, polygons and lines
_READING = 180  # bytes
_KEPT = 24  # bytes per reading of a scan that has been simulated
_SCAN = 1700  # bytes per scan, twice its objects: cut or turned over it is another one
_NUMBER, _NUMBER_TEXT = 24, 150  # bytes per number of an array, or of a text
_COPIES, _WIDE = 4, 16  # bytes per byte of a text; characters beyond ASCII take up to four each
_CELL, _PLACE, _POSE = 14, 32, 50  # bytes as places are looked for that are far from the walls
POSE_TEXT = 280
"""Bytes of a pose while it is written as a line of text."""
PROCESS = 96 << 20
"""Bytes of another process before it does anything: Python, NumPy, OpenCV."""


def scans_bytes(
    scans: int, numbers: int, file_bytes: int = 0, *, text: bool = False, ascii_only: bool = True
) -> int:
    """Peak of :func:`imgloc.io.scans.load_scans`, with the scans; they are kept in less.

    Parameters
    ----------
    scans : int
    numbers : int
        Ranges and angles of all of them, and what is known beside.
    file_bytes : int
        Of the file.
    text, ascii_only : bool
        Whether it is a text, and one without any other characters.

    Examples
    --------
    >>> scans_bytes(100, 100 * 360 + 360, 200_000) // 2**20
    1
    """
    if not text:
        return _SCAN * scans + _NUMBER * numbers + file_bytes
    copies = _COPIES if ascii_only else _WIDE
    return _SCAN * scans + _NUMBER_TEXT * numbers + copies * file_bytes


def poses_bytes(cells: int, places: int, headings: int) -> int:
    """Peak of :func:`imgloc.experiments.atlas.atlas_poses`, besides the map.

    Parameters
    ----------
    cells : int
        Of the map.
    places : int
        Squares of the raster, were all of them free.
    headings : int
        At each of them.

    Examples
    --------
    >>> poses_bytes(10_000 * 10_000, 10 * 10, 1) // 2**20
    1335
    """
    return _CELL * cells + (_PLACE + _POSE * headings) * places


def simulate_bytes(cells: int, fine_cells: int, readings: int, *, kept: int = 0) -> int:
    """Peak of :func:`imgloc.experiments.simulate.simulate_scans`, besides the map.

    Parameters
    ----------
    cells, fine_cells : int
        Of the map, and of the finer image on which rays are cast.
    readings : int
        Scans times rays, of those that are simulated at once.
    kept : int
        Readings of all that are simulated, if not at once.

    Examples
    --------
    >>> simulate_bytes(10**6, 16 * 10**6, 181 * 100) // 2**20
    163
    """
    return 24 * cells + 9 * fine_cells + _READING * readings + _KEPT * kept


def picture_bytes(
    what: str,
    shape: tuple[int, int],
    pixels: int,
    *,
    points: int = 0,
    n_psi: int = 72,
    marks: int = 0,
) -> int:
    """Peak of drawing a map or one of its features, besides the map.

    Parameters
    ----------
    what : str
        ``map``, ``bmap``, ``vmap``, ``surface``, ``visibility`` or ``distance``.
    shape : (int, int)
        Rows and columns that are drawn.
    pixels : int
        Of the picture.
    points : int
        Number of surface points, see :func:`imgloc.features.budget.surface_count`.
    n_psi : int
        Directions of the visibility map.
    marks : int
        Poses of an atlas that are drawn on the map.

    Examples
    --------
    >>> picture_bytes("map", (1000, 2000), 2000 * 1000) // 2**20
    53
    """
    drawing = _DRAWN[what] * shape[0] * shape[1] + _PIXEL * pixels + _MARK * marks
    if what in ("map", "distance"):
        return drawing
    need = drawing + prepare_bytes(
        (0, 0), points=points, n_psi=n_psi if what == "visibility" else 1
    )
    if what == "surface":
        return need + _ARROW * points
    # Every point's directions four more times: clipped, squared, summed.
    return need + 24 * n_psi * points * (what == "visibility")
