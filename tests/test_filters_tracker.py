"""The hypothesis tracker and the particle filter, on scans of bundled worlds along a path."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from places import ANGLES, POSES, drive, features_of

from imgloc import ScanSet, follow, load_map, load_scans, make_filter, prepare, sample_poses
from imgloc.errors import ConfigError, ScanError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import Followed, belief_of, deviations_of
from imgloc.filters.evidence import GATE, NO_PLACES, Places, Sight, settled, view_of
from imgloc.filters.follow import Follower
from imgloc.filters.motion import compose_poses
from imgloc.filters.tracker import Tracker, TrackerOptions, _Search
from imgloc.geometry import transform_poses, wrap
from imgloc.lab.particle import ParticleFilter, ParticleOptions, kld_bound, low_variance
from imgloc.model import LaserScan, OccupancyGrid, Pose2D, compose, inverse
from imgloc.options import Every, Options, Shared
from imgloc.robot.lasers import Laser
from imgloc.search.adapt import Told
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render
from tools.filters import Searches, piece
from tools.trust.disturb import dilated

WORLD = "visibility"


@cache
def log() -> ScanSet:
    """Twenty-four scans along the corridor of a world, half a metre apart, with odometry."""
    poses = np.array([[4.0 + 0.5 * k, 7.0, 0.02 * k] for k in range(24)])
    seen = drive(poses)
    scans = [replace(scan, stamp=float(k)) for k, scan in enumerate(seen.scans)]
    return replace(seen, scans=tuple(scans), stamps=np.arange(24.0))


BENT_WALLS = np.array([[0.0, 10.0], [9.0, 20.0], [0.0, 0.0], [0.0, 0.0]])


def errors(moments, scans):
    return [
        np.inf if m.best is None else np.hypot(*(np.array([*m.best]) - scans.poses[m.index])[:2])
        for m in moments
    ]


@cache
def searches():
    return Searches(features_of(WORLD), Options())


def found(scan):
    """What a search finds in a scan of the log, done once for all tests."""
    return searches()(log().scans[int(scan.stamp)])


def tracker_of(find=found, **how):
    return make_filter("tracker", features_of(WORLD), Options(), find=find, **how)


@cache
def tracked():
    return list(follow(features_of(WORLD), log(), tracker_of()))


def test_it_is_found_and_published_only_when_unique() -> None:
    moments = tracked()
    assert max(errors(moments, log())[4:]) < 0.3
    assert moments[0].pose is None  # one scan is not enough to be sure of a track
    assert moments[-1].pose is not None
    assert [m.pose is None for m in moments] == [m.belief.verdict != "unique" for m in moments]
    assert moments[5].metres == pytest.approx(2.5, rel=0.1)
    values = np.linalg.eigvalsh(moments[-1].covariance)
    assert (values > 0).all()


def test_map_odom_takes_odometry_to_the_map() -> None:
    last = tracked()[-1]
    at = compose_poses(
        np.array([last.map_odom.x, last.map_odom.y, last.map_odom.theta]), log().odom[-1]
    )
    np.testing.assert_allclose(at[:2], (last.best.x, last.best.y), atol=1e-9)


def test_the_sensor_stands_beside_what_odometry_is_of() -> None:
    mount = Pose2D(0.4, -0.1, 0.3)
    scans = log()
    back = inverse(mount)
    odom = compose_poses(scans.odom, np.array([back.x, back.y, back.theta]))
    mounted = tuple(replace(s, T_base_laser=mount) for s in scans.scans)
    moved = ScanSet(mounted, scans.poses, scans.stamps, odom)
    moments = list(follow(features_of(WORLD), moved, tracker_of()))
    for one, other in zip(tracked(), moments, strict=True):
        if not one.looked or not other.looked:
            continue
        sensor = compose(other.best, mount)
        # Not the same: what odometry may be wrong by is that of the robot's own motion.
        assert one.best.x == pytest.approx(sensor.x, abs=0.03)
        assert one.best.y == pytest.approx(sensor.y, abs=0.03)
        assert one.best.theta == pytest.approx(sensor.theta, abs=0.05)


@pytest.mark.parametrize(("view", "behind", "told"), [(180, 0, 1), (358, 0, 0), (180, np.pi, 0)])
def test_a_turn_confirms_a_place_as_far_as_it_shows_what_was_out_of_view(view, behind, told):
    x, y, _ = POSES["curved"]
    poses = np.array([[x, y, turn] for turn in np.linspace(0, np.pi, 10)])
    angles = np.deg2rad(np.arange(-view / 2, view / 2 + 0.1, 2.0))
    # Each other scan is of a laser that looks backwards, if there is one.
    mounts = np.array([[0.0, 0.0, behind * (k % 2)] for k in range(10)])
    at = poses + mounts
    ranges = simulate_ranges(render(WORLDS["curved"](), 0.05), at, angles, seed=2, range_max=30.0)
    scans = [
        LaserScan(
            r, angles, range_max=30.0, stamp=float(k),
            T_base_laser=Pose2D(*mount), laser=f"{mount[2]}",
        )
        for k, (r, mount) in enumerate(zip(ranges, mounts, strict=True))
    ]  # fmt: skip
    turning = ScanSet(tuple(scans), poses, np.arange(10.0), poses)
    tracker = make_filter("tracker", features_of("curved"), Options())
    moments = list(follow(features_of("curved"), turning, tracker))
    assert any(m.belief.verdict == "unique" for m in moments) == told
    assert max(errors(moments[-5:], turning)) < 0.2


def test_a_place_that_the_search_has_not_listed_does_not_die() -> None:
    """A component is scored where it is, not only where a search looked."""
    scans, features = log(), features_of(WORLD)
    truth = transform_poses(inverse(features.grid.origin), scans.poses)
    elsewhere = Places(np.array([[2.0, 2.0, 1.0], [20.0, 3.0, 0.0]]), np.zeros((2, 3, 3)))
    tracker = Tracker(features, find=lambda _: elsewhere)
    tracker.place(truth[0], (0.1, 0.05))
    for k, moment in enumerate(follow(features, scans, tracker)):
        assert errors([moment], scans)[0] < 0.4, k


def test_which_of_close_maxima_it_is_may_show_with_the_next_scans() -> None:
    """A search that says how far its maxima are apart is followed from one to another."""
    scans, features = piece(log(), range(3)), features_of(WORLD)
    beside = transform_poses(inverse(features.grid.origin), scans.poses[:1]) + [0.45, 0.0, 0.0]
    for deviation, verdict in ((0.0, "lost"), (0.15, "ambiguous")):
        places = Places(beside, np.diag([deviation**2, deviation**2, 0.0])[None])
        tracker = Tracker(features, find=lambda scan, at=places: NO_PLACES if scan.stamp else at)
        moments = list(follow(features, scans, tracker))
        assert (errors(moments, scans)[-1] < 0.1) == (deviation > 0)
        assert moments[-1].belief.verdict == verdict


def carried_off(scans, chosen):
    """The moments of a filter that is put at a pose of long ago before the scan at 10 s."""
    follower, moments = Follower(features_of(WORLD), chosen), []
    for scan, odom, stamp in zip(scans.scans, scans.odom, scans.stamps, strict=True):
        if stamp == 10.0:
            follower.place(Pose2D(*scans.poses[2]), (0.1, 0.05), "kidnap")
        moments.append(follower.step(scan, odom, stamp))
    return moments


@pytest.mark.parametrize("name", ["tracker", "particle"])
def test_a_kidnapping_is_noticed_at_once_and_recovered_from(name: str) -> None:
    scans, features = log(), features_of(WORLD)
    chosen = make_filter(name, features, Options(), seed=1, find=found)
    moments = carried_off(scans, chosen)
    away = errors(moments, scans)
    assert all(m.belief.verdict != "unique" for m, e in zip(moments, away, strict=True) if e > 1)
    assert max(away[18:]) < 0.5
    assert moments[-1].belief.resets > 0


def test_another_place_than_the_unique_one_takes_more_scans() -> None:
    """It fits for some metres where a building repeats."""
    tracker = tracker_of()
    tracker.place(np.array([5.0, 7.0, 0.0]), (0.1, 0.1))
    assert tracker._needed(np.array([9.0, 7.0, 0.0])) == 2  # nothing was unique yet
    tracker._unique = np.array([5.0, 7.0, 0.0]), 0.0
    assert [tracker._needed(np.array([x, 7.0, 0.0])) for x in (5.9, 6.1)] == [2, 5]
    for _ in range(10):  # by odometry it is at 10, and may be a metre off
        tracker.move(np.array([0.5, 0.0, 0.0]))
    assert [tracker._needed(np.array([x, 7.0, 0.0])) for x in (8.6, 11.4, 11.6)] == [2, 2, 5]


def test_who_is_carried_off_is_followed_from_the_first_scan_that_tells_where_to() -> None:
    carried = piece(log(), range(6), range(16, 20))
    moments = list(follow(features_of(WORLD), carried, tracker_of()))
    assert [m.belief.verdict for m in moments[5:7]] == ["unique", "ambiguous"]
    assert errors(moments, carried)[6] < 0.1
    assert 0.03 < 1 - moments[6].belief.mass[0] < 0.2  # it may have been somebody in the way


def test_somebody_in_the_way_once_makes_no_robot_move() -> None:
    """A scan that fits nowhere tells no other place."""
    scans, features = piece(log(), range(7)), features_of(WORLD)
    hidden = np.where(np.arange(len(ANGLES)) < 0.7 * len(ANGLES), 0.6, scans[5].ranges)
    scans = replace(
        scans, scans=(*scans.scans[:5], replace(scans[5], ranges=hidden), *scans.scans[6:])
    )
    seen = Searches(features, Options())
    tracker = Tracker(features, find=lambda s: seen(s) if s is scans[5] else found(s))
    moments = list(follow(features, scans, tracker))
    assert moments[5].belief.verdict == "ambiguous"
    assert max(errors(moments, scans)) < 0.1


def test_a_tracker_that_knows_its_place_seldom_searches_the_map() -> None:
    asked = []

    def find(scan):
        asked.append(scan.stamp)
        return found(scan)

    list(follow(features_of(WORLD), log(), Tracker(features_of(WORLD), find=find)))
    # Each scan until it is unique, then after 1.5 m, then twice as far each time, up to 6 m.
    assert asked == [0.0, 1.0, 3.0, 9.0, 21.0]


def test_no_scan_of_a_robot_that_is_sure_waits_for_a_whole_search(monkeypatch) -> None:
    taken, step, sure = list[int](), _Search.step, [False]

    def counted(self):
        taken[-1] += 1
        step(self)

    monkeypatch.setattr(_Search, "step", counted)
    taken.append(0)
    for moment in follow(features_of(WORLD), log(), tracker_of(None)):
        sure.append(moment.belief.verdict == "unique")
        taken.append(0)
    assert [n for n, was in zip(taken, sure, strict=True) if n > 1 and was] == []
    assert sum(n == 1 for n, was in zip(taken, sure, strict=True) if was) > 8
    assert taken[0] > 1  # who is lost does not go on without


def test_places_of_a_search_are_scored_where_the_robot_is_by_then() -> None:
    scans, held = log(), []
    how = TrackerOptions(search=(2.0, 2.0), later=1.5)
    robot = Tracker(features_of(WORLD), how=how, find=found)
    for moment in follow(features_of(WORLD), scans, robot):
        held.append(robot._searching)
        if robot._searching is not None:
            places = robot._searching.places(1)
            assert moment.belief.verdict == "unique"
            assert np.hypot(*(places.poses[0] - scans.poses[moment.index])[:2]) < 0.5
    spans = [sum(one is another for another in held) for one in held if one is not None]
    assert set(spans) <= {3, 4}  # 1.5 m by odometry, about half a metre for each scan
    assert len(spans) > 6


def test_unique_takes_two_scans_that_agree_or_one_and_a_place_that_was_told() -> None:
    features, scans = features_of(WORLD), piece(log(), range(4, 7))
    for start, expected in ((None, "ambiguous"), (Pose2D(*scans.poses[0]), "unique")):
        chosen = Tracker(features, how=TrackerOptions(sure=(0.0, 0.0)), find=found)
        moments = list(follow(features, scans, chosen, start=start, every=Every(0.0, 0.0)))
        assert moments[0].belief.mass[0] >= 0.99
        assert [moments[k].belief.verdict for k in (0, -1)] == [expected, "unique"]


def test_a_heading_is_looked_for_as_far_as_it_may_be_off() -> None:
    features = features_of(WORLD)
    truth = transform_poses(inverse(features.grid.origin), log().poses)[:1]
    view, off = view_of(log()[0], Options()), truth + [0.1, -0.1, 0.3]
    covariance = np.diag([0.1, 0.1, 0.2])[None] ** 2
    assert np.abs(settled(features, view, off) - truth)[0, 2] > 0.1
    near = settled(features, view, off, covariance)
    assert np.hypot(*(near - truth)[0, :2]) < 0.1
    assert np.abs(near - truth)[0, 2] < 0.02


def test_an_early_pose_is_looked_around_first_when_there_are_too_many() -> None:
    features = features_of(WORLD)
    truth = transform_poses(inverse(features.grid.origin), log().poses)[:1]
    view, off = view_of(log()[0], Options()), truth + [0.1, -0.1, 0.3]
    poses, wide = np.repeat(off, 12, axis=0), np.diag([0.5, 0.5, 0.2]) ** 2
    near = settled(features, view, poses, np.repeat(wide[None], 12, axis=0))
    away = np.abs(near - truth)[:, 2]
    assert away[0] < 0.02
    assert away[-1] > 0.1


def shortened(scans: ScanSet, factor: float) -> ScanSet:
    """The log as a sensor records it whose ranges are wrong by a factor."""
    return replace(scans, scans=tuple(scan.scaled(factor) for scan in scans.scans))


@pytest.mark.parametrize("name", ["tracker", "particle", "grid"])
def test_what_is_known_of_the_scale_is_used(name: str) -> None:
    features = features_of(WORLD)
    truth = transform_poses(inverse(features.grid.origin), log().poses)[0]
    known = Options(shared=Shared(1 / 0.9))
    beliefs = []
    for scans, options in ((log(), Options()), (shortened(log(), 0.9), known)):
        chosen = make_filter(name, features, options, find=lambda _: NO_PLACES)
        chosen.place(truth, (0.1, 0.05))
        chosen.see(scans[0])
        assert not chosen.watch(scans[0])
        beliefs.append(chosen.belief.poses[0])
    np.testing.assert_allclose(*beliefs, atol=0.02)


def test_walls_that_are_known_to_be_too_thick_are_thinner() -> None:
    for name in ("tracker", "particle", "grid"):
        chosen = make_filter(name, features_of(WORLD), Options(shared=Shared(1.0, 1)))
        walls = np.count_nonzero(chosen.features.grid.occupied)
        assert 0 < walls < np.count_nonzero(features_of(WORLD).grid.occupied)


def test_bent_walls_are_found_along_the_way_and_the_belief_begins_again(monkeypatch) -> None:
    monkeypatch.setattr("imgloc.filters.tracker.told_by", lambda *_: Told(BENT_WALLS))
    bad = replace(Options(), fused=replace(Options().fused, strained=0.0))  # no scan fits
    tracker = make_filter("tracker", features_of(WORLD), bad)
    tracker.how = replace(tracker.how, walls=(2, 2.5), sure=(100.0, 100.0))  # never unique
    carried, step = np.array([*log().poses[0, :2], 0.0]), np.array([0.5, 0.0, 0.02])
    tracker.place(carried, (0.3, 0.1))
    scans = iter(log().scans)
    tracker.see(next(scans))
    while not tracker.options.shared.bent:
        tracker.move(step)
        carried = compose_poses(carried, step)
        tracker.see(next(scans))
    assert tracker.options.shared == Shared(thinner=1, bent=0.15)
    assert tracker.features is features_of(WORLD).thinner(1)
    # What scans said on straight walls is forgotten: only the given pose counts, and a new search.
    assert np.hypot(*(tracker.belief.poses[0] - carried)[:2]) < 1.0
    assert tracker.belief.verdict != "unique"


@pytest.mark.parametrize("strained", [0.0, 0.5])
def test_on_bent_walls_a_given_pose_holds_until_a_scan_fits_elsewhere(strained: float) -> None:
    options = Options(shared=Shared(bent=0.15))
    options = replace(options, fused=replace(options.fused, strained=strained))
    tracker = make_filter("tracker", features_of(WORLD), options, find=found)
    given = np.array([5.0, 9.0, 2.0])
    tracker.place(given, (0.1, 0.1))
    tracker.see(log().scans[0])
    best = tracker.belief.poses[0]
    held = bool(np.hypot(*(best - given)[:2]) < 1.0)
    assert held == (strained == 0.0)
    assert tracker.belief.verdict != "unique"


def niches() -> tuple[MapFeatures, ScanSet]:
    """A corridor that is itself if turned by 180 degrees, but for one niche that is deeper.

    And a drive from one end to the other.
    """
    free = np.zeros((60, 300), bool)
    free[22:42, 10:290] = True
    for column in (40, 90, 140, 200, 250):
        free[42:50, column : column + 12] = True
    free |= free[::-1, ::-1]
    free[50:53, 90:102] = True
    features = prepare(OccupancyGrid(~free, free, 0.1))
    poses = np.array([[x, 2.9, 0.0] for x in np.arange(6.0, 22.0, 0.5)])
    angles = np.deg2rad(np.arange(-90.0, 91.0))
    ranges = simulate_ranges(features.grid, poses, angles, seed=3, range_max=8.0)
    scans = tuple(LaserScan(r, angles, range_max=8.0, stamp=float(k)) for k, r in enumerate(ranges))
    return features, ScanSet(scans, poses, np.arange(float(len(poses))), poses)


def test_a_given_pose_at_a_twin_of_the_true_place_is_found_out() -> None:
    features, scans = niches()
    truth, twin = Pose2D(*scans.poses[0]), Pose2D(24.0, 3.1, np.pi)
    ends = []
    for start in (truth, twin):
        tracker = make_filter("tracker", features, Options())
        moments = list(follow(features, scans, tracker, start=start, deviation=(0.2, 0.1)))
        ends.append(moments[16:])  # 5 m after the deeper niche was seen
    assert {m.belief.verdict for m in ends[0]} == {"unique"}
    assert max(errors(ends[0], scans)) < 0.2
    assert {m.belief.verdict for m in ends[1]} == {"ambiguous"}


def test_a_given_pose_is_forgotten_once_the_robot_is_unique_elsewhere() -> None:
    for given, kept in ((log().poses[0], True), (np.array([5.0, 9.0, 2.0]), False)):
        tracker, start = tracker_of(), Pose2D(*given)
        moments = list(follow(features_of(WORLD), log(), tracker, start=start))
        assert moments[-1].belief.verdict == "unique"
        assert errors(moments, log())[-1] < 0.2
        # What walls turn out to be does not bring it back.
        tracker._begin_again()
        assert (len(tracker.belief.poses) == 1) == kept


def test_evidence_is_new_more_slowly_on_bent_walls() -> None:
    options, way = Options(shared=Shared(bent=0.15)), np.array([1.0, 0.0])
    straight, bent = (Tracker(features_of(WORLD), o) for o in (Options(), options))
    shares = [one._fresh(Laser(way=way)) for one in (straight, bent)]
    assert shares[0] == pytest.approx(1 / 3)  # each 3 m
    assert shares[1] == pytest.approx(1 / 6)
    bent.place(log().poses[0], (0.1, 0.1))
    assert bent._fresh(Laser(way=way)) == pytest.approx(1 / 3)


def test_what_particles_are_drawn_from_has_a_shared_error_once(monkeypatch) -> None:
    features, asked = features_of(WORLD), list[tuple[int, Shared]]()

    def drawn(there, scan, n, rng, options):
        asked.append((int(there.grid.occupied.sum()), options.shared))
        return sample_poses(there, scan, n, rng, options)

    monkeypatch.setattr("imgloc.lab.particle.sample_poses", drawn)
    options = Options(shared=Shared(1.05, 1))
    particles = ParticleFilter(features, options, ParticleOptions(reset_by="fused"))
    particles.see(log()[0].scaled(1 / 1.05))
    assert asked == [(int(features.thinner(1).grid.occupied.sum()), Shared())]


def test_a_scale_is_found_along_the_way_and_only_where_there_is_one() -> None:
    features, truth = features_of(WORLD), Pose2D(*log().poses[0])
    for factor in (1.0, 0.95):
        tracker = Tracker(features, find=lambda _: NO_PLACES)
        moments = list(follow(features, shortened(log(), factor), tracker, start=truth))
        assert tracker.options.shared.scale == pytest.approx(1 / factor, abs=0.01 * (factor < 1))
        assert errors(moments, log())[-1] < 0.2


def test_scales_that_scatter_are_none() -> None:
    """Every second scan says another scale: their median is as far off as they are apart."""
    truth, factors = Pose2D(*log().poses[0]), np.tile([0.95, 0.95, 1.0, 1.05], 6)
    scans = tuple(scan.scaled(f) for scan, f in zip(log().scans, factors, strict=True))
    tracker = Tracker(features_of(WORLD), find=lambda _: NO_PLACES)
    moments = list(follow(features_of(WORLD), replace(log(), scans=scans), tracker, start=truth))
    assert tracker.options.shared.scale == 1.0
    assert errors(moments, log())[-1] < 0.2


def test_walls_that_are_drawn_too_thick_are_no_scale() -> None:
    features = prepare(dilated(load_map(WORLD), np.random.default_rng(0), 2))
    tracker = make_filter("tracker", features, Options())
    moments = list(follow(features, log(), tracker, start=Pose2D(*log().poses[0])))
    assert tracker.options.shared == Shared(thinner=2)
    assert errors(moments, log())[-1] < 0.05


@pytest.mark.parametrize(("spread", "expected"), [(0.0, 1.03), (0.026, 1.03), (0.06, 1.0)])
def test_a_scale_is_taken_only_if_its_error_bar_excludes_none(monkeypatch, spread, expected):
    tracker = tracker_of()
    tracker.options = replace(tracker.options, fused=replace(tracker.options.fused, strained=0.0))
    drawn = iter(1.03 * np.exp(spread * np.array([-1, -0.5, 0, 0, 0.5, 1])))
    monkeypatch.setattr(
        "imgloc.filters.tracker.told_by", lambda *_: Told(scaled=60.0, scale=float(next(drawn)))
    )
    tracker.place(np.array([5.0, 7.0, 0.0]), (0.1, 0.1))
    tracker._trusted = tracker.how.walls[1]  # before, the place may be another one
    for _ in range(6):
        tracker._judge_shared(view_of(log()[0], Options()), tracker._poses[:1])
    assert tracker.options.shared.scale == pytest.approx(expected)
    if expected != 1.0:  # and none again where later scans cannot tell it from none
        drawn = iter(np.full(6, 1 / 1.025))
        for _ in range(6):
            tracker._judge_shared(view_of(log()[0], Options()), tracker._poses[:1])
        assert tracker.options.shared.scale == 1.0


def test_scans_that_are_not_looked_at_correct_the_pose() -> None:
    """Of a heading that lags, odometry says 23 degrees less than there are."""
    scans = log()
    late = scans.odom - [0, 0, 1] * np.clip(0.05 * (np.arange(24.0) - 8), 0, 0.4)[:, None]
    lagging, tracker = replace(scans, odom=late), tracker_of()
    gap, start = Every(99.0, 9.0), Pose2D(*scans.poses[0])
    moments = list(follow(features_of(WORLD), lagging, tracker, every=gap, start=start))
    assert not any(m.looked for m in moments[1:])
    assert max(errors(moments, scans)) < 0.15
    turned = [wrap(m.best.theta - p[2]) for m, p in zip(moments, scans.poses, strict=True)]
    assert np.abs(turned).max() < 0.05


def test_odometry_that_is_often_wrong_is_trusted_less() -> None:
    wide, scans = [], log()
    for slip in (0.0, 0.18):
        odom = scans.odom + np.outer((-1.0) ** np.arange(24), [0, 0, slip])
        tracker = tracker_of()
        list(follow(features_of(WORLD), replace(scans, odom=odom), tracker))
        assert tracker.belief.verdict == "unique"
        tracker.move(np.array([2.0, 0.0, 0.0]))
        wide.append(deviations_of(tracker.belief.covariance[0])[0])
    assert wide[1] > 1.3 * wide[0]


def test_scans_that_say_nothing_leave_the_belief_alone() -> None:
    blind = LaserScan(np.full(90, np.inf), np.linspace(-1, 1, 90), range_max=9.0)
    for name in ("tracker", "particle", "grid"):
        chosen = make_filter(name, features_of(WORLD), Options())
        chosen.see(blind)
        assert not chosen.watch(blind)
        assert chosen.belief.verdict == "lost"


def blinked(scans: ScanSet, *at: int) -> ScanSet:
    """The log with NaN for some of its scans."""
    some = list(scans.scans)
    for k in at:
        some[k] = replace(some[k], ranges=np.full_like(some[k].ranges, np.nan))
    return replace(scans, scans=tuple(some))


def test_a_scan_that_is_lost_now_and_then_takes_nothing_back() -> None:
    at = range(7, 24, 3)
    moments = list(follow(features_of(WORLD), blinked(log(), *at), tracker_of()))
    assert [m.withheld == "blind" for m in moments] == [k in at for k in range(24)]
    seen = [m.belief.verdict for m in moments[4:] if m.withheld != "blind"]
    assert set(seen) == {"unique"}


@pytest.mark.parametrize("blind", [0, 1])
def test_every_other_scan_lost_confirms_a_place_whichever_scan_is_the_first(blind: int) -> None:
    """Steps of 4 cm: each second one alone makes a way, and it may be the one to a blind scan."""
    poses = np.column_stack((5.0 + 0.04 * np.arange(100), np.full(100, 7.0), np.zeros(100)))
    ranges = simulate_ranges(render(WORLDS[WORLD](), 0.05), poses, ANGLES, seed=2, range_max=30.0)
    scans = tuple(LaserScan(one, ANGLES, range_max=30.0) for one in ranges)
    made = ScanSet(scans, poses, 0.1 * np.arange(100.0), poses)
    lost = blinked(made, *range(blind, 100, 2))
    moments = list(follow(features_of(WORLD), lost, tracker_of(find=None)))
    first = next(k for k, moment in enumerate(moments) if moment.pose is not None)
    assert 36 <= first <= 46, first


def test_who_has_not_moved_has_not_been_followed() -> None:
    tracker = tracker_of()
    tracker.place(log().poses[0], (0.1, 0.1))
    tracker.see(log()[0])
    assert tracker._followed.tolist() == [0.0] * len(tracker._followed)
    tracker.move(np.array([0.5, 0.0, 0.0]))
    tracker.see(log()[0])
    assert tracker._followed.max() == pytest.approx(0.5)


def test_what_the_map_beats_is_explained_though_it_misfits_but_not_by_bent_walls() -> None:
    for bent, expected in ((0.0, [False, True]), (0.15, [False, False])):
        tracker = Tracker(features_of(WORLD), Options(shared=Shared(bent=bent)))
        tracker._lost, laser = 0.0, Laser(last=2.0)
        assert [tracker._explains(laser, mapped) for mapped in (False, True)] == expected


def test_what_is_dark_counts_from_where_it_began() -> None:
    tracker = tracker_of()
    tracker.place(np.array([5.0, 7.0, 0.0]), (0.1, 0.1))
    lost = []
    for seconds in (0.0, 0.6, 0.6, 0.5):  # up to a second is a blink, and counts if more follows
        tracker.miss(seconds)
        lost.append(tracker.belief.lost)
    assert lost == pytest.approx(tracker.how.dark[0] * np.array([0.0, 0.0, 1.2, 1.7]))


def test_of_two_places_that_fit_alike_the_nearer_one_is_followed() -> None:
    tracker, here = tracker_of(), np.array([5.0, 7.0, 0.0])
    tracker.place(here, (0.1, 0.1))
    poses = here + np.array([[0, 0, 0], [0, 0, 0], [0.2, 0, 0], [0.1, 0, 0]])
    score = np.array([-50.0, -50.0, 0.0, 0.0])  # where it is, nothing fits
    seen = Sight(poses, score, np.tile(np.diag([0.05] * 3) ** 2, (4, 1, 1)), np.zeros(4), 9.0)
    (at,), (cost,) = tracker._follow(seen)
    assert (at, 0.0 < cost < 1.0) == (3, True)
    # Where it settles close by, odometry was off: that costs what the gate does, 5.7 nats.
    far = here + np.outer([0.0, 0.28, 9.0, 9.0], [1.0, 0.0, 0.0])
    tracker._covariance[:] = 0.0
    taken = tracker._follow(replace(seen, poses=far, log_likelihood=score[[0, 2, 0, 0]]))
    assert taken == (1, pytest.approx(GATE / 2))


def test_who_stands_is_sure_again_after_a_blink_and_not_after_a_minute() -> None:
    """Noise makes scans at rest differ; wheels say that nothing moved."""
    ten, rng = piece(log(), range(10)), np.random.default_rng(0)
    last = ten.scans[-1]
    rest = [replace(last, ranges=last.ranges + 0.01 * rng.standard_normal(120)) for _ in range(9)]
    stands = ScanSet(
        (*ten.scans, *rest), None, np.arange(19.0), np.concatenate((ten.odom, [ten.odom[-1]] * 9))
    )
    for dark, expected in ((1, "unique"), (4, "ambiguous")):
        scans = blinked(stands, *range(10, 10 + dark))
        moments = list(follow(features_of(WORLD), scans, tracker_of(find=None)))
        assert moments[9].belief.verdict == "unique"
        assert moments[-1].belief.verdict == expected


@pytest.mark.parametrize("buffers", [2, 9])
def test_a_driver_that_goes_round_its_buffers_is_blind(buffers: int) -> None:
    scans = log()
    stale = tuple(
        scans.scans[10 - buffers + k % buffers] if k > 9 else s for k, s in enumerate(scans.scans)
    )
    moments = list(follow(features_of(WORLD), replace(scans, scans=stale), tracker_of()))
    assert [m.withheld for m in moments[10:]] == ["blind"] * 14
    assert moments[-1].age == 14.0


def test_on_another_buildings_map_what_fits_for_a_while_is_not_unique(shared: Path) -> None:
    """Before, some of these scans were: a corridor fits for 4 m, with masses up to 1."""
    scans = load_scans(shared / "data" / "raw" / "belgioioso.log").take(range(70, 110))
    features = prepare(load_map(shared / "data" / "fr079" / "map.yaml"))
    moments = list(follow(features, scans, make_filter("tracker", features, Options())))
    assert max(m.belief.mass.max(initial=0.0) for m in moments) > 0.95
    assert not [m.index for m in moments if m.pose is not None]


def test_a_scan_that_stays_as_it_is_while_the_robot_drives_is_an_old_one() -> None:
    """Each has noise of its own: no two are the same to the bit."""
    scans, rng = log(), np.random.default_rng(0)
    old = scans.scans[9]
    noisy = [replace(old, ranges=old.ranges + 0.005 * rng.standard_normal(120)) for _ in range(14)]
    stale = replace(scans, scans=(*scans.scans[:10], *noisy))
    moments = list(follow(features_of(WORLD), stale, tracker_of(find=None)))
    assert [m.withheld for m in moments[12:]] == ["blind"] * 12
    away = errors(moments, scans)
    assert all(e < 1 for e, m in zip(away, moments, strict=True) if m.pose is not None)


def test_a_pose_that_slips_may_be_that_of_somebody_who_was_carried() -> None:
    """Moved by 0.6 m while the wheels stood: the map is searched, and it is not sure at once."""
    asked, scans = list[float](), piece(log(), range(8))
    scans = replace(scans, odom=np.concatenate((scans.odom[:7], scans.odom[6:7])))

    def find(scan: LaserScan) -> Places:
        asked.append(scan.stamp)
        return found(scan)

    tracker = Tracker(features_of(WORLD), find=find)
    moments = list(follow(features_of(WORLD), scans, tracker))
    assert asked[-1] == 7.0
    assert moments[-1].looked


def test_every_decides_what_is_looked_at() -> None:
    scans, gap = piece(log(), range(10)), Every(1.2, 9.0)
    looked = [m.looked for m in follow(features_of(WORLD), scans, tracker_of(), every=gap)]
    assert looked[:5] == [True, True, False, False, True]  # two agree, and then it is the way


def test_refuses_logs_that_cannot_be_followed() -> None:
    scans, features = log(), features_of(WORLD)
    late = ScanSet(scans.scans, scans.poses, np.append(scans.stamps[:-1], np.inf), scans.odom)
    with pytest.raises(ScanError, match=r"stamps\[23\]: got inf, expected seconds"):
        next(follow(features, late, Tracker(features)))
    back = ScanSet(scans.scans, scans.poses, scans.stamps[::-1], scans.odom)
    with pytest.raises(ScanError, match=r"stamps\[1\]"):
        next(follow(features, back, Tracker(features)))
    with pytest.raises(ConfigError, match="metres"):
        Every(-1.0)
    with pytest.raises(ConfigError, match="one of tracker, grid, particle"):
        make_filter("kalman", features, Options())


def test_runs_are_the_same_every_time() -> None:
    scans, features = piece(log(), range(6)), features_of(WORLD)

    def run(name: str) -> list:
        chosen = make_filter(name, features, Options(), seed=3)
        return [(m.best, m.belief.verdict) for m in follow(features, scans, chosen)]

    for name in ("tracker", "particle"):
        assert run(name) == run(name)


@pytest.mark.parametrize("by", [1e-9, 1e-6, 1e-3])
def test_a_mount_that_trembles_changes_no_verdict(by: float) -> None:
    some = piece(log(), range(9))
    mounts = by * np.random.default_rng(0).standard_normal((9, 3))
    pairs = zip(some.scans, mounts, strict=True)
    shaken = tuple(replace(scan, T_base_laser=Pose2D(*mount)) for scan, mount in pairs)

    def verdicts(scans: ScanSet) -> list[tuple[str, str]]:
        features = features_of(WORLD)
        made = make_filter("tracker", features, Options())
        return [(m.belief.verdict, m.withheld) for m in follow(features, scans, made)]

    assert verdicts(replace(some, scans=shaken)) == verdicts(some)


def test_particles_are_as_many_as_they_need_to_be() -> None:
    how = ParticleOptions(least=50, most=1500)
    scans, features = piece(log(), range(9)), features_of(WORLD)
    particles = ParticleFilter(features, how=how)
    moments = list(follow(features, scans, particles))
    assert 50 <= len(particles.poses) < 600
    assert errors(moments, scans)[-1] < 0.4
    with pytest.raises(ConfigError, match="particles"):
        ParticleFilter(features, how=ParticleOptions(least=9, most=8))


def test_kld_bound_is_that_of_the_chi_square() -> None:
    # Fox 2003: 1 / (2 error) times the quantile of chi-square with bins - 1 degrees of freedom.
    assert kld_bound(21, 0.1, 1.6449) == pytest.approx(31.41 / 0.2, rel=0.01)


def test_low_variance_draws_as_often_as_expected() -> None:
    weights = np.array([0.1, 0.25, 0.05, 0.6])
    counts = np.bincount(low_variance(weights, 1000, np.random.default_rng(0)), minlength=4)
    assert np.abs(counts - 1000 * weights).max() <= 1


def test_places_join_across_the_seam_of_the_circle() -> None:
    poses = np.array([[0, 0, np.pi - 0.05], [0, 0, -np.pi + 0.05], [5, 5, 0.0]])
    belief = belief_of(poses, np.array([0.4, 0.4, 0.2]), sure=0.7, doubted=False, neff=2, resets=0)
    assert belief.verdict == "unique"
    assert abs(abs(belief.poses[0, 2]) - np.pi) < 1e-9
    doubted = belief_of(poses, np.array([0.4, 0.4, 0.2]), sure=0.7, doubted=True, neff=2, resets=0)
    assert doubted.verdict == "ambiguous"


def test_another_best_place_is_followed_anew() -> None:
    followed, step = Followed(), np.array([0.5, 0.0, 0.0])
    for k in range(4):
        followed.best(np.array([0.5 * k, 0.1, 0.0]))
        followed.move(step)
    assert followed.metres == pytest.approx(2.0)
    followed.best(np.array([9.0, 0.0, 0.0]))
    assert followed.metres == 0


def test_a_few_stamps_that_go_back_are_sorted_and_a_clock_set_back_is_refused(caplog) -> None:
    scans, features = log(), features_of(WORLD)
    order = [*range(10), 11, 10, *range(12, len(scans))]
    moments = list(follow(features, scans.take(order), Tracker(features), name="a.npz"))
    assert [moment.index for moment in moments] == [*range(10), 11, 10, *range(12, len(scans))]
    assert [moment.stamp for moment in moments] == scans.stamps.tolist()
    assert "the stamp of scan 11, 10.00, is 1 s before that of scan 10, 11.00" in caplog.text
    swapped = scans.stamps.copy()
    swapped[[10, 11]] = swapped[[11, 10]]
    moments = list(follow(features, replace(scans, stamps=swapped), Tracker(features)))
    assert [moment.index for moment in moments] == list(range(len(scans)))
    assert [moment.stamp for moment in moments[9:13]] == [9, 11, 11, 12]
    set_back = np.where(np.arange(len(scans)) > 12, scans.stamps - 9.5, scans.stamps)
    back = ScanSet(scans.scans, scans.poses, set_back, scans.odom)
    with pytest.raises(ScanError, match=r"stamps\[13\]: 3.50 after 12.00, 8.5 s back, expected"):
        next(follow(features, back, Tracker(features)))


def test_a_stamp_that_leaps_alone_is_left_out_of_a_log_and_of_a_stream(caplog) -> None:
    scans, features = log(), features_of(WORLD)

    def left(stamps) -> set[int]:
        coming = [replace(s, stamp=t) for s, t in zip(scans.scans, stamps, strict=True)]
        run = follow(features, zip(coming, scans.odom, strict=True), Tracker(features))
        return {*range(24)} - {m.index for m in run}

    ahead, back = (scans.stamps + by * (np.arange(24) == 5) for by in (500.0, -500.0))
    assert left(ahead) == {6}  # what comes later is not known; two in a row are the clock's
    assert "scan 6: its stamp, 6.00, goes back; left out" in caplog.text
    assert left(back) == {5}
    assert left(scans.stamps - 9.5 * (np.arange(24) > 12)) == {13}
    moments = follow(features, replace(scans, stamps=ahead), Tracker(features))
    assert {*range(24)} - {m.index for m in moments} == {5}


def test_scans_without_odometry_are_left_out_alone(caplog) -> None:
    scans, features = log(), features_of(WORLD)
    odom = scans.odom.copy()
    odom[[4, 7]] = np.nan
    some = ScanSet(scans.scans, scans.poses, scans.stamps, odom)
    assert len(list(follow(features, some, Tracker(features)))) == len(scans) - 2
    assert "2 of 24 scans, from 4 to 7, have no odometry" in caplog.text
