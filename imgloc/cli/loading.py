"""Maps and scans, loaded within the memory that may be taken."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from imgloc.cli.budgets import check_image, check_scans
from imgloc.cli.console import quiet_libraries

if TYPE_CHECKING:
    from imgloc.io.scanset import ScanSet
    from imgloc.model import OccupancyGrid


def load_grid(
    path: Path, memory_budget: int | None, *, allow_lossy: bool, held: int = 0, **reading: Any
) -> "OccupancyGrid":
    """Load a map, whose image is decoded only if that takes no more than the budget.

    Parameters
    ----------
    path : Path
        As in :func:`imgloc.io.maps.load_map`, of which `allow_lossy` and `reading` are options.
    memory_budget : int or None
        Bytes; None is half of what is there.
    allow_lossy : bool
    held : int
        Bytes of the budget that other maps take.

    Raises
    ------
    MapError
        If it cannot be read.
    ConfigError
        If it would take more than the budget.
    """
    from imgloc.features.budget import load_bytes
    from imgloc.io.maps import load_map

    check_image(path, reading, memory_budget, load_bytes, held=held)
    with quiet_libraries():
        return load_map(path, **reading, allow_lossy=allow_lossy)


def load_usable(
    path: Path, memory_budget: int | None, *, allow_lossy: bool, held: int = 0, **reading: Any
) -> "OccupancyGrid":
    """Load a map that has walls and free cells; see :func:`load_grid`.

    Raises
    ------
    MapError
        If it cannot be read, or has none.
    ConfigError
        If it would take more than the budget.
    """
    from imgloc.io.files import display
    from imgloc.io.maps import require_usable

    grid = load_grid(path, memory_budget, allow_lossy=allow_lossy, held=held, **reading)
    require_usable(grid, display(path))
    return grid


def load_set(path: Path, memory_budget: int | None) -> "ScanSet":
    """Load scans, which are read only if they take no more than the budget, bytes.

    Raises
    ------
    ScanError
        If they cannot be read.
    ConfigError
        If they would take more than the budget; None is half of what is there.
    """
    from imgloc.io.scans import load_scans

    check_scans(path, memory_budget)
    with quiet_libraries():
        return load_scans(path)
