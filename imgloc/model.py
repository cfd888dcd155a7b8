"""The types that flow through imgloc: frozen dataclasses over read-only NumPy arrays.

Poses that enter or leave the program are in the **map frame**, the one of the map's YAML;
everything between is in the **grid frame**: origin at the lower-left corner of cell ``[0, 0]``, x
along the columns, y along the rows, metres. :mod:`imgloc.geometry` converts, in one place, so
that an origin with a yaw is honoured everywhere.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
import numpy.typing as npt

from imgloc.equality import ByContent
from imgloc.errors import ConfigError
from imgloc.pose import DEGREES, pose_of
from imgloc.pose import MOST_TURNED as MOST_TURNED
from imgloc.pose import MOUNTED as MOUNTED
from imgloc.pose import Pose2D as Pose2D
from imgloc.pose import check_mount as check_mount
from imgloc.pose import wrapped_pose as wrapped_pose

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

FAR = 1e6
"""Range in metres that no sensor reaches. Drivers write such numbers if a ray met nothing."""

LONGEST_SWEEP = 10.0
"""Seconds that no sensor takes for a scan."""

VERDICTS = ("unique", "ambiguous", "no-match", "invalid")
SURE = VERDICTS[:2]  #: verdicts with which an answer has a pose


_CODES = 2  # most numbers that one sensor uses for "nothing seen"


def freeze(record: Any, dtype: npt.DTypeLike, *names: str) -> None:
    """Make fields read-only arrays of `dtype` that nobody else can write to: copies, if need be.

    An array that is read-only itself, and so is what it is a view of, is taken as it is.
    """
    for name in names:
        array = at = getattr(record, name)
        while isinstance(at, np.ndarray) and not at.flags.writeable and at.base is not None:
            at = at.base
        own = isinstance(at, np.ndarray) and not at.flags.writeable and array.dtype == dtype
        if not own:
            array = np.array(array, dtype=dtype)
            array.flags.writeable = False
        object.__setattr__(record, name, array)


def compose(a: Pose2D, b: Pose2D) -> Pose2D:
    """Return ``a ⊕ b``: pose `b` is in the frame of `a`, the result in the parent frame of `a`.

    Examples
    --------
    >>> p = compose(Pose2D(1, 0, np.pi / 2), Pose2D(1, 0, 0))
    >>> round(p.x, 6), round(p.y, 6)
    (1.0, 1.0)
    """
    c, s = np.cos(a.theta), np.sin(a.theta)
    return Pose2D(a.x + c * b.x - s * b.y, a.y + s * b.x + c * b.y, a.theta + b.theta)


def inverse(a: Pose2D) -> Pose2D:
    """Return the pose that undoes `a`: ``compose(a, inverse(a))`` is the identity."""
    c, s = np.cos(a.theta), np.sin(a.theta)
    return Pose2D(-c * a.x - s * a.y, s * a.x - c * a.y, -a.theta)


def base_of(pose: Pose2D, mount: Pose2D) -> Pose2D:
    """Pose T_map_base of the robot's base, from the sensor's `pose` and its `mount` on the robot.

    Examples
    --------
    >>> base_of(Pose2D(1.0, 0.0, 0.0), Pose2D(0.2, 0.0, 0.0)).x
    0.8
    """
    return compose(pose, inverse(mount))


@dataclass(frozen=True)
class GridInfo:
    """The lattice of an image of the plane (ROS: MapMetaData), without the image.

    Parameters
    ----------
    height, width : int
        Number of rows and columns. Row 0 is the lowest y.
    resolution : float
        Side of a cell, metres.
    origin : Pose2D
        Pose of the lower-left corner of cell ``[0, 0]`` in the map frame.
    """

    height: int
    width: int
    resolution: float
    origin: Pose2D = field(default_factory=lambda: Pose2D(0.0, 0.0, 0.0))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, as NumPy has them."""
        return self.height, self.width


@dataclass(frozen=True, repr=False, eq=False)
class OccupancyGrid(ByContent):
    """A map: its occupied and its free cells. A cell that is neither is unknown.

    Row 0 is the lowest y (the order of nav_msgs/OccupancyGrid): images are flipped once when
    they are loaded and once when they are drawn.

    Parameters
    ----------
    occupied, free : (H, W) bool arrays
        No cell is both.
    resolution : float
        Side of a cell, metres.
    origin : Pose2D
        Pose of the lower-left corner of cell ``[0, 0]`` in the map frame.
    movable : (H, W) bool array, optional
        Cells, free else, in which something may stand or not, as furniture or the leaf of a door.
        The default method of `localize` asks both.

    Examples
    --------
    >>> wall = np.eye(4, dtype=bool)
    >>> OccupancyGrid(wall, ~wall, 0.5)
    <OccupancyGrid 4 x 4 cells of 0.5 m: 2 x 2 m, 25.0% occupied, 75.0% free>
    """

    occupied: BoolArray
    free: BoolArray
    resolution: float
    origin: Pose2D = field(default_factory=lambda: Pose2D(0.0, 0.0, 0.0))
    movable: BoolArray | None = None

    def __post_init__(self) -> None:
        freeze(self, np.bool_, "occupied", "free", *["movable"] * (self.movable is not None))
        occupied, free = self.occupied.shape, self.free.shape
        if self.movable is not None and self.movable.shape != occupied:
            raise ValueError(f"movable {self.movable.shape} must have the shape {occupied}")
        if len(occupied) != 2 or occupied != free:
            raise ValueError(f"occupied {occupied} and free {free} must be images of one shape")
        if np.any(self.occupied & self.free):
            row, column = np.argwhere(self.occupied & self.free)[0].tolist()
            raise ValueError(f"cell [{row}, {column}] is both occupied and free")
        if not np.isfinite(self.resolution) or self.resolution <= 0:
            raise ValueError(f"resolution must be positive, got {self.resolution}")
        object.__setattr__(self, "origin", pose_of(self.origin, "origin"))
        if not np.isfinite([*self.origin]).all():
            raise ValueError(f"origin must be finite metres and a yaw, got {self.origin}")

    def __repr__(self) -> str:
        height, width = self.occupied.shape
        cells = f"{width} x {height} cells of {self.resolution:g} m"
        metres = f"{width * self.resolution:.4g} x {height * self.resolution:.4g} m"
        shares = f"{self.occupied.mean():.1%} occupied, {self.free.mean():.1%} free"
        return f"<OccupancyGrid {cells}: {metres}, {shares}>"

    @property
    def info(self) -> GridInfo:
        """The lattice of this grid."""
        height, width = self.occupied.shape
        return GridInfo(height, width, self.resolution, self.origin)

    @property
    def diagonal(self) -> float:
        """From one corner of the map to the opposite one, metres."""
        return math.hypot(*self.occupied.shape) * self.resolution

    @property
    def furnished(self) -> "OccupancyGrid":
        """The map on which all that is movable stands."""
        stands = self.free & (False if self.movable is None else self.movable)
        return OccupancyGrid(
            self.occupied | stands, self.free & ~stands, self.resolution, self.origin
        )

    @property
    def unknown(self) -> BoolArray:
        """Cells that are neither occupied nor free, (H, W) bool."""
        return ~(self.occupied | self.free)


@dataclass(frozen=True, repr=False, eq=False)
class LaserScan(ByContent):
    """One 2-D scan as it was recorded. Which readings count follows from REP 117.

    Parameters
    ----------
    ranges : (N,) float array
        Metres. +inf and values >= `range_max` or :data:`FAR` are "no return". NaN, -inf and
        values <= `range_min` are no evidence.
    angles : (N,) float array
        Direction of each ray in the sensor's frame, radians, counter-clockwise, 0 = forward;
        finite, also for rays without a reading.
    range_min, range_max : float
        A reading is valid iff it is finite and range_min < r < range_max.
    stamp : float
        Seconds; NaN when unknown.
    T_base_laser : Pose2D, optional
        Pose of the sensor on the robot. With it, answers have the robot's pose, too.
    time_increment : float
        Seconds from a reading to the next; `stamp` is that of the first in `ranges`. 0 if all are
        of one moment, or if this is not known.
    laser : str
        Name of the laser: its topic or frame. Scans of one name are of one laser, wherever it sits
        on the robot at their times.

    Examples
    --------
    >>> LaserScan([1.0, 2.0, np.inf], [-0.5, 0.0, 0.5], range_max=9.0)
    <LaserScan of 3 rays, 2 valid: -28.65 to 28.65 deg, 1 to 2 m of at most 9>
    """

    ranges: FloatArray
    angles: FloatArray
    range_min: float = 0.0
    range_max: float = float("inf")
    stamp: float = float("nan")
    T_base_laser: Pose2D | None = None
    time_increment: float = 0.0
    laser: str = ""

    def __post_init__(self) -> None:
        freeze(self, np.float64, "ranges", "angles")
        ranges, angles = self.ranges.shape, self.angles.shape
        if len(ranges) != 1 or ranges != angles:
            raise ValueError(f"ranges {ranges} and angles {angles} must be vectors of one length")
        if not np.isfinite(self.angles).all():
            i = int(np.argmin(np.isfinite(self.angles)))
            raise ValueError(f"angles must be finite, angles[{i}] is {self.angles[i]}")
        if np.abs(self.angles).max(initial=0.0) > MOST_TURNED + 1:  # straightened ones are moved
            i = int(np.abs(self.angles).argmax())
            raise ConfigError(f"angles[{i}]: got {self.angles[i]:g}, {DEGREES}")
        if self.T_base_laser is not None:
            object.__setattr__(self, "T_base_laser", pose_of(self.T_base_laser, "T_base_laser"))
            check_mount(self.mount, "T_base_laser")
        if not self.duration <= LONGEST_SWEEP:
            seconds = f"{self.time_increment} makes a sweep of {self.duration:g} s"
            raise ValueError(f"time_increment {seconds}, expected at most {LONGEST_SWEEP:g} s")

    def __repr__(self) -> str:
        seen, n = self.ranges[self.valid], len(self.ranges)
        about = f"<LaserScan of {n} rays, {len(seen)} valid"
        if n:
            low, high = np.rad2deg([self.angles.min(), self.angles.max()])
            about += f": {low:.4g} to {high:.4g} deg"
        if len(seen):
            about += f", {seen.min():.4g} to {seen.max():.4g} m of at most {self.range_max:g}"
        return about + ">"

    @property
    def valid(self) -> BoolArray:
        """(N,) bool: the readings that are distances to a surface."""
        r = self.ranges
        with np.errstate(invalid="ignore"):
            return np.isfinite(r) & (r > self.range_min) & (r < min(self.range_max, FAR))

    @property
    def directions(self) -> int:
        """Number of different directions of the valid readings, to a milliradian, modulo 2 pi.

        Examples
        --------
        >>> LaserScan([1.0, 1.1, 2.0, 3.0], [0.0, 0.0, 2 * np.pi, 1.0]).directions
        2
        """
        turns = np.rint(1000 * self.angles[self.valid] % (2000 * np.pi)) % np.rint(2000 * np.pi)
        # np.unique would import masked arrays, which takes 12 ms.
        return int(np.count_nonzero(np.diff(np.sort(turns), prepend=-1.0)))

    @property
    def no_return(self) -> BoolArray:
        """(N,) bool: the rays that met nothing within `range_max`."""
        with np.errstate(invalid="ignore"):
            beyond = np.isfinite(self.ranges) & (self.ranges >= min(self.range_max, FAR))
            return np.asarray(beyond | (self.ranges == np.inf), dtype=np.bool_)

    @property
    def digest(self) -> str:
        """A hash of the readings, angles and limits: scans with the same one are equal in these."""
        parts = (np.array([self.range_min, self.range_max]), self.ranges, self.angles)
        held = b"".join(part.tobytes() for part in parts)
        return hashlib.blake2b(held, digest_size=8).hexdigest()

    @property
    def duration(self) -> float:
        """Seconds from the first reading to the last."""
        return abs(self.time_increment) * max(0, len(self.ranges) - 1)

    @property
    def mount(self) -> Pose2D:
        """Pose of the sensor on the robot; where `T_base_laser` is unknown, they are one."""
        return self.T_base_laser or Pose2D(0.0, 0.0)

    def straightened(self, velocity: FloatArray, *, backward: bool = False) -> "LaserScan":
        """The scan as a robot that stands where it was at the first reading records it.

        Parameters
        ----------
        velocity : (3,) float array
            Of the robot, in its own frame: m/s, m/s, rad/s. If it is not finite, the scan stays as
            it is.
        backward : bool
            The first reading is the newest one: drivers of lidars that turn clockwise reverse the
            readings, and keep a positive `time_increment`.

        Examples
        --------
        >>> scan = LaserScan([2.0, 1.9, 1.8], [0.0, 0.0, 0.0], time_increment=0.1)
        >>> scan.straightened(np.array([1.0, 0.0, 0.0])).ranges.round(6).tolist()
        [2.0, 2.0, 2.0]
        """
        if not self.time_increment or not np.isfinite(velocity).all():
            return self
        pace = -self.time_increment if backward else self.time_increment
        t = pace * np.arange(len(self.ranges))
        mount = self.mount
        turn, half = velocity[2] * t, np.exp(0.5j * velocity[2] * t)
        seen = self.valid
        # Points of the robot's plane as complex numbers: a turn is a product.
        at, ahead = complex(mount.x, mount.y), np.exp(1j * (mount.theta + self.angles))
        ends = at + np.where(seen, self.ranges, 1.0) * ahead
        moved = complex(velocity[0], velocity[1]) * t * half + np.exp(1j * turn) * ends
        back = (moved - at) * np.exp(-1j * mount.theta)
        ranges = np.where(seen, np.minimum(np.abs(back), self._longest), self.ranges)
        # The angle nearest to what it was, so that a view does not break at a half turn.
        off = np.where(seen, np.angle(back * np.exp(-1j * self.angles)), turn)
        return replace(self, ranges=ranges, angles=self.angles + off, time_increment=0.0)

    @property
    def _longest(self) -> float:
        """The longest range that is a distance, metres."""
        return float(np.nextafter(min(self.range_max, FAR), 0))

    @property
    def flipped(self) -> "LaserScan":
        """The scan of a sensor that hangs upside down: its angles run clockwise.

        Examples
        --------
        >>> LaserScan([1.0, 2.0], [0.5, 1.0]).flipped.angles.tolist()
        [-0.5, -1.0]
        """
        return replace(self, angles=-self.angles)

    def scaled(self, factor: float) -> "LaserScan":
        """The scan with its ranges multiplied by `factor`: 0.001 turns millimetres into metres.

        `range_min` and `range_max` are multiplied, too. If the unit changes and most different
        readings exceed `range_max`, the limits were in metres already, and stay. Codes for "nothing
        seen" also exceed it, but a sensor has at most two of them.

        Examples
        --------
        >>> LaserScan([1500.0, 2500.0, 2600.0], [0.0, 0.1, 0.2], range_max=30.0).scaled(0.001)
        <LaserScan of 3 rays, 3 valid: 0 to 11.46 deg, 1.5 to 2.6 m of at most 30>
        """
        if factor == 1:
            return self
        seen = np.unique(self.ranges[np.isfinite(self.ranges) & (self.ranges > 0)])
        beyond = int(np.count_nonzero(seen >= self.range_max))
        other_unit = not 0.1 < factor < 10 and beyond > _CODES + len(seen) - beyond
        limits = 1.0 if other_unit else factor
        return replace(
            self,
            ranges=self.ranges * factor,
            range_min=self.range_min * limits,
            range_max=self.range_max * limits,
        )

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of readings: `valid` ones, and those dropped for each reason."""
        r = self.ranges
        with np.errstate(invalid="ignore"):
            too_close = (r == -np.inf) | (np.isfinite(r) & (r <= self.range_min))
        return {
            "valid": int(self.valid.sum()),
            "no_return": int(self.no_return.sum()),
            "too_close": int((too_close & ~self.no_return).sum()),
            "nan": int(np.isnan(r).sum()),
        }


@dataclass(frozen=True, repr=False, eq=False)
class OrientedPoints(ByContent):
    """Points of a surface with its directed normals.

    Parameters
    ----------
    xy : (N, 2) float array
        Metres.
    alpha : (N,) float array
        Direction of the normal that points into free space (toward the sensor), radians in
        (-pi, pi]; NaN where it is unknown.
    sigma_alpha : (N,) float array
        Standard deviation of `alpha`, radians.
    valid : (N,) bool array
        Whether `alpha` may be used. Points with ``valid == False`` still have a position.
    """

    xy: FloatArray
    alpha: FloatArray
    sigma_alpha: FloatArray
    valid: BoolArray

    def __post_init__(self) -> None:
        freeze(self, np.float64, "xy", "alpha", "sigma_alpha")
        freeze(self, np.bool_, "valid")
        n = len(self.xy)
        others = {self.alpha.shape, self.sigma_alpha.shape, self.valid.shape}
        if self.xy.shape != (n, 2) or others != {(n,)}:
            raise ValueError(
                f"xy {self.xy.shape}, alpha {self.alpha.shape}, sigma_alpha "
                f"{self.sigma_alpha.shape} and valid {self.valid.shape} must agree in length"
            )

    def __repr__(self) -> str:
        return f"<OrientedPoints: {len(self)}, of {int(self.valid.sum())} the normal is known>"

    def __len__(self) -> int:
        return len(self.xy)

    def select(self, index: npt.NDArray[Any]) -> "OrientedPoints":
        """Return the points at `index` (a mask or integer array) as a new set."""
        return OrientedPoints(
            self.xy[index], self.alpha[index], self.sigma_alpha[index], self.valid[index]
        )


@dataclass(frozen=True, repr=False, eq=False)
class Likelihood(ByContent):
    """A likelihood for every pose of a lattice, as a stack of images.

    Parameters
    ----------
    values : (K, H, W) float32 array
        ``values[k, row, col]`` belongs to the pose at the centre of cell ``[row, col]`` of
        `grid` with heading ``thetas[k]``, in the grid frame.
    thetas : (K,) float array
        Headings in the grid frame, radians, equally spaced over the circle.
    grid : GridInfo
        The lattice of x and y.
    method : str
        Name of the algorithm that made it.
    scan : LaserScan, optional
        The scan that it was computed for.
    """

    values: Float32Array
    thetas: FloatArray
    grid: GridInfo
    method: str
    scan: LaserScan | None = None

    def __post_init__(self) -> None:
        freeze(self, np.float32, "values")
        freeze(self, np.float64, "thetas")
        shape = (len(self.thetas), *self.grid.shape)
        if self.values.shape != shape:
            raise ValueError(
                f"values {self.values.shape} must be (thetas, rows, columns) = {shape}"
            )

    def __repr__(self) -> str:
        k, height, width = self.values.shape
        cells = f"{height} x {width} cells of {self.grid.resolution:g} m"
        return f"<Likelihood {self.method}: {k} headings x {cells}>"


@final
@dataclass(frozen=True, eq=False)
class Hypothesis(ByContent):
    """A pose that fits the scan.

    Parameters
    ----------
    pose : Pose2D
        Pose of the sensor, in the map frame in every answer. The method ``fused`` gives the mean of
        the maxima of a mode.
    log_likelihood : float
        Nats, up to a constant of the scan. The method ``fused`` gives that of the mode's highest
        maximum.
    mass : float
        Probability that the true pose belongs to this hypothesis, 0..1. The masses of all
        hypotheses sum to at most 1.
    covariance : (3, 3) float array
        Covariance of (x, y, theta): m², m rad, rad². Positive definite.
    """

    pose: Pose2D
    log_likelihood: float
    mass: float
    covariance: FloatArray

    def __post_init__(self) -> None:
        freeze(self, np.float64, "covariance")


@dataclass(frozen=True)
class Temperature:
    """The divisor of a score in nats, and its parts: ``(base + strain) * number * cell``.

    Examples
    --------
    >>> Temperature(1.5, 3.0, number=0.5, cell=4.0).value
    9.0
    """

    #: temperature if map and scan agree perfectly, or the calibrated temperature of a stack; NaN
    #: without a pose
    base: float = math.nan
    strain: float = 0.0  #: increase because of the misfit
    number: float = 1.0  #: factor for the number of readings
    cell: float = 1.0  #: factor for the size of the map's cells, at least 1

    @property
    def value(self) -> float:
        """The temperature: the product of its parts."""
        return (self.base + self.strain) * (self.number * self.cell)


@dataclass(frozen=True)
class Protection:
    """Around the best pose, what holds the true pose with a probability: a protection level."""

    share: float  #: the probability, 0..1
    #: radius around its position; infinite if too much mass is elsewhere, or if it would be larger
    #: than the map
    metres: float
    radians: float  #: the most that its heading is off; infinite if too much mass is elsewhere


@dataclass(frozen=True)
class Check:
    """One check of the verdict: `value` must be at least `limit`, or at most if not `at_least`."""

    name: str
    value: float
    limit: float
    at_least: bool

    @property
    def holds(self) -> bool:
        """True if `value` is on the right side of `limit`."""
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True)
class Floor:
    """Readings of a tilted laser that end on the floor: on a line, or on a circle around it."""

    distance: float  #: metres from the sensor to where the floor is nearest
    direction: float  #: radians, sensor frame, of that place; NaN for a circle
    share: float  #: of the valid readings that end on the floor, 0..1


@dataclass(frozen=True)
class Thing:
    """A piece of a scan that differs from the map, if the scan was taken at the best pose."""

    bearing: float  #: radians, sensor frame, of its middle
    distance: float  #: metres, mean of its readings
    share: float  #: of the readings that were scored, 0..1
    through: bool  #: whether most of its readings pass through a mapped wall; else it is unmapped


@dataclass(frozen=True, eq=False)
class Evidence(ByContent):
    """The evidence for the masses and the verdict of an answer."""

    readings: int = 0  #: number of readings that were scored
    best: float = math.nan  #: log-likelihood of a reading that fits perfectly, nats
    #: nats per reading that the best pose lacks against a perfect fit; NaN without a pose
    misfit: float = math.nan
    #: nats per reading that a building on no map would reach: the best empty room, with things of
    #: their own in it
    unmapped: float = math.nan
    #: nats, divided by the temperature, by which the best pose beats `unmapped`
    gained: float = math.nan
    #: nats against the best pose: walls of the scan are `through` rather than `mapped`, or it fits
    #: only with an error that was found; below 0 if more is for it
    against: float = 0.0
    mapped: int = 0  #: straight walls of the scan that are rather what the map has there
    through: int = 0  #: straight walls of the scan that pass through a mapped wall
    things: tuple[Thing, ...] = ()  #: pieces that differ from the map, the largest first
    #: factor on the readings with which they fit far better; 1 if none was needed
    scale: float = 1.0
    #: metres taken off each side of the walls, because the readings fit far better so; else 0
    thinner: float = 0.0
    #: standard deviation, metres, of the place of each piece of wall, as others drew it; else 0
    bent: float = 0.0
    floor: Floor | None = None  #: left out, because the other readings fit far better without it
    #: divisor of log-likelihoods, and of what they are compared with
    temperature: Temperature = field(default_factory=Temperature)
    #: logarithm of the volume of a hypothesis, as a share of that of all poses in the prior
    log_volume: float = 0.0
    #: checks of the verdict in their order, up to the first that does not hold, which decided; if
    #: all hold, the verdict is ``unique``
    checks: tuple[Check, ...] = ()
    found: int = 0  #: number of modes that were found
    listed: int = 0  #: number of modes that are listed as hypotheses
    unlisted: float = 0.0  #: mass on this map that is at none of the listed hypotheses

    @property
    def net(self) -> float:
        """Nats for the best pose: `gained` less `against`."""
        return self.gained - self.against


@dataclass(frozen=True, eq=False)
class Localization(ByContent):
    """The answer for one scan.

    Parameters
    ----------
    hypotheses : tuple of Hypothesis
        Separated poses, not samples of one mode; the best one first.
    verdict : str
        One of ``unique``, ``ambiguous``, ``no-match``, ``invalid``.
    entropy : float
        Entropy of the masses and `elsewhere`, nats. For a method with a stack, that of its whole
        posterior. 0 means that one pose holds all probability.
    explained : float
        Share of the valid recorded rays, 0..1, that end on a surface of the map at the best pose
        and pass through no wall.
    counts : mapping
        Number of valid readings, and of those dropped for each reason.
    timings_ms : mapping
        Wall time of each step, milliseconds; answers are equal whatever it is.
    parameters : mapping
        Every parameter that decided the answer, with the seed.
    complete : bool
        False if a time budget ended the search early.
    elsewhere : float
        Probability that the true pose is none of those found, 0..1.
    evidence : Evidence
        The evidence for the masses and the verdict.
    T_base_laser : Pose2D, optional
        Pose of the scan's sensor on the robot.
    protection : tuple of Protection
        Radius and heading around the best pose that hold the true one, at 95, 99 and 99.9 %.
    scan : str
        :attr:`LaserScan.digest` of the scan that was answered; empty if it is not known.
    """

    hypotheses: tuple[Hypothesis, ...]
    verdict: str
    entropy: float
    explained: float
    counts: Mapping[str, int] = field(default_factory=dict)
    timings_ms: Mapping[str, float] = field(default_factory=dict, compare=False)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    complete: bool = True
    elsewhere: float = 1.0
    evidence: Evidence = field(default_factory=Evidence)
    T_base_laser: Pose2D | None = None
    protection: tuple[Protection, ...] = ()
    scan: str = ""

    @property
    def best(self) -> Pose2D | None:
        """The pose of the best hypothesis, whatever the verdict; None without a hypothesis."""
        return self.hypotheses[0].pose if self.hypotheses else None

    @property
    def pose(self) -> Pose2D | None:
        """The best pose if the verdict is ``unique`` or ``ambiguous``, else None."""
        return self.best if self.verdict in SURE else None

    @property
    def base_pose(self) -> Pose2D | None:
        """The robot's pose T_map_base, map frame; None without `pose` or `T_base_laser`."""
        mount = self.T_base_laser
        return None if self.pose is None or mount is None else base_of(self.pose, mount)

    def as_row(self, index: int = 0, **parameters: object) -> dict[str, Any]:
        """The row of the scan `index` of a file, as `imgloc localize --json` writes it.

        Further `parameters` that decided the answer are added to its own.

        Examples
        --------
        >>> row = Localization((), "invalid", 0.0, float("nan")).as_row(3)
        >>> row["index"], row["verdict"], row["pose"], row["explained"]
        (3, 'invalid', None, None)
        """
        e, t = self.evidence, self.evidence.temperature
        mount = self.T_base_laser
        rows = [
            plain(h.pose)
            | {"mass": h.mass, "log_likelihood": h.log_likelihood, "covariance": h.covariance}
            | ({} if mount is None else {"base": base_of(h.pose, mount)})
            for h in self.hypotheses
        ]
        evidence = {"readings": e.readings, "misfit": e.misfit, "temperature": t.value}
        evidence |= {name: getattr(t, name) for name in ("base", "strain", "number", "cell")}
        rest = (
            "unmapped", "gained", "against", "mapped", "through", "scale", "thinner", "bent",
            "found", "listed", "unlisted",
        )  # fmt: skip
        evidence |= {name: getattr(e, name) for name in rest}
        floor = Floor(math.nan, math.nan, 0.0) if e.floor is None else e.floor
        evidence |= {"floor": floor.share}
        evidence |= {f"floor_{of}": getattr(floor, of) for of in ("distance", "direction")}
        out = {
            "index": index,
            **{name: getattr(self, name) for name in ("verdict", "pose", "base_pose")},
            "hypotheses": rows,
            "elsewhere": self.elsewhere,
            "protection": [vars(level) for level in self.protection],
            "things": [vars(thing) for thing in e.things],
            "evidence": evidence,
            **{key: getattr(self, key) for key in ("complete", "entropy", "explained", "counts")},
            "timings_ms": {key: round(ms, 3) for key, ms in self.timings_ms.items()},
            "parameters": {**self.parameters, **parameters},
        }
        return dict(plain(out))

    def __repr__(self) -> str:
        best = "no pose"
        if self.best is not None:
            x, y, theta = self.best
            at = f"x {x:.3f} m, y {y:.3f} m, theta {math.degrees(theta):.2f} deg"
            best = f"{at}, mass {self.hypotheses[0].mass:.1%}, {self.explained:.0%} explained"
        return f"<Localization {self.verdict}: {best}; {len(self.hypotheses)} hypotheses>"

    def to_json(self) -> str:
        """The row of :meth:`as_row` as one line of JSON."""
        return to_json(self.as_row())

    def _repr_html_(self) -> str:
        """A table of the hypotheses, for notebooks."""
        rows = "".join(
            f"<tr><td>{h.mass:.1%}<td>{h.pose.x:.3f}<td>{h.pose.y:.3f}"
            f"<td>{math.degrees(h.pose.theta):.2f}"
            for h in self.hypotheses
        )
        head = "<tr><th>mass<th>x / m<th>y / m<th>theta / deg"
        said = f"<p><b>{self.verdict}</b>, elsewhere {self.elsewhere:.1%}</p>"
        return f"{said}<table>{head}{rows}</table>"


def plain(value: Any) -> Any:
    """Return `value` in types that JSON has; a number that is not finite becomes None.

    Examples
    --------
    >>> plain({"a": (1.5, float("inf")), "at": Pose2D(1.0, 2.0)})
    {'a': [1.5, None], 'at': {'x': 1.0, 'y': 2.0, 'theta': 0.0}}
    """
    if isinstance(value, Pose2D):
        return {"x": value.x, "y": value.y, "theta": value.theta}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy's scalars and arrays
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(row: Mapping[str, object]) -> str:
    """Return a row as one line of JSON; a number that is not finite becomes null."""
    return json.dumps(plain(row), allow_nan=False)
