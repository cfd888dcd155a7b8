"""The recipe: a map becomes features, a scan becomes a likelihood, peaks become an answer.

>>> import numpy as np
>>> from imgloc.model import LaserScan, OccupancyGrid
>>> walls = np.pad(np.zeros((40, 60), bool), 2, constant_values=True)
>>> walls[2:20, 30:34] = True
>>> features = prepare(OccupancyGrid(walls, ~walls, 0.1))
>>> angles = np.deg2rad(np.arange(-180, 180, 2.0))
>>> from imgloc.features.raycast import cast_rays
>>> ranges = cast_rays(features.walls, [2.0, 3.0], angles + 0.3, 20.0, 0.1)
>>> answer = localize(features, LaserScan(ranges, angles, range_max=20.0))
>>> answer.verdict, round(answer.pose.x, 1), round(answer.pose.y, 1), round(answer.pose.theta, 1)
('unique', 2.0, 3.0, 0.3)
"""

import time
from dataclasses import asdict, fields, replace

import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.budget import (
    check_budget,
    default_budget,
    exact_bytes,
    fused_bytes,
    stack_bytes,
)
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import compose, rotate_covariance, uniform_thetas
from imgloc.io.maps import require_usable
from imgloc.likelihood.calibration import DEFAULTS
from imgloc.methods import (
    ALL_METHODS,
    FUSED,
    METHODS,
    Method,
    Options,
    check_method,
    headings_of,
    likelihood,
)
from imgloc.model import GridInfo, Hypothesis, LaserScan, Localization, OccupancyGrid
from imgloc.search.priors import Prior
from imgloc.search.trust import Trust, judge
from imgloc.searches import (
    NOTHING,
    Found,
    exact_thetas,
    find_exact,
    find_fused,
    find_stack,
    found_in_stack,
)

__all__ = [
    "ALL_METHODS", "FUSED", "METHODS", "Found", "Method", "Options", "Trust", "answer_bytes",
    "check_method", "check_options", "effective", "found_in_stack", "in_map_frame", "likelihood",
    "localize", "prepare",
]  # fmt: skip


def prepare(grid: OccupancyGrid, name: str = "map", **parameters: float) -> MapFeatures:
    """Prepare a map: refuse one that is of no use, and wrap it into its features.

    Parameters
    ----------
    grid : OccupancyGrid
    name : str
        What error messages call the map.
    **parameters
        Of :class:`~imgloc.features.mapfeatures.MapFeatures`.

    Raises
    ------
    MapError
        If the map has no walls or no free cells.
    """
    require_usable(grid, name)
    return MapFeatures(grid, **parameters)  # type: ignore[arg-type]


def localize(
    features: MapFeatures, scan: LaserScan, options: Options | None = None
) -> Localization:
    """Find every pose that fits a scan, and say how much to trust each.

    Parameters
    ----------
    features : MapFeatures
        Of :func:`prepare`.
    scan : LaserScan
    options : Options, optional

    Returns
    -------
    Localization
        Poses of the sensor in the map frame. A scan with readings in too few directions is
        answered with the verdict ``invalid``, not with an error; a search that ran out of time
        is never ``unique``.

    Raises
    ------
    ConfigError
        If an option is out of its range, the memory budget too small, or no pose in which a
        sensor can be is in the prior.
    """
    options = options or Options()
    check_options(features, options)
    start = time.perf_counter()
    directions = scan.directions
    found = NOTHING
    if directions >= max(1, options.trust.readings):
        if options.method == FUSED:
            search = find_fused
        else:
            search = find_exact if options.exact else find_stack
        found = search(features, scan, options)
    elapsed = 1e3 * (time.perf_counter() - start)
    top = found.hypotheses[: options.top]
    verdict = judge(directions, found.mass, found.elsewhere, options.trust)
    if verdict == "unique" and not found.complete:
        verdict = "ambiguous"  # what was not looked at may fit as well
    return Localization(
        hypotheses=tuple(in_map_frame(h, features.grid.info) for h in top),
        verdict=verdict,
        entropy=found.entropy,
        explained=found.explained,
        counts=scan.counts,
        timings_ms={"localize": elapsed},
        parameters=effective(options, features),
        complete=found.complete,
        elsewhere=found.elsewhere,
    )


def check_options(features: MapFeatures, options: Options) -> None:
    """Refuse what :func:`localize` cannot do, before anything is done.

    Raises
    ------
    ConfigError
        If an option is out of its range, the memory budget too small, or no pose in which a
        sensor can be is in the prior.
    """
    if options.top < 1:
        raise ConfigError(f"top must be at least 1, got {options.top}")
    check_method(options.method, ALL_METHODS)
    if options.exact and options.method not in (FUSED, "cbml"):
        raise ConfigError(f"the exact search is of cbml's score, not of {options.method}'s")
    if options.time_budget is not None and options.method != FUSED:
        raise ConfigError(f"a time budget is for the method {FUSED}, not for {options.method}")
    prior = options.prior.cells
    if prior is not None and not (prior & features.standable).any():
        raise ConfigError("the prior leaves no cell of the map in which a sensor can be")
    if options.exact or options.method == FUSED:
        shape, cell = features.lattice.shape, features.lattice.resolution
        check_budget(
            answer_bytes(features, options),
            default_budget() if options.memory_budget is None else options.memory_budget,
            f"{options.method} on {shape[0]} x {shape[1]} cells of {cell:g} m",
            "use larger cells",
        )


def answer_bytes(features: MapFeatures, options: Options) -> int:
    """How many bytes :func:`localize` takes at most, besides the map's features."""
    shape, cell = features.lattice.shape, features.lattice.resolution
    exact = exact_bytes(shape, cell, len(exact_thetas(options))) if options.exact else 0
    if options.method == FUSED:
        fused = options.fused
        return exact + fused_bytes(
            shape,
            cell,
            n_thetas=len(uniform_thetas(fused.theta_step)),
            vote_cell=fused.vote_cell,
            vote_headings=fused.vote_headings,
            vote_cells=fused.vote_cells,
        )
    return exact or stack_bytes(
        options.method,
        shape,
        len(headings_of(options)),
        threads=options.threads,
        n_rays=features.n_rays,
    )


def in_map_frame(hypothesis: Hypothesis, grid: GridInfo) -> Hypothesis:
    """Take a hypothesis from the grid frame to the map frame: origin and its yaw."""
    return replace(
        hypothesis,
        pose=compose(grid.origin, hypothesis.pose),
        covariance=rotate_covariance(hypothesis.covariance, grid.origin.theta),
    )


def effective(options: Options, features: MapFeatures) -> dict[str, object]:
    """The parameters that decided an answer, as plain values. Threads do not."""
    out = asdict(replace(options, prior=Prior()))
    out["prior"] = dict(options.prior.about)
    del out["threads"], out["memory_budget"]
    if options.time_budget is None:
        del out["time_budget"]
    fused = options.method == FUSED
    if out["theta_step"] is None:
        stack = "cbml" if fused else options.method
        out["theta_step"] = float(np.deg2rad(METHODS[stack].theta_step_deg))
    if not fused:
        out["calibration"] = asdict(options.calibration or DEFAULTS[options.method])
    else:
        del out["engine"], out["calibration"]
        if not options.exact:  # they are the headings of branch and bound
            del out["theta_step"]
    about_map = {f.name: getattr(features, f.name) for f in fields(features)}
    for name in ("grid", "memory_budget", "threads"):
        del about_map[name]
    return out | {"map": about_map, "seed": None}
