"""Where `imgloc evaluate` takes its maps and scans from."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from imgloc.cli.loading import load_set
from imgloc.cli.options import cut_scan
from imgloc.errors import ConfigError

if TYPE_CHECKING:
    from imgloc.io.scanset import ScanSet
    from imgloc.model import OccupancyGrid
    from imgloc.simulate import Sensor

_MAX_SCANS = 100_000


def check_sources(
    maps: Sequence[Path], scans: Sequence[Path] | None, count: int | None, sample: int | None,
    sensor: "Sensor", *, flipped: bool = False,
) -> None:  # fmt: skip
    """Refuse options that would be ignored.

    Raises
    ------
    ConfigError
        Naming the option.
    """
    from imgloc.simulate import Sensor

    if scans is None:
        if flipped:
            raise ConfigError("--flipped: expected --scans; simulated sensors are upright")
        if sample is not None:
            raise ConfigError("--sample: expected --scans to take from; -n is for simulated scans")
        if (count or 0) > _MAX_SCANS:
            raise ConfigError(f"-n: got {count:,}, expected at most {_MAX_SCANS:,} scans")
        return
    if len(scans) != len(maps):
        raise ConfigError(f"--scans: got {len(scans)} for {len(maps)} maps, expected one each")
    if count is not None:
        raise ConfigError("-n: recorded scans are not simulated; use --sample")
    if sensor != Sensor():
        raise ConfigError("--scans: options of a simulated sensor do not go with recorded scans")


def short_name(path: Path) -> str:
    """What a table calls a map: the folder of a map.yaml says more than its name."""
    from imgloc.io.files import display

    return display(path.parent.name if path.stem == "map" and path.parent.name else path.stem)


def simulated(
    path: Path,
    grid: "OccupancyGrid",
    count: int,
    seed: int,
    sensor: "Sensor",
    memory_budget: int | None = None,
) -> "ScanSet":
    """Simulate scans in a map; in a bundled one on its walls, not on its cells.

    Raises
    ------
    ConfigError
        If that would take more than the budget, bytes; None is half of what is there.
    """
    from imgloc.cli.budgets import check_simulation
    from imgloc.io.files import display
    from imgloc.simulate import fine_image, is_world, simulate_set

    world = is_world(path, grid)
    check_simulation(grid, display(path), count, sensor.rays, memory_budget, world=world)
    return simulate_set(grid, count, seed, sensor, fine_image(path, grid))


def recorded(
    path: Path,
    sample: int | None,
    sample_seed: int,
    range_max: float | None,
    memory_budget: int | None = None,
    *,
    flipped: bool = False,
) -> "ScanSet":
    """Load scans with poses, pick some at random and cut their readings.

    Raises
    ------
    ConfigError
        If that would take more than the budget, bytes; None is half of what is there.
    """
    from imgloc.io.files import display
    from imgloc.simulate import sample_set

    chosen = sample_set(load_set(path, memory_budget), sample, sample_seed, display(path))
    scans = tuple(cut_scan(scan, range_max, flipped=flipped) for scan in chosen.scans)
    return replace(chosen, scans=scans)
