"""Errors that all readings share are found where they are, and only there."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from walls import bent, redrawn

from imgloc import LaserScan, MapFeatures, OccupancyGrid, draw, explain, localize, pipeline
from imgloc.features.scanpoints import Readings, one_per_place
from imgloc.options import Drawn, FusedOptions, Options, Sensor, Shared
from imgloc.output.tables import answer_text
from imgloc.search.adapt import BENT, Told, adapt, drawn_gain, drawn_walls, judged, told_by
from imgloc.search.refine import normal_equations, refine
from imgloc.search.rescore import score_readings
from imgloc.simulation.scans import simulate
from imgloc.simulation.worlds import WORLDS, render

AS_IT_IS = Options(fused=FusedOptions(strained=float("inf")))


@cache
def world():
    """A world at 10 cm, with scans taken in it at 1 cm."""
    grid = render(WORLDS["curved"](), 0.1)
    sensor = Sensor(fov=2 * np.pi, rays=181, range_max=30.0)
    return grid, simulate(grid, 6, 4, sensor, render(WORLDS["curved"](), 0.01))


@cache
def features():
    return MapFeatures(world()[0])


@cache
def thick_features():
    return MapFeatures(thick(world()[0]))


def thick(grid):
    """The map with walls that are 0.2 m thicker on each side."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    return redrawn(grid, cv2.dilate(grid.occupied.astype(np.uint8), disc) > 0)


def bent_map():
    """The map as somebody else draws it: each block of 2 m stands 0.2 m off, any way."""
    return redrawn(world()[0], bent(world()[0], 20))


def walls_in(features, scans=None):
    """What scans of the world say together about the walls of a map."""
    found = [pipeline.find_modes(features, s, Options()) for s in scans or world()[1].scans]
    told = [told_by(features, f.readings, f.poses, Shared(), Options()) for f in found]
    return judged(told, Shared())


def test_walls_that_others_drew_are_taken_for_bent_by_one_scan():
    drawn = MapFeatures(thick(bent_map()))
    assert drawn.thickness == pytest.approx(0.5, abs=0.05)
    for scan, pose in zip(world()[1].scans, world()[1].poses, strict=True):
        answer, plain = (localize(drawn, scan, o) for o in (Options(), AS_IT_IS))
        assert (answer.evidence.thinner, answer.evidence.bent) == pytest.approx((0.1, 0.1))
        assert answer.verdict == "unique"
        assert plain.hypotheses[0].mass < answer.hypotheses[0].mass
        assert away(answer, pose) < 0.45  # blocks of wall are 0.2 m off, and walls 0.2 m too thick
        words = "allows for walls 0.10 m thinner on each side and pieces of wall 0.10 m off"
        assert words in answer_text("scan", answer)


@pytest.mark.parametrize("make", [lambda: thick(world()[0]), bent_map])
def test_walls_are_not_bent_if_thick_ones_stand_right_or_the_image_has_thin_ones(make):
    there = MapFeatures(make())
    for scan in world()[1].scans:
        assert localize(there, scan).evidence.bent == 0


def test_ranges_of_another_scale_do_not_bend_thick_walls():
    sensor = Sensor(fov=2 * np.pi, rays=181, range_max=30.0)
    for scan, pose in simulate(thick(world()[0]), 6, 4, sensor).with_poses():
        answer = localize(thick_features(), scan.scaled(1.05))
        assert answer.evidence.bent == 0
        assert away(answer, pose) < 0.1


def test_walls_are_thick_by_cells_and_by_metres():
    line = np.zeros((30, 40), bool)
    line[[3, -4]] = line[:, [3, -4]] = True
    wall = np.kron(line, np.ones((5, 5))) > 0
    for walls, cell, thickness in ((line, 0.5, 0.5), (wall, 0.05, 0.25), (wall, 0.1, 0.5)):
        there = MapFeatures(OccupancyGrid(walls, ~walls, cell))
        assert there.thickness == pytest.approx(thickness)
        found = drawn_walls(there, np.inf, Shared())
        is_thick = walls is wall and cell == 0.1
        assert found == (Shared(thinner=1, bent=0.1, usual=0.5) if is_thick else Shared())
    assert drawn_walls(there, np.inf, Shared(thinner=2)).thinner == 2
    assert drawn_walls(there, -100.0, Shared()) == Shared()
    stated = Drawn(bent=0.0).on(Shared(), there.grid.resolution)
    assert stated.straight
    assert drawn_walls(there, np.inf, stated) == stated


def test_where_no_sensor_can_be_nothing_speaks_for_bent_walls():
    readings = one_per_place(world()[1].scans[0], 0.07)
    beside = np.array([[-50.0, -50.0, 0.0]])
    assert drawn_gain(thick_features(), readings, beside, Options()) == -np.inf
    assert drawn_gain(features(), readings, world()[1].poses[:1], Options()) == -np.inf


def test_scans_tell_together_what_walls_a_map_has():
    assert walls_in(features()) == Shared()
    assert walls_in(thick_features()) == Shared(thinner=2)
    assert walls_in(MapFeatures(bent_map())).bent == BENT
    scaled = walls_in(features(), [scan.scaled(1 / 1.04) for scan in world()[1].scans])
    assert scaled.scale == pytest.approx(1.04, abs=0.01)
    assert replace(scaled, scale=1.0) == Shared()


def test_furniture_that_no_map_shows_is_no_bent_wall():
    grid, rng = render(WORLDS["curved"](), 0.01), np.random.default_rng(3)
    occupied, free = grid.occupied.astype(np.uint8), np.argwhere(grid.free)
    for row, column in rng.choice(free, len(free) // 20_000).tolist():  # one for two square metres
        high, wide = rng.integers(20, 60, 2).tolist()
        cv2.rectangle(occupied, (column, row), (column + wide, row + high), 1, -1)
    there = replace(grid, occupied=occupied > 0, free=grid.free & (occupied == 0))
    sensor = Sensor(fov=2 * np.pi, rays=181, range_max=30.0)
    assert walls_in(features(), simulate(there, 6, 4, sensor, there).scans) == Shared()


def test_what_is_known_of_the_walls_is_kept_where_scans_say_no_more():
    def of(walls, now):
        return judged([Told(one) for one in walls], now)

    told = np.zeros((3, 4, 2)) + [0.0, -20.0]
    assert of(told, Shared(1.0, 7, 0.3)) == Shared(1.0, 7, 0.3)
    told[:, 1, 0] = told[:, 0, 1] = 4.9  # nats per scan: too few for thinner walls, or bent ones
    assert of(told, Shared()) == Shared()


def away(answer, pose):
    return float(np.hypot(answer.best.x - pose[0], answer.best.y - pose[1]))


def test_walls_lose_cells_but_lines_stay():
    occupied = np.zeros((12, 14), bool)
    occupied[2:7, 2:12] = True  # five cells thick
    occupied[9, 2:12] = True  # a line
    there = MapFeatures(OccupancyGrid(occupied, ~occupied, 0.1))
    assert there.thinner(0) is there
    twice = there.thinner(2)
    assert twice is there.thinner(2)
    assert np.flatnonzero(there.thinner(1).grid.occupied[:8, 7]).tolist() == [3, 4, 5]
    assert twice.grid.occupied[9].sum() >= 9  # it may lose its ends
    rows = np.flatnonzero(twice.grid.occupied[:8, 7])
    assert rows.tolist() == [4]
    assert np.array_equal(twice.grid.free, ~twice.grid.occupied)
    assert twice.cell == there.cell


def test_a_pose_may_carry_a_scale():
    scans = world()[1]
    seen = one_per_place(scans.scans[0], 0.07)
    poses = np.array([scans.poses[0], scans.poses[0] + (0.1, 0.0, 0.05)])
    one, half = (np.column_stack((poses, np.full(2, s))) for s in (1.0, 0.5))
    model, shrunk = FusedOptions().model, Readings(0.5 * seen.ranges, seen.angles)
    same = score_readings(features(), seen, one, model)
    assert same == pytest.approx(score_readings(features(), seen, poses, model))
    halved = score_readings(features(), seen, half, model)
    assert halved == pytest.approx(score_readings(features(), shrunk, poses, model), rel=1e-5)
    (A,), (b,), _ = normal_equations(one, seen.xy, features().field, 0.1)
    (without,), (rest,), _ = normal_equations(poses, seen.xy, features().field, 0.1)
    assert A.shape == (2, 4, 4)
    assert A[:, :3, :3] == pytest.approx(without, rel=1e-4)
    assert b[:, :3] == pytest.approx(rest, rel=1e-4)


def test_the_slope_of_a_scale_is_its_difference():
    pose = np.array([[*world()[1].poses[1], 1.01]])
    xy, step = one_per_place(world()[1].scans[1], 0.07).xy, np.array([0, 0, 0, 1e-3])
    # With a kernel as wide as this b is half the slope of the sum of squares.
    at = (normal_equations(pose + k * step, xy, features().field, 1e3) for k in (-1, 0, 1))
    (_, _, less), (_, (b,), _), (_, _, more) = at
    assert b[0, 3] == pytest.approx(len(xy) * (more - less)[0] / 4e-3, rel=0.1)


def test_a_scale_moves_by_two_percent_a_step():
    xy = 0.9 * one_per_place(world()[1].scans[0], 0.07).xy
    pose, much = np.array([[*world()[1].poses[0], 1.0]]), (5.0,)
    once, twice = (refine(pose, xy, features().field, sigmas=much, iterations=n) for n in (1, 2))
    assert [once[0, 3], twice[0, 3]] == pytest.approx([1.02, 1.04])


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_ranges_of_another_scale_are_placed(factor):
    for scan, pose in zip(world()[1].scans, world()[1].poses, strict=True):
        answer = localize(features(), scan.scaled(factor))
        assert away(answer, pose) < 0.1
        assert answer.verdict == "unique"
        assert answer.evidence.scale * factor == pytest.approx(1, abs=0.02)
        assert answer.evidence.misfit < 0.5


def test_walls_that_are_too_thick_are_seen_as_such():
    for scan, pose in zip(world()[1].scans, world()[1].poses, strict=True):
        answer, plain = (localize(thick_features(), scan, o) for o in (Options(), AS_IT_IS))
        assert away(answer, pose) < 0.1
        assert answer.evidence.thinner == pytest.approx(0.2)
        assert answer.evidence.scale == 1.0
        assert answer.evidence.misfit < plain.evidence.misfit - 0.5
        assert (plain.evidence.thinner, plain.evidence.scale) == (0.0, 1.0)


def test_walls_of_a_very_large_map_that_are_too_thick_are_seen_as_such(monkeypatch):
    monkeypatch.setattr("imgloc.features.mapfeatures.PEELED_CELLS", 0)
    wide, known = MapFeatures(thick(world()[0])), Options(shared=Shared(thinner=2))
    for scan, pose in list(world()[1].with_poses())[1:]:
        assert away(localize(wide, scan), pose) < 0.08
        stated = localize(wide, scan, known)
        assert away(stated, pose) < 0.08
        assert (stated.evidence.scale, stated.evidence.thinner) == (1.0, pytest.approx(0.2))


def test_no_more_cells_are_taken_off_than_allowed(monkeypatch):
    monkeypatch.setattr("imgloc.search.adapt.THINNEST", 1)
    assert localize(thick_features(), world()[1].scans[0]).evidence.thinner < 0.15


def test_an_exact_map_is_left_alone():
    for scan in world()[1].scans:
        said = localize(features(), scan).evidence
        assert (said.scale, said.thinner) == (1.0, 0.0)
    pose, seen = np.array([world()[1].poses[0]]), one_per_place(world()[1].scans[0], 0.07)
    assert adapt(features(), seen, pose, Shared(), Options()) == Shared()


def test_what_fits_is_not_searched_again(monkeypatch):
    asked = []
    monkeypatch.setattr(pipeline, "adapt", lambda *given: asked.append(given) or given[3])
    for scan, n in ((world()[1].scans[0], 0), (world()[1].scans[0].scaled(0.95), 1)):
        localize(features(), scan)
        assert len(asked) == n


def test_no_scale_is_farther_off_than_allowed():
    scan = world()[1].scans[0].scaled(0.9)
    narrow = Options(fused=FusedOptions(most_scaled=1.02))
    assert abs(np.log(localize(features(), scan, narrow).evidence.scale)) <= np.log(1.02) + 1e-9


def test_what_is_known_is_where_the_search_begins():
    scan, pose = world()[1].scans[2].scaled(1 / 1.12), world()[1].poses[2]
    known = Options(shared=Shared(scale=1.12), fused=AS_IT_IS.fused)
    answer = localize(features(), scan, known)
    assert away(answer, pose) < 0.05
    assert answer.evidence.scale == 1.12
    assert answer.parameters["shared"] == vars(Shared(1.12))


def test_time_is_that_of_all_searches(monkeypatch):
    scan, now = world()[1].scans[0].scaled(0.95), [0.0]
    monkeypatch.setattr("imgloc.pipeline.time.monotonic", lambda: now[0])
    found = pipeline.find_modes

    def slow(*given, **how):
        out = found(*given, **how)
        now[0] += 6.0
        return out

    monkeypatch.setattr(pipeline, "find_modes", slow)
    answer = localize(features(), scan, Options(time_budget=10.0))
    assert (answer.complete, answer.evidence.scale) == (True, pytest.approx(1 / 0.95, abs=0.02))
    answer = localize(features(), scan, Options(time_budget=5.0))  # gone before the second
    assert (answer.complete, answer.evidence.scale) == (False, 1.0)
    assert answer.verdict != "unique"


def test_parts_are_asked_once_it_is_known_whether_walls_are_bent_and_not_again(monkeypatch):
    scan, asked = world()[1].scans[0], []
    found = pipeline.find_modes

    def listened(there, scan, options, *, more=None, alone=False):
        asked.append((there.grid.occupied.sum(), more is None))
        return found(there, scan, options, more=more, alone=alone)

    monkeypatch.setattr(pipeline, "find_modes", listened)
    answer = localize(thick_features(), scan)
    assert answer.evidence.thinner > 0
    walls, whole = zip(*asked, strict=True)
    assert walls[0] == walls[1] > walls[2]
    assert whole[:3] == (False, True, False)
    asked.clear()
    assert localize(features(), scan.scaled(0.95)).evidence.scale != 1
    assert [again[1] for again in asked] == [True] + [False] * (len(asked) - 1)


def test_explanations_and_words_allow_for_it():
    scan = world()[1].scans[0]
    answer = localize(thick_features(), scan)
    why = explain(thick_features(), scan, answer)
    best = answer.evidence.best - answer.evidence.misfit
    assert why.fits[0].per_reading == pytest.approx(best, abs=5e-3)  # at the mean of its maxima
    assert why.fits[0].rays.counts["agrees"] > 0.8 * scan.valid.sum()
    assert "fits far better with walls 0.20 m thinner" in answer_text("scan 0", answer)
    far = scan.scaled(0.95)
    answer = localize(features(), far)
    assert explain(features(), far, answer).fits[0].rays.counts["agrees"] > 0.8 * scan.valid.sum()
    drawn = draw(features(), answer, far).image
    undone = replace(answer, evidence=replace(answer.evidence, scale=1.0))
    assert np.array_equal(drawn, draw(features(), undone, far.scaled(answer.evidence.scale)).image)


def test_many_readings_at_the_end_of_the_reach_are_none():
    ranges = np.full(100, 3.0)
    ranges[:20] = 29.9
    scan = LaserScan(ranges, np.linspace(0, 3, 100), range_max=30.0)
    assert one_per_place(scan, 0.07).ranges.max() < 4
    few = replace(scan, ranges=np.where(np.arange(100) < 3, 29.9, 3.0))
    assert one_per_place(few, 0.07).ranges.max() > 29
    all_of_them = replace(scan, ranges=np.full(100, 29.9))
    assert len(one_per_place(all_of_them, 0.07)) == 100
