"""The recipe: a map becomes features, a scan becomes poses, and the poses an answer.

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
from dataclasses import replace
from typing import Any

import numpy as np

from imgloc.errors import expect
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import one_per_place
from imgloc.geometry import in_map_frame
from imgloc.io.maps import require_usable
from imgloc.likelihoods.posterior import entropy
from imgloc.likelihoods.stacks import check_stack, likelihood
from imgloc.model import (
    Evidence,
    FloatArray,
    LaserScan,
    Likelihood,
    Localization,
    OccupancyGrid,
)
from imgloc.numbers import number
from imgloc.options import FUSED, Options, Shared
from imgloc.search.adapt import adapt
from imgloc.search.asked import check_options, effective
from imgloc.search.hypotheses import as_hypotheses
from imgloc.search.modes import Modes, separate
from imgloc.search.priors import pyramid_levels, standing
from imgloc.search.proposals import propose_endpoints, propose_votes
from imgloc.search.refine import refine
from imgloc.search.rescore import score_poses, shortlist
from imgloc.search.stacked import exact_poses, find_exact, find_in_stack
from imgloc.search.trust import judge
from imgloc.search.weigh import NOTHING, _log_volumes, weigh

_LAST = number("pipeline.last")  # proposals that get the second look when time is up
_ROUNDS = number("pipeline.rounds")  # of searches with an error that the readings share
_FIRST_LOOK, _SECOND_LOOK = number("refine.first_look"), number("refine.second_look")


def prepare(grid: OccupancyGrid, name: str = "map", **parameters: Any) -> MapFeatures:
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
    TypeError
        If `grid` is none: a path, say, that :func:`imgloc.load_map` should read first.
    """
    expect(grid, OccupancyGrid, "grid")
    require_usable(grid, name)
    return MapFeatures(grid, **parameters)


def localize(
    features: MapFeatures,
    scan: LaserScan,
    options: Options | None = None,
    *,
    stack: Likelihood | None = None,
) -> Localization:
    """Find every pose that fits a scan, and say how much to trust each.

    Parameters
    ----------
    features : MapFeatures
        Of :func:`prepare`.
    scan : LaserScan
    options : Options, optional
    stack : Likelihood, optional
        Of :func:`likelihood` with the same arguments, if it is there already; a ConfigError for
        that of another method, map or scan.

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
    TypeError
        If an argument is of another kind.
    """
    options = Options() if options is None else options
    check_options(features, options)
    expect(scan, LaserScan, "scan")
    if stack is not None:
        check_stack(stack, features, scan, options)
    start = time.perf_counter()
    if scan.directions < max(1, options.trust.readings):
        found = NOTHING
    elif options.method == FUSED:  # propose, refine, score, separate; then weigh
        found = weigh(features, find_adapted_modes(features, scan, options), options, scan)
    elif options.exact:
        found = find_exact(features, scan, options)
    else:
        stack = likelihood(features, scan, options) if stack is None else stack
        found = find_in_stack(features, scan, stack, options)
    elsewhere = 1.0
    if len(found.poses):
        elsewhere = options.trust.mass_elsewhere(found.gained, found.lead)
    mass = (1 - elsewhere) * found.share
    verdict, checks = judge(scan.directions, mass, elsewhere, options.trust, found.complete)
    arrays = (found.poses, found.log_likelihood, mass, found.covariance)
    listed = as_hypotheses(*(array[: options.listed(found.share)] for array in arrays))
    hypotheses = tuple(in_map_frame(h, features.grid.info) for h in listed)
    elapsed = 1e3 * (time.perf_counter() - start)
    whole = np.append(mass, elsewhere) if len(mass) else mass
    return Localization(
        hypotheses=hypotheses,
        verdict=verdict,
        entropy=entropy(whole) if found.entropy is None else found.entropy,
        explained=found.explained,
        counts=scan.counts,
        timings_ms={"localize": elapsed},
        parameters=effective(options, features),
        complete=found.complete,
        elsewhere=elsewhere,
        evidence=Evidence(
            readings=found.readings,
            best=options.fused.model.best,
            misfit=found.misfit,
            unmapped=found.unmapped,
            gained=found.gained,
            scale=found.shared.scale,
            thinner=found.shared.thinner * features.grid.resolution,
            temperature=found.temperature,
            log_volume=_log_volumes(hypotheses, features),
            checks=checks,
            found=len(mass),
            listed=len(hypotheses),
            unlisted=float(mass[len(hypotheses) :].sum()),
        ),
        T_base_laser=scan.T_base_laser,
    )


def find_modes(
    features: MapFeatures, scan: LaserScan, options: Options, *, more: FloatArray | None = None
) -> Modes:
    """Search for all poses that fit a scan, by the default method.

    Endpoint correlation and GHT-V votes fail differently: where nothing that the one proposes
    fits, the other proposes, too. The score that decides is a third one. Most proposals are
    dropped after a look with a few rays. When the time of the `options` is up, only the best so
    far are followed.

    Parameters
    ----------
    features, scan, options
        As of :func:`localize`; with at least one valid reading.
    more : (M, 3) float array, optional
        Proposals of another source, grid frame.
    """
    fused, prior, seen = options.fused, options.prior, one_per_place(scan, options.fused.place)
    few, many = seen.spread(fused.few_rays), seen.spread(fused.rays)
    deadline = time.monotonic() + (np.inf if options.time_budget is None else options.time_budget)

    def look(proposals: FloatArray, before: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The best of them, refined, and of those that got this look before; and their scores."""
        poses = refine(proposals, few.xy, features.field, sigmas=_FIRST_LOOK)
        poses = np.concatenate((before, standing(poses, prior, features)))
        return shortlist(poses, few, features, fused)

    # Propose, refine with a few rays, and look which are worth more of them.
    endpoints, _ = propose_endpoints(
        levels := pyramid_levels(prior, features.pyramid, features.grid.resolution),
        few.xy,
        theta_step=fused.theta_step,
        keep=fused.keep[: len(levels)],
        skip=fused.skip,
        prior=prior,
        threads=options.threads,
    )
    if time.monotonic() >= deadline:
        endpoints = endpoints[: fused.second_look]
    proposals = [endpoints, np.empty((0, 3)) if more is None else more]
    if options.exact and time.monotonic() < deadline:
        proposals.append(exact_poses(features, scan, options, deadline)[0])
    looked, score = look(np.concatenate(proposals), np.empty((0, 3)))
    unfit = not len(looked) or score[0] < (fused.model.best - fused.unfit) * len(few)
    if unfit and time.monotonic() < deadline:
        looked, _ = look(propose_votes(features, scan, fused, prior, options.threads), looked)
    late = time.monotonic() >= deadline
    if late:
        looked = looked[:_LAST]

    # Refine with more rays.
    poses = refine(looked, many.xy, features.field, sigmas=_SECOND_LOOK)
    poses = standing(poses, prior, features)

    # Score, and separate.
    scores = score_poses(features, many, poses, options)
    poses, scores, spread = separate(features, poses, scores, len(many), options)
    return Modes(poses, scores, many, complete=not late, looked=looked, spread=spread)


def find_adapted_modes(features: MapFeatures, scan: LaserScan, options: Options) -> Modes:
    """Search for all poses, and again if the readings fit far better with an error they share.

    Parameters
    ----------
    features, scan, options
        As of :func:`find_modes`; a budget of time is that of all searches together.
    """
    start = time.monotonic()

    def find(shared: Shared) -> Modes:
        left = options
        if options.time_budget is not None:
            rest = max(0.0, start + options.time_budget - time.monotonic())
            left = replace(options, time_budget=rest)
        there = features.thinner(shared.thinner)
        return replace(find_modes(there, scan.scaled(shared.scale), left), shared=shared)

    fused, found = options.fused, find(options.shared)
    for _ in range(_ROUNDS):
        fits = found.mean_score >= fused.model.best - fused.strained
        if fits or not (found.complete and len(found.poses)):
            break
        places = np.concatenate((found.poses[:1], found.looked))
        shared = adapt(features, found.readings, places, found.shared, options)
        if shared == found.shared:
            break
        again = find(shared)
        if not again.complete:
            return replace(found, complete=False)
        if again.mean_score <= found.mean_score:
            break
        found = again
    return found
