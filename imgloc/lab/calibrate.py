"""Calibration of a stack: the smoothing and temperature with the greatest S, eq. 12.

Each trial's stack is computed once and blurred once for each pair of sigmas. A histogram of its
logarithms then gives the index of every temperature. Only one trial's stack is kept at a time.

Scans are simulated in the map itself, where every wall is in its place. A real map has errors, and
a real place has people. Two thirds of the scans are therefore disturbed, so that the fit does not
trust a scan more than it deserves there.

The map's own errors are not simulated. They are fitted from recorded scans, whose poses need not be
known: together these scans determine the map's scale and by how much its walls are too thick.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings, evenly, one_per_place
from imgloc.filters.choose import make_filter
from imgloc.filters.evidence import misfit_near, view_of
from imgloc.filters.follow import UNCONFIRMED, follow
from imgloc.filters.motion import increments
from imgloc.geometry import in_grid_frame, inside
from imgloc.io.scanset import ScanSet
from imgloc.lab.evaluation import cell_of_pose
from imgloc.lab.performance_index import Index, index_of, with_floor
from imgloc.likelihoods.posterior import smoothed
from imgloc.likelihoods.stacks import likelihood
from imgloc.model import (
    Float32Array,
    FloatArray,
    LaserScan,
    Likelihood,
    OccupancyGrid,
    Pose2D,
)
from imgloc.options import LOG_METHODS, Calibration, Options, Sensor, Shared, scale
from imgloc.pipeline import find_modes, localize
from imgloc.search.adapt import GAIN, THINNER, Told, as_seen, image_gain, judged, told_by
from imgloc.search.faces import any_depth, on_faces
from imgloc.search.refine import FROM_CELLS, refine
from imgloc.simulation.scans import simulate

SIGMAS_XY = (0.0, 0.1, 0.2)  #: metres tried
SIGMAS_THETA = tuple(float(np.deg2rad(deg)) for deg in (0.0, 5.0, 10.0, 15.0))  #: radians tried
EXPONENTS = np.geomspace(0.25, 256.0, 61)  #: 1 / temperature tried, in steps of an eighth
LEAST = 20
"""Fewest trials, on all maps together, for a fit: a few lucky scans would promise too much."""
SCANS = 20  #: largest number of scans from which a shared error is fitted
LEAST_FIT = 5  #: number of these scans that must fit the map at one place
STARTS = (1.0, 0.9, 1.1)  #: factors where the search for a scale begins
_ROUNDS = 4  # how often scans speak for another error
_BINS = 8192
_JUMP = 2.0  # metres that odometry jumps between two scans of different runs
_SURE = 0.05  # share of the scans along a way that must have a unique pose
_WALLS = 0.1  # standard deviation of a wall's displacement, metres
_SHARED = 10.0  # neighbouring readings with nearly the same displacement


@dataclass(frozen=True, eq=False)
class Sweep:
    """Logarithms of the relative densities at the true poses, with the floor mixed in, nats."""

    method: str
    configurations: tuple[tuple[float, float], ...]  #: sigma_xy [m] and sigma_theta [rad]
    logs: FloatArray  #: (n, C, E) by trial, configuration and exponent
    bare: FloatArray  #: (n,) by trial, for the stacks without calibration, as in the paper


@dataclass(frozen=True)
class CalibrationFit:
    """A calibration, with its index on the scans that it was fitted to, and the bare stack's."""

    calibration: Calibration
    index: Index
    bare: Index


def disturbed_set(
    grid: OccupancyGrid, n: int, seed: int, sensor: Sensor, fine: OccupancyGrid | None = None
) -> ScanSet:
    """Simulate scans: one third as the sensor measures, and two thirds disturbed.

    In the second scan of each three, something unmapped stops 50 % of the rays. In the third one,
    something unmapped stops 10 % of the rays, 10 % are dropped, and the walls are displaced by an
    error of 10 cm that neighbouring readings share.

    The arguments are those of :func:`imgloc.simulation.scans.simulate`.
    """
    crowd = replace(sensor, outliers=max(0.5, sensor.outliers))
    worn = replace(sensor, outliers=max(0.1, sensor.outliers), dropped=max(0.1, sensor.dropped))
    sets = [simulate(grid, n, seed, kind, fine) for kind in (sensor, crowd, worn)]
    rng = np.random.default_rng(seed)
    thirds = (sets[0].scans, sets[1].scans, [_displaced(scan, rng) for scan in sets[2].scans])
    scans = tuple(thirds[k % 3][k] for k in range(n))
    return ScanSet(scans, poses=sets[0].poses)  # the same ones in all


def _displaced(scan: LaserScan, rng: np.random.Generator) -> LaserScan:
    """The scan of a place whose walls differ from the map's by an error that varies slowly."""
    noise = rng.standard_normal((1, len(scan.ranges)))
    error = cv2.GaussianBlur(noise, (0, 0), _SHARED, borderType=cv2.BORDER_REFLECT)[0]
    error *= _WALLS * np.sqrt(2 * np.sqrt(np.pi) * _SHARED)  # what the blur has taken
    return replace(scan, ranges=np.maximum(scan.ranges + error, 1e-3))


def sweep(
    features: MapFeatures, scans: ScanSet, options: Options, *,
    advance: Callable[[], None] = lambda: None,
) -> Sweep:  # fmt: skip
    """Measure every smoothing and temperature on scans whose poses are known.

    The method is one of the paper's. For ``beam`` only the temperature is measured, because it has
    a sigma of its own for the cells. The arguments and errors are those of
    :func:`imgloc.lab.evaluation.evaluate`.
    """
    log = options.method in LOG_METHODS
    configurations = (
        ((0.0, 0.0),) if log else tuple((xy, th) for xy in SIGMAS_XY for th in SIGMAS_THETA)
    )
    logs, bare = np.empty((len(scans), len(configurations), len(EXPONENTS))), np.empty(len(scans))
    for i, (scan, pose) in enumerate(scans.with_poses()):
        stack = likelihood(features, scan, options)
        powers = EXPONENTS / scale(options.method, int(scan.valid.sum()))
        at = cell_of_pose(features, Pose2D(*pose), len(stack.thetas))
        for c, (sigma_xy, sigma_theta) in enumerate(configurations):
            image = replace(stack, values=smoothed(stack, Calibration(sigma_xy, sigma_theta)))
            logs[i, c] = densities(image, at, features, powers)
        bare[i] = densities(stack, at, features, np.ones(1))[0]
        advance()
    return Sweep(options.method, configurations, with_floor(logs), with_floor(bare))


def densities(
    stack: Likelihood, at: tuple[int, int, int], features: MapFeatures, powers: FloatArray
) -> FloatArray:
    """Relative densities (E,) of the pose cell `at` among free cells, for each power of a stack.

    They come from a histogram of ``log max L - log L``, with finer bins near the maximum.
    """
    log = stack.method in LOG_METHODS
    images = stack.values.reshape(len(stack.thetas), -1)
    free = np.flatnonzero(features.free)
    top = max(float(image[free].max(initial=-np.inf)) for image in images)
    if not log and top <= 0:
        return np.ones(len(powers))  # it says nothing
    if not (bool(inside(np.array(at[1:]), stack.grid)) and features.free[at[1:]]):
        return np.zeros(len(powers))

    def below(values: Float32Array) -> FloatArray:
        if log:
            return np.asarray(top - values, dtype=np.float64)
        return np.asarray(-np.log(values[values > 0] / np.float64(top)))

    # Values more than 40 nats below the maximum, at the flattest power, do not count.
    farthest = 40.0 / float(powers[0])
    width = np.sqrt(farthest) / (_BINS - 1)
    counts, sums = np.zeros(_BINS), np.zeros(_BINS)
    for image in images:
        depth = np.minimum(below(image[free]), farthest)
        bins = (np.sqrt(depth) / width).astype(np.int64)
        counts += np.bincount(bins, minlength=_BINS)
        sums += np.bincount(bins, weights=depth, minlength=_BINS)
    here = below(stack.values[at].reshape(1))
    if not len(here):
        return np.zeros(len(powers))
    poses = len(images) * len(free)
    some = counts > 0
    mean = sums[some] / counts[some]
    totals = np.exp(-powers[:, None] * mean) @ counts[some]
    return np.asarray(np.exp(-powers * here) * (poses / totals))


def check_trials(count: int) -> None:
    """Raise a ConfigError if there are fewer trials than :data:`LEAST`."""
    if count < LEAST:
        raise ConfigError(
            f"got {count} in all, expected at least {LEAST} scans to fit to: fewer make a method "
            "too sure of itself"
        )


def fit(sweeps: Sequence[Sweep]) -> CalibrationFit:
    """Choose the smoothing and temperature with the greatest S over all trials of all maps.

    Among the temperatures whose S is within one standard error of the greatest, the highest is
    taken. A real map agrees less with its scans than a simulated one, and a posterior that claims
    too much misleads. `sweeps` has one sweep of the method for each map, and all maps count alike.
    Fewer than :data:`LEAST` trials raise a ConfigError.
    """
    check_trials(sum(len(s.bare) for s in sweeps))
    mean = np.mean([s.logs.mean(axis=0) for s in sweeps], axis=0)
    c, e = np.unravel_index(int(mean.argmax()), mean.shape)
    sigma_xy, sigma_theta = sweeps[0].configurations[c]
    logs = np.concatenate([s.logs for s in sweeps])
    error = index_of(logs[:, c, e]).standard_error
    hottest = int(np.argmax(mean[c] >= mean[c, e] - error))
    calibration = Calibration(sigma_xy, sigma_theta, float(1 / EXPONENTS[hottest]))
    bare = index_of(np.concatenate([s.bare for s in sweeps]))
    return CalibrationFit(calibration, index_of(logs[:, c, hottest]), bare)


@dataclass(frozen=True)
class SharedFit:
    """An error that the scans of a sensor share on a map."""

    shared: Shared
    deviation: float | None  #: standard error of its scale; None if that was not fitted
    deviation_depth: float | None  #: standard error of its depth, metres; None as above
    used: int  #: scans that fit the map at one place, by themselves or along the way
    asked: int
    metres: float = 0.0  #: way along which odometry joined the scans; 0 if each was located alone


def fit_shared(
    features: MapFeatures, scans: Sequence[LaserScan], options: Options | None = None, *,
    advance: Callable[[], None] = lambda: None,
) -> SharedFit:  # fmt: skip
    """Fit the scale of a map, by how much its walls are too thick, and their depth, from scans.

    The poses of the scans need not be known (hard EM). Some evenly picked scans are each placed
    where they fit best, at one scale of 0.9, 1 or 1.1 for all. From there they speak together for
    another scale or thinner walls (:func:`~imgloc.search.adapt.judged`), and are placed again,
    until nothing gains any more. The median of the scales that remain corrects the result, and
    their scatter gives its standard error. The depth of the faces is fitted last:
    :func:`fit_depth`.

    Parameters
    ----------
    features : MapFeatures
        The map.
    scans : sequence of LaserScan
        Scans of one sensor. At most :data:`SCANS` of them are used.
    options : Options, optional
        Options of the method ``fused``.
    advance : callable
        Called after each scan, for each of :data:`STARTS`.

    Raises
    ------
    ConfigError
        If fewer than :data:`LEAST_FIT` of the scans fit the map at one place.
    """
    options = options or Options()
    some = [scans[k] for k in evenly(len(scans), SCANS)]

    def settled(shared: Shared) -> tuple[float, Shared]:
        told = _told(features, some, options, shared)
        for _ in range(_ROUNDS):
            if not told or (better := judged(told, shared, gain=GAIN / len(told))) == shared:
                break
            told, shared = _told(features, some, options, better), better
        return _gained(told), replace(shared, straight=False)

    starts = [Shared(start, straight=True) for start in STARTS]
    begin = starts[nearest([_told(features, some, options, one, advance) for one in starts])]
    gained, shared = settled(begin)
    # Ranges that are too short hide that walls are too thick: from thin walls both are found.
    more, other = settled(replace(begin, thinner=THINNER))
    shared = other if more > gained + GAIN / len(some) else shared
    for _ in range(2):
        steps = np.array(
            [
                refine(np.append(at, [[1]], axis=1), seen.xy, there.field, sigmas=FROM_CELLS)[0, 3]
                for there, seen, at in _placed(features, some, replace(options, shared=shared))
            ]
        )
        _enough(len(steps), len(some))
        middle, error = _middle(steps)
        shared = replace(shared, scale=shared.scale * middle)
    # Walls are drawn in cells: half a cell at the usual distance is an error of the scale, too.
    far = np.median(np.concatenate([scan.ranges[scan.valid] for scan in some]))
    error = float(np.hypot(error, features.grid.resolution / 2 / far))
    depth, uncertain = fit_depth(features, some, replace(options, shared=shared))
    shared = replace(shared, depth=depth)
    return SharedFit(shared, error, uncertain, len(steps), len(some))


def fit_along(
    features: MapFeatures, logs: Sequence[ScanSet], options: Options | None = None, *,
    advance: Callable[[], None] = lambda: None,
) -> SharedFit:  # fmt: skip
    """Fit the walls of a map that others drew from scans that odometry joins.

    No scan needs to fit the map by itself. Evenly picked scans show together whether the walls are
    too thick, or bent: :func:`~imgloc.search.adapt.judged`. The tracker then follows the robot
    with these walls from anywhere. The misfit that is usual here is the median over the scans whose
    poses are ``unique`` along the way.

    `logs` have scans in the order of time, with odometry. The other parameters are those of
    :func:`fit_shared`.

    Raises
    ------
    ConfigError
        If the scans speak for the walls as drawn, or too few of them have a pose that is sure.
    """
    options = options or Options()
    joined = [piece for log in logs if log.odom is not None for piece in _joined(log)]
    scans = [scan for piece in joined for scan in piece.scans]
    walls = _walls(features, [scans[k] for k in evenly(len(scans), SCANS)], options)
    if not scans or not walls.bent:
        _enough(0, len(scans))
    known, metres = replace(options, shared=walls), 0.0
    misfits = list[float]()
    for piece in joined:
        robot, before = make_filter("tracker", features, known), 0.0
        for moment in follow(features, piece, robot):
            # Whether it is this building is not asked: whoever calibrates a map says so.
            if moment.pose is not None or moment.withheld == UNCONFIRMED:
                there, scan = as_seen(features, piece.scans[moment.index], walls)
                view = view_of(scan, known)
                misfits.append(misfit_near(there, view, moment.belief.poses[:1], known))
            metres, before = metres + moment.metres - before, moment.metres
            advance()
    if len(misfits) < max(LEAST_FIT, _SURE * len(scans)):
        _enough(0, len(scans))
    shared = replace(walls, usual=float(np.median(misfits)))
    return SharedFit(shared, None, None, len(misfits), len(scans), metres)


def _joined(log: ScanSet) -> list[ScanSet]:
    """The parts of a log within which odometry does not jump, as it does from run to run."""
    known = log.with_odometry("log")[0]
    steps = [] if known.odom is None else np.hypot(*increments(known.odom)[:, :2].T)
    ends = np.flatnonzero(np.asarray(steps) > _JUMP) + 1
    return [known.take(part.tolist()) for part in np.split(np.arange(len(known)), ends)]


def _walls(features: MapFeatures, scans: Sequence[LaserScan], options: Options) -> Shared:
    """The walls that some scans speak for together, wherever each of them fits best."""
    evidence = _told(features, scans, options, Shared())
    return judged(evidence, Shared(), image=image_gain(features)) if evidence else Shared()


def _told(
    features: MapFeatures, scans: Sequence[LaserScan], options: Options, now: Shared,
    advance: Callable[[], None] = lambda: None,
) -> list[Told]:  # fmt: skip
    """Evidence of scans for another error than `now`, wherever each of them fits best."""
    evidence, options = list[Told](), replace(options, shared=now)
    for scan in scans:
        there, seen = as_seen(features, scan, now)
        if seen.directions >= max(1, options.trust.readings):
            found = find_modes(there, seen, options)
            places = np.concatenate((found.poses, found.looked))
            if len(places):
                evidence.append(told_by(features, found.readings, places, now, options))
        advance()
    return evidence


def nearest(evidence: Sequence[Sequence[Told]]) -> int:
    """Index of the start to begin at: that where scans fit best, if the others promise no more.

    The others promise as much with another scale, but their scans are farther from it.

    Examples
    --------
    >>> far, near = ([Told(np.full((2, 2), fit), scaled=127.0)] for fit in (112.0, 126.0))
    >>> nearest([far, near]), nearest([near, [Told(far[0].walls, scaled=140.0)]])
    (1, 1)
    """
    gains, fits = np.array([(_gained(told), _fits(told)) for told in evidence]).T
    return int(np.where(gains >= gains.max() - GAIN, fits, -np.inf).argmax())


def _fits(told: Sequence[Told]) -> float:
    """Nats per scan with the best thickness of straight walls; -inf without scans."""
    return float(np.mean([one.walls[:, 0] for one in told], axis=0).max()) if told else -np.inf


def _gained(told: Sequence[Told]) -> float:
    """Nats per scan with the best scale or thickness of straight walls; -inf without scans."""
    return max(_fits(told), float(np.mean([one.scaled for one in told]))) if told else -np.inf


def fit_depth(
    features: MapFeatures, scans: Sequence[LaserScan], options: Options | None = None
) -> tuple[float, float]:
    """Fit how deep in the walls of a map their faces are, from scans whose poses are not known.

    Readings that end alike before and behind the border of a wall's cells have a depth of 0: the
    map is sharp. On a map that scans made, they end within the blurred band. Each scan is placed
    with the scale and the walls in `options`. The result is the median over the ``unique`` scans,
    and its standard error, metres. A ConfigError if they are fewer than :data:`LEAST_FIT`.
    """
    options = options or Options()
    options = replace(options, shared=replace(options.shared, depth=None))
    found = [
        float(on_faces(at, seen.spread(options.fused.rays), there, any_depth()).depth[0])
        for there, seen, at in _placed(features, scans, options)
    ]
    _enough(len(found), len(scans))
    middle, error = _middle(np.array(found))
    return middle, error


def _placed(
    features: MapFeatures, scans: Sequence[LaserScan], options: Options
) -> Iterator[tuple[MapFeatures, Readings, FloatArray]]:
    """Map, readings and pose (1, 3), grid frame, of each scan at one place.

    No other error is allowed for than that in the options.
    """
    options = replace(options, top=1, fused=replace(options.fused, strained=float("inf")))
    for scan in scans:
        answer = localize(features, scan, options)
        if answer.verdict == "unique" and answer.pose is not None:
            there, near = as_seen(features, scan, options.shared)
            at = np.array([[*in_grid_frame(answer.pose, features.grid)]])
            yield there, one_per_place(near, options.fused.place), at


def _middle(values: FloatArray) -> tuple[float, float]:
    """Median of some values, and its standard error, assuming a Gaussian."""
    middle = float(np.median(values))
    spread = 1.4826 * float(np.median(np.abs(values - middle)))
    return middle, 1.2533 * spread / float(np.sqrt(len(values)))


def _enough(fit: int, asked: int) -> None:
    """Raise a ConfigError if too few scans fit to find an error that they share."""
    if fit < LEAST_FIT:
        raise ConfigError(
            f"{fit} of {asked} scans fit this map at one place, expected at least {LEAST_FIT} to "
            "say what error they share; are they from here? Scans of a log with odometry need not "
            "fit one by one"
        )
