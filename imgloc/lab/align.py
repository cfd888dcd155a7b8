"""Two maps of one place: where one lies in the other's frame, and how well they agree.

The straight walls of one map are a scan of the other. Their directions, as complex images, are
correlated at every heading by FFT. The best places are refined on the signed distance to the walls,
in both maps at once. Maps of one building bend against each other, so a lattice of patches then
follows the walls, and springs hold neighbouring patches together (Sumner et al., Embedded
deformation for shape manipulation, 2007). Walls that one map has and the other sees decide whether
it is the same place.

>>> wall = np.pad(np.zeros((60, 90), bool), 3, constant_values=True)
>>> wall[20:50, 30:33] = wall[40:43, 50:70] = True
>>> a = OccupancyGrid(wall, ~wall, 0.1, Pose2D(-2.0, 1.0))
>>> b = OccupancyGrid(wall[::-1, ::-1], ~wall[::-1, ::-1], 0.1)
>>> found = align_maps(a, b)
>>> found.verdict, round(found.pose.x, 2), round(found.pose.y, 2), round(abs(found.pose.theta), 2)
('unique', 7.6, 7.6, 3.14)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from scipy import fft
from scipy.spatial.distance import cdist

from imgloc.errors import MapError, expect
from imgloc.features.distance import DistanceField, distance_field
from imgloc.features.surface import surface_points
from imgloc.geometry import (
    cell_of,
    inside,
    poses_of,
    rotation,
    transform_points,
    transform_poses,
    values_at,
    wrap,
)
from imgloc.model import (
    BoolArray,
    FloatArray,
    IntArray,
    Localization,
    OccupancyGrid,
    Pose2D,
    compose,
    inverse,
    plain,
)
from imgloc.numbers import number
from imgloc.options import FusedOptions
from imgloc.search.weigh import MODES

_CELL: float = number("align.cell")  # metres: cell and blur of the correlation
_PLACES, _FOLLOWED = MODES, number("align.followed")  # refined, and bent
_WIDTHS = number("align.widths")  # of the kernel of the refinement and the patches, metres
_PATCH, _REACH = number("align.patch")  # metres between patches, and of their weights
_STIFF = number("align.stiff")  # between neighbouring patches, metres and radians
_SLACK = number("align.slack")  # metres that a metre of wall may be off, at the same cost
_NEAR = _CELL  # metres: walls of two maps that are nearer are one
_STRAIGHT = number("align.straight")  # radians: normals that are surer are of walls
_HELD = np.array((1.0, 1.0, 0.1))  # of a patch where nothing pulls it: metres, metres, radians
_DAMPING = 1e-3  # share of the pull that holds a pose where it is, along a corridor
_PATCHES, _LEAST_WALL = 400, 1.0  # at most so many, each with so many metres of wall
_LEAST = number("align.least")  # share of walls that agree, metres of them, overlap
_PLAIN = number("align.plain")  # share of walls that agree, overlap
_SURE = number("align.sure")  # metres
# Best score of the mirrored map that chance alone may make, and share of the best score that makes
# another place a rival.
_CHANCE, _RIVAL = number("align.chance"), number("align.rival")
SCALES = number("align.scales")  # least and greatest scale, and the step between them
_ROUNDED = 0.005  # share by which a scale that is found may be off
# Metres and radians: scans agree where their poses are one. Walls that are nearer are of one place.
_SAME, _ = _VOTE = FusedOptions.separation
_LEAST_MASS = number("align.mass")  # of the scans, as a share, on a transform
_ARM = _REACH  # metres: a heading says as much as a point so far off
_HYPOTHESES, _TRIED = 10, 200  # of a scan, and votes whose transform is tried
_ROUNDS, _LEAST_AWAY = 20, 1e-3  # of least absolute differences; metres
_MOST = np.array((0.3, 0.3, 0.05, 0.02, 0.05))  # of a step, in the units of a pose
_SIDE = 512  # cells of the correlation along a side, about: on larger maps they grow
_POINTS = 2500  # surface points of a map that are refined and judged, about


@dataclass(frozen=True, eq=False)
class Side:
    """The part of one map that is used, in its grid frame: its straight walls. Furniture moves."""

    grid: OccupancyGrid
    xy: FloatArray  #: (N, 2) surface points, metres
    alpha: FloatArray  #: (N,) their normals, radians
    length: float  #: metres of wall that a point stands for
    field: DistanceField

    def thinned(self, most: int) -> "Side":
        """The same with at most so many points, about."""
        k = max(1, len(self.xy) // most)
        return Side(self.grid, self.xy[::k], self.alpha[::k], k * self.length, self.field)


def side_of(grid: OccupancyGrid, name: str = "map") -> Side:
    """The straight walls of a map and the distance to any; a MapError if it has none."""
    surface = surface_points(grid.occupied, grid.free, grid.resolution)
    some = surface.select(surface.valid & (surface.sigma_alpha <= _STRAIGHT))
    if len(some) == 0:
        raise MapError(f"{name}: no straight wall next to a free cell, expected some to compare")
    walls = distance_field(grid.occupied, grid.resolution)
    return Side(grid, some.xy, some.alpha, grid.resolution, walls)


def propose(
    a: Side, b: Side, *, scale: float = 1.0, rough: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Correlate the directions of the walls of two maps at every heading.

    Both faces of a wall have one direction, so a wall that one map saw from one side fits one that
    the other saw from both. The images are of ``exp(2 i alpha)``.

    Parameters
    ----------
    a, b : Side
        The two maps.
    scale : float
        Factor on the lengths of `b`.
    rough : float
        Factor on the cell and on the step between the headings.

    Returns
    -------
    places : (M, 5) float array
        Poses of the grid frame of `b` in that of `a`, metres, metres, radians; the scale; and 0,
        by how many metres the walls of `b` are thicker on each side. Best first.
    scores : (M,) float array
        Cells of wall that agree.
    """
    middle = scale * (b.xy.min(axis=0) + b.xy.max(axis=0)) / 2
    reach = float(np.hypot(*(scale * b.xy - middle).T).max())
    low, high = a.xy.min(axis=0) - reach, a.xy.max(axis=0) + reach
    cell = rough * max(_CELL, 2 * a.grid.resolution, float((high - low).max()) / _SIDE)
    shape = tuple(fft.next_fast_len(math.ceil(n / cell + 8)) for n in (high - low)[::-1])
    image = _directions((a.xy - low) / cell, a.alpha, shape)
    parts = [cv2.GaussianBlur(part.copy(), (0, 0), 1.0) for part in (image.real, image.imag)]
    spectrum = fft.fft2(parts[0] + 1j * parts[1])
    step = rough * float(np.clip(2 * cell / reach, *np.deg2rad((0.5, 2.0))))
    count = math.ceil(math.pi / step)
    found = []
    for theta in np.arange(count) * (math.pi / count):
        turned = (scale * b.xy - middle) @ rotation(theta).T / cell + 0.5
        scan = fft.fft2(_directions(turned, b.alpha + theta, shape))
        # Half a turn leaves the directions as they are, and mirrors the spectrum.
        for other, half in ((scan, 0.0), (np.roll(scan[::-1, ::-1], 1, (0, 1)), math.pi)):
            agree = fft.ifft2(spectrum * np.conj(other)).real.astype(np.float32)
            rows, columns, values = _peaks(agree, _PLACES)
            x, y = (columns + 0.5) * cell + low[0], (rows + 0.5) * cell + low[1]
            rest = np.tile((theta + half, scale, 0.0), (len(x), 1))
            found.append(np.column_stack((x, y, rest, values)))
    poses, scores = np.split(np.concatenate(found), [5], axis=1)
    order = np.argsort(-scores[:, 0], kind="stable")
    poses, scores = poses[order], scores[order, 0]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    poses[:, 0] -= c * middle[0] - s * middle[1]
    poses[:, 1] -= s * middle[0] + c * middle[1]
    kept = _separate(_placed(poses, _some(b)), 3 * cell, _PLACES)
    return poses[kept], scores[kept]


def _some(side: Side) -> FloatArray:
    """A few points of a map that distinguish places, (N, 2) metres."""
    return side.xy[:: max(1, len(side.xy) // 50)]


def _directions(
    cells: FloatArray, alpha: FloatArray, shape: tuple[int, ...]
) -> npt.NDArray[np.complex64]:
    """The directions of walls as a complex image, no longer than 1 in a cell; it wraps around."""
    column, row = np.floor(cells).astype(np.int64).T
    flat, size = row % shape[0] * shape[1] + column % shape[1], shape[0] * shape[1]
    x, y = (np.bincount(flat, part, size) for part in (np.cos(2 * alpha), np.sin(2 * alpha)))
    image = x + 1j * y
    return (image / np.maximum(np.abs(image), 1.0)).reshape(shape).astype(np.complex64)


def _peaks(
    image: npt.NDArray[np.float32], most: int
) -> tuple[IntArray, IntArray, npt.NDArray[np.float32]]:
    """Rows, columns and values of the largest local maxima."""
    top = image >= cv2.dilate(image, np.ones((5, 5), np.uint8))
    index = np.flatnonzero(top)
    values = image.ravel()[index]
    index = index[np.argsort(-values, kind="stable")[:most]]
    return index // image.shape[1], index % image.shape[1], image.ravel()[index]


def _separate(there: FloatArray, near: float, most: int) -> list[int]:
    """The first of C places that are more than `near` metres from each other, in their order.

    `there` (C, N, 2) has some points of a map at each place, metres.
    """
    kept = list[int]()
    for k, points in enumerate(there):
        away = np.square(there[kept] - points).sum(axis=2).mean(axis=1)
        if not (away < near**2).any():
            kept.append(k)
            if len(kept) == most:
                break
    return kept


def _placed(poses: FloatArray, xy: FloatArray) -> FloatArray:
    """Points (N, 2) of a map at C poses (C, 5), (C, N, 2) metres."""
    c, s = (poses[:, 3] * part(poses[:, 2]) for part in (np.cos, np.sin))
    R = np.stack((np.stack((c, s), axis=1), np.stack((-s, c), axis=1)), axis=1)
    return np.asarray(xy @ R + poses[:, None, :2])


class _Pairs(NamedTuple):
    """Which points pull which patches."""

    patch: IntArray  #: (N,)
    point: IntArray  #: (N,)
    share: FloatArray  #: (N,) 0..1


def meet(a: Side, b: Side, pose: FloatArray, *, free: bool = False) -> FloatArray:
    """Move the pose of a map to where its walls meet those of another.

    Gauss-Newton with a shrinking Geman-McClure kernel, as :func:`~imgloc.search.refine.refine`, on
    the distances of the walls of `b` in `a` and of those of `a` in `b`. By how much the walls of
    one are thicker is found, too: else a pose would snap to one face. Walls that face elsewhere do
    not pull.

    Parameters
    ----------
    a, b : Side
        The two maps.
    pose : (5,) float array
        As :func:`propose` gives it.
    free : bool
        Whether the scale is refined, too.
    """
    pairs = [
        _Pairs(np.zeros(n, np.int64), np.arange(n), np.ones(n)) for n in (len(b.xy), len(a.xy))
    ]
    poses = np.array(pose, dtype=np.float64)[None]
    kept = [0, 1, 2, 3, 4] if free else [0, 1, 2, 4]
    for width in _WIDTHS:
        for _ in range(2):
            (A,), (v,) = _equations(a, b, np.zeros((1, 2)), poses, pairs, width)
            A[range(5), range(5)] += _DAMPING * (A[0, 0] + A[1, 1]) + 1e-12
            step = np.linalg.solve(A[np.ix_(kept, kept)], v[kept])
            poses[0, kept] -= np.clip(step, -_MOST[kept], _MOST[kept])
    poses[:, 2] = wrap(poses[:, 2])
    return np.asarray(poses[0])


def _equations(
    a: Side, b: Side, at: FloatArray, poses: FloatArray, pairs: Sequence[_Pairs], width: float
) -> tuple[FloatArray, FloatArray]:
    """Weighted ``J^T J`` (P, 5, 5) and ``J^T e`` (P, 5) of patches.

    The pose (P, 5) of a patch of `b` puts the point `at` (P, 2) of `b` on `a`, and turns the others
    about it. `pairs` are those of the points of `b` and those of `a`.
    """
    A, v = np.zeros((len(at), 5, 5)), np.zeros((len(at), 5))
    for of_b, (k, i, share) in zip((True, False), pairs, strict=True):
        theta, scale, thicker = poses[k, 2:].T
        R = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        if of_b:
            arm = np.einsum("ijn,nj->ni", R, b.xy[i] - at[k]) * scale[:, None]
            e, slope = _looked_up(a.field, arm + poses[k, :2])
            facing, alpha, length, sign = slope, b.alpha[i] + theta, b.length, -1.0
        else:
            arm = a.xy[i] - poses[k, :2]
            there = np.einsum("jin,nj->ni", R, arm) / scale[:, None] + at[k]
            e, slope = _looked_up(b.field, there)
            facing, alpha = np.einsum("ijn,nj->ni", R, slope), a.alpha[i]
            e, slope, length, sign = e * scale, -facing, a.length, 1.0
        e = e + sign * thicker
        weight = share * length * _same_way(facing, alpha) / np.square(1 + np.square(e / width))
        turn = arm[:, 0] * slope[:, 1] - arm[:, 1] * slope[:, 0]
        grow = (arm * slope).sum(axis=1) / scale
        J = np.stack((slope[:, 0], slope[:, 1], turn, grow, np.full(len(k), sign)))
        for r, weighted in enumerate(J * weight):
            v[:, r] += np.bincount(k, weighted * e, len(at))
            for c in range(r + 1):
                A[:, r, c] += np.bincount(k, weighted * J[c], len(at))
    lower = np.tril(A, -1)
    return A + lower.transpose(0, 2, 1), v


def _looked_up(field: DistanceField, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances (N,) at points (N, 2), metres, and their gradients (N, 2)."""
    e, gx, gy = (part.astype(np.float64) for part in field.lookup(*xy.T))
    return e, np.column_stack((gx, gy))


def _same_way(facing: FloatArray, alpha: FloatArray) -> BoolArray:
    """Return whether directions (N, 2) are within 60 degrees of angles (N,)."""
    along = facing[:, 0] * np.cos(alpha) + facing[:, 1] * np.sin(alpha)
    return np.asarray(along > 0.5 * np.hypot(*facing.T))


@dataclass(frozen=True, eq=False)
class Bend:
    """Where a map lies on another: a pose, a scale, and how its parts are moved beyond these."""

    pose: FloatArray  #: (5,) as :func:`propose` gives it
    at: FloatArray  #: (P, 2) centres of the patches, grid frame of `b`, metres
    moved: FloatArray  #: (P, 3) how they are moved and turned on `a`: metres, metres, radians

    def shift(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Moves of points (N, 2) of `b`, grid frame, on `a`: (N, 2) m, and turned (N,) rad."""
        if len(self.at) == 0:
            return np.zeros((len(xy), 2)), np.zeros(len(xy))
        spread = _REACH / self.pose[3]
        near = -cdist(xy, self.at, "sqeuclidean") / (2 * spread**2)
        weight = np.exp(near - near.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        turn, size = weight @ self.moved[:, 2], self.pose[3] * rotation(self.pose[2]).T
        arm = (xy @ size) * turn[:, None] - weight @ (self.moved[:, 2:] * (self.at @ size))
        return weight @ self.moved[:, :2] + np.column_stack((-arm[:, 1], arm[:, 0])), turn

    def onto(self, xy: FloatArray) -> FloatArray:
        """Points (N, 2) of `b` on `a`, grid frames, metres."""
        straight = self.pose[3] * xy @ rotation(self.pose[2]).T + self.pose[:2]
        return np.asarray(straight + self.shift(xy)[0])

    def back(self, xy: FloatArray) -> FloatArray:
        """Points (N, 2) of `a` on `b`, grid frames, metres; exact where the shift is even."""
        R, s = rotation(self.pose[2]), self.pose[3]
        straight = (xy - self.pose[:2]) @ R / s
        return np.asarray(straight - self.shift(straight)[0] @ R / s)


def bent(a: Side, b: Side, pose: FloatArray) -> Bend:
    """Let patches of a map, put on another by a pose (5,), follow the walls there."""
    size = pose[3] * rotation(pose[2]).T
    gap = _PATCH / pose[3]
    while True:
        square = np.floor(b.xy / gap).astype(np.int64)
        cells, count = np.unique(square, axis=0, return_counts=True)
        if len(cells) <= _PATCHES:
            break
        gap *= 2
    cells = cells[count * b.length * pose[3] >= _LEAST_WALL]
    at = (cells + 0.5) * gap
    start = np.column_stack((at @ size + pose[:2], np.tile(pose[2:], (len(at), 1))))
    if len(at) == 0:
        return Bend(pose, at, np.zeros((0, 3)))
    pairs = [_pairs(b.xy, at, _REACH / pose[3]), _pairs(a.xy, start[:, :2], _REACH)]
    springs = _springs(cells, start[:, :2])
    moved = np.zeros((len(at), 3))
    for width in _WIDTHS:
        for _ in range(2):
            poses = start + np.column_stack((moved, np.zeros((len(at), 2))))
            A, v = _equations(a, b, at, poses, pairs, width)
            whole, pull = springs.copy(), springs @ moved.ravel() + v[:, :3].ravel() / _SLACK**2
            for k in range(len(at)):
                whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += A[k, :3, :3] / _SLACK**2
            step = np.linalg.solve(whole, pull).reshape(-1, 3)
            moved -= np.clip(step, -_MOST[:3], _MOST[:3])
    return Bend(pose, at, moved)


def _pairs(xy: FloatArray, at: FloatArray, reach: float) -> _Pairs:
    """Points (N, 2) near patches (P, 2), with Gaussian shares of which `reach` is the deviation."""
    square = cdist(at, xy, "sqeuclidean")
    patch, point = np.nonzero(square < (2 * reach) ** 2)
    return _Pairs(patch, point, np.exp(-square[patch, point] / (2 * reach**2)))


def _springs(cells: IntArray, there: FloatArray) -> FloatArray:
    """Stiffness (3P, 3P) of springs between patches on neighbouring `cells` (P, 2) of a lattice.

    A patch `there` (P, 2) that moves and turns asks its neighbours to do so as if both were rigid.
    """
    by, n = {tuple(cell): k for k, cell in enumerate(cells.tolist())}, len(cells)
    K = np.diag(np.tile(1 / np.square(_HELD), n))
    weights = np.array((_STIFF[0], _STIFF[0], _STIFF[1])) ** -2.0
    for k, (column, row) in enumerate(cells.tolist()):
        for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1), (-1, 0), (0, -1), (-1, -1), (-1, 1)):
            if (j := by.get((column + dx, row + dy))) is None:
                continue
            x, y = there[j] - there[k]
            J = np.array([[1, 0, -y, -1, 0, 0], [0, 1, x, 0, -1, 0], [0, 0, 1, 0, 0, -1]])
            at = np.r_[3 * k : 3 * k + 3, 3 * j : 3 * j + 3]
            K[np.ix_(at, at)] += J.T @ (weights[:, None] * J)
    return np.asarray(K, dtype=np.float64)


@dataclass(frozen=True)
class Agreement:
    """Agreement of two maps where one lies on the other: metres of straight wall, m2."""

    hit: float  #: of wall that both have
    missed: float  #: of wall that only one has, where the other saw free space or solid wall
    shared: float  #: m2 that both saw free
    overlap: float  #: the same as a share of the smaller one's free space
    residual: float  #: median distance of walls that both have, metres, without any bend
    bend: float  #: how far 95 % of these are moved by the bend at most, metres

    @property
    def share(self) -> float:
        """Share of the walls, which the other map could have, that it has."""
        return self.hit / max(self.hit + self.missed, 1e-9)

    @property
    def score(self) -> float:
        """Metres of wall that speak for it less those that speak against it."""
        return self.hit - self.missed

    @property
    def plausible(self) -> bool:
        """True if so much agrees, and so much is shared, that it may be the same place."""
        share, length, overlap = _LEAST
        return bool(self.share >= share and self.hit >= length and self.overlap >= overlap)

    @property
    def plain(self) -> bool:
        """True if so much agrees that no chance makes it."""
        share, overlap = _PLAIN
        return bool(self.share >= share and self.overlap >= overlap)


def agreement(a: Side, b: Side, bend: Bend) -> Agreement:
    """Agreement of two maps if one is put on the other."""
    theta, scale, thicker = bend.pose[2:].tolist()
    straight = _rigid(bend.pose)
    hit = missed = 0.0
    away, moved = list[FloatArray](), list[FloatArray]()
    onto, back = theta + bend.shift(b.xy)[1], -theta - bend.shift(straight.back(a.xy))[1]
    for one, other, put, flat, turn, size, off in (
        (b, a, bend.onto, straight.onto, onto, 1.0, -thicker),
        (a, b, bend.back, straight.back, back, scale, thicker),
    ):
        near, length = max(_NEAR, 1.5 * a.grid.resolution), one.length
        xy = put(one.xy)
        e, slope = _looked_up(other.field, xy)
        e = size * e + off
        fits = (np.abs(e) < near) & _same_way(slope, one.alpha + turn)
        on = inside(cell_of(xy, other.grid.resolution), other.grid.info)
        free = values_at(other.grid.free, xy, other.grid.resolution)
        against = ((e >= near) & free) | ((e <= -near) & on)
        hit += length * np.count_nonzero(fits & on)
        missed += length * np.count_nonzero(against)
        rigid = flat(one.xy[fits & on])
        away.append(np.abs(size * _looked_up(other.field, rigid)[0] + off))
        moved.append(size * np.hypot(*(xy[fits & on] - rigid).T))
    cells = np.argwhere(a.grid.free[::2, ::2]) * 2 + 1
    middles = np.asarray(cells[:, ::-1] * a.grid.resolution, dtype=np.float64)
    shared = values_at(b.grid.free, bend.back(middles), b.grid.resolution)
    both = 4 * a.grid.resolution**2 * np.count_nonzero(shared)
    areas = [
        float(np.count_nonzero(side.grid.free)) * (size * side.grid.resolution) ** 2
        for side, size in ((a, 1.0), (b, scale))
    ]
    residual, far = (
        float(np.quantile(some, q)) if len(some := np.concatenate(every)) else math.nan
        for every, q in ((away, 0.5), (moved, 0.95))
    )
    return Agreement(hit, missed, both, min(1.0, both / max(min(areas), 1e-9)), residual, far)


@dataclass(frozen=True, eq=False)
class ScanAlignment:
    """The transform between two maps that scans, located in both, agree on."""

    pose: Pose2D | None  #: of the frame of `b` in that of `a`; None if too few scans agree
    used: int  #: scans that agree on it
    given: int  #: scans with a hypothesis in both maps
    located: int  #: scans with a pose in both maps: neither ``no-match`` nor ``invalid``
    residual: float  #: median distance between the two places of a scan, metres
    turn: float  #: median angle between them, radians
    #: (used, 3) the poses of these scans in the map frames of `b` and of `a`
    of_b: FloatArray
    of_a: FloatArray

    def as_row(self) -> dict[str, Any]:
        """Plain values for JSON."""
        names = ("pose", "used", "given", "located", "residual", "turn")
        return dict(plain({name: getattr(self, name) for name in names}))


def align_scans(pairs: Sequence[tuple[Localization, Localization]]) -> ScanAlignment:
    """Find the one transform by which the answers to the same scans in two maps differ.

    Parameters
    ----------
    pairs : sequence of (Localization, Localization)
        The answers to each scan in the map `a` and in the map `b`. Each hypothesis of one, with
        each of the other, is a vote that weighs as both masses.

    Notes
    -----
    The scale is 1. A scan that is ambiguous in a map takes part: the others decide which of its
    poses is meant. So does one that is ``no-match``, as most are in an old map. More than half of
    the scans must agree, with a share of their mass that chance does not reach, and two must have a
    pose in both maps. The transform has the least sum of absolute differences, so that a few scans
    that are far off do not pull.

    Examples
    --------
    >>> align_scans([]).pose is None
    True
    """
    some = [(a, b) for a, b in pairs if a.hypotheses and b.hypotheses]
    located = np.array([a.pose is not None and b.pose is not None for a, b in some], np.bool_)
    count, none = int(np.count_nonzero(located)), np.zeros((0, 3))
    lost = ScanAlignment(None, 0, len(some), count, math.nan, math.nan, none, none)
    if count < 2:
        return lost
    votes = [
        (one, other, k)
        for k, (a, b) in enumerate(some)
        for one in a.hypotheses[:_HYPOTHESES]
        for other in b.hypotheses[:_HYPOTHESES]
    ]
    there, here = (poses_of(column) for column in ([v[0] for v in votes], [v[1] for v in votes]))
    mass = np.array([one.mass * other.mass for one, other, _ in votes])
    scan = np.array([k for _, _, k in votes])
    best = (0.0, np.zeros(0, np.int64))
    for k in np.argsort(-mass, kind="stable")[:_TRIED]:
        T = compose(Pose2D(*there[k]), inverse(Pose2D(*here[k])))
        chosen = _voting(T, there, here, mass, scan)
        if (total := float(mass[chosen].sum())) > best[0] + 1e-9:
            best = total, chosen
    chosen = best[1]
    for _ in range(3):
        pose = _between(there[chosen], here[chosen])
        chosen = _voting(pose, there, here, mass, scan)
        if 2 * len(chosen) <= len(some) or mass[chosen].sum() < _LEAST_MASS * len(some):
            return lost
    pose = _between(there[chosen], here[chosen])
    away, turned = _apart(pose, there[chosen], here[chosen])
    residuals = float(np.median(away)), float(np.median(turned))
    return ScanAlignment(
        pose, len(chosen), len(some), count, *residuals, here[chosen], there[chosen]
    )


def _apart(T: Pose2D, there: FloatArray, here: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances of poses (N, 3) that a transform moves from others: (N,) metres, (N,) radians."""
    moved = transform_poses(T, here)
    return np.hypot(*(moved - there)[:, :2].T), np.abs(wrap(moved[:, 2] - there[:, 2]))


def _voting(
    T: Pose2D, there: FloatArray, here: FloatArray, mass: FloatArray, scan: IntArray
) -> IntArray:
    """The heaviest vote of each scan among those that agree with a transform, if one does."""
    away, turn = _apart(T, there, here)
    (good,) = np.nonzero((away < _VOTE[0]) & (turn < _VOTE[1]))
    good = good[np.argsort(-mass[good], kind="stable")]
    return np.asarray(good[np.unique(scan[good], return_index=True)[1]])


def _between(there: FloatArray, here: FloatArray) -> Pose2D:
    """The transform that takes poses `here` (N, 3) nearest to those `there`, metres and radians.

    Positions give the turn if they are far apart, headings if they are not: a heading weighs as an
    arm of :data:`_ARM` metres. Least absolute differences, by least squares with other weights.
    """
    weight = np.ones(len(there))
    turn = there[:, 2] - here[:, 2]
    for _ in range(_ROUNDS):
        a, b = (np.average(poses[:, :2], axis=0, weights=weight) for poses in (there, here))
        p, q = there[:, :2] - a, here[:, :2] - b
        x = weight @ ((p * q).sum(axis=1) + _ARM**2 * np.cos(turn))
        y = weight @ (q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0] + _ARM**2 * np.sin(turn))
        theta = math.atan2(y, x)
        off = a - rotation(theta) @ b
        pose = Pose2D(off[0], off[1], theta)
        away, turned = _apart(pose, there, here)
        weight = 1 / np.maximum(np.hypot(away, _ARM * turned), _LEAST_AWAY)
    return pose


@dataclass(frozen=True)
class Place:
    """One place where a map may lie on another."""

    pose: Pose2D  #: of the frame of `b` in that of `a`, map frames
    agreement: Agreement
    bend: Bend

    @property
    def scale(self) -> float:
        """Factor on the lengths of `b`."""
        return float(self.bend.pose[3])

    @property
    def allowed(self) -> bool:
        """True if the scale is one of those that are searched, 0.8 to 1.25."""
        return bool(SCALES[0] <= self.scale <= SCALES[1])


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where a map `b` lies in the frame of a map `a`, and how far to trust it.

    A point p of `b`, map frame, is at ``pose ⊕ scale * p`` in the map frame of `a`.
    """

    #: ``unique``; ``ambiguous``, where another place agrees about as well; ``no-match``
    verdict: str
    places: tuple[Place, ...]  #: what was looked at closely, best first; also without a match
    origins: tuple[Pose2D, Pose2D]  #: of the grids of `a` and `b`
    corners: FloatArray  #: (4, 2) of what is known of `b`, its map frame, metres

    @property
    def best(self) -> Place | None:
        """The place that agrees best; None if the verdict is ``no-match``."""
        return None if self.verdict == "no-match" else self.places[0]

    @property
    def pose(self) -> Pose2D | None:
        """Pose of the frame of `b` in that of `a`; None if the verdict is ``no-match``."""
        return None if self.best is None else self.best.pose

    def move(self, poses: FloatArray) -> FloatArray:
        """Carry poses (N, 3) of the map frame of `b` over to that of `a`: metres, metres, radians.

        They follow the bend: what stood beside a wall of `b` stands beside that wall of `a`. It is
        a MapError if nothing matches.
        """
        if self.best is None:
            raise MapError("the maps do not match: expected maps of one place to carry poses over")
        bend, (a, b) = self.best.bend, self.origins
        local = transform_poses(inverse(b), np.asarray(poses, dtype=np.float64).reshape(-1, 3))
        turn = bend.pose[2] + bend.shift(local[:, :2])[1]
        there = np.column_stack((bend.onto(local[:, :2]), local[:, 2] + turn))
        return transform_poses(a, there)

    def as_row(self) -> dict[str, Any]:
        """Plain values for JSON: all but the verdict and `others` are null without a match."""

        def numbers(place: Place) -> dict[str, Any]:
            found = place.agreement
            return dict(plain(place.pose)) | {
                "scale": place.scale, "thicker": 2 * float(place.bend.pose[4]),
                "residual": found.residual, "bend": found.bend,
                "agreement": found.share, "overlap": found.overlap,
                "agreeing_m": found.hit, "contradicting_m": found.missed,
            }  # fmt: skip

        listed = [numbers(place) for place in self.places]
        first = listed.pop(0) if self.best is not None else dict.fromkeys(listed[0])
        return dict(plain({"verdict": self.verdict} | first | {"others": listed}))


def align_maps(
    a: OccupancyGrid, b: OccupancyGrid, *, scale: bool = False, scans: ScanAlignment | None = None
) -> Alignment:
    """Find where a map lies in the frame of another map of the same place.

    The maps may have other resolutions, origins and wall thicknesses, be turned by any angle, and
    overlap in part.

    Parameters
    ----------
    a, b : OccupancyGrid
        The two maps.
    scale : bool
        Whether `b` may have another scale, 0.8 to 1.25 times that of `a`.
    scans : ScanAlignment, optional
        What :func:`align_scans` found. The place that scans agree on comes first, and is ``unique``
        if the walls agree, too. If they do not, the verdict is ``ambiguous``.

    Returns
    -------
    Alignment
        A pose, in map frames, with the agreement of the walls, the bend, and other places. If walls
        contradict each other as those of different buildings do, or agree best at a scale beyond
        0.8 to 1.25, the verdict is ``no-match``.

    Notes
    -----
    Any two buildings with corridors agree somewhere. A mirror image, which is no building's, shows
    how well: unless nearly all walls agree, those of `b` must agree far better than if mirrored.

    Raises
    ------
    MapError
        If a map has no wall next to free space.
    TypeError
        If an argument is no OccupancyGrid.
    """
    for value, name in ((a, "a"), (b, "b")):
        expect(value, OccupancyGrid, name)
    one, other = side_of(a, "a"), side_of(b, "b")
    start = None
    if scans is not None and scans.pose is not None:
        T = compose(compose(inverse(a.origin), scans.pose), b.origin)
        start = np.array([(T.x, T.y, T.theta, 1.0, 0.0)])
    places = tuple(
        Place(_in_map_frames(a, b, bend), fit, bend)
        for bend, fit in _places(one, other, scale, start)
    )
    made = Alignment("unique", places, (a.origin, b.origin), corners_of(b))
    if scans is not None and scans.pose is not None:
        made = _as_scans_say(made, scans)
        return made if made.places[0].allowed else replace(made, verdict="no-match")
    best = places[0].agreement
    if not best.plausible or not (best.plain or best.score >= _SURE) or not places[0].allowed:
        return replace(made, verdict="no-match")
    if not best.plain:
        mirrored = replace(b, occupied=b.occupied[:, ::-1], free=b.free[:, ::-1])
        (_, chance), *_ = _places(one, side_of(mirrored, "b"), scale, None)
        if best.score < _CHANCE * chance.score:
            return replace(made, verdict="no-match")
    rivals = [p.agreement for p in places[1:] if p.agreement.plausible and p.allowed]
    if rivals and rivals[0].score >= _RIVAL * best.score:
        return replace(made, verdict="ambiguous")
    return made


def _places(
    a: Side, b: Side, scale: bool, start: FloatArray | None
) -> list[tuple[Bend, Agreement]]:
    """Where a map may lie on another, best first; a `start` (1, 5) is looked at in any case."""
    few_a, few_b = a.thinned(_POINTS), b.thinned(_POINTS)
    if scale:
        low, high, step = SCALES
        factors = low * step ** np.arange(math.ceil(math.log(high / low, step)) + 1)
        parts = [propose(a, b, scale=float(f), rough=2.0) for f in factors]
        found, scores = (np.concatenate(column) for column in zip(*parts, strict=True))
        found = found[np.argsort(-scores, kind="stable")][: 2 * _PLACES]
    else:
        found, _ = propose(a, b)
    if start is not None:
        found = np.concatenate((start, found))
    poses = np.array([meet(few_a, few_b, pose, free=scale) for pose in found])
    # A true scale at the end of the range may be refined a little beyond it.
    nearest = poses[:, 3].clip(*SCALES[:2])
    poses[:, 3] = np.where(np.abs(poses[:, 3] / nearest - 1) <= _ROUNDED, nearest, poses[:, 3])
    score = np.array([agreement(few_a, few_b, _rigid(pose)).score for pose in poses])
    score[: 0 if start is None else 1] = np.inf
    order, some = np.argsort(-score, kind="stable"), _some(b)
    order = order[_separate(_placed(poses[order], some), _SAME, _FOLLOWED)]
    bends = [bent(few_a, few_b, poses[k]) for k in order]
    fits = [agreement(few_a, few_b, bend) for bend in bends]
    # Bends may bring two together.
    order = np.argsort([-fit.score for fit in fits], kind="stable")
    there = np.array([bends[k].onto(some) for k in order])
    return [(bends[order[k]], fits[order[k]]) for k in _separate(there, _SAME, _FOLLOWED)]


def _rigid(pose: FloatArray) -> Bend:
    """A map that does not bend."""
    return Bend(pose, np.zeros((0, 2)), np.zeros((0, 3)))


def _in_map_frames(a: OccupancyGrid, b: OccupancyGrid, bend: Bend) -> Pose2D:
    """The pose of the map frame of `b` in that of `a`."""
    x, y, theta, scale, _ = bend.pose.tolist()
    corner = compose(a.origin, Pose2D(x, y, theta))
    turn = corner.theta - b.origin.theta
    off = scale * rotation(turn) @ (b.origin.x, b.origin.y)
    return Pose2D(corner.x - off[0], corner.y - off[1], turn)


def corners_of(grid: OccupancyGrid) -> FloatArray:
    """Corners (4, 2) of the rectangle that holds all known cells, map frame, metres."""
    known = grid.occupied | grid.free
    (left, right), (low, high) = (np.flatnonzero(known.any(axis=k))[[0, -1]] for k in (0, 1))
    cells = [(left, low), (right + 1, low), (left, high + 1), (right + 1, high + 1)]
    return transform_points(grid.origin, np.array(cells, dtype=np.float64) * grid.resolution)


def differences(found: Alignment, scans: ScanAlignment) -> dict[str, Any]:
    """Distance between where walls and scans put `b`: metres, radians; None without both.

    `walls_apart` and `walls_turned` are those of the middle of the scans' poses and of their
    headings, carried over as :meth:`Alignment.move` does: each scan has an error of its own.
    `corners_apart` has the distances of the corners of `b` by the one pose of the walls from those
    by the one pose of the scans. `halves_apart` has those by the first and by the second half of
    the scans: where two maps bend against each other no one pose is better than that.
    """
    keys = ("walls_apart", "walls_turned", "corners_apart", "halves_apart")
    if found.pose is None or scans.pose is None:
        return dict.fromkeys(keys)
    apart = found.move(scans.of_b) - scans.of_a
    away = float(np.hypot(*np.median(apart[:, :2], axis=0)))
    half = len(scans.of_a) // 2
    first, second = (
        _between(scans.of_a[some], scans.of_b[some]) for some in (slice(half), slice(half, None))
    )
    values = (
        away, float(abs(np.median(wrap(apart[:, 2])))),
        _distances(found.pose, scans.pose, found.corners),
        _distances(first, second, found.corners),
    )  # fmt: skip
    return dict(zip(keys, values, strict=True))


def _distances(T: Pose2D, U: Pose2D, xy: FloatArray) -> list[float]:
    """Distances between points (N, 2) that two transforms move, metres."""
    return [float(d) for d in np.hypot(*(transform_points(T, xy) - transform_points(U, xy)).T)]


def _as_scans_say(found: Alignment, scans: ScanAlignment) -> Alignment:
    """The alignment with the place first on which the scans agree."""

    def apart(place: Place) -> float:
        alone = replace(found, places=(place,))
        return differences(alone, scans)["walls_apart"] or 0.0

    places = sorted(found.places, key=lambda place: apart(place) > _SAME)
    first, best = places[0].agreement, found.places[0].agreement
    if apart(places[0]) > _SAME or first.score < _RIVAL * best.score:
        return replace(found, verdict="ambiguous" if best.plausible else "no-match")
    return replace(found, verdict="unique", places=tuple(places))
