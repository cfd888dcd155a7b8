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
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np

from imgloc.errors import ConfigError, expect
from imgloc.features.budget import check_budget, exact_bytes, fused_bytes, stack_bytes
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.pyramid import block_masks
from imgloc.features.scanpoints import Readings, one_per_place, scan_xy
from imgloc.geometry import centre_of, in_map_frame, uniform_thetas, wrap
from imgloc.io.maps import require_usable
from imgloc.likelihoods.posterior import calibrated, entropy
from imgloc.likelihoods.stacks import stack_of
from imgloc.model import (
    Evidence,
    Float32Array,
    FloatArray,
    Hypothesis,
    LaserScan,
    Likelihood,
    Localization,
    OccupancyGrid,
    Temperature,
)
from imgloc.numbers import number
from imgloc.options import DEFAULTS, FUSED, METHODS, Options, Prior, Shared
from imgloc.search.adapt import adapt
from imgloc.search.background import unmapped_score
from imgloc.search.branch_and_bound import best_poses
from imgloc.search.hypotheses import as_hypotheses, centres, covariances, masses, modes
from imgloc.search.peaks import peaks_of_posterior
from imgloc.search.priors import on_lattice, pyramid_levels, share_of_poses, standing, stands
from imgloc.search.proposals import propose_endpoints, propose_votes
from imgloc.search.refine import refine
from imgloc.search.rescore import Scores, rescore, shortlist
from imgloc.search.trust import judge

MODES = number("pipeline.modes")
"""Poses that are looked for, however few are listed: no verdict depends on the list's length."""
_LAST = number("pipeline.last")  # proposals that get the second look when time is up
# share of the spread of a mode's maxima by which their mean may be off
_MAXIMA = number("pipeline.maxima")
_ROUNDS = number("pipeline.rounds")  # of searches with an error that the readings share
_FIRST_LOOK, _SECOND_LOOK = number("refine.first_look"), number("refine.second_look")
_FROM_CELLS = number("refine.from_cells")


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
        _check_stack(stack, features, scan, options)
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


@dataclass(frozen=True)
class Modes:
    """What the search found, best first: C separated modes of the grid frame; there may be none."""

    poses: FloatArray  #: (C, 3) the mean of the maxima of each, if a sensor can be there
    scores: Scores  #: of the best of them
    readings: Readings  #: those that were scored
    complete: bool = True  #: the search came to its end
    #: (L, 3) those that got the second look, before they had it
    looked: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    #: (C, 3, 3) second moments of the maxima around those poses, if they are known
    spread: FloatArray | None = None
    shared: Shared = field(default_factory=Shared)  #: the error that was allowed for

    @property
    def mean_score(self) -> float:
        """Nats per reading of the best pose; -inf without one."""
        best = self.scores.log_likelihood[:1].sum()
        return float(best) / len(self.readings) if len(self.poses) else float("-inf")


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


def separate(
    features: MapFeatures, poses: FloatArray, scores: Scores, n: int, options: Options
) -> tuple[FloatArray, Scores, FloatArray]:
    """Modes of refined poses (M, 3) that were scored by `n` readings, best first.

    Their poses (C, 3), each in the mean of its maxima if a sensor can be there, the scores of the
    best of these, and their second moments (C, 3, 3) around the mean.
    """
    fused, score = options.fused, scores.log_likelihood
    distance, angle = fused.separation
    best = modes(poses, score, distance=distance, angle=angle)
    misfit = _misfit(scores, n, options)
    tempered = score / options.trust.temperature_at(misfit, n, features.grid.resolution).value
    mean, spread = centres(poses, tempered, best, within=fused.separation, same=fused.same)
    off = np.where(stands(mean, options.prior, features)[:, None], 0, poses[best] - mean)
    off[:, 2] = wrap(off[:, 2])
    mean, spread = mean + off, spread + off[:, :, None] * off[:, None]
    apart = modes(mean, score[best], distance=distance, angle=angle)  # some have met
    return mean[apart], scores.select(best[apart]), spread[apart]


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


def score_poses(
    features: MapFeatures, readings: Readings, poses: FloatArray, options: Options
) -> Scores:
    """Scores of poses (C, 3), or with a scale (C, 4), grid frame, by some readings of a scan."""
    ranges, angles, model = readings.ranges, readings.angles, options.fused.model
    return rescore(poses, ranges, angles, features.field, features.walls, model)


@dataclass(frozen=True)
class Found:
    """M separated poses of the grid frame, best first, and what they are worth."""

    poses: FloatArray  #: (M, 3)
    log_likelihood: FloatArray  #: (M,)
    share: FloatArray  #: (M,) Mass of each if the true pose is one of them
    covariance: FloatArray  #: (L, 3, 3) Of as many as are listed, at least
    misfit: float = float("nan")  #: nats per reading that the best pose lacks
    unmapped: float = float("nan")  #: nats per reading in a building that is on no map
    gained: float = float("nan")  #: nats, tempered, by which the best pose beats that
    explained: float = 0.0  #: share of the valid rays that the best pose explains
    temperature: Temperature = field(default_factory=Temperature)  #: what made shares of nats
    readings: int = 0  #: how many decided about the misfit
    shared: Shared = field(default_factory=Shared)  #: error that was allowed for
    #: share of the best, as far as it says something about the true pose being none of them: votes
    #: are spread where walls are few, too, so that those of a stack say nothing
    lead: float = 0.0
    entropy: float | None = None  #: of a whole posterior, nats
    complete: bool = True  #: the search came to its end


NOTHING = Found(np.empty((0, 3)), np.empty(0), np.empty(0), np.empty((0, 3, 3)))


def weigh(
    features: MapFeatures, found: Modes, options: Options, scan: LaserScan | None = None
) -> Found:
    """What separated, scored poses are worth: shares and covariances; and of a `scan` its rays."""
    if len(found.poses) == 0:
        return replace(NOTHING, complete=found.complete)
    explained = 0.0
    if scan is not None:
        explained = explained_rays(features, scan, found.poses[:1], options, found.shared)
    features = features.thinner(found.shared.thinner)
    xy, score = found.readings.xy, found.scores.log_likelihood
    fit, temperature = _fit(features, found.readings, found.scores, options)
    share = masses(score, temperature.value)
    listed = found.poses[: options.listed(share)]
    covariance = _covariances(features, listed, xy, options, 2 * min(options.fused.model.sigmas))
    if found.spread is not None:
        covariance = covariance + _MAXIMA * found.spread[: len(listed)]
    return Found(
        *(found.poses, score, share, covariance),
        explained=explained,
        temperature=temperature,
        lead=float(share[0]),
        complete=found.complete,
        shared=found.shared,
        **fit,
    )


def find_exact(features: MapFeatures, scan: LaserScan, options: Options) -> Found:
    """The best poses of CBML's stack without the stack.

    Shares are among at least :data:`MODES` of them, each score raised to the calibrated power,
    as if every mode were equally wide.
    """
    poses, score = exact_poses(features, scan, options)
    if len(poses) == 0:
        return NOTHING
    how = options.calibration or DEFAULTS["cbml"]
    temperature = how.temperature_at("cbml", int(scan.valid.sum()))
    xy = one_per_place(scan, options.fused.place).spread(options.fused.rays).xy
    share = masses(np.log(score), temperature)
    listed = poses[: options.listed(share)]
    return Found(
        poses,
        score,
        share,
        _covariances(features, listed, xy, options, features.lattice.resolution),
        temperature=Temperature(temperature),
        **_settled_fit(features, scan, poses[:1], options),
    )


def exact_poses(
    features: MapFeatures, scan: LaserScan, options: Options, deadline: float = np.inf
) -> tuple[FloatArray, FloatArray]:
    """Best separated poses (M, 3) by CBML's score, grid frame, and their scores (M,), exactly.

    After the `deadline`, by :func:`time.monotonic`, only those that are known by then.
    """
    prior, pooled, thetas = options.prior, features.pooled, options.thetas
    wanted = np.flatnonzero(prior.headings(thetas, np.pi / len(thetas)))
    if prior.cells is not None:
        where = on_lattice(prior, features.free, features.factor)
        pooled = replace(pooled, where=block_masks(where, pooled.top))
    (distance, angle), n = options.fused.separation, max(options.top or MODES, MODES)
    xy, some, threads = scan_xy(scan)[scan.valid], thetas[wanted], options.threads
    best = best_poses(
        pooled,
        xy,
        some,
        count=n,
        distance=distance,
        angle=angle,
        threads=threads,
        deadline=deadline,
    )
    xy = centre_of(best.cells[:, 1:], features.lattice.resolution)
    return np.column_stack((xy, thetas[wanted[best.cells[:, 0]]])), best.scores.astype(np.float64)


def find_in_stack(
    features: MapFeatures, scan: LaserScan, stack: Likelihood, options: Options
) -> Found:
    """Modes of the posterior of a full stack: mass and moments of the peaks of each.

    The highest peak comes first, the paper's global maximum; a lower one that is broader may
    hold more mass.
    """
    probability = posterior_of(features, scan, stack, options)
    n = 4 * max(options.top or MODES, MODES)  # some are neighbours on the slope of one mode
    cell, apart = stack.grid.resolution, options.fused.separation
    poses, share, covariance, peaks = peaks_of_posterior(
        probability, stack.thetas, cell, n=n, separation=apart
    )
    if len(poses) == 0:
        return NOTHING
    how = options.calibration or DEFAULTS[stack.method]
    temperature = how.temperature_at(stack.method, int(scan.valid.sum()))
    uniform = 1 / (len(stack.thetas) * np.count_nonzero(features.free))
    with np.errstate(divide="ignore"):
        score = np.log(probability[tuple(peaks.T)].astype(np.float64) / uniform)
    return Found(
        *(poses, score, share, covariance),
        temperature=Temperature(temperature),
        entropy=entropy(probability),
        **_settled_fit(features, scan, poses[:1], options),
    )


def explained_rays(
    features: MapFeatures, scan: LaserScan, pose: FloatArray, options: Options, shared: Shared
) -> float:
    """Share of the valid rays, 0..1, that end on a surface of the map and pass through no wall.

    From a `pose` (1, 3), grid frame. The score asks squares, of which each counts once; this is of
    the rays as they were recorded: half of them on the robot itself are half.
    """
    scan, there = scan.scaled(shared.scale), features.thinner(shared.thinner)
    rays = Readings(scan.ranges[scan.valid], scan.angles[scan.valid])
    return float(score_poses(there, rays, pose, options).explained[0])


def settle(
    features: MapFeatures, scan: LaserScan, poses: FloatArray, options: Options
) -> tuple[FloatArray, Readings, Scores]:
    """Poses after they have settled, and their scores: trust is about the place, not the cell."""
    readings = one_per_place(scan, options.fused.place).spread(options.fused.rays)
    poses = refine(poses, readings.xy, features.field, sigmas=_FROM_CELLS)
    return poses, readings, score_poses(features, readings, poses, options)


def _settled_fit(
    features: MapFeatures, scan: LaserScan, best: FloatArray, options: Options
) -> dict[str, Any]:
    """What :func:`_fit` says of a stack's best pose (1, 3)."""
    pose, readings, scores = settle(features, scan, best, options)
    explained = explained_rays(features, scan, pose, options, Shared())
    return _fit(features, readings, scores, options)[0] | {"explained": explained}


def _fit(
    features: MapFeatures, readings: Readings, scores: Scores, options: Options
) -> tuple[dict[str, Any], Temperature]:
    """How well the best pose fits, as :class:`Found` has it, and the temperature of its score."""
    n, model = len(readings), options.fused.model
    misfit = _misfit(scores, n, options)
    temperature = options.trust.temperature_at(misfit, n, features.grid.resolution)
    share = share_of_poses(options.prior, features)
    unmapped = unmapped_score(readings.xy, model, share, temperature.value / n)
    said = {
        "misfit": misfit,
        "unmapped": unmapped,
        "gained": (model.best - misfit - unmapped) * n / temperature.value,
        "readings": n,
    }
    return said, temperature


def _misfit(scores: Scores, n: int, options: Options) -> float:
    """Nats per reading, of `n`, that the best of some scores lacks."""
    return options.fused.model.best - float(scores.log_likelihood.max(initial=-np.inf)) / n


def _covariances(
    features: MapFeatures, poses: FloatArray, xy: FloatArray, options: Options, sigma: float
) -> FloatArray:
    """Covariances of the poses that are listed."""
    field, trust, extent = features.field, options.trust, options.fused.separation
    return covariances(poses, xy, field, sigma=sigma, correlated=trust.correlated, extent=extent)


def _log_volumes(hypotheses: tuple[Hypothesis, ...], features: MapFeatures) -> FloatArray:
    """Logarithm of the volume of each mode as a share of that of all poses."""
    space = np.count_nonzero(features.free) * features.lattice.resolution**2 * 2 * np.pi
    # An integral of a density that is no narrower than the score is sharp: the search's own
    # rounding and a mode that is its own best pose cost as much in every map.
    volumes = [0.5 * np.linalg.slogdet(2 * np.pi * h.covariance)[1] for h in hypotheses]
    return np.asarray(np.array(volumes) - np.log(space))


def likelihood(features: MapFeatures, scan: LaserScan, options: Options | str) -> Likelihood:
    """Compute the full stack of one of the paper's methods.

    Parameters
    ----------
    features : MapFeatures
        On whose lattice of poses, in the grid frame, the stack is.
    scan : LaserScan
    options : Options or str
        Or the name of the method alone.

    Raises
    ------
    ConfigError
        If the method is unknown, or the stack is larger than the memory budget.

    Examples
    --------
    >>> walls = np.pad(np.zeros((8, 9), bool), 1, constant_values=True)
    >>> scan = LaserScan([0.4, 0.5], [0.0, 1.0], range_max=9.0)
    >>> likelihood(prepare(OccupancyGrid(walls, ~walls, 0.1)), scan, "cbml").values.shape
    (120, 10, 11)
    """
    if isinstance(options, str):
        options = Options(options)
    expect(features, MapFeatures, "features")
    check_method(options.method, tuple(METHODS))
    thetas, lattice = options.thetas, features.lattice
    method, threads, budget = options.method, options.threads, options.memory_budget
    n, shape = len(thetas), lattice.shape
    need = stack_bytes(method, shape, n, threads=threads, n_rays=features.n_rays)
    what = f"{method} on {n} headings x {shape[0]} x {shape[1]} cells"
    check_budget(need, budget, what, "use larger cells, a larger theta step, or the method 'fused'")
    engine = options.engine
    values = stack_of(
        method, features, scan, thetas, engine=engine, threads=threads, memory_budget=budget
    )
    return Likelihood(values, thetas, lattice, method, scan)


def _check_stack(
    stack: Likelihood, features: MapFeatures, scan: LaserScan, options: Options
) -> None:
    """Refuse a stack of something else than what is asked."""
    if stack.method != options.method:
        raise ConfigError(f"stack: got one of {stack.method}, expected one of {options.method}")
    of, here = ((*g.shape, g.resolution) for g in (stack.grid, features.lattice))
    if of != here:
        raise ConfigError(f"stack: got rows, columns, cell {of}, expected {here}: of another map?")
    other = stack.scan
    if other is not None and not (
        np.array_equal(other.ranges, scan.ranges, equal_nan=True)
        and np.array_equal(other.angles, scan.angles)
        and (other.range_min, other.range_max) == (scan.range_min, scan.range_max)
    ):
        raise ConfigError(f"stack: got one of another scan, {other!r}, expected {scan!r}")


def posterior_of(
    features: MapFeatures, scan: LaserScan, stack: Likelihood, options: Options
) -> Float32Array:
    """The calibrated posterior (K, H, W) of a stack over the poses of the prior."""
    where = on_lattice(options.prior, features.free, features.factor)
    headings = options.prior.headings(stack.thetas, np.pi / len(stack.thetas))
    return calibrated(stack, where, int(scan.valid.sum()), options.calibration, headings=headings)


def check_method(name: str, known: Sequence[str]) -> None:
    """Refuse a method that does not exist, by a ConfigError that names those that do."""
    if name not in known:
        raise ConfigError(f"method must be one of {', '.join(known)}, got {name!r}")


def check_options(features: MapFeatures, options: Options) -> None:
    """Refuse what :func:`localize` cannot do, by its errors, before anything is done."""
    expect(features, MapFeatures, "features")
    expect(options, Options, "options")
    if options.exact and options.method not in (FUSED, "cbml"):
        raise ConfigError(f"the exact search is of cbml's score, not of {options.method}'s")
    if options.time_budget is not None and options.method != FUSED:
        raise ConfigError(f"a time budget is for the method {FUSED}, not for {options.method}")
    prior = options.prior.cells
    if prior is not None and not (prior & features.standable).any():
        raise ConfigError("the prior leaves no cell of the map in which a sensor can be")
    if options.exact or options.method == FUSED:
        (height, width), cell = features.lattice.shape, features.lattice.resolution
        what = f"{options.method} on {height} x {width} cells of {cell:g} m"
        need = answer_bytes(features, options)
        check_budget(need, options.memory_budget, what, "use larger cells")


def answer_bytes(features: MapFeatures, options: Options) -> int:
    """How many bytes :func:`localize` takes at most, besides the map's features."""
    shape, cell = features.lattice.shape, features.lattice.resolution
    exact = exact_bytes(shape, cell, len(options.thetas)) if options.exact else 0
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
        options.method, shape, len(options.thetas), threads=options.threads, n_rays=features.n_rays
    )


def effective(options: Options, features: MapFeatures) -> dict[str, object]:
    """The parameters that decided an answer, as plain values. Threads do not."""
    out = asdict(replace(options, prior=Prior(), theta_step=options.step))
    out["prior"] = dict(options.prior.about)
    hidden = {"threads", "memory_budget"}
    if options.time_budget is None:
        hidden.add("time_budget")
    if options.method != FUSED:
        out["calibration"] = asdict(options.calibration or DEFAULTS[options.method])
        hidden.add("shared")  # votes know nothing of it
    else:
        hidden |= {"engine", "calibration"}
        if not options.exact:  # they are the headings of branch and bound
            hidden.add("theta_step")
    unsaid = ("grid", "memory_budget", "threads")
    about_map = {
        f.name: getattr(features, f.name) for f in fields(features) if f.name not in unsaid
    }
    out = {key: value for key, value in out.items() if key not in hidden}
    return out | {"map": about_map, "seed": None}
