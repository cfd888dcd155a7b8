"""A robot's frames, odometry, stamps and recordings, each on numbers that one can check by hand."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from imgloc import Frames, LaserScan, Odometry, Pose2D, Recording, ScanError
from imgloc.io.messages import planar
from imgloc.robot.frames import GAP
from imgloc.robot.lasers import Lasers
from imgloc.robot.recording import Source, mounted, pick_odometry
from imgloc.robot.stamps import AHEAD, ANEW, FINE, OLD, Stamps


def link(x=0.0, y=0.0, yaw=0.0, *, down=False) -> np.ndarray:
    """A pose, 4 x 4; upside down, about its own x axis."""
    c, s = math.cos(yaw), math.sin(yaw)
    out = np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1.0, 0], [0, 0, 0, 1]])
    return out @ np.diag([1.0, -1, -1, 1]) if down else out


def frames_of(*links, moving=()) -> Frames:
    frames = Frames()
    for child, parent, pose in links:
        frames.add(child, parent, pose)
    for child, parent, stamp, pose in moving:
        frames.add(child, parent, pose, stamp)
    return frames


def at(frames: Frames, frame: str, base: str, stamp: float = math.inf):
    found = frames.at(frame, base, stamp)
    return None if found is None else planar(found)


def test_a_laser_is_found_through_links_also_upside_down() -> None:
    mast = ("mast", "base_link", link(0.2, yaw=0.5))
    frames = frames_of(mast, ("laser", "mast", link(0.1, down=True)))
    expected = (0.2 + 0.1 * math.cos(0.5), 0.1 * math.sin(0.5), 0.5)
    assert at(frames, "laser", "base_link") == pytest.approx(expected)
    assert frames.at("laser", "base_link")[2, 2] == pytest.approx(-1.0)
    assert at(frames, "laser", "odom") is None


def test_the_tree_is_climbed_both_ways() -> None:
    """base_footprint below base_link, and a sibling: the path goes up and down."""
    frames = frames_of(
        ("laser", "base_link", link(0.3)),
        ("base_footprint", "base_link", link(0.1)),
        ("arm", "base_link", link(0.0, 1.0)),
    )
    assert at(frames, "laser", "base_footprint") == pytest.approx((0.2, 0.0, 0.0))
    assert at(frames, "laser", "arm") == pytest.approx((0.3, -1.0, 0.0))
    assert frames.base_of("laser") == "base_footprint"


def test_a_moving_link_is_interpolated_and_never_held() -> None:
    moving = [("laser", "base", 10.0, link(yaw=3.0)), ("laser", "base", 10.5, link(1.0, yaw=-3.0))]
    frames = frames_of(moving=moving)
    x, y, yaw = at(frames, "laser", "base", 10.25)
    assert (x, y) == pytest.approx((0.5, 0.0))
    assert abs(yaw) == pytest.approx(math.pi)  # across the seam, not through zero
    assert at(frames, "laser", "base", 10.51) is None
    assert at(frames, "laser", "base", 9.99) is None
    far = frames_of(moving=[*moving, ("laser", "base", 10.5 + 3 * GAP, link(2.0))])
    assert at(far, "laser", "base", 10.5 + 1.5 * GAP) is None


def test_a_link_that_stays_the_same_is_static_however_often_it_is_published() -> None:
    frames = frames_of(moving=[("laser", "base", 0.1 * k, link(0.3)) for k in range(1000)])
    assert at(frames, "laser", "base", 1e6) == pytest.approx((0.3, 0, 0))
    assert len(frames.moves("laser", "base")[0]) == 2
    frames.add("laser", "base", link(0.4), 200.0)
    assert at(frames, "laser", "base", 1e6) is None
    assert at(frames, "laser", "base", 50.0) == pytest.approx((0.3, 0, 0))


def test_time_that_begins_anew_forgets_what_moved() -> None:
    moving = [("base", "odom", 5.0, link(1.0))]
    frames = frames_of(("laser", "base", link(0.3)), moving=moving)
    frames.forget()
    assert at(frames, "laser", "base") is not None
    assert at(frames, "base", "odom") is None


@pytest.mark.parametrize("scan", [1.05, 1.5, 1.99, 2.01, -0.01])
def test_odometry_is_not_held(scan: float) -> None:
    """At 1 m/s and 1 rad/s the pose of a second ago is a metre and 57 degrees behind."""
    odometry = Odometry(0.1 * np.arange(11), [(0.1 * k, 0, 0.1 * k) for k in range(11)])
    assert odometry.at(scan) is None
    assert odometry.waits(scan) == (scan > 1)
    odometry.add(1.1, (1.1, 0, 1.1))
    np.testing.assert_allclose(odometry.at(1.05), [1.05, 0, 1.05])


def test_where_the_robot_was_lately_is_known_for_a_second() -> None:
    lately = Odometry([0.0, 1.0], [(0, 0, 0), (2.0, 0, 0)]).lately
    assert [lately(t).tolist() for t in (0.5, 2.0)] == [[1.0, 0, 0], [2.0, 0, 0]]
    assert (lately(2.1), Odometry().lately(1.0)) == (None, None)  # it may have gone on


def test_a_log_is_prolonged_by_a_step_and_no_more() -> None:
    odometry = Odometry([0.0, 0.05], [(0, 0, 0), (0.05, 0, 0)])
    found = odometry.along(np.array([-0.05, 0.02, 0.1, 0.11]))
    np.testing.assert_allclose(found[:3, 0], [-0.05, 0.02, 0.1], atol=1e-12)
    assert np.isnan(found[3]).all()


def test_odometry_in_any_order_and_twice_is_one_line() -> None:
    odometry = Odometry()
    for stamp in (2.0, 0.0, 1.0, 1.0):
        assert odometry.add(stamp, (stamp, 0, 0))
    assert not odometry.add(3.0, (math.nan, 0, 0))
    assert len(odometry) == 3
    np.testing.assert_allclose(odometry.at(1.5), [1.5, 0, 0])


def test_a_leap_of_time_counts_from_the_second_stamp() -> None:
    stamps = Stamps(most=5.0)
    taken = [stamps.take(t, 100.0) for t in (100.0, 90.0, 100.1, 90.0, 90.1, 90.05)]
    assert taken == [FINE, OLD, FINE, OLD, ANEW, OLD]
    ahead = Stamps(most=5.0)
    taken = [ahead.take(t, 10.0) for t in (9.0, 12.0, 12.1, 90.0, 90.1)]
    assert taken == [FINE, AHEAD, FINE, AHEAD, AHEAD]
    slow = Stamps()  # a clock that is ahead, and a scan each other second
    assert [slow.take(t, t - 1.5) for t in (0.0, 2.0, 4.0, 6.0)] == [AHEAD, FINE, FINE, FINE]


def test_lasers_are_told_apart_by_name_wherever_they_sit() -> None:
    lasers, rng = Lasers(), np.random.default_rng(0)
    for _ in range(100):
        mount = Pose2D(1e-9 * rng.standard_normal(), 0.0)
        lasers.of(LaserScan([1.0], [0.0], T_base_laser=mount, laser="front"))
    assert len(lasers) == 1
    for k in range(63):
        lasers.of(LaserScan([1.0], [0.0], laser=str(k)))
    with pytest.raises(ScanError, match="more than 64"):
        lasers.of(LaserScan([1.0], [0.0], laser="one more"))


def tree(*bodies: str) -> Frames:
    """Robots by namespace in one tree, each with a base that moves below its odometry's frame."""
    frames = Frames()
    for body in bodies:
        frames.add(f"{body}laser", f"{body}base_link", link(0.2))
        for k in range(5):
            frames.add(f"{body}base_link", f"{body}odom", link(float(k)), float(k))
        frames.add(f"{body}odom", "map", link())
    return frames


def topic(name: str, frame: str, child: str) -> Source:
    moves = Odometry(np.arange(5.0), [(float(k), 0, 0) for k in range(5)])
    return Source(name, frame, child, moves)


def picked(topics, frames, laser="laser", scan="/scan", asked="", spaces=None):
    about = Recording(taken=scan)
    source, about = pick_odometry(topics, frames, laser, about, asked, "a.bag", spaces or {})
    return SimpleNamespace(**(vars(about) | {"source": source}))


def test_the_odometry_is_that_of_the_robot_which_carries_the_laser() -> None:
    both = [topic(f"/{b}odom", f"{b}odom", f"{b}base_link") for b in ("a/", "b/")]
    for body, other in (("a/", "b/"), ("b/", "a/")):
        found = picked(both, tree("a/", "b/"), f"{body}laser", f"/{body}scan")
        assert (found.source.name, found.robots) == (f"/{body}odom", (f"/{other}odom",))


def test_what_a_robot_cannot_know_is_no_odometry() -> None:
    truth = topic("/base_pose_ground_truth", "map", "base_link")
    wheels = topic("/robot/odom", "odom", "base_link")
    found = picked([truth, wheels], tree(""))
    assert found.source is wheels
    assert found.truths == ("/base_pose_ground_truth",)
    alone = picked([truth], Frames())
    assert alone.source is None
    assert alone.truths == ("/base_pose_ground_truth",)
    assert picked([truth], Frames(), asked="/base_pose_ground_truth").source is truth


def test_a_link_of_tf_that_leads_to_the_laser_is_the_odometry() -> None:
    frames = tree("")
    for k in range(5):  # another child of the same frame
        frames.add("a_wall", "odom", link(float(-k)), float(k))
    found = picked([], frames)
    assert (found.source.frame, found.source.child) == ("odom", "base_link")
    np.testing.assert_allclose(found.source.odometry.at(2.5), [2.5, 0, 0])


@pytest.mark.parametrize("frame", ["odom_combined", "t265", "world"])
def test_the_frame_of_the_odometry_may_have_any_name(frame: str) -> None:
    moving = [("base_link", frame, float(k), link(float(k))) for k in range(5)]
    pan = [("laser", "base_link", float(k), link(0.2, yaw=0.1 * k)) for k in range(5)]
    found = picked([], frames_of(moving=[*pan, *moving]))
    assert (found.source.frame, found.source.child) == (frame, "base_link")


def test_several_robots_without_transforms_are_told_apart_by_name_or_refused() -> None:
    both = [topic("/a/odom", "odom", "base"), topic("/b/odom", "odom", "base")]
    assert picked(both, Frames(), scan="/b/scan").source is both[1]
    with pytest.raises(ScanError, match="one of /a/odom, /b/odom"):
        picked(both, Frames())
    with pytest.raises(ScanError, match="no odometry /c; it has /a/odom, /b/odom"):
        picked(both, Frames(), asked="/c")
    assert picked(both, Frames(), asked="b/odom").source is both[1]


def test_robots_whose_frames_have_the_same_names_are_told_apart_by_their_topics() -> None:
    both = [topic(name, "odom", "base_link") for name in ("/a/wheels", "/b/odom")]
    spaces = {"a": tree(""), "b": tree("")}
    found = picked(both, tree(""), scan="/a/scan", spaces=spaces)
    assert (found.source, found.robots) == (both[0], ("/b/odom",))
    assert picked(both[1:], tree(""), scan="/a/scan", spaces=spaces).source.tf


def test_further_odometries_of_the_robot_are_named() -> None:
    wheels, fused = topic("/odom", "odom", "base_link"), topic("/filtered", "odom", "base_link")
    found = picked([fused, wheels], tree(""))
    assert found.source is wheels
    assert found.others == ("/filtered",)


def test_the_mount_is_that_of_the_time() -> None:
    pan = [("laser", "base_link", 0.1 * k, link(0.2, yaw=0.1 * k)) for k in range(11)]
    found = mounted(frames_of(moving=pan), "laser", "", np.array([0.25, 0.5, 7.0]))
    assert {t: round(planar(pose)[2], 6) for t, pose in found.items()} == {0.25: 0.25, 0.5: 0.5}
    assert mounted(Frames(), "laser", "", np.array([0.5])) is None


def test_poses_out_of_order_are_not_static() -> None:
    stamps = (12.0, 14.0, 11.0, 10.0, 13.0)
    frames = frames_of(moving=[("laser", "base", t, link(max(0.0, t - 12))) for t in stamps])
    assert at(frames, "laser", "base", 10.5) == pytest.approx((0, 0, 0))
    assert at(frames, "laser", "base", 13.5) == pytest.approx((1.5, 0, 0))


def test_a_placeholder_in_tf_static_does_not_hide_what_moves() -> None:
    frames = frames_of(moving=[("base", "odom", float(k), link(float(k))) for k in range(3)])
    frames.add("base", "odom", link())
    assert at(frames, "base", "odom", 1.5) == pytest.approx((1.5, 0, 0))
    later = frames_of(("base", "odom", link()))
    for k in range(3):
        later.add("base", "odom", link(float(k)), float(k))
    assert at(later, "base", "odom", 1.5) == pytest.approx((1.5, 0, 0))


def test_an_odometry_of_one_message_is_none_beside_tf() -> None:
    one = Source("/odom", "odom", "base_link", Odometry([0.0], [(0, 0, 0)]))
    found = picked([one], tree(""))
    assert (found.source.tf, found.others) == (True, ("/odom",))
