"""A sweep takes time: it is straightened by odometry, or the covariance allows for the speed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command import MAPS, call

import imgloc
from imgloc import ConfigError, LaserScan, OccupancyGrid, Pose2D, ScanError, ScanSet
from imgloc.io.scans import load_scans, save_scans
from imgloc.robot.odometry import velocities_at
from imgloc.runs.opening import Desk, ScanFiles

PACE, RAYS = 0.1 / 180, 181
ANGLES = np.linspace(-np.pi / 2, np.pi / 2, RAYS)


def room(x: float, y: float, theta: float, angles: np.ndarray) -> np.ndarray:
    """Ranges in a room of 8 m x 6 m whose corner is the origin."""
    ux, uy = np.cos(theta + angles), np.sin(theta + angles)
    with np.errstate(divide="ignore"):
        return np.minimum(np.where(ux > 0, 8 - x, -x) / ux, np.where(uy > 0, 6 - y, -y) / uy)


def sweep(velocity: tuple[float, float, float], mount: Pose2D | None = None) -> LaserScan:
    """A sweep by a robot that begins at (3, 2, 0.3): its rays are cast one by one, as it moves."""
    vx, vy, turn = velocity
    at = mount or Pose2D(0.0, 0.0)
    ranges = []
    for k, angle in enumerate(ANGLES):
        t = k * PACE
        half, heading = 0.3 + turn * t / 2, 0.3 + turn * t
        x = 3 + t * (vx * np.cos(half) - vy * np.sin(half))
        y = 2 + t * (vx * np.sin(half) + vy * np.cos(half))
        x += np.cos(heading) * at.x - np.sin(heading) * at.y
        y += np.sin(heading) * at.x + np.cos(heading) * at.y
        ranges.append(room(x, y, heading + at.theta, np.array([angle]))[0])
    return LaserScan(ranges, ANGLES, T_base_laser=mount, time_increment=PACE)


@pytest.mark.parametrize("mount", [None, Pose2D(0.3, -0.1, 0.5)])
@pytest.mark.parametrize("velocity", [(1, 0, 0), (0, 0, 2), (0.7, 0.2, -1.5)])
def test_a_straightened_sweep_ends_on_the_walls_of_where_it_began(velocity, mount) -> None:
    seen = sweep(velocity, mount)
    at = mount or Pose2D(0.0, 0.0)
    x = 3 + np.cos(0.3) * at.x - np.sin(0.3) * at.y
    y = 2 + np.sin(0.3) * at.x + np.cos(0.3) * at.y
    straight = seen.straightened(np.array(velocity, dtype=float))
    expected = room(x, y, 0.3 + at.theta, straight.angles)
    assert np.abs(straight.ranges - expected).max() < 2e-3
    assert np.abs(seen.ranges - room(x, y, 0.3 + at.theta, ANGLES)).max() > 0.05
    assert straight.time_increment == 0
    assert straight.straightened(np.array([9.0, 9.0, 9.0])) is straight  # once is enough


def test_what_is_no_distance_stays_none_and_only_turns() -> None:
    scan = LaserScan([np.inf, np.nan, 9.0, 2.0], np.zeros(4), range_max=9.0, time_increment=0.1)
    straight = scan.straightened(np.array([1.0, 0.0, 0.5]))
    assert straight.no_return.tolist() == [True, False, True, False]
    assert straight.valid.tolist() == [False, False, False, True]
    assert straight.angles[:3] == pytest.approx([0.0, 0.05, 0.1])
    same = scan.straightened(np.array([np.nan, 0.0, 0.0]))
    assert same is scan


def test_a_velocity_is_that_of_the_way_driven_in_the_robots_frame() -> None:
    turn, radius, stamps = 0.5, 2.0, 0.1 * np.arange(9)
    stamps[-1] = 9.0  # after a gap
    theta = turn * stamps
    poses = np.stack((radius * np.sin(theta), radius * (1 - np.cos(theta)), theta), axis=1)
    found = velocities_at(stamps, poses)
    assert np.isnan(found[[0, -1]]).all()
    assert found[1:-1] == pytest.approx(np.tile([radius * turn, 0.0, turn], (7, 1)), abs=1e-3)
    shuffled = np.random.default_rng(0).permutation(9)
    assert np.array_equal(velocities_at(stamps[shuffled], poses[shuffled]), found[shuffled], True)


def test_poses_that_are_too_near_in_time_tell_no_velocity_of_their_own() -> None:
    poses = np.array([[0, 0, 0], [0.1, 0, 0], [0.106, 0, 0]])
    found = velocities_at(np.array([0.0, 0.1, 0.105]), poses)
    assert found[2] == pytest.approx([0.106 / 0.105, 0, 0])


def test_the_time_of_a_sweep_is_kept_by_files_and_messages(tmp_path) -> None:
    scan = sweep((1, 0, 0))
    save_scans(tmp_path / "a.npz", ScanSet((scan,)))
    fields = imgloc.scan_to_msg(scan)
    line = {"ranges": scan.ranges.tolist(), "angles": ANGLES.tolist(), "time_increment": PACE}
    (tmp_path / "a.jsonl").write_text(json.dumps(line))
    (tmp_path / "a.csv").write_text(
        f"# angle_min=-1.57 angle_max=1.57 time_increment={PACE}\n"
        + ",".join(map(str, scan.ranges))
    )
    for read in (
        *(load_scans(tmp_path / f"a.{kind}")[0] for kind in ("npz", "jsonl", "csv")),
        imgloc.scan_from_msg(fields),
    ):
        assert read.time_increment == pytest.approx(PACE)
        assert read.duration == pytest.approx(0.1)
    fields["time_increment"] = 0.1  # of a driver that writes the time between two scans
    assert imgloc.scan_from_msg(fields).time_increment == 0


def log(n: int = 6) -> ScanSet:
    """Sweeps of a robot that drives at 1 m/s, a tenth of a second each."""
    scan = sweep((1, 0, 0))
    odom = np.array([[0.2 * k, 0, 0] for k in range(n)])
    stamps = 0.2 * np.arange(n)
    scans = tuple(replace(scan, stamp=float(t)) for t in stamps)
    return ScanSet(scans, stamps=stamps, odom=odom)


def test_commands_straighten_the_scans_that_they_choose(tmp_path) -> None:
    save_scans(tmp_path / "log.npz", log())
    as_they_are = Desk().scans(tmp_path / "log.npz", ScanFiles()).scans.scans
    assert all(scan.time_increment for scan in as_they_are)
    taken = Desk().scans(tmp_path / "log.npz", ScanFiles(straighten="forward"))
    first, second = taken.scans.scans[:2]
    assert first.time_increment > 0  # nothing before it tells how fast the robot was
    assert second.time_increment == 0
    expected = log().scans[1].straightened(np.array([1.0, 0.0, 0.0]))
    assert second.ranges == pytest.approx(expected.ranges)
    late = Desk().scans(tmp_path / "log.npz", ScanFiles(straighten="backward")).scans.scans[1]
    other = replace(log().scans[1], time_increment=-PACE).straightened(np.array([1.0, 0, 0]))
    assert late.ranges == pytest.approx(other.ranges)


def test_the_covariance_allows_for_the_speed_that_is_given() -> None:
    features = imgloc.prepare(imgloc.load_map(MAPS / "curved.yaml"))
    scan = replace(imgloc.simulate(features.grid, 1, seed=1)[0], time_increment=PACE)
    plain, wide = (
        imgloc.localize(features, scan, imgloc.Options(**how)).hypotheses[0].covariance
        for how in ({}, {"max_speed": 2.0, "max_turn": 1.0})
    )
    assert np.sqrt(wide[2, 2]) >= 0.05
    assert np.sqrt(wide[0, 0]) >= 0.1
    still = imgloc.localize(
        features, replace(scan, time_increment=0), imgloc.Options(max_speed=2.0, max_turn=1.0)
    )
    assert np.array_equal(still.hypotheses[0].covariance, plain)
    with pytest.raises(ConfigError, match="max_speed: got -1"):
        imgloc.Options(max_speed=-1)


def test_the_command_takes_the_speed(tmp_path) -> None:
    scan, place = sweep((0, 0, 0)), tmp_path / "room.yaml"
    save_scans(tmp_path / "a.npz", ScanSet((scan,)))
    walls = np.pad(np.zeros((60, 80), bool), 2, constant_values=True)
    imgloc.save_map(place, OccupancyGrid(walls, ~walls, 0.1, Pose2D(-0.2, -0.2)))
    rows = []
    for how in ((), ("--max-speed", "1", "--max-turn-deg", "90")):
        out = call("localize", place, tmp_path / "a.npz", "--json", *how)
        rows.append(json.loads(out.out))
    before, after = (row["hypotheses"][0]["covariance"][2][2] for row in rows)
    assert after - before == pytest.approx((0.05 * np.pi / 2) ** 2, rel=1e-3)
    assert rows[1]["parameters"]["max_turn"] == pytest.approx(np.pi / 2)
    diagonal = imgloc.load_map(place).diagonal
    speeds = ("--max-speed", "1000", "--max-turn-deg", "50000")
    out = call("localize", place, tmp_path / "a.npz", "--json", *speeds)
    levels = [level["metres"] for level in json.loads(out.out)["protection"]]
    assert all(metres is None or metres <= diagonal for metres in levels)
    assert None in levels
    call("batch", place, tmp_path / "a.npz", "--out", tmp_path / "o", *how).ends(0)
    (row,) = [
        json.loads(line) for line in (tmp_path / "o" / "results.jsonl").read_text().splitlines()
    ]
    covariance = row["answers"][0]["hypotheses"][0]["covariance"]
    assert covariance == rows[1]["hypotheses"][0]["covariance"]
    out = call("batch", MAPS, "--job", "check", "--out", tmp_path / "p", "--straighten", "forward")
    assert (out.code, "--straighten" in out.err) == (2, True)


def test_inspect_tells_which_way_sweeps_are_straightened(tmp_path) -> None:
    scans = []
    for k in range(40):
        turned = 0.25 * k
        ranges = []
        for i, angle in enumerate(ANGLES):  # turning at 2.5 rad/s, the newest reading first
            heading = 0.3 + turned - 2.5 * i * PACE
            x, y = 3 + 0.04 * k * np.cos(0.3), 2 + 0.04 * k * np.sin(0.3)
            ranges.append(room(x, y, heading, np.array([angle]))[0])
        scans.append(LaserScan(ranges, ANGLES, stamp=0.1 * k, time_increment=PACE))
    heading = np.remainder(0.25 * np.arange(40) + np.pi, 2 * np.pi) - np.pi
    odom = np.column_stack((0.04 * np.arange(40), np.zeros(40), heading))
    stamps = np.array([scan.stamp for scan in scans])
    save_scans(tmp_path / "log.npz", ScanSet(tuple(scans), stamps=stamps, odom=odom))
    facts = json.loads(call("inspect", tmp_path / "log.npz", "--json").out)
    ways = facts["straightened"]
    assert ways["backward"] > ways["forward"]
    assert "with --straighten backward" in call("inspect", tmp_path / "log.npz").out


def test_what_is_not_straightened_is_counted(tmp_path, caplog) -> None:
    save_scans(tmp_path / "log.npz", log())
    Desk().scans(tmp_path / "log.npz", ScanFiles(straighten="forward"))
    assert "1 of 6 scans are not straightened" in caplog.text  # nothing is before the first
    (tmp_path / "a.jsonl").write_text('{"ranges": [1, 2], "angles": [0, 1], "odom": [0, 0, 0]}\n')
    grows = (tmp_path / "a.jsonl", "--follow", "--straighten", "forward")
    run = call("track", MAPS / "curved.yaml", *grows)
    run.ends(2, "--straighten: needs the odometry of a whole log")


def test_a_sweep_that_takes_longer_than_any_sensor_is_refused(tmp_path) -> None:
    with pytest.raises(ValueError, match=r"makes a sweep of 180 s, expected at most 10 s"):
        replace(sweep((0, 0, 0)), time_increment=1.0)
    (tmp_path / "a.json").write_text('{"ranges": [1, 2], "angles": [0, 1], "time_increment": NaN}')
    with pytest.raises(ScanError, match="scan 0: time_increment nan makes a sweep of nan s"):
        load_scans(tmp_path / "a.json")
