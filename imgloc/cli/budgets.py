"""Memory that a command will take: said beforehand, and refused if it is too much."""

from typing import TYPE_CHECKING

from imgloc.cli.console import LOG

if TYPE_CHECKING:
    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.methods import Options
    from imgloc.model import OccupancyGrid


def check_memory(need: int, memory_budget: int | None, what: str, hint: str) -> None:
    """Say how much `what` takes at most.

    Raises
    ------
    ConfigError
        If it is more than the budget, bytes; None is half of what is there.
    """
    from imgloc.features.budget import MIB, check_budget, default_budget

    budget = default_budget() if memory_budget is None else memory_budget
    LOG.info("%s: at most %d MiB, the budget is %d MiB", what, -(-need // MIB), budget // MIB)
    check_budget(need, budget, what, f"{hint}, or raise --memory-budget")


def check_simulation(
    grid: "OccupancyGrid", name: str, count: int, rays: int, memory_budget: int | None,
    *, world: bool = False,
) -> None:  # fmt: skip
    """Check the memory that simulating scans takes; those of a bundled `world` on its walls."""
    from imgloc.experiments.finegrid import FINE, fine_factor
    from imgloc.features.estimates import simulate_bytes

    height, width = grid.occupied.shape
    factor = round(grid.resolution / FINE) if world else fine_factor(grid)
    check_memory(
        simulate_bytes(height * width, height * width * factor**2, count * rays),
        memory_budget,
        f"{name}: simulating {count:,} scans of {rays:,} rays "
        f"on {factor * height} x {factor * width} cells",
        "simulate fewer scans, crop the map",
    )


def check_answer(
    features: "MapFeatures", options: "Options", name: str, memory_budget: int | None
) -> None:
    """Check the memory that an answer takes besides the features."""
    from imgloc.pipeline import answer_bytes

    (height, width), cell = features.lattice.shape, features.lattice.resolution
    check_memory(
        answer_bytes(features, options),
        memory_budget,
        f"{name}: {options.method} on {height} x {width} cells of {cell:g} m",
        "use a larger --cell or --theta-step-deg",
    )


def check_picture(features: "MapFeatures", what: str, name: str, memory_budget: int | None) -> None:
    """Check the memory that drawing a map or one of its features takes."""
    from imgloc.draw.canvas import default_scale
    from imgloc.features.budget import surface_count
    from imgloc.features.estimates import picture_bytes

    coarse = what in ("bmap", "vmap")
    info = features.lattice if coarse else features.grid.info
    (height, width), scale = info.shape, default_scale(info)
    points = 0 if what in ("map", "distance") else surface_count(features.grid)
    check_memory(
        picture_bytes(
            what, info.shape, height * width * scale**2, points=points, n_psi=features.n_psi
        ),
        memory_budget,
        f"{name}: a picture ({what}) of {scale * height} x {scale * width} pixels",
        "use a larger --cell" if coarse else "crop the map",
    )
