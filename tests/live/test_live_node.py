"""`imgloc node` with real processes on loopback: a player, the node, and one who listens."""

import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import MAPS, ROOT, call, spawn
from scipy.spatial.transform import Rotation

import imgloc
from imgloc.features.scanpoints import scan_xy
from imgloc.geometry import pose_errors, transform_points
from imgloc.io.clouds import Cloud
from imgloc.live.messages import Messages
from imgloc.live.node import load_ros, placed
from imgloc.live.settings import Settings
from imgloc.live.status import Found
from imgloc.model import LaserScan, Pose2D, base_of

pytest.importorskip("rclpy", reason="no ROS 2 here: source one, or pip install 'imgloc[node]'")

from tools.robot.kill import Told, environment, judged, lines_of, true_poses
from tools.robot.play import START, to_and_fro

MAP, OTHER = MAPS / "double_wall.yaml", MAPS / "curved.yaml"
MOUNT = Pose2D(0.1, 0.0, math.radians(90.0))
SENSOR = "0.1,0,90deg"
PATIENCE = 30.0  # seconds that a scan may be old on a busy machine
LONG = 120.0  # and anything may take
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot that drives a metre to and fro in MAP, with a scan each 0.1 s."""
    path = tmp_path_factory.mktemp("log") / "log.npz"
    imgloc.save_scans(path, to_and_fro(MOUNT))
    return path


def truth_of(log: Path) -> np.ndarray:
    """Poses (N, 3) of the robot's base."""
    scans = imgloc.load_scans(log)
    return np.array([vars_of(imgloc.model.base_of(Pose2D(*row), MOUNT)) for row in scans.poses])


def vars_of(pose: Pose2D) -> tuple[float, float, float]:
    return pose.x, pose.y, pose.theta


class Field:
    """Processes of one test, which hear each other alone, and what was heard and played."""

    def __init__(self, folder: Path) -> None:
        # A domain that no other test on this machine has: who holds the port has the domain.
        self.held, domain = socket.socket(), 1
        while True:
            try:
                self.held.bind(("127.0.0.1", 28_900 + domain))
                break
            except OSError:
                domain += 1
        self.around = environment(domain)
        self.around["PYTHONPATH"] = str(ROOT)
        self.folder, self.running = folder, list[subprocess.Popen[bytes]]()
        self.played_in, self.heard_in = folder / "played.jsonl", folder / "heard.jsonl"

    def start(self, module: str, *words: object) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", module, *map(str, words)]
        with (self.folder / f"{len(self.running)}-{module}.txt").open("wb") as said:
            made = subprocess.Popen(command, env=self.around, cwd=ROOT, stdout=said, stderr=said)
        self.running.append(made)
        return made

    def node(self, *words: object) -> "subprocess.Popen[bytes]":
        return self.start("imgloc", "node", "--max-age", PATIENCE, *words)

    def play(self, *words: object) -> "subprocess.Popen[bytes]":
        return self.start("tools.robot", "play", *words, "--write", self.played_in)

    def listen(self) -> None:
        self.start("tools.robot", "listen", "--all", "--write", self.heard_in)
        self.until(self.heard_in.exists)

    def ask(self, *services: str) -> list[dict[str, Any]]:
        command = [sys.executable, "-m", "tools.robot", "ask", *services]
        done = subprocess.run(command, env=self.around, cwd=ROOT, capture_output=True, timeout=LONG)
        assert done.stdout, done.stderr
        return [json.loads(line) for line in done.stdout.splitlines()]

    def walk(self, *transitions: str) -> list[bool]:
        return [one["success"] for one in self.ask(*transitions)]

    def check(self, *words: object, at: str = SENSOR, ros: Sequence[str] = ()) -> tuple[int, str]:
        command = [sys.executable, "-m", "imgloc", "node", *map(str, words), "--sensor", at,
                   "--check", "--max-age", str(PATIENCE), *ros]  # fmt: skip
        done = subprocess.run(command, env=self.around, cwd=ROOT, capture_output=True,
                              timeout=LONG, text=True)  # fmt: skip
        return done.returncode, done.stdout + done.stderr

    def heard(self, topic: str) -> list[dict[str, Any]]:
        return [one for one in lines_of(self.heard_in) if one["topic"] == topic]

    def played(self) -> list[dict[str, Any]]:
        return lines_of(self.played_in)

    def until(self, there: Callable[[], object]) -> None:
        """Wait until something is there."""
        end = time.monotonic() + LONG
        while not there():
            assert time.monotonic() < end, self.said()
            time.sleep(0.05)

    def said(self) -> str:
        """What all of them printed."""
        texts = sorted(self.folder.glob("*.txt"))
        last = lines_of(self.heard_in)[-1:]
        return "\n".join([*(f"{t.name}: {t.read_text()[-2000:]}" for t in texts), str(last)])

    def level(self) -> int:
        """Of the last diagnostics."""
        return self.heard("diagnostics")[-1]["level"] if self.heard("diagnostics") else -1

    def told(self, log: Path) -> Told:
        """What was told on /initialpose, held against the truth."""
        return judged(Told(PATIENCE), self.heard("initialpose"), self.played(), truth_of(log))


@pytest.fixture
def field(tmp_path: Path) -> Iterator[Field]:
    made = Field(tmp_path)
    yield made
    for process in made.running:
        process.kill()
        process.wait()
    made.held.close()


def test_a_robot_is_told_its_first_pose_once_and_silence_is_said(field, log) -> None:
    field.listen()
    node = field.node("--sensor", SENSOR)
    player = field.play(MAP, log)
    field.until(lambda: field.level() == 0)
    assert len(field.heard("initialpose")) == 1
    said = field.heard("status")[-1]
    assert said["localized"] is True
    assert 0.9 < said["localizationScore"] <= 1
    assert 0 < said["deviationRange"] < 0.2
    assert said["mapId"] == "map"
    assert said["state"] == "quiet"
    assert pose_errors(np.array([[said["x"], said["y"], said["theta"]]]),
                       START)[0] == pytest.approx([0, 0], abs=1.1)  # fmt: skip
    player.kill()
    field.until(lambda: field.level() == 3)
    assert field.heard("diagnostics")[-1]["message"] == "no scans on /scan"
    field.until(lambda: not field.heard("status")[-1]["localized"])
    assert field.heard("status")[-1]["withheld"] == "late"
    told = field.told(log)
    assert (told.poses, told.right) == (1, True), told
    assert told.worst_m < 0.1
    node.send_signal(signal.SIGTERM)
    assert node.wait(LONG) == 0


def test_two_lasers_are_one_robot(field, log) -> None:
    field.listen()
    sensors = ("--sensor", SENSOR, "--sensor", "0.1,0,270deg")
    field.node("--scan", "front", "--scan", "rear", *sensors)
    field.play(MAP, log, "--lasers", 2, "--best-effort")
    field.until(lambda: field.heard("initialpose"))
    assert field.told(log).right


def test_a_tilted_camera_answers_as_a_laser_at_its_place(log) -> None:
    scan, features = imgloc.load_scans(log)[10], imgloc.prepare(imgloc.load_map(MAP))
    link = np.eye(4)  # 0.5 m high, looks 30 degrees down and to the left
    link[:3, :3] = Rotation.from_euler("ZYX", [90, 30, 0], degrees=True).as_matrix()
    link[:3, 3] = MOUNT.x, MOUNT.y, 0.5
    ends = transform_points(MOUNT, scan_xy(scan)[scan.valid])
    points = np.concatenate([np.insert(share * ends, 2, z, axis=1)
                             for share, z in ((1.0, 0.2), (0.5, 0.0), (0.6, 0.5))])  # fmt: skip
    seen = (points - link[:3, 3]) @ link[:3, :3]
    settings = Settings(cloud_topics=("points",), height=(0.1, 0.4))
    cut = placed(Cloud(seen, 0.0), settings, "points", None, link)
    (a, b) = (imgloc.localize(features, one) for one in (scan, cut))
    assert (a.verdict, b.verdict) == ("unique", "unique")
    there, here = (one.hypotheses[0].pose for one in (a, b))
    there, here = base_of(there, MOUNT), base_of(here, cut.T_base_laser)
    assert pose_errors(np.array([vars_of(here)]), there)[0] == pytest.approx([0, 0], abs=0.01)


def test_a_cloud_of_points_is_a_scan_at_its_height(field, log) -> None:
    field.listen()
    field.node(MAP, "--sensor", SENSOR, "--cloud", "/points", "--height", "0.1,0.4")
    field.play(MAP, log, "--no-map", "--cloud")
    field.until(lambda: field.heard("initialpose"))
    assert field.told(log).right
    checked = field.node(
        MAP, "--sensor", SENSOR, "--cloud", "/points", "--height", "5,6", "--check"
    )
    assert checked.wait(LONG) == 1
    assert "ok     /points: 1" in field.said(), field.said()
    assert "no point at this height" in field.said(), field.said()


@pytest.mark.parametrize(
    ("what", "said", "level"),
    [("stamp", "no scans on /scan (its stamp stays the same)", 3),
     ("ranges", "/scan: each scan repeats the one before; is its driver frozen?", 1)],
)  # fmt: skip
def test_a_laser_that_repeats_one_scan_is_given_up(field, log, what, said, level) -> None:
    field.listen()
    field.node(MAP, "--sensor", SENSOR, "--tries", 6)
    field.play(MAP, log, "--no-map", "--freeze", what)
    field.until(lambda: any(one["state"] == "given up" for one in field.heard("status")))
    field.until(lambda: field.heard("diagnostics"))  # a status may come before them
    field.until(lambda: (field.level(), field.heard("diagnostics")[-1]["message"]) == (level, said))
    assert not field.heard("initialpose")


# An answer may come before its reader is known, and is lost then.
SET = """
import sys, rclpy, rclpy.parameter_client
rclpy.init()
client = rclpy.parameter_client.AsyncParameterClient(node := rclpy.create_node("setter"), "imgloc")
for name, value in zip(sys.argv[1::2], sys.argv[2::2]):
    for _ in range(9):
        asked = client.set_parameters([rclpy.Parameter(name, value=eval(value))])
        rclpy.spin_until_future_complete(node, asked, timeout_sec=10)
        if asked.done():
            print(asked.result().results[0].reason or "done")
            break
"""


def test_parameters_change_while_it_runs_or_say_why_not(field, log) -> None:
    field.listen()
    field.node(MAP, "--sensor", SENSOR, "--tries", 10_000)
    field.play(MAP, log, "--no-map", "--freeze", "ranges")
    field.until(lambda: field.heard("status") and field.heard("status")[-1]["tries"] > 6)
    for words, said in (
        (("tries", "-1", "track", "True", "max_age", "[1.0]"),
         ("parameter tries: got -1, expected a whole number, scans, 2", "read-only",
          "max_age: got")),
        (("tries", "6"), ("done",)),
    ):  # fmt: skip
        assert not any(one["state"] == "given up" for one in field.heard("status"))
        command = [sys.executable, "-c", SET, *words]
        done = subprocess.run(command, env=field.around, capture_output=True, timeout=LONG)
        for line, expected in zip(done.stdout.decode().splitlines(), said, strict=True):
            assert expected in line
    field.until(lambda: field.heard("status")[-1]["state"] == "given up")


def test_no_pose_has_the_stamp_of_a_scan_that_says_nothing(field, log) -> None:
    field.listen()
    field.node(MAP, "--sensor", SENSOR, "--tries", 10_000)
    field.play(MAP, log, "--no-map", "--disturb", "nan", "unstamped", "short")
    field.until(lambda: field.heard("initialpose"))
    assert field.told(log).right
    disturbed = {round(p["stamp"], 6) for p in field.played() if p["disturbed"]}
    assert not disturbed & {round(p["stamp"], 6) for p in field.heard("initialpose")}


def test_a_stamp_ahead_of_the_clock_neither_starts_anew_nor_ends_the_track(field, log) -> None:
    field.listen()
    field.node(MAP, "--sensor", SENSOR, "--track")
    field.play(MAP, log, "--no-map", "--disturb", "ahead")
    field.until(lambda: len(field.heard("pose")) > 40)
    assert len(field.heard("initialpose")) == 1
    assert "starts anew" not in field.said()
    followed = judged(Told(PATIENCE), field.heard("pose"), field.played(), truth_of(log))
    assert followed.right, followed
    ahead = {round(p["stamp"], 6) for p in field.played() if p["disturbed"]}
    assert not ahead & {round(p["stamp"], 6) for p in field.heard("pose")}


def test_millimetres_are_explained_and_given_up(field, log) -> None:
    scans, path = imgloc.load_scans(log), field.folder / "mm.npz"
    wrong = tuple(replace(scan, ranges=1000 * scan.ranges) for scan in scans)
    imgloc.save_scans(path, imgloc.ScanSet(wrong, scans.poses, scans.stamps, scans.odom))
    field.listen()
    field.node(MAP, "--sensor", SENSOR, "--tries", 3)
    field.play(MAP, path, "--no-map")
    field.until(lambda: any(said["state"] == "given up" for said in field.heard("status")))
    said = next(said for said in field.heard("status") if said["state"] == "given up")
    assert (said["verdict"], said["tries"], said["localized"]) == ("invalid", 3, False)
    assert "range_max is 12): are they millimetres?" in said["message"]
    field.until(
        lambda: any("gave up after 3" in one["message"] for one in field.heard("diagnostics"))
    )
    printed = field.folder / "1-imgloc.txt"
    field.until(lambda: "are they millimetres?" in printed.read_text())
    assert not field.heard("initialpose")


def test_another_map_starts_anew_and_what_was_found_in_the_first_is_gone(field, log) -> None:
    field.listen()
    field.node("--sensor", SENSOR)
    field.play(OTHER, log, "--then", MAP, "--after", 2)
    field.until(lambda: field.heard("initialpose"))
    assert field.told(log).right  # nothing was published in the map that it is not from


def test_a_robot_is_followed_and_answers_when_it_is_asked(field, log) -> None:
    field.listen()
    node = field.node(MAP, "--sensor", SENSOR, "--track", "--ros-args", "-p", "every:=1")
    field.play(MAP, log, "--no-map")
    field.until(lambda: len(field.heard("pose")) > 10)
    answer, reset = field.ask("localize", "reset")
    assert answer["success"], answer
    assert "unique: x " in answer["message"]
    assert reset["success"]
    field.until(lambda: len(field.heard("initialpose")) >= 2)
    followed = judged(Told(PATIENCE), field.heard("pose"), field.played(), truth_of(log))
    assert followed.right, followed
    assert field.told(log).right
    node.send_signal(signal.SIGINT)
    assert node.wait(LONG) == 0


def test_a_behaviour_trees_call_finds_a_robot_that_was_carried_off(field, log) -> None:
    field.listen()
    field.node(MAP, "--sensor", SENSOR)
    player = field.play(MAP, log, "--no-map")
    field.until(lambda: field.heard("initialpose"))
    player.kill()
    player.wait()
    scans, path = imgloc.load_scans(log), field.folder / "carried.npz"
    carried = scans.take(range(25, len(scans)))  # on the way back
    imgloc.save_scans(path, carried)
    field.ask("reinitialize_global_localization")
    before = len(field.heard("initialpose"))
    field.play(MAP, path, "--no-map")
    field.until(lambda: len(field.heard("initialpose")) > before)
    last = field.heard("initialpose")[-1:]
    index = {round(one["stamp"], 6): one["index"] for one in field.played()}
    truth = truth_of(log)[25 + index[round(last[0]["stamp"], 6)]]
    here = np.array([[last[0]["x"], last[0]["y"], math.radians(last[0]["theta_deg"])]])
    assert pose_errors(here, Pose2D(*truth))[0] == pytest.approx([0, 0], abs=0.2)


def test_a_lifecycle_manager_prepares_starts_stops_and_starts_again(field, log) -> None:
    field.listen()
    node = field.node(MAP, "--sensor", SENSOR, "--lifecycle")
    field.play(MAP, log, "--no-map")
    assert field.walk("activate", "configure") == [False, True]
    time.sleep(2.0)
    assert not field.heard("status")  # it is not active
    for transitions in (["activate"], ["deactivate", "activate"]):
        before = len(field.heard("initialpose"))
        assert all(field.walk(*transitions))
        field.until(lambda before=before: len(field.heard("initialpose")) > before)
    assert field.told(log).right
    assert field.walk("deactivate", "cleanup") == [True, True]
    node.send_signal(signal.SIGINT)
    assert node.wait(LONG) == 0


def test_a_pose_is_remembered_and_a_scan_decides_whether_it_still_holds(field, log) -> None:
    file, truth = field.folder / "robot.json", truth_of(log)
    field.listen()
    node = field.node(MAP, "--sensor", SENSOR, "--remember", file)
    player = field.play(MAP, log, "--no-map")
    field.until(lambda: file.exists() and len(field.played()) > 40)
    for process in (player, node):
        process.send_signal(signal.SIGTERM)
        assert process.wait(LONG) in (0, -signal.SIGTERM)
    kept = json.loads(file.read_text())
    pose = kept["pose"]
    here = np.hypot(truth[:, 0] - pose["x"], truth[:, 1] - pose["y"])
    assert here.min() < 0.1  # where it was
    for said, off in (("restored", 0), ("moved", 3)):
        file.write_text(json.dumps({**kept, "pose": {**pose, "x": pose["x"] + off}}))
        before, heard = len(field.heard("initialpose")), len(field.heard("status"))
        node = field.node(MAP, "--sensor", SENSOR, "--remember", file)
        field.until(lambda heard=heard: len(field.heard("status")) > heard + 2)  # it is there
        first = field.folder / f"{len(field.running)}.jsonl"
        player = field.start("tools.robot", "play", MAP, log, "--no-map", "--hold", 3, "--first",
                             here[:1000].argmin(), "--write", first)  # fmt: skip
        field.until(lambda before=before: len(field.heard("initialpose")) > before)
        field.until(lambda said=said: field.heard("status")[-1].get("remembered") == said)
        told = judged(Told(PATIENCE), field.heard("initialpose")[before:], lines_of(first), truth)
        assert told.right, told
        for process in (player, node):
            process.kill()
            process.wait()


def test_another_localizer_is_watched_and_no_pose_is_published(field, log) -> None:
    field.listen()
    field.node(MAP, "--sensor", SENSOR, "--watch", "/amcl_pose")
    wrong = field.folder / "wrong"
    field.play(MAP, log, "--no-map", "--amcl", wrong, "--best-effort")
    for said, level in (("agrees", 0), ("disagrees", 2)):
        field.until(lambda said=said: field.heard("status")[-1:] and (
            field.heard("status")[-1]["watch"]["said"] == said))  # fmt: skip
        field.until(lambda level=level: field.level() == level)
        wrong.touch()
    status = field.heard("status")[-1]["watch"]
    assert status["seconds"] < 60
    assert status["pose"]["x"] == pytest.approx(START.x + 0.5, abs=1.0)
    assert "; imgloc would give x 1" in field.heard("diagnostics")[-1]["message"]
    assert not field.heard("initialpose")


def test_a_running_robot_is_checked_and_what_is_wrong_says_what_to_do(field, log) -> None:
    scans, path = imgloc.load_scans(log), field.folder / "mm.npz"
    wrong = tuple(replace(scan, ranges=1000 * scan.ranges) for scan in scans)
    imgloc.save_scans(path, imgloc.ScanSet(wrong, scans.poses, scans.stamps, scans.odom))

    check = field.check
    code, said = check(MAP)
    assert (code, "wrong  /scan: no publisher" in said) == (1, True), said
    player = field.play(MAP, log)
    field.until(field.played)
    code, said = check(MAP)
    assert re.search(r"ok     /scan: (9|1\d)\.\d Hz", said), said
    assert "ok     scans on double_wall: 3 unique" in said, said
    assert "wrong  /initialpose: nobody listens" in said, said
    assert re.search(r"ok     scans and odometry: \d\d% of the readings agree", said), said
    for at, words, found in (
        (SENSOR, (OTHER,), "scans on curved: 9 no-match"),
        ("0.1,0,0", (MAP,), "sensor turned by 90 degrees on the robot. Try --sensor 0.1,0,90"),
    ):
        code, said = check(*words, "--watch", "/amcl_pose", at=at)
        assert (code, found in said, "initialpose" in said) == (1, True, False), said
        assert "wrong  /amcl_pose: no publisher" in said, said
    player.kill()
    player.wait()
    field.played_in.unlink()
    field.play(MAP, path, "--lasers", 1)
    field.until(field.played)
    code, said = check("--scan", "scan", "--scan", "front", "--sensor", SENSOR)
    assert "ok     map /map: " in said, said
    assert "millimetres" in said, said
    assert "remap it: -r front:=/scan" in said, said


def floors_of(field) -> Path:
    """A folder of two maps."""
    floors = field.folder / "floors"
    floors.mkdir()
    for one in (MAP, OTHER):
        imgloc.save_map(floors / one.name, imgloc.load_map(one))
    return floors


def test_a_check_hears_what_is_mapped_and_scans_need_not_fit_other_floors(field, log) -> None:
    floors = floors_of(field)
    field.listen()
    field.play(MAP, log)
    field.until(field.played)
    mapped = [f"{name}:=/{name}" for name in ("scan", "odom", "initialpose")]
    words = [word for one in ("__ns:=/r1", *mapped) for word in ("-r", one)]
    code, said = field.check(floors, ros=("--ros-args", *words))
    assert (code, "ok     scans on curved: 9 no-match" in said) == (0, True), said


def test_messages_name_topics_and_services_as_they_are_mapped(field) -> None:
    node = field.node("--sensor", "0,0,0", "--ros-args", "-r", "__ns:=/r1", "-r", "scan:=/front")
    field.until(lambda: "no scans on /front" in field.said())
    node.send_signal(signal.SIGTERM)
    assert node.wait(LONG) == 0


def test_a_folder_of_floors_says_which_it_is_by_the_recorded_clock(field, log) -> None:
    floors = floors_of(field)
    field.listen()
    field.node(floors, "--sensor", SENSOR, "--ros-args", "-p", "use_sim_time:=true")
    field.play(MAP, log, "--no-map", "--clock")
    field.until(lambda: field.heard("initialpose"))
    pose = field.heard("initialpose")[0]
    assert 1000 <= pose["stamp"] <= 1060
    field.until(lambda: field.heard("status")[-1]["mapId"] == "double_wall")


def test_killed_and_started_again_nothing_wrong_is_told(field, log) -> None:
    field.listen()
    node, player = field.node(MAP, "--sensor", SENSOR), field.play(MAP, log, "--no-map")
    for victim in ("node", "player"):
        count = len(field.heard("initialpose"))
        field.until(lambda count=count: len(field.heard("initialpose")) > count)
        (node if victim == "node" else player).kill()
        if victim == "node":
            node = field.node(MAP, "--sensor", SENSOR)
        player.kill()
        player = field.play(MAP, log, "--no-map", "--first", 30)
    time.sleep(1.0)
    told = field.told(log)
    assert told.poses >= 2
    assert told.right, told


def test_a_recorded_robot_is_told_where_it_is(field, shared) -> None:
    map_path = shared / "data" / "olin_mac" / "maps" / "mac_1st_floor_final.yaml"
    bag = shared / "data" / "olin_mac" / "bags" / "macfirst_floor_take_2"
    field.listen()
    field.node("--sensor", "0.00394,0,90deg")
    field.play(map_path, bag, "--count", 150)
    field.until(lambda: field.heard("initialpose"))
    recorded = imgloc.load_scans(bag)
    played = recorded.take(range(1 + max(one["index"] for one in field.played())))
    truth = true_poses(map_path, played, Pose2D(6.88, -8.36, 1.77))
    told = judged(Told(PATIENCE), field.heard("initialpose"), field.played(), truth)
    assert told.right, told


def test_a_listener_who_hears_nothing_ends_at_ctrl_c(field) -> None:
    field.listen()
    (listener,) = field.running
    time.sleep(2.0)  # until it waits
    listener.send_signal(signal.SIGINT)
    assert listener.wait(LONG) == 130


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ((MAP,), 2, "sensor: missing, expected X,Y,YAW"),
        ((MAP, "--sensor", "20,0,0"), 2, "20 m from the robot's base"),
        ((MAP, "--scan", "a", "--scan", "b", "--sensor", "0,0,0"), 2, "for each of 2"),
        ((MAP, "--sensor", "0,0,0", "--ros-args", "-p", "every:=soon"), 2, "every: got 'soon'"),
        (
            (MAP, "--sensor", "0,0,0", "--ros-args", "-p", "every:=-1.0"),
            2,
            "error: parameter every: got -1",
        ),
        ((MAP, "--sensor", "0,0,0", "--ros-args", "-p", "every"), 2, "the arguments of ROS: "),
        (("visibility",), 2, "sensor: missing"),
        ((MAP, "--sensor", "0,0,0", "--watch", "/amcl_pose", "--track"), 2, "publishes no pose"),
        (
            (MAP, "--sensor", "0,0,0", "--cloud", "points"),
            2,
            "--height: expected with cloud_topics",
        ),
        ((MAP, "--sensor", "0,0,0", "--watch", "tf"), 2, "watch: tf2_msgs is not installed"),
        ((MAP, "--sensor", "0,0,0", "--remember", ROOT / "README.md"), 2, "README.md: not JSON"),
        ((MAP, "--sensor", "0,0,0", "--remember", "no/where.json"), 2, "its folder is not there"),
        ((MAP, "--sensor", "0,0,0", "--tf"), 2, "--tf: expected track, too"),
        (("nowhere.yaml", "--sensor", "0,0,0"), 3, "nowhere.yaml: no such file"),
    ],
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of what rclpy imports
def test_what_is_wrong_is_said_before_the_node_runs(words, code, said) -> None:
    call("node", *words).ends(code, said)


def test_an_unknown_parameter_is_named() -> None:
    words = (MAP, "--sensor", "0,0,0", "--ros-args", "-p", "evry:=1.0", "-p", "every:=-1.0")
    spawn("node", *words).ends(2, "parameter evry: unknown, and ignored; did you mean every?")


def test_messages_are_those_that_amcl_and_rviz_take() -> None:
    from builtin_interfaces.msg import Time

    made = Messages(load_ros())
    covariance = np.array([[1e-4, -5e-5, 0.0], [-5e-5, 0.25, 0.0], [0.0, 0.0, 1e-6]])
    places = (Pose2D(1.0, 2.0, math.pi), Pose2D(3.0, 2.0))
    found = Found(5.0, "hall", "unique", places, (0.9, 0.1), covariance)
    stamp = Time(sec=5, nanosec=7)
    header = made.header(stamp, "map")
    message = made.pose(places[0], covariance, header, (0.1, 0.05))
    variances = message.pose.covariance.reshape(6, 6)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (5, 7)
    assert np.count_nonzero(variances) == 3
    assert (variances[0, 0], variances[5, 5]) == pytest.approx((0.01, 0.0025))
    assert variances[1, 1] > 0.25
    assert abs(message.pose.pose.orientation.z) == pytest.approx(1.0)
    scan = LaserScan([1.0, np.nan, 2.0], [0.0, 1.0, math.pi / 2], T_base_laser=Pose2D(0.5, 0.0))
    markers = made.markers(found, scan, header).markers
    assert [m.ns for m in markers] == ["", "places", "masses", "places", "masses", "scan"]
    assert len({(m.ns, m.id) for m in markers}) == len(markers)
    ends = np.array([(p.x, p.y) for p in markers[-1].points])
    assert ends == pytest.approx(np.array([[-0.5, 2.0], [0.5, 0.0]]))
    assert markers[2].text == "90.0 %"
    array = made.places(found, header)
    assert [(p.position.x, p.position.y) for p in array.poses] == [(1.0, 2.0), (3.0, 2.0)]
    link = made.link(Pose2D(1.0, 2.0, 0.5), header, "odom")
    assert (link.child_frame_id, link.transform.translation.y) == ("odom", 2.0)


@pytest.mark.parametrize(
    ("set_before", "heard"), [({}, "LOCALHOST"), ({RANGE: "SUBNET"}, "SUBNET")]
)
def test_a_played_robot_is_heard_on_this_machine_alone(set_before, heard) -> None:
    program = (
        "import os, sys; sys.modules['rclpy'] = None; sys.argv[1:] = ['ask', 'reset']\n"
        f"from tools.robot.__main__ import main; main(); print(os.environ.get({RANGE!r}))"
    )
    around = {k: v for k, v in os.environ.items() if not k.startswith("ROS_")} | set_before
    around["PYTHONPATH"] = str(ROOT)
    done = subprocess.run(
        [sys.executable, "-c", program], env=around, capture_output=True, text=True, timeout=LONG
    )
    assert done.stdout == f"{heard}\n", done.stderr
