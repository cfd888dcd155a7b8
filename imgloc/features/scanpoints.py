"""The points of a scan, and their normals (Fig. 3) by regression over neighbouring rays."""

import math
from dataclasses import dataclass, replace

import numpy as np

from imgloc.geometry import wrap
from imgloc.model import BoolArray, FloatArray, IntArray, LaserScan, OrientedPoints
from imgloc.numbers import number

# A wall is followed up to this angle between ray and wall (Borges & Aldon 2004, breakpoints).
GRAZING = np.deg2rad(10.0)
# Neighbours further apart say nothing about each other: no whole number of readings, no angle of a
# regular scan, where rounding would decide. Three readings lost in a row are no end of a surface.
_GAP, _MAX_GAP = 4.5, np.deg2rad(20.7)
_SAME = 1e-4  # radians between two readings of one ray
_MIN_NEIGHBOURS = 3
# Metres: the deviation of a reading, and half the window of the regression at right angles to the
# ray; never fewer than so many neighbours on either side unless the surface ends there.
_SIGMA, _WIDTH = 0.02, 0.25
SURE = np.pi / 6  # radians: normals that are less certain are marked invalid
# Radians to either side whose readings are a reading's neighbourhood, and the share of the readings
# that is far for its own.
_BESIDE, _FAR_SHARE = number("scanpoints.far")
_END, _MANY = 0.99, 0.05  # share of the sensor's reach, and of the readings, that lie beyond


def scan_points(ranges: FloatArray, angles: FloatArray, valid: BoolArray) -> OrientedPoints:
    """Return the valid readings as points with normals that face the sensor.

    Parameters
    ----------
    ranges, angles, valid : (N,) arrays
        Metres and radians in the sensor frame, in any order; which are distances to something.

    Returns
    -------
    OrientedPoints
        In the sensor frame, one per valid reading, in their order. Points with fewer than three
        neighbours on their surface are not `valid`, alpha is NaN, sigma_alpha inf: endpoints still.

    Raises
    ------
    ValueError
        If the arrays differ in length.

    Notes
    -----
    The window is broken at depth jumps. Where it is not straight within the noise, the windows that
    end at the point are tried, then narrower ones: the first straight one is taken, else the
    straightest. sigma_alpha is of the larger of the noise expected and the residuals found.

    Examples
    --------
    A wall one metre ahead, seen by five rays; its normal points back, to -x:

    >>> angles = np.deg2rad(np.arange(-10, 15, 5.0))
    >>> points = scan_points(1 / np.cos(angles), angles, np.ones(5, bool))
    >>> np.cos(points.alpha).round(6).tolist(), points.valid.all()
    ([-1.0, -1.0, -1.0, -1.0, -1.0], np.True_)
    """
    ranges, angles = np.asarray(ranges, np.float64), np.asarray(angles, np.float64)
    valid = np.asarray(valid, np.bool_)
    if not (ranges.shape == angles.shape == valid.shape == (len(ranges),)):
        raise ValueError(
            f"ranges {ranges.shape}, angles {angles.shape} and valid {valid.shape} "
            "must be vectors of one length"
        )

    rho, phi = ranges[valid], wrap(angles[valid])
    xy = np.column_stack((rho * np.cos(phi), rho * np.sin(phi)))  # p_i of Fig. 3
    if (n := len(rho)) == 0:
        return OrientedPoints(xy, rho, rho, np.zeros(0, np.bool_))

    # Three turns of the circle, so that a window may reach across the seam at +-180 deg.
    order = np.argsort(phi, kind="stable")
    turn = np.concatenate((phi[order] - 2 * np.pi, phi[order], phi[order] + 2 * np.pi))
    depth, points = np.tile(rho[order], 3), np.tile(xy[order], (3, 1))
    first, last = _surfaces(depth, turn)
    moments = np.zeros((3 * n + 1, 5))
    x, y = points.T
    np.cumsum(np.column_stack((x, y, x * x, y * y, x * y)), axis=0, out=moments[1:])

    middle = np.arange(n, 2 * n)
    first, last, ray = first[middle], last[middle], turn[middle]
    best = np.array([[np.nan], [np.inf], [np.inf]]).repeat(n, axis=1)
    for reach in (_WIDTH, _WIDTH / 2):
        half = np.minimum(reach / np.maximum(depth[middle], 1e-9), np.pi / 4)
        low = np.minimum(np.searchsorted(turn, ray - half, "left"), middle - _MIN_NEIGHBOURS)
        high = np.maximum(np.searchsorted(turn, ray + half, "right") - 1, middle + _MIN_NEIGHBOURS)
        for a, b in ((low, high), (middle, high), (low, middle)):  # around, after, before
            a, b = np.maximum(a, first), np.minimum(b, last)
            fit = _regress(moments, a, b + 1, ray)
            take = (best[2] > 3.0) & (fit[2] < best[2])
            best[:, take] = fit[:, take]

    line, sigma, _ = best
    normal = line + np.pi / 2
    away = np.cos(normal - ray) > 0
    alpha, sigma_alpha = np.empty(n), np.empty(n)
    alpha[order] = wrap(np.where(away, normal + np.pi, normal))
    sigma_alpha[order] = sigma
    return OrientedPoints(xy, alpha, sigma_alpha, sigma_alpha <= SURE)


def evenly(count: int, n: int) -> IntArray:
    """Indices of at most `n` of `count` things, evenly spread over them.

    Examples
    --------
    >>> evenly(5, 3).tolist(), evenly(2, 3).tolist()
    ([0, 2, 4], [0, 1])
    """
    return np.linspace(0, count - 1, min(n, count)).round().astype(np.int64)


@dataclass(frozen=True, eq=False)
class Readings:
    """A scan as a search sees it: one reading for each place that the scan saw."""

    ranges: FloatArray  #: (N,) metres
    angles: FloatArray  #: (N,) radians, sensor frame, ascending
    #: rays that met nothing as far as another reading shows that the sensor reaches
    silent: "Readings | None" = None

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def xy(self) -> FloatArray:
        """(N, 2) endpoints, sensor frame, metres."""
        return np.column_stack((np.cos(self.angles), np.sin(self.angles))) * self.ranges[:, None]

    def spread(self, n: int) -> "Readings":
        """At most `n` of them, evenly spread over all; and of the silent ones."""
        silent = None if self.silent is None else self.silent.spread(n)
        return replace(self._select(evenly(len(self), n)), silent=silent)

    def parts(self) -> "tuple[Readings, Readings, Readings]":
        """The third that is far for its neighbourhood, and the two halves of the view.

        A thing that is not on the map, such as a cart or a crowd, hardly holds all three: a person
        stands before a wall, which is seen beside him.

        Examples
        --------
        >>> readings = Readings(np.array([5.0, 1.0, 4.0, 9.0]), np.array([0.0, 0.1, 0.2, 1.0]))
        >>> [part.ranges.tolist() for part in readings.parts()]
        [[5.0, 9.0], [5.0, 1.0], [4.0, 9.0]]
        """
        turn = np.concatenate([self.angles + turn for turn in (-math.tau, 0, math.tau)])
        ends = np.searchsorted(turn, self.angles[:, None] + (-_BESIDE, _BESIDE))
        beside = np.maximum.reduceat(np.append(np.tile(self.ranges, 3), 0), ends.ravel())[::2]
        far = np.argsort(-self.ranges / beside, kind="stable")
        third = np.sort(far[: math.ceil(_FAR_SHARE * len(self))])
        half, each = -(-len(self) // 2), np.arange(len(self))
        return self._select(third), self._select(each[:half]), self._select(each[half:])

    def _select(self, pick: IntArray) -> "Readings":
        return Readings(self.ranges[pick], self.angles[pick], self.silent)


def one_per_place(scan: LaserScan, side: float) -> Readings:
    """Draw the valid endpoints of a scan as an image, and read off one point for each cell.

    Rays are dense where a wall is near, and all of them share its error on the map: counted one by
    one, a near surface outvotes the far walls, which fix the robot's place. Many readings in the
    last hundredth of the sensor's reach are no distances but codes for glass and open space.
    Directions in which several rays side by side met nothing are kept, too.

    Parameters
    ----------
    scan : LaserScan
    side : float
        Side of a square cell of the image, metres. A cell stands for the mean of its points.

    Examples
    --------
    >>> scan = LaserScan([1.0, 1.0, 1.0, 5.0], [0.01, 0.02, 0.03, 0.5], range_max=9.0)
    >>> readings = one_per_place(scan, 0.1)
    >>> readings.ranges.round(3).tolist(), readings.angles.round(3).tolist()
    ([1.0, 5.0], [0.02, 0.5])
    """
    seen = scan.valid
    at_end = seen & (scan.ranges > _END * scan.range_max)
    if _MANY * seen.sum() < at_end.sum() < seen.sum():
        seen &= ~at_end
    xy = scan_xy(scan)[seen]
    cells = np.floor(xy / side)
    # np.unique compares pairs as structures, and reports Ctrl-C meanwhile as a TypeError.
    by_cell = np.lexsort(cells.T[::-1])
    first = np.append(True, np.any(np.diff(cells[by_cell], axis=0) != 0, axis=1))
    cell = np.empty(len(cells), np.int64)
    cell[by_cell] = np.cumsum(first) - 1
    count = np.bincount(cell)
    x, y = (np.bincount(cell, along) / count for along in xy.T)
    angles = np.arctan2(y, x)
    order = np.argsort(angles, kind="stable")
    far = np.hypot(x, y)[order]
    silent = _silent(scan, scan.no_return | (scan.valid & ~seen), far.max(initial=0.0))
    return Readings(far, angles[order], silent)


def _silent(scan: LaserScan, none: BoolArray, reach: float) -> Readings:
    """The rays that met nothing, nor did their neighbours: a lost reading is no open space."""
    order = np.argsort(scan.angles, kind="stable")
    none = none[order]
    angles = scan.angles[order][none & np.roll(none, 1) & np.roll(none, -1)]
    return Readings(np.full(len(angles), reach), angles)


def scan_xy(scan: LaserScan) -> FloatArray:
    """Endpoints (N, 2) of all readings, sensor frame; what is not valid is at the origin."""
    r = np.where(scan.valid, scan.ranges, 0.0)
    return np.column_stack((r * np.cos(scan.angles), r * np.sin(scan.angles)))


def _surfaces(rho: FloatArray, phi: FloatArray) -> tuple[IntArray, IntArray]:
    """First and last ray, by index, on the surface that each of (N,) rays met."""
    gap = np.diff(phi)
    jump = np.abs(np.diff(rho))
    near = np.minimum(rho[1:], rho[:-1])
    one = gap[: len(rho) // 3]  # of one turn; several echoes of a ray are no gap
    usual = np.median(one[one > _SAME]) if np.any(one > _SAME) else np.inf
    broken = (jump > 5 * _SIGMA + near * gap / np.tan(GRAZING)) | (
        gap > min(_GAP * usual, _MAX_GAP)
    )
    surface = np.concatenate(([0], np.cumsum(broken)))
    starts = np.concatenate(([0], np.flatnonzero(broken) + 1, [len(rho)]))
    return starts[surface], starts[surface + 1] - 1


def _regress(moments: FloatArray, low: IntArray, high: IntArray, ray: FloatArray) -> FloatArray:
    """Fit lines to the points ``low..high-1``: direction, standard error, excess; (3, N).

    The excess is by how many standard deviations of chi-square the residuals are larger than
    the noise explains. Where a window has fewer than three neighbours: NaN, inf, inf.
    """
    m = (high - low).astype(np.float64)
    sums = moments[high] - moments[low]
    mx, my, xx, yy, xy = (sums / m[:, None]).T
    xx, yy, xy = xx - mx * mx, yy - my * my, xy - mx * my
    mean, half = (xx + yy) / 2, (xx - yy) / 2
    spread = np.hypot(half, xy)
    line = 0.5 * np.arctan2(2 * xy, 2 * half)
    residual = np.maximum(mean - spread, 0.0)
    # The noise is along the ray; what counts is its part across the line.
    noise = (_SIGMA * np.sin(line - ray)) ** 2
    enough = m > _MIN_NEIGHBOURS
    with np.errstate(divide="ignore", invalid="ignore"):
        unbiased = residual * m / (m - 2)
        sigma = np.sqrt(np.maximum(noise, unbiased) / (m * (mean + spread)))
        excess = (unbiased / _SIGMA**2 - 1) * np.sqrt((m - 2) / 2)
    return np.where(enough, (line, sigma, excess), [[np.nan], [np.inf], [np.inf]])
