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
from collections.abc import Generator, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from imgloc.errors import expect
from imgloc.features.floor import floors, left_out
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings, one_per_place
from imgloc.io.maps import require_usable
from imgloc.likelihoods.stacks import Stack, held_stack, likelihood
from imgloc.model import FloatArray, Floor, LaserScan, Likelihood, Localization, OccupancyGrid
from imgloc.numbers import number
from imgloc.options import FUSED, Options, Shared
from imgloc.search.adapt import THINNER, adapt, as_seen, drawn_gain, drawn_walls
from imgloc.search.answer import answered
from imgloc.search.asked import check_options
from imgloc.search.modes import Modes, lead, rivals, separate
from imgloc.search.priors import pyramid_levels, refined
from imgloc.search.proposals import propose_endpoints
from imgloc.search.refine import FIRST_LOOK, SECOND_LOOK
from imgloc.search.rescore import score_poses, shortlist
from imgloc.search.stacked import weigh_stack
from imgloc.search.weigh import MODES, nothing, weigh

_ROUNDS = number("pipeline.rounds")  # searches again with an error that the readings share


def prepare(
    grid: OccupancyGrid, name: str = "map", *, ready: bool = True, **parameters: Any
) -> MapFeatures:
    """Check a map, and make of it what the search needs.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    name : str
        Name of the map in error messages.
    ready : bool
        Compute now what an answer of the default method may use, so that the first answer takes
        little longer than others; on large maps the first one that wants thinner walls takes 0.1 to
        0.4 s longer. Without it each feature is computed when it is first used.
    **parameters
        Parameters of :class:`~imgloc.features.mapfeatures.MapFeatures`.

    Returns
    -------
    MapFeatures
        Features of the map. Those of other methods are computed when they are first used.

    Raises
    ------
    MapError
        If the map has no walls or no free cells.
    TypeError
        If `grid` is no OccupancyGrid, but for example a path. :func:`imgloc.load_map` reads a path.
    """
    expect(grid, OccupancyGrid, "grid")
    require_usable(grid, name)
    features = MapFeatures(grid, **parameters)
    return features.ready(THINNER) if ready else features


def localize(
    features: MapFeatures,
    scan: LaserScan,
    options: Options | None = None,
    *,
    stack: Likelihood | Stack | None = None,
) -> Localization:
    """Find every pose that fits a scan, with the probability of each and a verdict.

    Parameters
    ----------
    features : MapFeatures
        The map, from :func:`prepare`.
    scan : LaserScan
        The scan, in the sensor frame.
    options : Options, optional
        Method, prior and limits of the search. By default the whole map is searched.
    stack : Likelihood or Stack, optional
        Stack of this method, map and scan from :func:`likelihood`, to save computing it again; or
        one of your own, or what makes it: see :class:`~imgloc.likelihoods.stacks.Stack`.

    Returns
    -------
    Localization
        Poses of the sensor in the map frame: metres, metres, radians. A scan with readings in too
        few directions raises no error: its verdict is ``invalid``. A search that ran out of time
        is never ``unique``.

    Raises
    ------
    ConfigError
        If an option is out of its range or the memory budget is too small. If no pose of the prior
        can hold a sensor. If `stack` belongs to another method, map or scan.
    TypeError
        If an argument has a wrong type.
    """
    options = Options() if options is None else options
    check_options(features, options)
    expect(scan, LaserScan, "scan")
    return _located(features, scan, options, held_stack(stack, features, scan, options))


def localize_many(
    features: MapFeatures, scans: Iterable[LaserScan], options: Options | None = None
) -> Iterator[Localization]:
    """Answer scans of one map, each exactly as :func:`localize` does.

    Parameters
    ----------
    features, options
        As for :func:`localize`. They are checked once, before the first answer is asked for.
    scans : iterable of LaserScan
        The scans. One is taken when its answer is asked for.

    Returns
    -------
    iterator of Localization
        One answer for each scan, in their order.

    Raises
    ------
    ConfigError, TypeError
        As :func:`localize` does.

    Examples
    --------
    >>> from imgloc.io.maps import bundled_maps, load_map
    >>> from imgloc.simulation.scans import simulate
    >>> features = prepare(load_map(bundled_maps() / "curved.yaml"))
    >>> scans = simulate(features.grid, 2, seed=1)
    >>> [answer.verdict for answer in localize_many(features, scans.scans)]
    ['unique', 'unique']
    """
    how = Options() if options is None else options
    check_options(features, how)
    return (_located(features, scan, how) for scan in scans)


def _located(
    features: MapFeatures, scan: LaserScan, options: Options, stack: Likelihood | None = None
) -> Localization:
    """Answer a scan by options that have been checked."""
    expect(scan, LaserScan, "scan")
    start = time.perf_counter()
    if scan.directions < max(1, options.trust.readings):
        weighed = nothing(options)
    elif options.method == FUSED and stack is None:
        found = find_adapted_modes(features, scan, options)
        weighed = weigh(features, found, options, scan)
    else:
        stack = likelihood(features, scan, options) if stack is None else stack
        weighed = weigh_stack(features, scan, stack, options)
    return answered(features, scan, weighed, options, 1e3 * (time.perf_counter() - start))


def find_modes(
    features: MapFeatures, scan: LaserScan, options: Options, *,
    more: FloatArray | None = None, alone: bool = False,
) -> Modes:  # fmt: skip
    """Search a map for all poses that fit a scan, by the default method.

    Endpoint correlation proposes poses. If none of them fits, it proposes others with parts of the
    scan, because a cart or a crowd may hold most of the readings. Another score decides. Most
    proposals are dropped after a look with few readings. When the time budget of the `options` is
    spent, only the best poses so far are followed.

    Parameters
    ----------
    features : MapFeatures
        The map.
    scan : LaserScan
        The scan, with at least one valid reading.
    options : Options
        Prior, limits and time budget of the search.
    more : (M, 3) float array, optional
        Proposals in place of those of parts, grid frame: metres, metres, radians.
    alone : bool
        These propose alone, without the whole scan.

    Returns
    -------
    Modes
        Separated modes in the grid frame, best first; perhaps none.
    """
    steps = find_modes_by_steps(features, scan, options, more=more, alone=alone)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]


def find_modes_by_steps(
    features: MapFeatures, scan: LaserScan, options: Options, *,
    more: FloatArray | None = None, alone: bool = False,
) -> Generator[None, None, Modes]:  # fmt: skip
    """Search as :func:`find_modes` does, and pause after each step; return the modes."""
    fused = options.fused
    end = time.monotonic() + (np.inf if options.time_budget is None else options.time_budget)

    # Thin the readings to one for each place. Take few for a first look, more for a second.
    seen = one_per_place(scan, fused.place)
    few, many = seen.spread(fused.few_rays), seen.spread(fused.rays)

    # Propose poses whose endpoints fall on walls, and pick those that are worth more readings.
    proposals = np.empty((0, 3)) if alone else propose(features, few, options, end)
    proposals = proposals if more is None else np.concatenate((proposals, more))
    yield
    looked, score = look(features, proposals, few, options)
    yield

    # If none of them fits, and none leads by as much, a thing may hold half of the readings: others
    # propose without it. Where things are drawn they may fit at a wrong place.
    lacks = options.model.best * len(few) - float(score.max(initial=-np.inf))
    by = lead(looked, score, options)
    unfit = lacks > fused.unfit * len(few) and by < fused.led * lacks
    if (unfit or features.furnished is not None) and more is None:
        others = [np.empty((0, 3))]
        for part in seen.parts():
            if time.monotonic() < end:
                others.append(propose(features, part.spread(fused.few_rays), options, end))
                yield
        looked, _ = look(features, np.concatenate(others), few, options, before=looked)
        yield
    late = time.monotonic() >= end
    looked = looked[:MODES] if late else looked

    # Refine the best with more readings, in free space; score them, and separate the modes.
    poses = refined(looked, many.xy, features, SECOND_LOOK, options.prior)
    scores = score_poses(features, many, poses, options.model)
    poses, scores, spread = separate(features, poses, scores, len(many), options)
    return Modes(poses, scores, many, not late, looked, by >= fused.led * lacks, spread)


def propose(features: MapFeatures, few: Readings, options: Options, end: float) -> FloatArray:
    """Propose poses by endpoint correlation, with and without what is movable.

    The result (M, 3) is in the grid frame: metres, metres, radians. Only the best poses are
    returned if the time is past `end`, seconds by :func:`time.monotonic`.
    """
    fused, prior = options.fused, options.prior
    found = []
    for there in features.both:
        levels = pyramid_levels(prior, there.pyramid, there.grid.resolution)
        poses, _ = propose_endpoints(
            levels, few.xy, theta_step=fused.theta_step, keep=fused.keep[: len(levels)],
            skip=fused.skip, worse=fused.worse, prior=prior, threads=options.threads,
        )  # fmt: skip
        found.append(poses[: fused.second_look] if time.monotonic() >= end else poses)
    return np.concatenate(found)


def look(
    features: MapFeatures,
    proposals: FloatArray,
    few: Readings,
    options: Options,
    before: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Refine proposals (M, 3) with few readings; the best of them and of `before`, (B, 3).

    These are poses (L, 3) in the grid frame and their scores (L,) in nats, best first.
    """
    poses = refined(proposals, few.xy, features, FIRST_LOOK, options.prior)
    poses = poses if before is None else np.concatenate((before, poses))
    return shortlist(poses, few, features, options)


def find_adapted_modes(features: MapFeatures, scan: LaserScan, options: Options) -> Modes:
    """Search for all poses that fit a scan, and allow for errors that many readings share.

    If nothing fits well on a map that others drew, walls are taken for bent. Else it is tried
    without readings that may end on the floor, and with another scale or thinner walls.

    Arguments and result are those of :func:`find_modes`, with what was found; `features` are of the
    uncorrected map. The time budget covers all searches together.
    """
    fused, start = options.fused, time.monotonic()

    def find(shared: Shared, floor: Floor | None = None, **how: Any) -> Modes:
        there, seen = as_seen(features, left_out(scan, floor), shared)
        left = options.left(time.monotonic() - start, shared=shared)
        return replace(find_modes(there, seen, left, **how), shared=shared, floor=floor)

    def again(*how: Any, **more: Any) -> Modes:
        if not (repeated := find(*how, **more)).complete:
            raise TimeoutError
        return repeated

    def lacks(found: Modes) -> float:
        return options.model.best - options.shared.usual - found.mean_score

    # With furniture that may be gone any scale would fit somewhere.
    adapts = features.furnished is None and fused.strained < np.inf
    # Where walls may be bent, parts of the scan propose once it is known whether they are.
    drawn = adapts and drawn_walls(features, np.inf, options.shared) != options.shared
    found = find(options.shared, more=np.empty((0, 3)) if drawn else None)
    if not (adapts and found.complete and len(found.poses)):
        return found
    try:
        if drawn and lacks(found) > fused.strained:
            gain = drawn_gain(features, found.readings, found.places, options)
            options = replace(options, shared=drawn_walls(features, gain, options.shared))
            found = again(options.shared)
        whole = found
        for floor in floors(scan) if lacks(found) > fused.strained else ():
            if left_out(scan, floor).directions >= options.trust.readings:
                without = again(options.shared, floor, more=np.empty((0, 3)))
                if lacks(without) <= min(fused.strained, lacks(found)) and rivals(
                    without, whole, features, options
                ):
                    found = without
        for _ in range(_ROUNDS):
            if lacks(found) <= fused.strained or not len(found.poses):
                break
            places = found.starts(*fused.separation)
            shared = adapt(features, found.readings, places, found.shared, options)
            if shared == found.shared:
                break
            adapted = again(shared, found.floor, more=found.places, alone=found.leads)
            if adapted.mean_score <= found.mean_score:
                break
            found = adapted
        return found
    except TimeoutError:
        return replace(found, complete=False)
