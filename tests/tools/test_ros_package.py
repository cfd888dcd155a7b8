"""The ament package: what it says, that colcon builds it, and the words that ros2 launch starts."""

import importlib.util
import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from command import MAPS, ROOT, spawn

from imgloc.__about__ import __version__
from imgloc.live.node import MODULES

PACKAGE = ROOT / "tools" / "ros" / "imgloc_ros"


def test_it_depends_on_all_messages_that_the_node_imports() -> None:
    said = ElementTree.parse(PACKAGE / "package.xml").getroot()
    depends = {one.text for one in said.findall("exec_depend")}
    assert {*MODULES, "rclpy", "nav2_msgs", "tf2_msgs", "lifecycle_msgs"} <= depends
    assert said.findtext("version") == __version__
    setup = (PACKAGE / "setup.py").read_text()
    assert re.search(r'version="([^"]+)"', setup)[1] == __version__
    assert not list(PACKAGE.glob("imgloc_ros/*.py"))  # no code twice


def test_its_view_shows_what_the_node_publishes() -> None:
    layout = json.loads((PACKAGE / "foxglove" / "imgloc.json").read_text())
    topics = layout["configById"]["3D!map"]["topics"]
    assert {"/imgloc/hypotheses", "/imgloc/markers", "/initialpose"} <= topics.keys()


def test_the_launch_file_starts_the_node_with_what_was_said(tmp_path: Path) -> None:
    path = PACKAGE / "launch" / "first_pose.launch.py"
    spec = importlib.util.spec_from_file_location("first_pose", path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    given = {name: value for name, (value, _) in made.ARGUMENTS.items()}
    assert Path(given["params"]).is_file()
    assert made.words_of(given)[:3] == ["imgloc", "node", "--ros-args"]
    pytest.importorskip("rclpy", reason="no ROS 2 here: source one, or pip install 'imgloc[node]'")
    given |= {"map": str(MAPS / "curved.yaml"), "sensor": "0.2,0,0", "namespace": "/r1",
              "remember": str(tmp_path / "no" / "robot.json")}  # fmt: skip
    found = spawn(*made.words_of(given)[1:])
    assert (found.code, "its folder is not there" in found.err) == (2, True), found
