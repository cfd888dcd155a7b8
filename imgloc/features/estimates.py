"""How many bytes reading and simulating take, known before they are taken.

As in :mod:`imgloc.features.budget`: upper bounds. Those of what is loaded were measured as the
peak resident memory of a process of its own, those of the rest with :mod:`tracemalloc`.
"""

_READING = 180  # bytes
_KEPT = 24  # bytes per reading of a scan that has been simulated
_SAMPLE, _TEXT = 28, 4  # bytes per pixel as it is classified; and per byte of its file
_LEVELS = 6 << 20  # bytes that count how often each grey occurs, or say what each one means
_LOADED = 20  # bytes per pixel as it is decoded and read as occupied or free
_SCAN = 1700  # bytes per scan, twice its objects: cut or turned over it is another one
_NUMBER, _NUMBER_TEXT = 24, 150  # bytes per number of an array, or of a text
_COPIES, _WIDE = 4, 16  # bytes per byte of a text; characters beyond ASCII take up to four each
_CELL, _PLACE, _POSE = 14, 32, 50  # bytes as places are looked for that are far from the walls
PROCESS = 96 << 20
"""Bytes of another process before it does anything: Python, NumPy, OpenCV."""


def check_bytes(pixels: int, file_bytes: int) -> int:
    """Peak of :func:`imgloc.io.mapcheck.check_map`.

    Parameters
    ----------
    pixels : int
        Of the image, whatever its channels.
    file_bytes : int
        Of its file: samples may be written as text.
    """
    return _SAMPLE * pixels + _TEXT * file_bytes + _LEVELS


def load_bytes(pixels: int, file_bytes: int) -> int:
    """Peak of :func:`imgloc.io.maps.load_map`, with the map itself.

    Parameters
    ----------
    pixels, file_bytes : int
        As in :func:`check_bytes`.

    Examples
    --------
    >>> load_bytes(10_000 * 10_000, 2_665_308) // 2**20
    1923
    """
    return _LOADED * pixels + _TEXT * file_bytes + _LEVELS


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
    """Peak of :func:`imgloc.atlas.atlas_poses`, besides the map.

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
    """Peak of :func:`imgloc.simulate.simulate_scans`, besides the map.

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
