"""The deciding score against loops over readings, and what each of its terms is for."""

import cmath
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgloc import FusedOptions, MapFeatures, OccupancyGrid, Options, Shared
from imgloc.features.distance import distance_field, distance_image
from imgloc.features.raycast import cast_rays
from imgloc.features.scanpoints import Readings
from imgloc.numbers import number
from imgloc.options import Bending, EvidenceModel
from imgloc.search.refine import endpoints
from imgloc.search.rescore import (
    hit_density,
    piece_evidence,
    pieces,
    score_poses,
    shortlist,
    things_at,
)

RESOLUTION = 0.1
seeds = st.integers(0, 2**32 - 1)


def room_with_pillars(seed, shape=(50, 70)):
    rng = np.random.default_rng(seed)
    wall = np.pad(rng.random((shape[0] - 4, shape[1] - 4)) < 0.01, 2, constant_values=True)
    free = np.argwhere(~wall)
    at = free[rng.integers(len(free), size=4)]
    xy = (at[:, ::-1] + rng.uniform(0.1, 0.9, (4, 2))) * RESOLUTION
    return wall, np.column_stack((xy, rng.uniform(-np.pi, np.pi, 4))), rng


def score(wall, poses, ranges, angles, model=None, resolution=RESOLUTION):
    features = MapFeatures(OccupancyGrid(wall, ~wall, resolution))
    readings = Readings(np.asarray(ranges, float), np.asarray(angles, float))
    return score_poses(features, readings, np.asarray(poses, float), model or EvidenceModel())


def walk(wall, x, y, psi, limit):
    """Length of a walk of 2 mm a step to the first wall; inf if none is met before `limit`."""
    for t in np.arange(0, limit, 0.002):
        c = math.floor((x + t * math.cos(psi)) / RESOLUTION)
        r = math.floor((y + t * math.sin(psi)) / RESOLUTION)
        if not (0 <= r < wall.shape[0] and 0 <= c < wall.shape[1]):
            return math.inf
        if wall[r, c]:
            return float(t)
    return math.inf


def naive_shifted(seen, rho, model, resolution=RESOLUTION):
    """Chance, relative to its best, that a wall met at `seen` is drawn in a wrong place."""
    beyond = max(rho - seen - (model.margin + resolution / 2), 0)
    return math.exp(-((beyond / model.displaced) ** 2))


def naive_chances(wall, pose, rho, phi, model):
    """Chances of rays close by: a ray may only just touch something, and a walk has steps."""
    x, y, theta = pose
    for turn in (-0.003, 0.0, 0.003):
        seen = walk(wall, x, y, theta + phi + turn, rho)
        for more in (-0.005, 0.005):
            yield naive_shifted(seen + more, rho, model)


def naive_log_density(d, shifted, model):
    """Formula of the module's head for one reading."""
    normal = [math.exp(-(d**2) / (2 * s**2)) / (s * math.sqrt(2 * math.pi)) for s in model.sigmas]
    o = model.absent + (1 - model.absent) * shifted
    return math.log(o * (model.hit * sum(normal) / len(normal) + (1 - model.hit) / model.span))


@given(seeds, st.sampled_from([EvidenceModel(), EvidenceModel((0.1,), 0.5, 4.0, 0.01, 0.2, 0.3)]))
@settings(max_examples=12)
def test_the_score_equals_the_loops(seed, model):
    wall, poses, rng = room_with_pillars(seed)
    poses = poses[:2]
    angles = rng.uniform(-np.pi, np.pi, 9)
    ranges = rng.uniform(0.05, 6, 9)
    got = score(wall, poses, ranges, angles, model)
    field = distance_field(wall, RESOLUTION)
    one_by_one = np.zeros(len(poses))
    for k, (rho, phi) in enumerate(zip(ranges, angles, strict=True)):
        alone = score(wall, poses, [rho], [phi], model)
        one_by_one += alone.log_likelihood
        distance = endpoints(poses, rho * np.array([[math.cos(phi), math.sin(phi)]]), field)
        for i, (x, y, theta) in enumerate(poses):
            d = float(distance[2][i, 0])
            shifted = list(naive_chances(wall, (x, y, theta), rho, phi, model))
            bounds = [naive_log_density(d, of(shifted), model) for of in (min, max)]
            assert bounds[0] - 1e-3 <= alone.log_likelihood[i] <= bounds[1] + 1e-3
            if max(shifted) < 0.95 * model.absent:  # gone rather than displaced
                assert got.crossed[i, k]
            if min(shifted) > 1.05 * model.absent / (1 - model.absent):
                assert not got.crossed[i, k]
            assert got.on_surface[i, k] == (abs(d) < 2 * max(model.sigmas))
    np.testing.assert_allclose(got.log_likelihood, one_by_one, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("model", [EvidenceModel(), EvidenceModel().bending(0.15)])
def test_a_piece_is_seen_with_or_without_what_is_movable(model):
    wall, poses, rng = room_with_pillars(5)
    grid = OccupancyGrid(wall, ~wall, RESOLUTION, movable=rng.random(wall.shape) < 0.01)
    readings = Readings(np.full(9, 1.5), np.linspace(0, 0.3, 9))  # one piece
    bare, full, both = (
        score_poses(MapFeatures(each), readings, poses, model)
        for each in (OccupancyGrid(wall, ~wall, RESOLUTION), grid.furnished, grid)
    )
    told = bare.log_likelihood, full.log_likelihood
    np.testing.assert_allclose(both.log_likelihood, np.logaddexp(*told) - math.log(2))
    rather = (told[1] > told[0])[:, None]
    assert 0 < rather.sum() < len(poses)
    assert (both.on_surface == np.where(rather, full.on_surface, bare.on_surface)).all()


def naive_pieces(ranges, angles):
    """Indices of the readings in pieces of 20 degrees without a jump of 0.5 m."""
    order = sorted(range(len(angles)), key=lambda k: angles[k])
    turned = {k: math.floor((angles[k] - angles[order[0]]) / math.radians(20)) for k in order}
    ends = [ranges[k] * cmath.exp(1j * angles[k]) for k in (order[0], order[-1])]
    if abs(ends[0] - ends[1]) <= 0.5:  # begin where a surface does
        jumps = [abs(ranges[k] - ranges[j]) > 0.5 for j, k in itertools.pairwise(order)]
        begin = jumps.index(True) + 1 if any(jumps) else 0
        order = order[begin:] + order[:begin]
    pieces = [[order[0]]]
    for before, k in itertools.pairwise(order):
        if turned[before] == turned[k] and abs(ranges[k] - ranges[before]) <= 0.5:
            pieces[-1].append(k)
        else:
            pieces.append([k])
    return pieces


def naive_bent(d, ranges, angles, model, shifted=None):
    """Seven offsets of each piece, up to two deviations."""
    pieces = naive_pieces(ranges, angles)
    steps = [2 * (j - 3) / 3 for j in range(7)]
    chances = [math.exp(-(e**2) / 2) for e in steps]
    logs = [
        math.log(sum(
            c / sum(chances)
            * math.exp(sum(naive_log_density(d[k] - e * model.bent, 1.0, model) for k in piece))
            for e, c in zip(steps, chances, strict=True)
        ))
        for piece in pieces
    ]  # fmt: skip
    if shifted is None:
        return sum(logs)
    kept = [math.prod(shifted[k] for k in piece) for piece in pieces]
    gone = [math.log(model.absent + (1 - model.absent) * stands) for stands in kept]
    weights = [len(piece) ** model.alike / len(piece) for piece in pieces]
    whole = sum(w * len(piece) for w, piece in zip(weights, pieces, strict=True))
    both = sum(w * (a + b) for w, a, b in zip(weights, logs, gone, strict=True))
    return both * len(d) / whole


@given(seeds, st.sampled_from([0.05, 0.15, 0.4]))
@settings(max_examples=20)
def test_the_evidence_of_bent_walls_equals_the_loops(seed, bent):
    rng, model = np.random.default_rng(seed), EvidenceModel(bent=bent)
    angles, ranges = rng.uniform(-3, 3, 15), rng.choice([2.0, 2.3, 4.0], 15)
    distance = rng.normal(0, 0.3, (3, 15)).astype(np.float32)
    got = displaced(distance, ranges, angles, model)
    expected = [naive_bent(d.tolist(), ranges, angles, model) for d in distance]
    np.testing.assert_allclose(got, expected, rtol=1e-4)


def displaced(distance, ranges, angles, model):
    order, parts, _ = pieces(ranges, angles)
    return piece_evidence(distance[:, order], parts, model).sum(axis=1)


@given(seeds, st.sampled_from([0.05, 0.15, 0.4]))
@settings(max_examples=12)
def test_pieces_of_bent_walls_before_and_beyond_others_equal_the_loops(seed, bent):
    wall, poses, rng = room_with_pillars(seed)
    model = EvidenceModel().bending(bent)
    angles, ranges = rng.uniform(-3, 3, 15), rng.choice([2.0, 2.3, 4.0], 15)
    got = score(wall, poses[:2], ranges, angles, model).log_likelihood
    xy = ranges[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    distance = endpoints(poses[:2], xy, distance_field(wall, RESOLUTION))[2]
    for one, d, pose in zip(got, distance.tolist(), poses, strict=False):
        chances = [
            sorted(naive_chances(wall, pose, rho, phi, model))
            for rho, phi in zip(ranges, angles, strict=True)
        ]
        least, most = (
            naive_bent(d, ranges, angles, model, [each[k] for each in chances]) for k in (0, -1)
        )
        assert least - 1e-3 <= one <= most + 1e-3


def test_bent_walls_forgive_a_piece_that_is_off_but_not_readings_that_scatter():
    angles, ranges = np.linspace(0, 0.3, 12), np.full(12, 3.0)
    offs = {"none": np.zeros(12), "off": np.full(12, 0.2), "scattered": np.tile([0.2, -0.2], 6)}
    straight, bent = EvidenceModel(), EvidenceModel(bent=0.15)
    got = {
        name: displaced(d, ranges, angles, bent)[0] - np.log(hit_density(d, straight)).sum()
        for name, d in ((name, d[None].astype(np.float32)) for name, d in offs.items())
    }
    assert got["none"] < 0
    assert got["off"] > 5
    assert got["scattered"] < got["off"] / 2


def test_a_piece_of_a_bent_wall_is_gone_as_a_whole():
    open_to_all = Bending(absent=1.0, alike=1.0)
    bent = FusedOptions(bending=open_to_all)
    assert Options(shared=Shared(bent=0.2), fused=bent).model.absent == 1.0
    assert Options(shared=Shared(bent=0.2)).model == EvidenceModel().bending(0.2)
    assert Options().model == EvidenceModel()
    wall, ranges = corridor(screen=3.0), np.full(8, 3.9)
    angles = np.linspace(-0.05, 0.05, 8)
    models = EvidenceModel(), EvidenceModel().bending(0.15), EvidenceModel(bent=0.15, absent=1.0)
    straight, bent, free = (score(wall, POSE, ranges, angles, model) for model in models)
    assert all(one.crossed.all() for one in (straight, bent, free))
    assert bent.log_likelihood[0] > straight.log_likelihood[0] + 10
    # All readings pass one wall, which is gone once.
    lost = free.log_likelihood[0] - bent.log_likelihood[0]
    assert lost == pytest.approx(-math.log(EvidenceModel().bending(0.15).absent), abs=0.01)


def corridor(screen=None):
    """A wall at x = 5 m, seen from (1, 1); on demand a thin screen in between."""
    wall = np.zeros((20, 80), bool)
    wall[:, 50:52] = True
    if screen is not None:
        wall[:, round(screen / RESOLUTION)] = True
    return wall


POSE = [[1.0, 1.0, 0.0]]


@pytest.mark.parametrize("resolution", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("before", [1, 2, 3, 4, 6, 30])
def test_the_further_behind_a_wall_the_less_likely_it_is_drawn_in_a_wrong_place(resolution, before):
    model = EvidenceModel(margin=0.07, displaced=0.15)
    wall = np.zeros((20, 80), bool)
    wall[:, 50:52] = True
    screened = wall.copy()
    screened[:, 50 - 1 - before] = True  # so many free cells before the wall
    pose = [[10 * resolution, 10.5 * resolution, 0.0]]
    a, b = (
        score(w, pose, [40 * resolution], [0.0], model, resolution).log_likelihood[0]
        for w in (wall, screened)
    )
    # Half a cell is free besides the margin, however large a cell is.
    beyond = max((before + 1) * resolution - 0.07 - resolution / 2, 0)
    o = model.absent + (1 - model.absent) * math.exp(-((beyond / 0.15) ** 2))
    assert b - a == pytest.approx(math.log(o), abs=0.04)  # a ray ends to 1/128 of a cell
    assert b - a >= math.log(model.absent) - 1e-4  # never less than: it is gone


@pytest.mark.parametrize(
    ("rho", "crossed", "on_surface"),
    [
        (0.01, False, False),
        (2.0, False, False),  # too short: something not on the map, no contradiction
        (4.0, False, True),
        (4.3, False, False),  # less than the margin behind the wall's face, but deep in it
        (4.36, False, False),  # more, but the wall may be drawn in a wrong place
        (4.48, False, False),
        (4.53, True, False),  # exp(-(0.18 / 0.1)^2) < 0.1: rather than that, it is gone
        (7.0, True, False),  # too long: through a mapped wall
    ],
)
def test_too_short_is_no_surprise_and_too_long_is(rho, crossed, on_surface):
    wall = corridor()
    wall[:, 52:60] = True
    model = EvidenceModel(sigmas=(0.05,), absent=0.1, margin=0.3, displaced=0.1)
    got = score(wall, POSE, [rho], [0.0], model)
    assert bool(got.crossed[0, 0]) is crossed
    assert bool(got.on_surface[0, 0]) is on_surface


@given(seeds)
@settings(max_examples=10)
def test_the_true_pose_explains_its_scan_and_beats_its_neighbours(seed):
    wall, poses, rng = room_with_pillars(seed)
    angles = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    true = poses[0]
    ranges = cast_rays(distance_image(wall), true[:2], true[2] + angles, 30.0, RESOLUTION)
    others = true + rng.normal(size=(20, 3)) * (0.5, 0.5, 0.5) + (0.3, 0, 0)
    got = score(wall, np.vstack((true, others)), ranges, angles)
    assert got.log_likelihood.argmax() == 0
    assert (got.on_surface[0] & ~got.crossed[0]).mean() > 0.95


def test_no_poses():
    got = score(corridor(), np.empty((0, 3)), [1.0, 2.0], [0.0, 0.1])
    assert got.log_likelihood.shape == (0,)
    assert got.crossed.shape == got.on_surface.shape == (0, 2)


@pytest.mark.parametrize(("ranges", "kept"), [(4.0, 1), (2.5, 3)], ids=["fits", "fits nowhere"])
def test_poses_far_behind_are_left_out_where_the_best_one_fits(ranges, kept):
    wall = corridor()
    features = MapFeatures(OccupancyGrid(wall, ~wall, RESOLUTION))
    readings = Readings(np.full(40, ranges), np.linspace(-0.1, 0.1, 40))
    options = Options(fused=FusedOptions(behind=1.0, least_look=1))
    poses = np.array([[1.0, 1.0, 0.0], [1.2, 1.0, 0.5], [0.4, 1.0, -0.5]])
    assert len(shortlist(poses, readings, features, options)[0]) == kept


def naive_things(told, bent, ranges, angles, model):
    """Each piece of 20 degrees without a jump of 0.5 m is of the map or of a thing of its own.

    One of the map stands where the map has it, or displaced. A thing pays once: where the surface
    goes on, the next piece may be of the same thing. All ways to share the pieces out are summed.
    Mapped pieces that go on straight are one wall.
    """
    price, apart = number("rescore.price"), number("rescore.apart")
    pieces = naive_pieces(ranges, angles)
    ends = [(a[-1], b[0]) for a, b in itertools.pairwise(pieces)]
    goes_on = [bool(abs(ranges[k] - ranges[j]) <= 0.5) for j, k in ends]
    xy = np.transpose(ranges * np.array([np.cos(angles), np.sin(angles)]))
    along = [np.linalg.svd(xy[piece] - xy[piece].mean(axis=0))[2][0] for piece in pieces]
    straight = [abs(a @ b) > math.cos(np.pi / 6) for a, b in itertools.pairwise(along)]
    fits, here = [False], []
    for piece, moved in zip(pieces, bent, strict=True):
        there = sum(told[k] for k in piece)
        here.append(np.logaddexp(there, moved - number("rescore.displaced")[1]))
        own = len(piece) * (model.best - apart) - price
        fits.append(len(piece) > 1 and here[-1] > max(own, len(piece) * (model.best - 2.0)))
    begins = ~np.array([False, *np.array(goes_on) & straight]) | ~np.array(fits[:-1])
    free = [len(piece) * (model.best - apart) for piece in pieces]
    ways = [()]
    for k in range(len(pieces)):
        choices = ["map", "thing"] + ["same"] * (k > 0 and goes_on[k - 1])
        ways = [(*way, one) for way in ways for one in choices if one != "same" or way[-1] != "map"]
    logs = [
        sum(here[k] if one == "map" else free[k] - price * (one == "thing")
            for k, one in enumerate(way)) for way in ways
    ]  # fmt: skip
    return np.logaddexp.reduce(logs), np.count_nonzero(begins & fits[1:])


@given(seeds)
@settings(max_examples=12)
def test_the_score_by_things_equals_the_loops(seed):
    wall, poses, rng = room_with_pillars(seed)
    angles, ranges = np.sort(rng.uniform(-0.6, 0.6, 40)), np.repeat(rng.uniform(0.5, 4, 5), 8)
    got, model = score(wall, poses[:2], ranges, angles), EvidenceModel()
    each = [
        score(wall, poses[:2], [r], [a]).log_likelihood for r, a in zip(ranges, angles, strict=True)
    ]
    # All readings of a piece count alike here: what the bent score says of it alone.
    displaced = replace(model, bent=number("rescore.displaced")[0], alike=1.0)
    pieces = [np.array(piece) for piece in naive_pieces(ranges, angles)]
    bent = [score(wall, poses[:2], ranges[p], angles[p], displaced).log_likelihood for p in pieces]
    for i, told in enumerate(np.transpose(each)):
        moved = [one[i] for one in bent]
        total, mapped = naive_things(told, moved, ranges, angles, model)
        assert got.things[i] == pytest.approx(total, abs=1e-2)
        assert got.mapped[i] == mapped


@pytest.mark.parametrize(("split", "things"), [(False, 1), (True, 2)])
def test_a_cart_of_many_pieces_is_one_thing(split, things):
    """Its side goes on over four pieces; a gap with the wall behind it makes it two things."""
    model, wall = EvidenceModel(), corridor()
    angles = np.linspace(-0.6, 0.6, 121)
    ranges = np.full(121, 1.5)
    if split:
        ranges[55:66] = 4.0 / np.cos(angles[55:66])
    readings, features = (
        Readings(ranges, angles),
        MapFeatures(OccupancyGrid(wall, ~wall, RESOLUTION)),
    )
    got = score_poses(features, readings, np.array(POSE), model)
    hidden = np.count_nonzero(ranges == 1.5)
    assert [one.through for one in things_at(readings, got, 0)] == [False] * things
    assert sum(one.share for one in things_at(readings, got, 0)) == pytest.approx(hidden / 121)
    own = hidden * (model.best - number("rescore.apart")) - things * number("rescore.price")
    assert got.things[0] - own == pytest.approx(model.best * (121 - hidden), abs=8.0)


@given(seeds, st.integers(1, 71))
@settings(max_examples=20)
def test_the_surfaces_of_a_full_turn_are_those_of_any_heading(seed, turned):
    """A thing over the first angle is one thing, and its bearing is within it."""
    angles = np.deg2rad(np.arange(-180, 180, 5.0))
    ranges = np.repeat(np.random.default_rng(seed).choice([1.0, 3.0], 18), 4)
    ranges[:8] = np.repeat([1.0, 3.0], 4)

    def surfaces(turn):
        order, parts, goes_on = pieces(np.roll(ranges, turn), angles)
        surface = np.searchsorted(parts[~goes_on], np.arange(72), "right")
        ids = (order - turn) % 72
        return {tuple(sorted(ids[surface == k].tolist())) for k in np.unique(surface)}

    assert surfaces(turned) == surfaces(0)


def test_a_thing_behind_the_sensor_is_one_thing():
    angles = np.deg2rad(np.arange(-180, 180, 1.0))
    readings = Readings(np.where(np.abs(angles) < np.deg2rad(151), 3.0, 0.8), angles)
    features = MapFeatures(OccupancyGrid(corridor(), ~corridor(), RESOLUTION))
    scores = score_poses(features, readings, np.array(POSE), EvidenceModel())
    near = [one for one in things_at(readings, scores, 0) if one.distance < 1]
    assert [round(math.degrees(one.bearing)) % 360 for one in near] == [180]


def test_what_hides_a_wall_costs_once():
    """Twice as many readings on a thing that stands before a wall cost little more."""
    model, cost = EvidenceModel(), []
    for n in (20, 40):
        angles = np.linspace(-0.15, 0.15, n)
        far = 4.0 / np.cos(angles)
        seen = (score(corridor(), POSE, r, angles) for r in (far, np.full(n, 1.5)))
        wall, thing = (s.things[0] for s in seen)
        cost.append(wall - thing)
        assert cost[-1] < number("rescore.price") + n * number("rescore.apart")
    assert cost[1] - cost[0] < 20 * number("rescore.apart")
    assert model.best * 40 - wall < 12


@pytest.mark.parametrize(("reach", "things"), [(3.9, 0), (6.0, 1)])
@pytest.mark.parametrize("n", [12, 24])
def test_rays_that_meet_nothing_cost_once_where_the_map_has_a_wall(reach, things, n):
    angles = np.linspace(-0.15, 0.15, n)
    readings = Readings(np.array([1.0]), np.array([np.pi / 2]))
    silent = replace(readings, silent=Readings(np.full(n, reach), angles))
    features = MapFeatures(OccupancyGrid(corridor(), ~corridor(), RESOLUTION))
    met, unmet = (
        score_poses(features, r, np.array(POSE), EvidenceModel()) for r in (readings, silent)
    )
    assert met.things[0] - unmet.things[0] == pytest.approx(
        things * number("rescore.price"), abs=0.1
    )
    assert met.log_likelihood[0] == unmet.log_likelihood[0]


def test_a_wall_that_is_passed_counts_once_and_strays_do_not():
    """So does the wall behind it, which goes on over four pieces."""
    angles = np.linspace(-0.6, 0.6, 36)
    for screened in (False, True):
        got = score(corridor(2.5 if screened else None), POSE, 4.0 / np.cos(angles), angles)
        assert (got.passing[0].sum(), got.through[0], got.mapped[0]) == (4 * screened, screened, 1)
    far = 4.0 / np.cos(angles)
    far[18] = 6.5
    got = score(corridor(), POSE, far, angles)
    assert got.crossed.sum() == 1
    assert got.through[0] == 0


def test_an_empty_room_is_four_walls():
    wall = np.pad(np.zeros((70, 110), bool), 5, constant_values=True)
    angles = np.deg2rad(np.arange(-180, 180, 2.0))
    ranges = cast_rays(distance_image(wall), [2.0, 1.5], angles, 20.0, RESOLUTION)
    got = score(wall, [[2.0, 1.5, 0.0]], ranges, angles)
    assert (got.mapped[0], got.through[0]) == (4, 0)


def test_things_are_named_by_where_they_are():
    wall = corridor()
    angles = np.concatenate((np.linspace(-0.1, 0.1, 21), np.linspace(0.4, 0.5, 7)))
    ranges = np.where(angles < 0.2, 4.0 / np.cos(angles), 1.5)  # the wall, and a box before it
    features = MapFeatures(OccupancyGrid(wall, ~wall, RESOLUTION))
    readings = Readings(ranges, angles)
    scores = score_poses(features, readings, np.array(POSE), EvidenceModel())
    (box,) = things_at(readings, scores, 0)
    assert (box.bearing, box.distance) == pytest.approx((0.45, 1.5), abs=0.01)
    assert (box.share, box.through) == (pytest.approx(7 / 28), False)
    screened = MapFeatures(OccupancyGrid(corridor(screen=3.0), ~corridor(screen=3.0), RESOLUTION))
    scores = score_poses(screened, readings, np.array(POSE), EvidenceModel())
    (gone, box) = things_at(readings, scores, 0)
    assert gone.through
    assert gone.share > box.share
