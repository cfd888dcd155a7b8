"""The score that decides: endpoint evidence under the paper's visibility constraint.

A reading should end on a surface. The distance to the nearest surface measures that, and forgives
half-cells, grazing angles and thick walls, as ray-traced ranges do not. A reading that passes
through a mapped wall contradicts the map (Sec. V), unless the wall has gone, as an open door. ::

    p(rho | x) = o * (h mean_s N(d; 0, sigma_s) + (1 - h) / span)

where d is that distance and h the share of readings that come from mapped surfaces. The factor o is
1 before a wall. Beyond it o is the chance that the wall has gone, or is drawn that far from its
true place. As in eq. 2, too short a reading is no surprise, and too long a reading is one. A sharp
and a wide sigma make the score sharp where map and scan agree, and forgiving where the map is old.

The walls of a map that others drew may stand some decimetres off, or be gone, each piece by
itself. All readings of a piece then share one offset e ~ N(0, bent), which is summed out, and one
factor o. They share further errors, so a piece of n readings counts as n^a of them, a < 1::

    p(piece | x) = o sum_e p(e) prod_rho (h mean_s N(d - e; 0, sigma_s) + (1 - h) / span)

A changed shelf, a person, an open door is one thing that differs, however many readings fall on it.
A wall that is drawn 10 cm off is one error. On any map a piece of the scan is what the map has
there, or that displaced (the sum above), or a thing of its own::

    p'(piece | x) = p(piece | x) + exp(-displacement) p(displaced piece | x)
    own(piece) = exp(n (best - apart) - price)

The first reading of a thing pays for its place, and the others follow from it: where a surface goes
on, the next piece of the same thing pays no price. All ways to share the pieces of a scan out are
summed, piece after piece.

A wall counts once, too, where it is asked how much of a scan the map explains: pieces that go on
straight are one wall. At a corner another one begins.

What the map has where the sensor is, is gone, and one thing: rays begin where they leave it.

Rays that meet nothing count less, because glass and dark surfaces return none. Where the map has no
wall as far as another reading shows that the sensor reaches, they cost nothing. A piece of them (20
degrees) that should meet a wall is a thing of its own at most: nothing shows that one goes on. A
building on no map would have walls there, too, so this compares places of the map alone.

A map may name what is movable, as the furniture of a drawing. A piece is then seen with or without
all of that, one as likely as the other::

    p(piece | x) = (p(piece | x, bare map) + p(piece | x, furnished map)) / 2

The search looks for poses by readings. Which of them is the best, things decide.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.raycast import cast_along
from imgloc.features.scanpoints import Readings
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray, Thing
from imgloc.numbers import number
from imgloc.options import EvidenceModel, Options
from imgloc.search.hypotheses import first_in_cell, modes
from imgloc.search.refine import endpoints

# A piece of wall: radians that it is seen under, metres between two neighbours that part it, and
# radians that it turns by where another wall begins.
_PIECE: tuple[float, float, float] = number("rescore.piece")
# Offsets that stand for all: how many, and the farthest, standard deviations.
_OFFSETS: tuple[int, float] = number("rescore.offsets")
# Nats that a place may be behind the best one to be as good, and how many such places are kept.
_EQUAL: float = number("rescore.equal")
_EQUALS: int = number("rescore.equals")
# Nats that a thing of its own costs, and nats that each of its readings lacks against a fit.
_PRICE, APART = number("rescore.price"), number("rescore.apart")
# Standard deviation, metres, of the place of a piece that is mapped elsewhere than it stands, and
# nats that this costs.
_DISPLACED, _DISPLACEMENT = number("rescore.displaced")
# Neighbours that tell of a wall, by ending on it and by passing it; and nats that each of them may
# lack, because stray readings end near some wall.
_RUN: tuple[int, int] = number("rescore.run")
_FITS: float = number("rescore.fits")


@dataclass(frozen=True)
class Scores:
    """Scores of C poses by N readings, from :func:`score_poses`."""

    log_likelihood: FloatArray  #: (C,) nats, each reading by itself
    things: FloatArray  #: (C,) nats, each piece as what the map has there or a thing of its own
    silence: FloatArray  #: (C,) nats of these, 0 or less, for rays that met nothing
    mapped: IntArray  #: (C,) number of straight walls that are rather what the map has there
    through: IntArray  #: (C,) and of those most of which pass through a mapped wall
    own: BoolArray  #: (C, P) pieces, of some readings at least, that are rather things of their own
    passing: BoolArray  #: (C, P) pieces most of which pass through a mapped wall
    #: (C, N) whether a reading ends nearer to a surface than twice the wider sigma
    on_surface: BoolArray
    #: (C, N) whether a reading passes through a mapped wall, which more likely than not is gone
    crossed: BoolArray

    def select(self, index: IntArray) -> "Scores":
        """The scores of the poses at `index`."""
        return Scores(*(getattr(self, each.name)[index] for each in fields(self)))


def score_poses(
    features: MapFeatures, readings: Readings, poses: FloatArray, model: EvidenceModel
) -> Scores:
    """Score poses by endpoint evidence, with a penalty for readings that pass through a wall.

    `poses` are in the grid frame, (C, 3): metres, metres, radians. A fourth column (C, 4) is a
    scale of the readings, a factor.
    """
    order, parts, goes_on = pieces(readings.ranges, readings.angles)
    told = _told(features, readings, poses, model)
    if not model.bent:
        displaced = replace(model, bent=_DISPLACED)
        bent = _bent_pieces(told.distance[:, order], parts, displaced, told.shifted[:, order])
        told = replace(told, pieces=np.logaddexp(told.pieces, bent - _DISPLACEMENT))
    on_surface, crossed = np.abs(told.distance) < 2 * max(model.sigmas), told.shifted < model.absent
    sizes, own = _sizes(parts, len(order)), things_of_their_own(parts, len(order), model)
    crossing, some = _sums(crossed[:, order], parts), sizes >= _RUN[0]
    fits = some & (told.pieces > np.maximum(own, sizes * (model.best - _FITS)))
    passing = (crossing >= _RUN[1]) & (2 * crossing > sizes)
    things = _whole(told, own, goes_on, model) - _PRICE * _within(features, poses)
    # Of bent walls each piece is off by itself.
    straight = goes_on & ~turning(readings.xy[order], parts) & (not model.bent)
    return Scores(
        told.total, things, told.silence, walls(fits, straight), walls(passing, straight),
        some & (told.pieces < own), passing, on_surface, crossed,
    )  # fmt: skip


def countable(readings: Readings) -> bool:
    """Return whether any piece of a scan has readings enough to count."""
    order, parts, _ = pieces(readings.ranges, readings.angles)
    return bool((_sizes(parts, len(order)) >= _RUN[0]).any())


def walls(some: BoolArray, straight: BoolArray) -> IntArray:
    """Number of walls (C,) of some of the pieces (C, P), if those that are `straight` go on.

    Examples
    --------
    >>> walls(np.array([[True, True, False, True]]), np.array([False, True, True, True])).tolist()
    [2]
    """
    before = np.pad(some[:, :-1], ((0, 0), (1, 0)))
    return np.asarray((some & ~(before & straight)).sum(axis=1))


def turning(xy: FloatArray, parts: IntArray) -> BoolArray:
    """Return whether pieces of endpoints (N, 2) turn against the ones before, bool (P,)."""
    z = xy @ (1, 1j)
    sums, squares = np.add.reduceat((z, z * z), parts, axis=1)
    twice = squares - sums * sums / _sizes(parts, len(z))  # its angle: twice their direction
    return np.asarray(np.abs(np.angle(twice * np.conj(np.roll(twice, 1)))) > 2 * _PIECE[2])


def things_at(readings: Readings, scores: Scores, index: int) -> tuple[Thing, ...]:
    """Name the pieces of a scan that differ from the map at one of the scored poses.

    They are not on the map, or pass through a wall of it. Pieces of a surface that goes on are one
    thing. The largest come first.
    """
    order, parts, goes_on = pieces(readings.ranges, readings.angles)
    kind = np.where(scores.passing[index], 2, scores.own[index])  # 0: what the map has
    begins = ~goes_on | (np.diff(kind, prepend=-1) != 0)
    parts, kind = parts[begins], kind[begins]
    sizes = _sizes(parts, len(order))
    angle = np.angle(np.add.reduceat(np.exp(1j * readings.angles[order]), parts))
    far = np.add.reduceat(readings.ranges[order], parts) / sizes
    found = np.flatnonzero(kind)
    return tuple(
        Thing(float(angle[k]), float(far[k]), float(sizes[k] / len(order)), bool(kind[k] == 2))
        for k in found[np.argsort(-sizes[found], kind="stable")]
    )


def score_things(
    features: MapFeatures, readings: Readings, poses: FloatArray, model: EvidenceModel
) -> FloatArray:
    """Log-likelihoods (C,) by things, nats, but no piece of wall is displaced: for a first look."""
    _, parts, goes_on = pieces(readings.ranges, readings.angles)
    own = things_of_their_own(parts, len(readings), model)
    return _whole(_told(features, readings, poses, model), own, goes_on, model)


def score_readings(
    features: MapFeatures, readings: Readings, poses: FloatArray, model: EvidenceModel
) -> FloatArray:
    """Log-likelihoods (C,) of :func:`score_poses`, nats, without the things."""
    return _told(features, replace(readings, silent=None), poses, model).total


@dataclass(frozen=True)
class _Told:
    """Fit of N readings in P pieces at C poses, with what is movable where a piece fits so."""

    total: FloatArray  #: (C,) log-densities of all readings, nats
    pieces: FloatArray  #: (C, P) those of each piece
    distance: Float32Array  #: (C, N) of the endpoints from a surface, metres
    shifted: Float32Array  #: (C, N) chance that the wall that a reading passes is displaced
    silence: FloatArray  #: (C,) log-probability of rays that met nothing, on the bare map


def _told(
    features: MapFeatures, readings: Readings, poses: FloatArray, model: EvidenceModel
) -> _Told:
    """Fit of readings at poses (C, 3), grid frame."""
    order, parts, _ = pieces(readings.ranges, readings.angles)
    density, distance = _endpoint_density(features, readings, poses, model)
    shifted, unmet = _shifted(features, readings, poses, model)
    if model.bent:
        each = _bent_pieces(distance[:, order], parts, model, shifted[:, order])
    else:
        each = _sums(np.log(density * _stands(shifted, model))[:, order], parts)
    if features.furnished is not None:
        other = _told(features.furnished, replace(readings, silent=None), poses, model)
        rather = np.empty(distance.shape, np.bool_)
        rather[:, order] = np.repeat(other.pieces > each, _sizes(parts, len(order)), axis=1)
        distance = np.where(rather, other.distance, distance)
        shifted = np.where(rather, other.shifted, shifted)
        each = np.logaddexp(each, other.pieces) - np.log(2)
    total = each @ _counts(parts, len(order), model) if model.bent else each.sum(axis=1)
    silence = np.zeros(len(poses))
    if readings.silent:
        order, parts, _ = pieces(readings.silent.ranges, readings.silent.angles)
        through = _sums(np.log(_stands(unmet, model))[:, order], parts)
        silence = np.logaddexp(through, -_PRICE).sum(axis=1)
    return _Told(np.asarray(total), each, distance, shifted, silence)


def by_things(told: FloatArray, own: FloatArray, goes_on: BoolArray) -> FloatArray:
    """Log-likelihood (C,) of scans cut into pieces, each on the map or a thing of its own, nats.

    `told` (C, P) has the log-densities of the pieces on the map, `own` (P,) those of things of
    their own, and `goes_on` (P,) is of :func:`pieces`.

    Examples
    --------
    >>> told, own = np.full((1, 3), -90.0), np.full(3, -_PRICE)
    >>> [round(by_things(told, own, np.array([False, on, on]))[0] / _PRICE) for on in (False, True)]
    [-3, -1]
    """
    mapped, thing = told[:, 0], np.full(len(told), own[0])
    for k in range(1, len(own)):
        either = np.logaddexp(mapped, thing)
        follows = np.logaddexp(either, thing + _PRICE) if goes_on[k] else either
        mapped, thing = either + told[:, k], follows + own[k]
    return np.asarray(np.logaddexp(mapped, thing))


def _whole(told: _Told, own: FloatArray, goes_on: BoolArray, model: EvidenceModel) -> FloatArray:
    """Log-likelihood (C,) of scans by things, and by rays that met nothing, nats."""
    # On bent walls all pieces are displaced or gone already.
    return told.silence + (told.total if model.bent else by_things(told.pieces, own, goes_on))


def things_of_their_own(parts: IntArray, n: int, model: EvidenceModel) -> FloatArray:
    """Log-density (P,) of pieces of `n` readings that are on no map, nats; see :func:`pieces`."""
    return np.asarray(_sizes(parts, n) * (model.best - APART) - _PRICE)


def _sizes(parts: IntArray, n: int) -> IntArray:
    return np.diff(np.append(parts, n))


def _sums(each: BoolArray | Float32Array, parts: IntArray) -> FloatArray:
    """Sums (C, P) over the readings of each piece."""
    return np.add.reduceat(each, parts, axis=1, dtype=np.float64)


def _counts(parts: IntArray, n: int, model: EvidenceModel) -> FloatArray:
    """Weights (P,) of pieces of a bent wall: together all readings count as many as they are."""
    sizes = _sizes(parts, n)
    weight = sizes ** (model.alike - 1.0)
    return np.asarray(weight * (n / (sizes @ weight)))


def _shifted(
    features: MapFeatures, readings: Readings, poses: FloatArray, model: EvidenceModel
) -> list[Float32Array]:
    """Chance that the wall that a reading passes is displaced; 1 before a wall, (C, N).

    Then the same for the rays that met nothing. One call casts both: it takes as long for more.
    """
    both = [readings, readings.silent] if readings.silent else [readings]
    ranges, angles = (np.hstack([getattr(one, of) for one in both]) for of in ("ranges", "angles"))
    margin = model.margin + features.field.resolution / 2 + features.field.recess
    far = ranges * poses[:, 3:] if poses.shape[1] == 4 else ranges
    reach = np.maximum(far - margin, 1e-3)
    c, s = (turn(poses[:, 2:3]).astype(np.float32) for turn in (np.cos, np.sin))
    u, v = (turn(angles).astype(np.float32) for turn in (np.cos, np.sin))
    along = c * u - s * v, s * u + c * v
    seen = _seen(features, poses, along, reach)
    beyond = np.maximum(far - seen - margin, 0).astype(np.float32)  # 0 where nothing is met
    shifted = np.exp(-np.square(beyond / np.float32(model.displaced)))
    return np.split(shifted, [len(readings)], axis=1)


def _within(features: MapFeatures, poses: FloatArray) -> BoolArray:
    """Return whether the map has something where each sensor is, (C,)."""
    return np.asarray(features.field.lookup(poses[:, 0], poses[:, 1])[0] < 0)


def _seen(
    features: MapFeatures, poses: FloatArray, along: tuple[Float32Array, ...], reach: FloatArray
) -> Float32Array:
    """Cast rays (C, N): metres to the first wall, or to the first after they have left one.

    Examples
    --------
    >>> from imgloc.model import OccupancyGrid
    >>> box = np.zeros((20, 40), bool)
    >>> box[5:15, 10:20] = box[:, -1] = True  # a sensor before it, and one in it, look along x
    >>> features, along = MapFeatures(OccupancyGrid(box, ~box, 0.1)), np.ones((2, 1), np.float32)
    >>> poses = np.array([[0.5, 1.0, 0.0], [1.5, 1.0, 0.0]])
    >>> np.rint(10 * _seen(features, poses, (along, 0 * along), np.full((2, 1), 9.0))).tolist()
    [[5.0], [24.0]]
    """
    cell, at = features.field.resolution, poses[:, None, :2]
    seen = cast_along(features.walls, at, along[0], along[1], reach, cell)
    if (within := _within(features, poses)).any():
        inside = np.maximum(np.float32(0.5) - features.field.distance / np.float32(cell), 0)
        inside[features.field.steps >= 0] = 0
        u, v, far = along[0][within], along[1][within], np.broadcast_to(reach, seen.shape)[within]
        left = np.minimum(cast_along(inside, at[within], u, v, far, cell) + cell / 2, far)
        at, far = at[within] + left[..., None] * np.stack((u, v), -1), np.maximum(far - left, 1e-3)
        seen[within] = left + cast_along(features.walls, at, u, v, far, cell)
    return seen


def _stands(shifted: Float32Array, model: EvidenceModel) -> Float32Array:
    """Chance that walls which are displaced with the chance `shifted` let readings pass."""
    return np.float32(model.absent) + np.float32(1 - model.absent) * shifted


def _endpoint_density(
    features: MapFeatures, readings: Readings, poses: FloatArray, model: EvidenceModel
) -> tuple[Float32Array, Float32Array]:
    """Density of each reading by its endpoint alone, 1 / metres, and distance in metres: (C, N)."""
    distance = endpoints(poses, readings.xy, features.field)[2]
    return hit_density(distance, model), distance


def hit_density(distance: Float32Array, model: EvidenceModel) -> Float32Array:
    """Density of readings by the distance of their endpoints from a surface.

    `distance` is in metres and has any shape. The densities have the same shape and 1 / metres.
    """
    density = np.full(distance.shape, (1 - model.hit) / model.span, dtype=np.float32)
    for sigma in model.sigmas:
        peak = model.hit / (len(model.sigmas) * sigma * np.sqrt(2 * np.pi))
        density += np.float32(peak) * np.exp(distance * distance * np.float32(-0.5 / sigma**2))
    return density


def _bent_pieces(
    distance: Float32Array, parts: IntArray, model: EvidenceModel, shifted: Float32Array
) -> FloatArray:
    """Log-density (C, P) of pieces of bent wall, each of which is displaced or gone, nats."""
    stands = np.log(np.maximum(shifted, np.finfo(np.float32).tiny))
    kept = model.absent + (1 - model.absent) * np.exp(_sums(stands, parts))
    return np.asarray(piece_evidence(distance, parts, model) + np.log(kept))


def pieces(ranges: FloatArray, angles: FloatArray) -> tuple[IntArray, IntArray, BoolArray]:
    """Cut readings (N,), metres and radians, into pieces of wall.

    Returns the order (N,) of the readings by their angles, where in it each piece begins, (P,), and
    whether it goes on with the surface of the piece before, (P,). Where a surface goes on over the
    first angle, the order begins at the next one.
    """
    angle, jump, _ = _PIECE
    order = np.argsort(angles, kind="stable")
    turned = np.floor((angles[order] - angles[order[0]]) / angle)
    far = np.abs(np.diff(ranges[order], prepend=ranges[order[-1]])) > jump
    last, first = ranges[order[[-1, 0]]] * np.exp(1j * angles[order[[-1, 0]]])
    begin = int(far.argmax()) if abs(first - last) <= jump else 0
    index = np.roll(np.arange(len(order)), -begin)
    order, turned, far = order[index], turned[index], far[index]
    far[0] = True
    parts = np.flatnonzero(far | (np.diff(turned, prepend=turned[0]) != 0))
    return order, parts, ~far[parts]


def piece_evidence(distance: Float32Array, parts: IntArray, model: EvidenceModel) -> FloatArray:
    """Log-density (C, P) of the readings on each piece of wall, its offset summed out, nats.

    `distance` (C, N), metres, is in the order of :func:`pieces`, `parts` (P,) are where they begin.
    """
    count, farthest = _OFFSETS if model.bent else (1, 0.0)
    offsets = np.linspace(-farthest, farthest, count)
    chance = np.exp(-np.square(offsets) / 2)
    logs = np.stack([
        np.log(p) + np.add.reduceat(
            np.log(hit_density(distance - np.float32(offset * model.bent), model)), parts,
            axis=1, dtype=np.float64,
        )
        for offset, p in zip(offsets, chance / chance.sum(), strict=True)
    ])  # fmt: skip
    # scipy.special.logsumexp takes a quarter of a second to import.
    most = logs.max(axis=0)
    return np.asarray(most + np.log(np.exp(logs - most).sum(axis=0)))


def shortlist(
    poses: FloatArray, readings: Readings, features: MapFeatures, options: Options
) -> tuple[FloatArray, FloatArray]:
    """Choose the poses that get the second look, by a score with few readings.

    `poses` (C, 3) are in the grid frame. The result has the best places, and the best poses even if
    they share a place: (L, 3), the best places first, and their scores (L,) in nats. Poses far
    behind a best one that fits are left out, apart from a few places. If refinement has brought
    poses together, the one whose readings end nearest to walls stands for all.
    """
    fused, model = options.fused, options.model
    density = _endpoint_density(features, readings, poses, model)[0]
    ends = np.log(density).sum(axis=1, dtype=np.float64)
    order = np.argsort(-ends, kind="stable")
    poses = poses[np.sort(order[first_in_cell(poses[order], *fused.same)])]
    score = score_things(features, readings, poses, model)
    # Of places that are as good as the best one none is left out, else their masses are chance.
    equal = int(np.count_nonzero(score >= score.max(initial=-np.inf) - _EQUAL))
    places = max(fused.second_look, min(equal, _EQUALS))
    best, close = (
        modes(poses, score, distance=distance, angle=angle, most=most)
        for (distance, angle), most in ((fused.twins, places), (fused.same, fused.closer))
    )
    both = np.concatenate((best, np.setdiff1d(close, best)))
    # What is far behind cannot win any more, but some of it is listed.
    (distance, angle), count = fused.separation, fused.least_look
    top = score.max(initial=-np.inf)
    near = score[both] >= top - fused.behind
    near |= top < (model.best - fused.strained) * len(readings)  # where nothing fits, all may be
    near[modes(poses[both], score[both], distance=distance, angle=angle, most=count)] = True
    return poses[both[near]], score[both[near]]
