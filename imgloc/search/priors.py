"""The prior: where the sensor may be before the scan is looked at, and which way it may face.

A prior is a set of poses. All other poses have probability 0. A prior that excludes the twin of the
true pose can therefore make an ambiguous scan unique. Poses of the set may have weights, which
multiply their masses once they are found. Somebody is sure of a set; a weight may be wrong. It
therefore moves mass, and takes ``unique`` away, but never gives it.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.pyramid import Level, any_of_blocks
from imgloc.geometry import cell_of, in_grid_frame, inside, values_at, wrap
from imgloc.model import BoolArray, FloatArray, GridInfo, IntArray, OccupancyGrid, Pose2D
from imgloc.numbers import number
from imgloc.options import FusedOptions, Hint, Known, Prior
from imgloc.search.refine import refine

SLIP = FusedOptions.separation
"""How far outside of the prior a refined pose, as one hypothesis, may lie and be brought back."""
ASTRAY = number("priors.astray")
"""Weight of poses far from all hints, because hints may be wrong; at a hint it is 1."""
_LOOKS = 1 << 18  # cells that are looked at in one go


def ranked(
    prior: Prior, poses: FloatArray, share: FloatArray, resolution: float
) -> tuple[IntArray, FloatArray]:
    """Order of poses (M, 3), grid frame, by their shares (M,) times weights, and these shares.

    Poses of weight 0 come last, with a share of 0; the others have the sum of all shares.

    Examples
    --------
    >>> prior = Prior(weights=np.array([[0.2, 0.8, 0.0]]))
    >>> poses = np.array([[0.5, 0.5, 0.0], [1.5, 0.5, 0.0], [2.5, 0.5, 0.0]])
    >>> order, share = ranked(prior, poses, np.array([0.5, 0.25, 0.25]), 1.0)
    >>> order.tolist(), share.round(3).tolist()
    ([1, 0, 2], [0.667, 0.333, 0.0])
    """
    if prior.weights is None and not prior.hints:
        return np.arange(len(share)), share
    weight = np.ones(len(share))
    if prior.weights is not None:
        weight *= values_at(prior.weights, poses[:, :2], resolution)
    for some in prior.hints:
        weight *= np.maximum(sum(_at_hint(one, poses) for one in some), ASTRAY)
    found = share * weight
    order = np.argsort(-found, kind="stable")
    return order, found[order] * (share.sum() / max(1e-300, found.sum()))


def _at_hint(hint: Hint, poses: FloatArray) -> FloatArray:
    """Weights (C,) of poses (C, 3) by one hint."""
    x, y, theta = poses.T
    square = (np.square(x - hint.x) + np.square(y - hint.y)) / hint.metres**2
    square += np.square(wrap(theta - hint.theta) / hint.radians)
    return np.asarray(hint.weight * np.exp(-square / 2))


def nearest(prior: Prior, poses: FloatArray, resolution: float) -> FloatArray:
    """Move poses (C, 3), grid frame, that lie just outside the prior to its border.

    A pose that refinement takes a few centimetres out of the prior is still the same place. Poses
    farther out than :data:`SLIP` are left out. `resolution` is the side of a cell, metres.

    Examples
    --------
    >>> prior = Prior(np.array([[True, False, False]]), (0.0, 0.5))
    >>> nearest(prior, np.array([[0.45, 0.1, 0.6], [1.7, 0.1, -0.1]]), 0.4).round(3).tolist()
    [[0.4, 0.1, 0.5]]
    """
    poses = np.array(poses, dtype=np.float64)
    if prior.heading is not None:
        poses = poses[prior.headings(poses[:, 2], SLIP[1])]
        centre, tolerance = prior.heading
        turned = ~prior.headings(poses[:, 2])
        turn = np.clip(wrap(poses[turned, 2] - centre), -tolerance, tolerance)
        poses[turned, 2] = wrap(centre + turn)
    if prior.cells is None:
        return poses
    beside = np.flatnonzero(~prior.admits(poses, resolution))
    cells = _nearest_cells(prior.cells, cell_of(poses[beside, :2], resolution), resolution)
    # Not on the edge itself, which may belong to the next cell.
    low = (cells[:, ::-1] + 1e-6) * resolution
    high = (cells[:, ::-1] + 1 - 1e-6) * resolution
    poses[beside, :2] = np.clip(poses[beside, :2], low, high)
    return poses[prior.admits(poses, resolution)]


def refined(
    poses: FloatArray, xy: FloatArray, features: MapFeatures, sigmas: Sequence[float], prior: Prior
) -> FloatArray:
    """Refine poses (M, 3) by scan points (N, 2), with and without what is movable.

    The result has those at which a sensor can be; see :func:`~imgloc.search.refine.refine`.
    """
    moved = [refine(poses, xy, there.field, sigmas=sigmas) for there in features.both]
    return standing(np.concatenate(moved), prior, features)


def standing(poses: FloatArray, prior: Prior, features: MapFeatures) -> FloatArray:
    """The poses (C, 3), grid frame, that are in the prior and where a sensor can be.

    Poses just outside the prior are moved to its border, as :func:`nearest` does.
    """
    poses = nearest(prior, poses, features.grid.resolution)
    return poses[stands(poses, prior, features)]


def stands(poses: FloatArray, prior: Prior, features: MapFeatures) -> BoolArray:
    """Return whether each pose (C, 3), grid frame, is in the prior and can hold a sensor: (C,)."""
    ok = values_at(features.standable, poses[:, :2], features.grid.resolution)
    return ok & prior.admits(poses, features.grid.resolution)


def on_lattice(prior: Prior, free: BoolArray, factor: int) -> BoolArray:
    """The lattice cells in `free` that hold a cell of the prior, (H', W') bool.

    A lattice cell has `factor` x `factor` cells of the map.
    """
    if prior.cells is None:
        return free
    return np.asarray(free & any_of_blocks(prior.cells, factor))


def pyramid_levels(prior: Prior, levels: tuple[Level, ...], resolution: float) -> tuple[Level, ...]:
    """The pyramid with only those free cells that touch the prior.

    `resolution` is the side of a map cell, metres.
    """
    if prior.cells is None:
        return levels
    return tuple(
        replace(level, free=on_lattice(prior, level.free, round(level.resolution / resolution)))
        for level in levels
    )


def prior_of(known: Known, grid: OccupancyGrid) -> Prior:
    """Turn constraints in the map frame into a prior on the cells of a map.

    Two constraints on the heading raise a ConfigError.

    Examples
    --------
    >>> free = np.ones((4, 4), bool)
    >>> prior = prior_of(Known(heading=(1.0, 0.1)), OccupancyGrid(~free, free, 1.0))
    >>> prior.heading, prior.cells is None
    ((1.0, 0.1), True)
    """
    prior = Prior()
    hints = list(known.hints)
    if known.near is not None and known.sd is not None:
        hints.append(Hint(*known.near[:3], *known.sd))
    elif known.near is not None:
        x, y, yaw, radius, tolerance = known.near
        at = in_grid_frame(Pose2D(x, y, yaw), grid)
        about = {"x": x, "y": y, "theta": yaw, "radius": radius, "tolerance": tolerance}
        disc = near(grid.info, at.x, at.y, radius)
        prior &= Prior(disc, (at.theta, tolerance), {"near": about})
    if known.heading is not None:
        yaw, tolerance = known.heading
        about = {"theta": yaw, "tolerance": tolerance}
        prior &= Prior(None, (yaw - grid.origin.theta, tolerance), {"heading": about})
    if known.clearance:
        cells = clearance(grid, known.clearance)
        prior &= Prior(cells, None, {"clearance": known.clearance})
    if hints:
        poses = (in_grid_frame(Pose2D(one.x, one.y, one.theta), grid) for one in hints)
        own = (replace(one, **vars(pose)) for one, pose in zip(hints, poses, strict=True))
        name = "hints" if known.hints else "near"
        prior &= Prior(hints=(tuple(own),), about={name: [vars(one) for one in hints]})
    return prior


def leaves_none(prior: Prior, features: MapFeatures) -> bool:
    """Return whether the prior has no cell of the map in which a sensor can be."""
    return prior.cells is not None and not bool((prior.cells & features.standable).any())


def near(info: GridInfo, x: float, y: float, radius: float) -> BoolArray:
    """Cells (H, W) whose centre is within `radius` metres of a point in the grid frame, metres.

    The cell that holds the point is always one of them. A radius that is not positive and finite
    raises a ConfigError.

    Examples
    --------
    >>> near(GridInfo(1, 4, 1.0), 0.5, 0.5, 1.0).tolist()
    [[True, True, False, False]]
    """
    if not (np.isfinite(radius) and radius > 0):
        raise ConfigError(f"the radius must be positive and finite, got {radius:g} m")
    columns = (np.arange(info.width) + 0.5) * info.resolution - x
    rows = (np.arange(info.height) + 0.5) * info.resolution - y
    disc = np.asarray(np.add.outer(rows**2, columns**2) <= radius**2 + 1e-9)
    here = cell_of(np.array([x, y]), info.resolution)
    if inside(here, info):
        disc[tuple(here)] = True
    return disc


def clearance(grid: OccupancyGrid, radius: float) -> BoolArray:
    """Cells (H, W) whose centre is at least `radius` metres away from everything that is not free.

    Unknown cells and the world off the map are not free, because no robot has been there. The
    distance is that between cell centres, less half a cell. It is exact for walls along the axes,
    and at most 0.21 cells too large at a corner. A radius that is negative or not finite raises a
    ConfigError.

    Examples
    --------
    >>> free = np.ones((1, 7), bool)
    >>> [int(clearance(OccupancyGrid(~free, free, 1.0), radius).sum()) for radius in (0.5, 1.0)]
    [7, 0]
    """
    if not (np.isfinite(radius) and radius >= 0):
        raise ConfigError(f"the clearance must be finite and not negative, got {radius:g} m")
    padded = np.pad(grid.free, 1).astype(np.uint8)
    # Distances are between centres; the blocked cell itself begins half a cell nearer.
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return np.asarray(grid.free & ((distance - 0.5) * grid.resolution >= radius - 1e-6))


def _nearest_cells(mask: BoolArray, cells: IntArray, resolution: float) -> IntArray:
    """The nearest cell of `mask` for each (row, col) of (C, 2); the cell itself if all are far."""
    # For few cells this takes 2 ms; a distance transform with indices takes 40 ms on a large map.
    reach = int(np.ceil(SLIP[0] / resolution))
    side = np.arange(-reach, reach + 1)
    square = np.add.outer(side**2, side**2)
    offsets = np.argwhere(square <= reach**2)
    offsets = offsets[np.argsort(square[tuple(offsets.T)], kind="stable")] - reach
    info = GridInfo(mask.shape[0], mask.shape[1], resolution)
    out, left = cells.copy(), np.arange(len(cells))
    while len(left) and len(offsets):
        # The first look finds nearly all: few are left for the many offsets far away.
        some, offsets = np.split(offsets, [1 + _LOOKS // len(left)])
        looks = cells[left, None] + some
        hit = inside(looks, info)
        hit[hit] = mask[tuple(looks[hit].T)]
        found = hit.any(axis=1)
        out[left[found]] += some[hit[found].argmax(axis=1)]
        left = left[~found]
    return out
