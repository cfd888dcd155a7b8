"""How many bytes simulating scans and drawing a map take, known before they are taken.

As in :mod:`imgloc.features.budget`: upper bounds, measured with :mod:`tracemalloc`.
"""

from imgloc.features.budget import prepare_bytes

_DRAWN = {"map": 12, "bmap": 54, "vmap": 96, "surface": 12, "visibility": 12, "distance": 44}
_PIXEL = 16  # bytes: three colours twice, and what is searched for a place for the scale bar
_ARROW = 500  # bytes per surface point with its normal, as Python numbers
_READING = 180  # bytes


def simulate_bytes(cells: int, fine_cells: int, readings: int) -> int:
    """Peak of :func:`imgloc.experiments.simulate.simulate_scans`, besides the map.

    Parameters
    ----------
    cells, fine_cells : int
        Of the map, and of the finer image on which rays are cast.
    readings : int
        Scans times rays.

    Examples
    --------
    >>> simulate_bytes(10**6, 16 * 10**6, 181 * 100) // 2**20
    163
    """
    return 24 * cells + 9 * fine_cells + _READING * readings


def picture_bytes(
    what: str, shape: tuple[int, int], pixels: int, *, points: int = 0, n_psi: int = 72
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

    Examples
    --------
    >>> picture_bytes("map", (1000, 2000), 2000 * 1000) // 2**20
    53
    """
    drawing = _DRAWN[what] * shape[0] * shape[1] + _PIXEL * pixels
    if what in ("map", "distance"):
        return drawing
    need = drawing + prepare_bytes(
        (0, 0), points=points, n_psi=n_psi if what == "visibility" else 1
    )
    if what == "surface":
        return need + _ARROW * points
    # Every point's directions four more times: clipped, squared, summed.
    return need + 24 * n_psi * points * (what == "visibility")
