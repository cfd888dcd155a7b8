"""Estimates of the memory that a computation needs, in bytes, and the memory that is available.

The factors are upper bounds of peaks measured with :mod:`tracemalloc`, as the tests do again, and
rarely more than a few times too high.
"""

import os
from contextlib import suppress
from pathlib import Path

import numpy as np

from imgloc.errors import ConfigError
from imgloc.model import OccupancyGrid

MIB = 1 << 20
#: What is assumed to be available where the system does not say.
UNKNOWN_RAM = 4 << 30
#: Another process before it does anything: Python, NumPy, OpenCV.
PROCESS = 96 * MIB

_POSE = 20  # bytes per pose of a stack: itself, its posterior, and the search for peaks
_FIXED = 64 * MIB  # buffers whose size depends neither on the map nor on the scan


def available_bytes(
    meminfo: Path = Path("/proc/meminfo"), cgroup: Path = Path("/sys/fs/cgroup")
) -> int:
    """Bytes of RAM that can be taken without anything being swapped out.

    On Linux what is available by the kernel (`meminfo`), or what the container's limit leaves if
    that is less (`cgroup`); elsewhere half of the RAM; :data:`UNKNOWN_RAM` if nothing is known.
    """
    free = []
    with suppress(OSError, ValueError, IndexError):
        for line in meminfo.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                free.append(1024 * int(line.split()[1]))
    with suppress(OSError, ValueError):
        limit, used = ((cgroup / f"memory.{name}").read_text() for name in ("max", "current"))
        free.append(max(0, int(limit) - int(used)))  # without a limit it says "max"
    if free:
        return min(free)
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2
    except (AttributeError, OSError, ValueError):  # Windows has no sysconf
        return UNKNOWN_RAM


def default_budget() -> int:
    """Half of the RAM that is available, bytes."""
    return available_bytes() // 2


def check_budget(need: int, budget: int | None, what: str, hint: str) -> None:
    """Refuse to start something that would take more memory than it may.

    `need` and `budget` are bytes; a budget of None is :func:`default_budget`. The ConfigError has
    `what` takes them, with its sizes, as the subject of a sentence, and as a `hint` what to change.

    Examples
    --------
    >>> check_budget(3 << 30, 1 << 30, "a stack of 120 headings", "use larger cells")
    Traceback (most recent call last):
        ...
    imgloc.errors.ConfigError: a stack of 120 headings needs 3072 MiB of memory, the budget is \
1024 MiB: use larger cells
    """
    budget = default_budget() if budget is None else budget
    if need > budget:
        raise ConfigError(
            f"{what} needs {-(-need // MIB)} MiB of memory, the budget is {budget // MIB} MiB: "
            f"{hint}"
        )


def surface_count(grid: OccupancyGrid) -> int:
    """Upper bound for the surface points of a map: its edges between occupied and free cells.

    Examples
    --------
    >>> wall = np.array([[False, True, False]] * 2)
    >>> surface_count(OccupancyGrid(wall, ~wall, 0.1))
    4
    """
    a, b = grid.occupied, grid.free
    across = (a[:, 1:] & b[:, :-1]) | (b[:, 1:] & a[:, :-1])
    along = (a[1:] & b[:-1]) | (b[1:] & a[:-1])
    return int(np.count_nonzero(across) + np.count_nonzero(along))


def features_bytes(
    shape: tuple[int, int], *, points: int, factor: int, n_psi: int = 72, seeing: int = 0
) -> int:
    """Peak of computing what a method uses of a map, besides the map itself.

    `points` are :func:`surface_count`, `n_psi` directions of the visibility map, `factor` cells of
    the map along one of the lattice; `seeing` surface points have visibility.

    Examples
    --------
    >>> round(features_bytes((10_000, 10_000), points=100_000, factor=2) / 2**30, 1)
    2.2
    """
    cells = shape[0] * shape[1]
    held = 14 * cells + 3 * cells // factor**2 + 25 * points + 4 * n_psi * seeing
    # One at a time: images of the map, outlines and the lines fitted to them in a band of rows,
    # rays of the visibility map.
    lines = 120 * points + 1200 * min(points, 1 << 17)
    return held + max(9 * cells, lines, 130 * min(seeing * n_psi, 1 << 21))


def ray_distances_bytes(shape: tuple[int, int], n_psi: int) -> int:
    """Bytes for the stack of :func:`imgloc.features.raydistance.ray_distances`.

    Examples
    --------
    >>> ray_distances_bytes((400, 500), 360) / 1e6
    144.0
    """
    return 2 * shape[0] * shape[1] * n_psi


def stack_bytes(
    method: str, shape: tuple[int, int], n_thetas: int, *, threads: int = 1, n_rays: int = 360
) -> int:
    """Peak of `localize` with one of the paper's methods: its stack, and what it becomes.

    `shape` is that of the lattice; `n_rays` are the directions of the ray distances of ``beam``.

    Examples
    --------
    >>> stack_bytes("cbml", (1000, 1000), 120) // 2**20
    2360
    """
    cells = shape[0] * shape[1]
    votes = 4 * (threads - 1) * cells * n_thetas  # each thread beyond the first has its own
    extra = {
        "cbml": 8 * cells,  # the image and its multiples
        "cbml-o": 96 * cells,  # the field and its projections on 32 directions
        "ght": votes,
        "ght-v": votes,
        "beam": ray_distances_bytes(shape, n_rays),
    }
    return _POSE * cells * n_thetas + extra.get(method, 0) + _FIXED


def fused_bytes(shape: tuple[int, int], *, n_thetas: int = 360) -> int:
    """Peak of `localize` with the default method, besides the features.

    `shape` is of the lattice of poses, `n_thetas` the headings of the endpoint correlation.
    """
    cells = shape[0] * shape[1]
    # The coarsest level takes every third heading, some at a time.
    coarse = min(n_thetas // 3 * cells // 16, max(1 << 22, cells // 16))
    # Then the finest level in a margin as wide as the map, for readings that long.
    return 12 * coarse + 10 * cells + _FIXED


def scans_bytes(scans: int, numbers: int, file_bytes: int = 0, *, text: bool = False) -> int:
    """Peak of :func:`imgloc.io.scans.load_scans` for so many scans and numbers in a file.

    Examples
    --------
    >>> scans_bytes(100, 100 * 360 + 360, 200_000) // 2**20
    1
    """
    return 1700 * scans + (125 if text else 24) * numbers + (16 if text else 1) * file_bytes


def simulate_bytes(cells: int, fine_cells: int, readings: int, *, kept: int = 0) -> int:
    """Peak of simulating so many readings at once on a map and a finer image of it.

    `kept` are the readings of all that are simulated, if not at once.

    Examples
    --------
    >>> simulate_bytes(10**6, 16 * 10**6, 181 * 100) // 2**20
    163
    """
    return 24 * cells + 9 * fine_cells + 180 * readings + 24 * kept


def poses_bytes(cells: int, places: int, most: int) -> int:
    """Peak of choosing the poses of an atlas: the map's cells, places of the raster, poses."""
    return 18 * cells + 2 * places + 60 * min(places, most)
