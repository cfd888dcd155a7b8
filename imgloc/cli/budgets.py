"""Memory that a command will take: said beforehand, and refused if it is too much."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from imgloc.cli.console import LOG

if TYPE_CHECKING:
    from pathlib import Path

    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.io.images import ImageSize
    from imgloc.model import LaserScan, OccupancyGrid
    from imgloc.options import Options

_MARK = 1000  # bytes per pose that is drawn on a map, as rows, polygons and lines
COARSER = "crop the map, use a larger --cell or --theta-step-deg"


def fixed_budget(memory_budget: int | None) -> int:
    """Bytes that a command may take to its end: by default half of what is there at its start."""
    from imgloc.features.budget import default_budget

    return default_budget() if memory_budget is None else memory_budget


def check_memory(need: int, memory_budget: int | None, what: str, hint: str) -> None:
    """Say how much `what` takes at most.

    Raises
    ------
    ConfigError
        If it is more than the budget, bytes; None is half of what is there.
    """
    from imgloc.features.budget import MIB, check_budget

    budget = fixed_budget(memory_budget)
    LOG.info("%s: at most %d MiB, the budget is %d MiB", what, -(-need // MIB), budget // MIB)
    check_budget(need, budget, what, f"{hint}, or raise --memory-budget")


def check_image(
    map_path: "Path", reading: Mapping[str, Any], memory_budget: int | None,
    need: "Callable[[ImageSize], int]", *, held: int = 0,
) -> None:  # fmt: skip
    """Check the memory that looking at the image of a map takes, as its header says.

    That is what `need` says of its size, and what other maps that are `held` at the same time take.
    """
    from imgloc.features.budget import MIB
    from imgloc.io.files import display
    from imgloc.io.images import image_size
    from imgloc.io.maps import resolve_settings

    image = resolve_settings(map_path, **reading).image
    size = image_size(image)
    beside = f" beside {-(-held // MIB)} MiB of other maps" if held else ""
    check_memory(
        held + need(size),
        memory_budget,
        f"{display(image)}: an image of {size.width} x {size.height} pixels{beside}",
        "crop the map",
    )


def check_scans(path: "Path", memory_budget: int | None) -> None:
    """Check the memory that reading scans takes, as the headers or the lines of their file say."""
    from imgloc.features.budget import scans_bytes
    from imgloc.io.files import display
    from imgloc.io.scans import scans_size

    size = scans_size(path)
    check_memory(
        scans_bytes(size.scans, size.numbers, size.file_bytes, text=size.text),
        memory_budget,
        f"{display(path)}: a file of up to {size.scans:,} scans and {size.numbers:,} numbers",
        "take fewer scans, in several files",
    )


def held_bytes(scans: "Sequence[LaserScan]") -> int:
    """Bytes of scans that are held in memory.

    A few scans out of many hold the array of all.
    """
    from imgloc.features.budget import scans_bytes

    arrays = [a if a.base is None else a.base for s in scans for a in (s.ranges, s.angles)]
    return scans_bytes(len(scans), 0) + sum({id(a): a.nbytes for a in arrays}.values())


def check_poses(
    grid: "OccupancyGrid", name: str, step: float, headings: int, memory_budget: int | None
) -> None:
    """Check the memory that looking for the poses of an atlas takes."""
    from imgloc.features.budget import poses_bytes

    height, width = grid.occupied.shape
    places = round(height * grid.resolution / step + 1) * round(width * grid.resolution / step + 1)
    check_memory(
        poses_bytes(height * width, places, headings),
        memory_budget,
        f"{name}: {headings} headings at up to {places:,} places on {height} x {width} cells",
        "use a larger --step or fewer --headings, crop the map",
    )


def check_simulation(
    grid: "OccupancyGrid", name: str, count: int, rays: int, memory_budget: int | None,
    *, world: bool = False, at_once: int | None = None, sets: int = 1,
    hint: str = "simulate fewer scans, crop the map",
) -> None:  # fmt: skip
    """Check the memory that simulating scans takes; those of a bundled `world` on its walls.

    They are simulated `at_once`, by default all, and as many as `sets` times `count` are kept.
    """
    from imgloc.features.budget import simulate_bytes
    from imgloc.simulate import FINE, fine_factor

    height, width = grid.occupied.shape
    factor = round(grid.resolution / FINE) if world else fine_factor(grid)
    check_memory(
        simulate_bytes(
            height * width,
            height * width * factor**2,
            min(count, at_once or count) * rays,
            kept=sets * count * rays,
        ),
        memory_budget,
        f"{name}: simulating {count:,} scans of {rays:,} rays "
        f"on {factor * height} x {factor * width} cells",
        hint,
    )


def check_answer(
    features: "MapFeatures", options: "Options", name: str,
    *, hint: str = COARSER, workers: int = 1, scans: "Sequence[LaserScan]" = (),
) -> None:  # fmt: skip
    """Check the memory that an answer, the features it needs and the scans take together.

    The budget, that of the options, is for all of several processes, which share nothing.
    """
    from imgloc.features.budget import MIB, PROCESS
    from imgloc.pipeline import answer_bytes

    (rows, columns), lattice = features.grid.occupied.shape, features.lattice
    held = features.bytes_for(options.method)
    answer = answer_bytes(features, options)
    what = (
        f"{name}: {options.method} on {lattice.height} x {lattice.width} cells of "
        f"{lattice.resolution:g} m ({-(-answer // MIB)} MiB) with features of "
        f"{rows} x {columns} cells ({-(-held // MIB)} MiB)"
    )
    need = held + answer
    if workers > 1:
        need = workers * (need + PROCESS + 2 * rows * columns)
        what, hint = f"{what} in each of {workers} processes", f"use fewer --workers, {hint}"
    if (kept := held_bytes(scans)) >= MIB:
        what = f"{what} and {len(scans):,} scans ({-(-kept // MIB)} MiB)"
    check_memory(need + kept, options.memory_budget, what, hint)


def check_picture(
    features: "MapFeatures", what: str, name: str, memory_budget: int | None, *, marks: int = 0
) -> None:
    """Check the memory that drawing a map or one of its features takes."""
    from imgloc.draw.canvas import default_scale
    from imgloc.features.budget import features_bytes, picture_bytes, surface_count

    coarse = what in ("bmap", "vmap")
    info = features.lattice if coarse else features.grid.info
    (height, width), scale = info.shape, default_scale(info)
    points = 0 if what in ("map", "distance") else surface_count(features.grid)
    seen = features.n_psi if what == "visibility" else 0
    check_memory(
        features_bytes((0, 0), points=points, n_psi=max(1, seen))
        + picture_bytes(height * width, height * width * scale**2, points=points, n_psi=seen)
        + _MARK * marks,
        memory_budget,
        f"{name}: a picture ({what}) of {scale * height} x {scale * width} pixels",
        "use a larger --cell" if coarse else "crop the map",
    )
