"""Doors on plans and in drawings: the arc that a leaf swings along, and the leaf."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from imgloc.errors import MapError
from imgloc.model import FloatArray
from imgloc.numbers import number
from imgloc.plans.vectors import Stroke

_MOST = 4000  # doors of a drawing: a hospital has a thousand
HANGS: float = number("doors.hangs")  #: of its width, that a leaf may end beside its place
_ROUND = HANGS / 3  # of its radius, that an arc may be off
_SHARP = np.pi / 6  # a larger turn is a corner, and not a part of an arc
_SWINGS = (np.pi / 4, 5 / 4 * np.pi)  # radians that a door may turn
LEAVES: tuple[float, float] = number("floorplan.leaf")  #: metres that a leaf may be wide


@dataclass(frozen=True, eq=False)
class Door:
    """One leaf of a door, in the units of its drawing."""

    hinge: FloatArray  #: (2,)
    closed: FloatArray  #: (2,) where its free end is when it is closed
    opened: FloatArray  #: (2,) where it is drawn, or the other end of its swing
    width: float
    both: bool  #: a leaf is drawn at both ends


def doors_of(strokes: Sequence[Stroke], roles: Sequence[str]) -> list[Door]:
    """The arcs about one end of a straight line as long as their radius: leaves of doors."""
    apart = ("thing", "note", "stairs")
    pairs = [
        np.stack((s.points[:-1], s.points[1:]), axis=1)
        for s, role in zip(strokes, roles, strict=True)
        if role not in apart or len(s.points) < 6
    ]
    walls = [s.points for s, role in zip(strokes, roles, strict=True) if role == "wall"]
    if not pairs:
        return []
    both = np.concatenate(pairs)
    both = np.concatenate((both, both[:, ::-1]))  # from either end
    tree, length = cKDTree(both[:, 0]), np.hypot(*(both[:, 1] - both[:, 0]).T)
    found, known = list[Door](), np.full((_MOST, 3), np.inf)  # hinges and widths
    for stroke, role in zip(strokes, roles, strict=True):
        if role in ("thing", "stairs") or stroke.filled:
            continue
        for centre, radius, tips in arcs(stroke.points):
            near = np.array(tree.query_ball_point(centre, HANGS * radius), int)
            near = near[abs(length[near] - radius) < HANGS * radius]
            leaf = [
                bool((np.hypot(*(both[near, 1] - tip).T) < HANGS * radius).any()) for tip in tips
            ]
            others = known[: len(found)]
            twice = (np.hypot(*(others[:, :2] - centre).T) < 2 * HANGS * radius) & (
                abs(others[:, 2] - radius) < 2 * HANGS * radius
            )
            if (any(leaf) or role == "door") and not twice.any():
                if len(found) == _MOST:
                    raise MapError(f"it has more than {_MOST:,} doors, expected that of a floor")
                known[len(found)] = *centre, radius
                opened = 0 if leaf[0] or not leaf[1] else 1
                found.append(Door(centre, tips[1 - opened], tips[opened], radius, all(leaf)))
    return _turned(found, walls)


def _turned(doors: list[Door], walls: list[FloatArray]) -> list[Door]:
    """The same, closed where a wall, or another leaf, goes on: a leaf may be drawn at both ends."""
    if not walls:
        return doors
    some = np.concatenate(
        [dense(w, np.median([d.width for d in doors] or [1]) / 20) for w in walls]
    )
    tree, out = cKDTree(some), list[Door]()
    tips = np.array([(d.closed, d.opened, d.hinge) for d in doors]).reshape(-1, 2)
    for n, d in enumerate(doors):
        ends = d.closed, d.opened
        away = [float(tree.query(end + 0.1 * (end - d.hinge))[0]) for end in ends]
        others = np.delete(tips, slice(3 * n, 3 * n + 3), axis=0)
        for k, end in enumerate(ends):
            if np.hypot(*(others - end).T).min(initial=np.inf) < HANGS * d.width:
                away[k] = min(away[k], 0.1 * d.width)
        swap = away[1] + (0 if d.both else HANGS * d.width) < away[0]
        out.append(replace(d, closed=d.opened, opened=d.closed) if swap else d)
    return out


def dense(points: FloatArray, step: float) -> FloatArray:
    """Points along a line, no farther apart than `step`, up to a bound."""
    parts = np.clip(np.ceil(np.hypot(*np.diff(points, axis=0).T) / step), 1, 2000)
    ends = np.append(0, np.cumsum(parts))
    return np.column_stack([np.interp(np.arange(ends[-1] + 1), ends, c) for c in points.T])


def arcs(points: FloatArray) -> list[tuple[FloatArray, float, tuple[FloatArray, FloatArray]]]:
    """The parts of a line that are arcs of 45 to 225 degrees: centre, radius and both ends."""
    out = list[tuple[FloatArray, float, tuple[FloatArray, FloatArray]]]()
    step = np.diff(points, axis=0)
    long = np.hypot(*step.T)
    step, points = step[long > 0], np.concatenate((points[:1], points[1:][long > 0]))
    long = long[long > 0]
    if len(step) < 3:
        return out
    unit = step / long[:, None]
    turn = (unit[1:] * unit[:-1]).sum(axis=1)
    ratio = long[1:] / long[:-1]
    cuts = np.flatnonzero((turn < np.cos(_SHARP)) | (ratio > 2.5) | (ratio < 0.4)) + 1
    for a, b in zip((0, *cuts), (*cuts, len(step)), strict=True):
        own = points[a : b + 1]
        if len(own) < 4:
            continue
        middle = own.mean(axis=0)
        to = own - middle
        (x, y, c), *_ = np.linalg.lstsq(
            np.column_stack((2 * to, np.ones(len(to)))), (to**2).sum(axis=1), rcond=None
        )
        centre, radius = middle + (x, y), float(np.sqrt(max(0.0, c + x * x + y * y)))
        away = np.hypot(*(own - centre).T)
        if not radius or np.abs(away - radius).max() > _ROUND * radius:
            continue
        angle = np.unwrap(np.arctan2(*(own - centre).T[::-1]))
        if _SWINGS[0] < abs(angle[-1] - angle[0]) < _SWINGS[1]:
            out.append((centre, radius, (own[0], own[-1])))
    return out
