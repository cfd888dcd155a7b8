"""The atlas of a map: where one scan is enough. A scan is simulated and located at every place."""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from imgloc.errors import ConfigError, MapError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import cell_of, in_map_frame, pose_errors, poses_of
from imgloc.io.text import csv_text
from imgloc.lab.bound import least_covariances
from imgloc.lab.evaluation import share
from imgloc.model import FloatArray, LaserScan, OccupancyGrid, Pose2D, plain
from imgloc.options import Options, Sensor
from imgloc.pipeline import localize, prepare
from imgloc.runs.workers import Supervised
from imgloc.search.priors import clearance as roomy
from imgloc.simulation.scans import ray_angles, refine_grid, simulate_ranges

COLUMNS = (
    "x", "y", "theta", "kind", "mass", "error", "turn", "twin_x", "twin_y", "twin_theta",
    "twin_mass", "places", "bound",
)  # fmt: skip
"""Columns of the table: map frame, metres and radians; `kind` is one of :data:`KINDS`."""
KINDS = ("unique", "ambiguous", "no-match", "wrong")
"""Results of a scan: ``unique`` means unique and right, ``wrong`` means unique but elsewhere."""
NEAR = (0.5, float(np.deg2rad(15.0)))
"""A hypothesis nearer than this to the true pose is right, metres and radians."""
TOP = 10
MOST = 20_000  #: largest number of poses
_TOGETHER = 4  # poses that a process is given at a time
AT_ONCE = 1000  #: scans that are simulated at a time


@dataclass(frozen=True)
class Spot:
    """One pose of the atlas, map frame, and the result of its scan."""

    pose: Pose2D
    kind: str  #: one of :data:`KINDS`
    mass: float  #: mass of the true pose; 0 if it is not among the hypotheses
    error: float  #: metres from the true pose to the best hypothesis; NaN without one
    turn: float  #: radians from the true heading to that of the best hypothesis; NaN without one
    twin: Pose2D | None  #: the best hypothesis that is not the true pose, map frame
    twin_mass: float
    places: int = 1  #: places that fit: the fewest with the mass of a unique answer
    #: least standard deviation that the position can have by one scan, metres; inf where walls
    #: leave a direction free, NaN if the noise is not known
    bound: float = float("nan")

    @property
    def row(self) -> list[object]:
        """Values of :data:`COLUMNS`."""
        twin = (None,) * 3 if self.twin is None else (self.twin.x, self.twin.y, self.twin.theta)
        pose = (self.pose.x, self.pose.y, self.pose.theta)
        found = (self.mass, self.error, self.turn, *twin, self.twin_mass, self.places, self.bound)
        return [*pose, self.kind, *found]


def as_csv(spots: Sequence[Spot]) -> str:
    """A row of each spot below the names of :data:`COLUMNS`. NaN is left empty.

    Examples
    --------
    >>> nan = float("nan")
    >>> as_csv([Spot(Pose2D(1.0, 2.5), "no-match", 0.0, nan, nan, None, 0.0)]).split()[1]
    '1.0,2.5,0.0,no-match,0.0,,,,,,0.0,1,'
    """
    rows = (["" if isinstance(v, float) and math.isnan(v) else v for v in s.row] for s in spots)
    return csv_text([COLUMNS, *rows])


def atlas_poses(grid: OccupancyGrid, step: float, headings: int, clearance: float) -> FloatArray:
    """Poses (N, 3), grid frame, at the free centres of squares of `step` metres.

    Each place has evenly spaced `headings`, the first along x. It is at least `clearance` metres
    from everything that is not free.

    Raises
    ------
    ConfigError, MapError
        If there are more poses than :data:`MOST`, which are counted before they are made; if no
        place has the clearance.

    Examples
    --------
    >>> free = np.ones((4, 6), bool)
    >>> atlas_poses(OccupancyGrid(~free, free, 1.0), 2.0, 1, 0.0)[:, :2].tolist()
    [[1.0, 1.0], [3.0, 1.0], [5.0, 1.0], [1.0, 3.0], [3.0, 3.0], [5.0, 3.0]]
    """
    info, free = grid.info, roomy(grid, clearance)
    if (in_a_cell := info.resolution / step) > MOST:
        check_count(int(in_a_cell), step)
    y, x = (np.arange(step / 2, side * info.resolution, step) for side in info.shape)
    rows, columns = (cell_of(np.stack((v, v), axis=-1), info.resolution)[:, 0] for v in (y, x))
    y, rows = y[rows < info.height], rows[rows < info.height]
    x, columns = x[columns < info.width], columns[columns < info.width]
    across = np.bincount(columns, minlength=info.width).astype(np.float32)
    check_count(int(np.bincount(rows, minlength=info.height) @ (free @ across)) * headings, step)
    # Only rows and columns that hold a place: in a fine raster the others are many.
    some, other = (np.logical_or.reduce(free, axis)[at] for axis, at in ((1, rows), (0, columns)))
    row, column = np.nonzero(free[np.ix_(rows[some], columns[other])])
    places = np.column_stack((x[other][column], y[some][row]))
    if not len(places):
        raise MapError(
            f"no place on a raster of {step:g} m is {clearance:g} m away from what is not free; "
            "expected some, hint: a smaller step or clearance"
        )
    theta = np.arange(headings) * (2 * np.pi / headings)
    return np.column_stack((places.repeat(headings, axis=0), np.tile(theta, len(places))))


def check_count(count: int, step: float) -> None:
    """Refuse more poses than :data:`MOST`, at places `step` metres apart: a ConfigError."""
    if count > MOST:
        found = f"`step`: {count:,} poses at places {step:g} m apart"
        raise ConfigError(f"{found}, expected at most {MOST:,}; use a larger step")


def simulate_at(
    grid: OccupancyGrid, poses: FloatArray, sensor: Sensor, seed: int,
    fine: OccupancyGrid | None = None,
) -> list[tuple[Pose2D, LaserScan]]:  # fmt: skip
    """Simulate a scan at each pose (N, 3), grid frame.

    Rays are cast in `fine`, by default the map redrawn with cells of 1 cm.
    """
    fine = fine or refine_grid(grid)
    angles, range_max = ray_angles(sensor.rays, sensor.fov), sensor.range_max
    ranges = [
        simulate_ranges(
            fine, part, angles, sigma=sensor.sigma, range_max=range_max,
            seed=seed + k, outliers=sensor.outliers, dropped=sensor.dropped,
        )
        for k, part in enumerate(np.array_split(poses, -(-len(poses) // AT_ONCE)))
    ]  # fmt: skip
    pairs = zip(poses, np.concatenate(ranges), strict=True)
    return [(Pose2D(*pose), LaserScan(r, angles, range_max=range_max)) for pose, r in pairs]


def summarise(spots: Sequence[Spot], step: float) -> dict[str, Any]:
    """Shares of the poses, and of the free area, by result; places are `step` metres apart."""
    places: dict[tuple[float, float], list[bool]] = {}
    for spot in spots:
        places.setdefault((spot.pose.x, spot.pose.y), []).append(spot.kind == "unique")
    return {
        "poses": len(spots), "places": len(places), "area": len(places) * step**2,
        **{kind: vars(share(spot.kind == kind for spot in spots)) for kind in KINDS},
        "unique_area": vars(share(all(flags) for flags in places.values())),
        "bound": float(np.median([spot.bound for spot in spots] or [np.nan])),
        "free": vars(share(spot.bound == np.inf for spot in spots)),
    }  # fmt: skip


def survey_part(
    features: MapFeatures, scan: LaserScan, options: Options, *, step: float, headings: int,
    start: int = 0, seconds: float = 0.5,
) -> dict[str, Any]:  # fmt: skip
    """Survey a map with the laser of a scan for some seconds: a part of its atlas.

    Parameters
    ----------
    features : MapFeatures
        The map. Rays are cast in its cells.
    scan : LaserScan
        A scan of the laser, which gives its angles and its reach.
    options : Options
        Options of the search.
    step : float
        Metres between two places. Places come in random order, so that each part covers the whole
        map.
    headings : int
        Number of headings at each place.
    start : int
        Number of the first pose of this part: ``next`` of the part before.
    seconds : float
        Time after which no further pose is begun. A part has at least one pose.

    Returns
    -------
    dict
        ``of`` is the number of all poses. ``next`` is the number of the next pose, or None at the
        end. ``spots`` has each pose (map frame, metres and radians) with its ``kind``, one of
        :data:`KINDS`. No result depends on how the poses are divided into parts.

    Raises
    ------
    ConfigError, MapError
        If there are too many poses or none, or `start` is none of their numbers.

    Examples
    --------
    >>> from imgloc.io.maps import bundled_maps, load_map
    >>> features = prepare(load_map(bundled_maps() / "curved.yaml"))
    >>> laser = LaserScan(np.ones(90), np.linspace(-np.pi, np.pi, 90), range_max=30.0)
    >>> part = survey_part(features, laser, Options(), step=4.0, headings=1, seconds=0.0)
    >>> part["next"], [spot["kind"] for spot in part["spots"]]
    (1, ['unique'])
    """
    end, grid = time.monotonic() + seconds, features.grid
    poses = atlas_poses(grid, step, headings, Sensor().clearance)
    if start >= len(poses):
        raise ConfigError(f"start: got {start}, expected less than {len(poses)}")
    mixed = np.random.default_rng(0).permutation(len(poses) // headings)
    poses = poses.reshape(-1, headings, 3)[mixed].reshape(-1, 3)
    reach = scan.range_max if np.isfinite(scan.range_max) else Sensor().range_max
    options, spots = replace(options, top=TOP), list[dict[str, Any]]()
    for k in range(start, len(poses)):
        ranges = simulate_ranges(grid, poses[k : k + 1], scan.angles, range_max=reach, seed=k)[0]
        seen = LaserScan(ranges, scan.angles, range_max=reach)
        spot = _spot(features, Pose2D(*poses[k]), seen, options)
        spots.append({**plain(spot.pose), "kind": spot.kind})
        if time.monotonic() >= end:
            break
    after = start + len(spots)
    return {"of": len(poses), "next": after if after < len(poses) else None, "spots": spots}


def survey(
    grid: OccupancyGrid, scans: Sequence[tuple[Pose2D, LaserScan]], options: Options, *,
    sigma: float = Sensor().sigma, workers: int = 1,
) -> Iterator[Spot]:  # fmt: skip
    """Locate scan after scan, and compare each with its true pose; yield the spots in that order.

    Poses are the sensor's in the grid frame. The noise `sigma` of the ranges, metres, gives the
    bound of each. `workers` is the number of processes. No result depends on it.
    """
    parts = [scans[k : k + _TOGETHER] for k in range(0, len(scans), _TOGETHER)]
    if workers == 1:
        for part in parts:
            yield from _spots(grid, part, options, sigma)
        return
    with Supervised(workers, module=__name__) as pool:
        try:
            for done in [pool.submit(_spots, grid, part, options, sigma) for part in parts]:
                yield from done.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


_prepared = lru_cache(maxsize=1)(prepare)


def _spots(
    grid: OccupancyGrid, scans: Sequence[tuple[Pose2D, LaserScan]], options: Options, sigma: float
) -> list[Spot]:
    features = _prepared(grid)
    spots = [_spot(features, pose, scan, options) for pose, scan in scans]
    at = np.array([[pose.x, pose.y, pose.theta] for pose, _ in scans])
    laser = scans[0][1]
    least = least_covariances(features, at, laser.angles, laser.range_max, sigma)
    bounds = np.sqrt(least[:, 0, 0] + least[:, 1, 1])
    bounds[bounds > grid.diagonal] = np.inf
    return [replace(spot, bound=bound) for spot, bound in zip(spots, bounds.tolist(), strict=True)]


def _spot(features: MapFeatures, pose: Pose2D, scan: LaserScan, options: Options) -> Spot:
    truth = in_map_frame(pose, features.grid)
    answer = localize(features, scan, options)
    errors = pose_errors(poses_of(answer.hypotheses), truth)
    right = np.all(errors <= NEAR, axis=1)
    mass = np.array([h.mass for h in answer.hypotheses])
    kind = "no-match" if answer.verdict == "invalid" else answer.verdict
    if kind == "unique" and not right[0]:
        kind = "wrong"
    error, turn = errors[0].tolist() if len(errors) else (float("nan"), float("nan"))
    others = np.flatnonzero(~right)
    twin = answer.hypotheses[others[0]] if len(others) else None
    twin_pose, twin_mass = (None, 0.0) if twin is None else (twin.pose, float(twin.mass))
    places = 1 + int(np.count_nonzero(np.cumsum(mass) < options.trust.mass))
    share = float(mass[right].sum())
    return Spot(truth, kind, share, error, turn, twin_pose, twin_mass, places)
