"""Points of a scan: order, normals, the sensor's side, and when a normal is not known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgloc.features.scanpoints import Readings, evenly, one_per_place, scan_points
from imgloc.geometry import wrap
from imgloc.model import LaserScan


def fan(count, fov_deg):
    angles = np.deg2rad(np.linspace(-fov_deg / 2, fov_deg / 2, count, endpoint=fov_deg < 360))
    return np.asarray(angles)


def box(angles, x, y, width=8.0, height=6.0):
    """Exact ranges and normals in a rectangular room, seen from (x, y)."""
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        side = np.where(c > 0, width - x, x) / np.abs(c)
        cap = np.where(s > 0, height - y, y) / np.abs(s)
    normal = np.where(
        side < cap, np.where(c > 0, np.pi, 0.0), np.where(s > 0, -np.pi / 2, np.pi / 2)
    )
    return np.minimum(side, cap), normal


def every(angles):
    return np.ones(len(angles), bool)


def degrees_off(alpha, truth):
    return np.abs(np.rad2deg(wrap(alpha - truth)))


@pytest.mark.parametrize("direction_deg", [0, 45, 90, 135, 180, -120])
def test_the_normal_of_a_wall_points_back_at_the_sensor(direction_deg):
    direction = np.deg2rad(direction_deg)
    angles = direction + fan(41, 40)
    ranges = 2.0 / np.cos(angles - direction)
    points = scan_points(ranges, angles, every(angles))
    assert points.valid.all()
    assert degrees_off(points.alpha, direction + np.pi).max() < 1e-5
    ahead = scan_points(ranges, angles - direction, every(angles))
    np.testing.assert_allclose(points.sigma_alpha, ahead.sigma_alpha, rtol=1e-6)
    assert (
        np.einsum("ij,ij->i", points.xy, np.cos([points.alpha, points.alpha - np.pi / 2]).T) < 0
    ).all()


def test_only_valid_readings_become_points_and_in_their_order():
    angles = fan(61, 60)
    ranges = 2.0 / np.cos(angles)
    valid = every(angles)
    valid[[0, 20, 21, 60]] = False
    ranges[[0, 20]] = np.nan, np.inf
    ranges[21] = 81.9  # a code of the sensor
    points = scan_points(ranges, angles, valid)
    assert len(points) == 57
    np.testing.assert_allclose(np.hypot(*points.xy.T), ranges[valid])
    np.testing.assert_allclose(np.arctan2(*points.xy.T[::-1]), angles[valid])
    assert points.valid.all()
    assert degrees_off(points.alpha, np.pi).max() < 1e-5


@pytest.mark.parametrize(("count", "fov"), [(181, 180), (1081, 270), (360, 360)])
def test_noisy_room(count, fov):
    rng = np.random.default_rng(count)
    errors, scores = [], []
    for _ in range(20):
        heading, x, y = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 7.5), rng.uniform(0.5, 5.5)
        angles = fan(count, fov)
        ranges, normal = box(angles + heading, x, y)
        points = scan_points(ranges + rng.normal(0, 0.02, count), angles, every(angles))
        assert points.valid.mean() > 0.97
        error = degrees_off(points.alpha + heading, normal)[points.valid]
        errors.append(error)
        scores.append(np.deg2rad(error) / points.sigma_alpha[points.valid])
    error, score = np.concatenate(errors), np.concatenate(scores)
    assert np.median(error) < 1.5
    assert np.percentile(error, 95) < 7
    # sigma_alpha describes the error: half of a normal distribution lies within 0.67 sigma.
    assert 0.4 < np.median(score) < 1.0


def test_a_normal_is_that_of_so_much_wall():
    step = np.deg2rad(0.5)
    angles = step * np.arange(-80, 81)
    middle = scan_points(2 / np.cos(angles), angles, every(angles)).sigma_alpha[80]
    n = 2 * np.floor(0.25 / (2 * step)) + 1  # points that far to either side, 2 m ahead
    assert middle == pytest.approx(0.02 / (2 * step * np.sqrt(n * (n * n - 1) / 12)), rel=0.05)


def test_noise_as_expected_does_not_narrow_the_window():
    angles, rng = np.deg2rad(np.arange(-60, 60.1, 0.5)), np.random.default_rng(0)
    ranges = 2 / np.cos(angles)
    quiet = scan_points(ranges, angles, every(angles)).sigma_alpha
    noisy = [ranges + rng.normal(0, 0.02, len(angles)) for _ in range(20)]
    sigma = np.array([scan_points(r, angles, every(angles)).sigma_alpha for r in noisy])
    # Half as many points would make it 2.8 times as large. Three sigmas are one in 370, or so.
    assert np.mean(sigma > 1.8 * quiet) < 0.005


def test_corners_keep_the_normals_of_their_walls():
    angles = fan(721, 360)
    ranges, normal = box(angles, 3.0, 2.0)
    points = scan_points(ranges, angles, every(angles))
    assert (degrees_off(points.alpha, normal) > 10).sum() <= 8  # four corners, two rays each


def test_a_window_stops_at_a_depth_jump():
    angles = fan(121, 60)
    pillar = np.abs(angles) < np.deg2rad(10)
    ranges = np.where(pillar, 1.0, 4.0) / np.cos(angles)  # two parallel walls, 3 m apart
    points = scan_points(ranges, angles, every(angles))
    assert points.valid.all()
    assert degrees_off(points.alpha, np.pi).max() < 1e-4


def test_fewer_than_three_neighbours_give_no_normal():
    angles = np.deg2rad([-30, -29, -28, 0, 1, 2, 3, 40])
    points = scan_points(np.array([1.0, 1, 1, 3, 3, 3, 3, 2]), angles, every(angles))
    np.testing.assert_array_equal(points.valid, [0, 0, 0, 1, 1, 1, 1, 0])
    assert np.isnan(points.alpha[[0, 1, 2, 7]]).all()
    assert np.isinf(points.sigma_alpha[[0, 1, 2, 7]]).all()
    assert np.isfinite(points.xy).all()


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_tiny_scans(count):
    angles = np.linspace(0, 0.01, count)
    points = scan_points(np.ones(count), angles, every(angles))
    assert len(points) == count
    assert not points.valid.any()
    assert len(scan_points(np.ones(5), np.zeros(5), np.zeros(5, bool))) == 0


@pytest.mark.parametrize(
    ("step_deg", "lost", "known"), [(1, 3, 1), (1, 4, 0), (20, 0, 1), (21, 0, 0)]
)
def test_rounding_does_not_decide_what_is_beside_a_ray(step_deg, lost, known):
    # Three rays, some lost, and three more, wherever they begin: three alone have no normal.
    ray = np.array([0, 1, 2, 3 + lost, 4 + lost, 5 + lost])
    for turn in np.linspace(-3, 3, 25):
        angles = np.deg2rad(step_deg) * ray + turn
        points = scan_points(np.ones(6), angles, every(angles))
        assert np.isfinite(points.alpha).tolist() == 6 * [bool(known)]


def test_a_full_turn_has_no_seam():
    angles = fan(360, 360)  # -180 .. 179 deg, the wall behind crosses the seam
    ranges, normal = box(angles, 4.0, 3.0)
    points = scan_points(ranges, angles, every(angles))
    behind = np.abs(angles) > np.deg2rad(170)
    assert degrees_off(points.alpha, normal)[behind].max() < 1e-4
    assert np.ptp(points.sigma_alpha[behind]) < 0.2 * points.sigma_alpha[behind].mean()


def test_a_half_turn_does_have_one():
    angles = fan(181, 180)
    ranges = np.full(181, 2.0)
    ranges[:3] = 1.0  # three rays at one end: too few, whatever is at the other
    points = scan_points(ranges, angles, every(angles))
    assert not points.valid[:3].any()
    assert points.valid[3:].all()


@settings(max_examples=30)
@given(st.integers(0, 1000), st.floats(-7.0, 7.0))
def test_order_and_heading_of_the_rays_do_not_matter(seed, turn):
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(-np.pi, np.pi, 300))  # irregular
    ranges, _ = box(angles, rng.uniform(1, 7), rng.uniform(1, 5))
    ranges += rng.normal(0, 0.02, 300)
    reference = scan_points(ranges, angles, every(angles))
    order = rng.permutation(300)
    shuffled = scan_points(ranges[order], angles[order], every(angles))
    np.testing.assert_allclose(shuffled.xy, reference.xy[order])
    np.testing.assert_array_equal(shuffled.valid, reference.valid[order])
    np.testing.assert_array_equal(shuffled.alpha, reference.alpha[order])
    turned = scan_points(ranges, angles + turn, every(angles))
    same = reference.valid & turned.valid
    assert (reference.valid == turned.valid).mean() > 0.99
    off = degrees_off(turned.alpha[same], reference.alpha[same] + turn)
    assert (off < 1e-4).mean() > 0.99  # but for ties between windows


def test_wrong_lengths():
    with pytest.raises(ValueError, match="one length"):
        scan_points(np.ones(4), np.zeros(3), np.ones(4, bool))


@pytest.mark.parametrize("name", ["fr079", "gh25", "duke_loop5"])
def test_real_scans_have_normals_almost_everywhere(shared, name):
    with np.load(shared / "data" / name / "scans.npz") as data:
        ranges, angles = data["ranges"][:20], data["angles"]
        low, high = float(data["range_min"]), float(data["range_max"])
    for scan in ranges:
        valid = np.isfinite(scan) & (scan > low) & (scan < high)
        points = scan_points(scan, angles, valid)
        assert points.valid.mean() > 0.8
        facing = np.einsum("ij,ji->i", points.xy, [np.cos(points.alpha), np.sin(points.alpha)])
        assert (facing[points.valid] <= 1e-9).all()


@pytest.mark.parametrize(("gap_deg", "known"), [(0.95, False), (1.01, True)])
def test_a_normal_is_known_to_within_30_degrees(gap_deg, known):
    # Four rays to a wall 1 m ahead, h apart on it: sigma is 2 cm / (h root 5).
    angles = np.deg2rad(gap_deg * np.array([-1.5, -0.5, 0.5, 1.5]))
    points = scan_points(1 / np.cos(angles), angles, every(angles))
    np.testing.assert_allclose(points.sigma_alpha, 0.02 / np.deg2rad(gap_deg) / 5**0.5, rtol=0.01)
    assert points.valid.tolist() == 4 * [known]
    assert (points.sigma_alpha.max() < np.pi / 6) == known


@given(st.integers(0, 60), st.integers(0, 70))
def test_even_picks_are_spread_from_the_first_to_the_last(count, n):
    index = evenly(count, n)
    assert len(index) == min(n, count)
    if len(index) > 1:
        assert (index[0], index[-1]) == (0, count - 1)
        steps = np.diff(index)
        assert 0 < steps.min() <= steps.max() <= steps.min() + 1


def test_enough_rays_keep_all_readings():
    assert evenly(4, 10).tolist() == [0, 1, 2, 3]


def test_a_place_is_one_reading_however_many_rays_saw_it():
    # Three rays on 3 cm of a wall, a fourth beside them in the next square, one far away.
    ends = np.array([[1.01, 0.01], [1.02, 0.03], [1.03, 0.05], [1.11, 0.05], [-4.0, -0.3]])
    ranges, angles = np.hypot(*ends.T), np.arctan2(ends[:, 1], ends[:, 0])
    seen = one_per_place(LaserScan(ranges, angles, range_max=9.0), 0.1)
    expected = [[-4.0, -0.3], [1.02, 0.03], [1.11, 0.05]]  # by angle; squares start at 0
    np.testing.assert_allclose(seen.xy, expected, atol=1e-12)
    # Around the sensor no square reaches over 0: four points about it are of four places.
    about = LaserScan(np.full(4, 0.05), np.deg2rad([45, 135, 225, 315]), range_max=9.0)
    assert len(one_per_place(about, 0.1)) == 4
    assert np.all(np.diff(one_per_place(about, 0.1).angles) > 0)


def test_the_far_part_of_a_scan_sees_past_those_who_stand_before_a_wall():
    """People hold more than half of the readings, and the wall behind them is all around."""
    angles = np.deg2rad(np.arange(-180, 180, 2.0))
    walls = box(angles, 3.0, 2.0)[0]
    stand = np.arange(len(angles)) % 9 < 5  # 10 of every 18 degrees
    seen = Readings(np.where(stand, 0.5, walls), angles)
    far, left, right = (np.isin(part.angles, angles[stand]) for part in seen.parts())
    assert not far.any()
    assert left.mean() > 0.5
    assert right.mean() > 0.5
    assert len(far) == pytest.approx(len(angles) / 3, abs=1)
    # A neighbourhood goes on over the first angle.
    turned = Readings(seen.ranges, angles + np.pi / 7).parts()[0]
    assert turned.ranges.tolist() == seen.parts()[0].ranges.tolist()
    edge = Readings(np.array([1.0, 9.0, 1.0, 2.0]), np.deg2rad([-179.0, 0.0, 90.0, 179.0]))
    assert edge.parts()[0].ranges.tolist() == [9.0, 1.0]


def test_only_valid_readings_have_a_place():
    scan = LaserScan([np.nan, np.inf, 2.0, 99.0], [0.0, 0.1, 0.2, 0.3], range_max=9.0)
    assert one_per_place(scan, 0.1).ranges.tolist() == pytest.approx([2.0])
    assert len(one_per_place(LaserScan([np.nan], [0.0]), 0.1)) == 0


def test_rays_that_come_three_times_have_their_normals():
    """Echoes of one ray, or scans that somebody has joined."""
    angles = np.deg2rad(np.arange(-90, 91, 1.0))
    ranges = box(angles, 3.0, 2.0)[0]
    once = scan_points(ranges, angles, every(angles))
    thrice = scan_points(ranges.repeat(3), angles.repeat(3), every(angles.repeat(3)))
    assert thrice.valid.mean() > 0.95
    assert np.median(degrees_off(thrice.alpha[1::3], once.alpha)) < 1


def test_rays_side_by_side_that_met_nothing_are_open_space_and_a_lost_reading_is_not():
    ranges = np.array([2.0, np.inf, 3.0, np.inf, np.inf, 20.0, np.inf, 4.0, np.nan, np.nan, np.nan])
    angles = np.arange(len(ranges)) / 10
    silent = one_per_place(LaserScan(ranges, angles, range_max=20.0), 0.05).silent
    np.testing.assert_allclose(silent.angles, [0.4, 0.5])
    np.testing.assert_allclose(silent.ranges, 4.0)  # as far as it has shown that it reaches
    shuffled = LaserScan(ranges[::-1], angles[::-1], range_max=20.0)
    np.testing.assert_allclose(one_per_place(shuffled, 0.05).silent.angles, silent.angles)
