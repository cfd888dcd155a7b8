"""A second opinion of another localizer's poses, along a drive."""

from dataclasses import replace

import numpy as np
import pytest
from command import MAPS, call

import imgloc
from imgloc import Pose2D, ScanSet
from imgloc.filters.watch import AGREES, CANNOT, DISAGREES, Watch
from tools.robot.play import START, to_and_fro

OFF = Pose2D(START.x + 3.0, START.y, START.theta)


@pytest.fixture(scope="module")
def drive() -> ScanSet:
    """A metre to and fro in double_wall, a scan each 0.2 m."""
    return to_and_fro().take(range(0, 300, 5))


@pytest.fixture(scope="module")
def features():
    return imgloc.prepare(imgloc.load_map(MAPS / "double_wall.yaml"))


def said(features, drive, claims) -> list[tuple[str, Pose2D | None]]:
    watch = Watch(features, imgloc.Options())
    own = imgloc.Tracking().follower(features, imgloc.Options())
    out = []
    for k, scan in enumerate(drive.scans):
        scan, odom = replace(scan, stamp=float(drive.stamps[k])), Pose2D(*drive.odom[k])
        if k in claims:
            watch.hear(scan.stamp, claims[k], odom)
        found = watch.step(scan, odom, own.step(scan, drive.odom[k]))
        out.append((found.said, found.pose))
    return out


def test_right_poses_agree_and_a_jump_disagrees_with_the_pose_that_it_would_give(features, drive):
    true = [Pose2D(*row) for row in drive.poses]
    jump = {k: replace(p, x=p.x + 2.0 * (k >= 50)) for k, p in enumerate(true)}
    found = said(features, drive, jump)
    words = [word for word, _ in found]
    assert DISAGREES not in words[:50]
    assert words[40:50] == [AGREES] * 10
    assert words[51:] == [DISAGREES] * (len(words) - 51)  # the first scan alone cannot tell
    assert words[50] == CANNOT
    pose = found[59][1]
    assert (pose.x, pose.y) == pytest.approx((true[59].x, true[59].y), abs=0.1)


def test_a_pose_is_carried_on_by_odometry_until_none_has_come_for_too_long(features, drive) -> None:
    drive = drive.take(range(25, 60))
    along = replace(drive, odom=np.column_stack((np.arange(35.0) * 0.2, np.zeros((35, 2)))))
    claims = {k: Pose2D(*pose) for k, pose in enumerate(drive.poses)}
    right = said(features, drive, {k: claims[k] for k in range(0, 35, 3)})
    assert {word for word, _ in right[15:]} == {AGREES}
    silent = said(features, along, {k: claims[k] for k in range(15)})
    assert {word for word, _ in silent[27:]} == {DISAGREES}


def test_nothing_is_said_before_a_pose_has_come(features, drive) -> None:
    assert {word for word, _ in said(features, drive.take(range(5)), {})} == {CANNOT}


def test_track_says_what_it_thinks_of_a_trajectory(tmp_path, drive) -> None:
    log, tum, some = tmp_path / "log.npz", tmp_path / "amcl.tum", drive
    imgloc.save_scans(log, some)
    lines = [
        f"{stamp:.9f} {x + 2.0 * (k >= 50):.6f} {y:.6f} 0 0 0 {np.sin(t / 2):.9f} "
        f"{np.cos(t / 2):.9f}"
        for k, (stamp, (x, y, t)) in enumerate(zip(some.stamps, some.poses, strict=True))
    ]
    tum.write_text("\n".join(lines) + "\n")
    found = call("track", MAPS / "double_wall.yaml", log, "--watch", tum, "--json").ends(0)
    rows = [imgloc.io.own.parse_json(line.encode()) for line in found.out.splitlines()]
    assert rows[45]["watch"]["said"] == AGREES
    assert rows[-1]["watch"]["said"] == DISAGREES
    assert rows[-1]["watch"]["seconds"] > 1.0
    late = tmp_path / "late.tum"
    late.write_text("9999 0 0 0 0 0 0 1\n9999.5 0 0 0 0 0 0 1\n")
    found = call("track", MAPS / "double_wall.yaml", log, "--watch", late)
    found.ends(4, "late.tum: no pose has a stamp before that of the last scan")


def test_a_scan_that_fits_nowhere_outweighs_no_place_that_the_scans_before_hold(features, drive):
    own = imgloc.Tracking().follower(features, imgloc.Options())
    for scan, odom, stamp in zip(drive.scans[:30], drive.odom, drive.stamps, strict=False):
        moment = own.step(replace(scan, stamp=float(stamp)), odom)
    odd = replace(scan, ranges=np.full(len(scan.ranges), 4.0))
    for share, expected in ((1.0, CANNOT), (0.01, DISAGREES)):
        belief = replace(moment.belief, verdict="ambiguous", mass=share * moment.belief.mass)
        watch, held = Watch(features, imgloc.Options()), replace(moment, belief=belief)
        watch.hear(0.0, moment.best, None)
        assert [watch.step(odd, None, held, at).said for at in (1.0, 2.0)] == [CANNOT, expected]


def test_scans_that_suddenly_do_not_fit_speak_against_what_odometry_alone_holds(features, drive):
    own = imgloc.Tracking().follower(features, imgloc.Options())
    moment = own.step(scan := drive.scans[0], drive.odom[0])
    odd = replace(scan, ranges=np.full(len(scan.ranges), 4.0))
    alike, grown = [0.9] * 7, [0.9] * 3 + [0.95] + [0.9] * 3
    for scans, shares, expected in (
        ([scan, *[odd] * 6], alike, DISAGREES),
        ([scan, *[odd] * 6], grown, CANNOT),  # the scans since then speak for the place
        ([odd] * 7, alike, CANNOT),
    ):
        watch, true, words = Watch(features, imgloc.Options()), Pose2D(*drive.poses[0]), []
        watch.hear(0.0, true, None)
        for k, (one, share) in enumerate(zip(scans, shares, strict=True)):
            mass = share * moment.belief.mass
            held = replace(moment.belief, verdict="ambiguous", mass=mass)
            words.append(watch.step(one, None, replace(moment, belief=held), 0.5 * k).said)
        assert DISAGREES not in words[:6]
        assert words[6] == expected
