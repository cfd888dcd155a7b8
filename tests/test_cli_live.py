"""`imgloc track` while a log is being written: standard input, a pipe, a file that grows."""

import json
import os
import select
import shutil
import signal
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, Run, call, command, fed, rows
from places import drive, lines_of

from imgloc.cli.tracking import live_of
from imgloc.options import Logs

N_RAYS = 120
MAP, N = MAPS / "visibility.yaml", 8


@pytest.fixture(scope="module")
def lines() -> list[str]:
    return lines_of(drive(np.array([[4.0 + 0.5 * k, 7.0, 0.0] for k in range(N)])))


def started(*words: object) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    made = command(["track", MAP, *words])
    return subprocess.Popen(made, stdin=pipe, stdout=pipe, stderr=pipe, text=True)


def followed(text: str, *words: object) -> Run:
    """A run that is given all of its lines at once."""
    return fed(text, "track", MAP, "-", *words)


def line_of(run: subprocess.Popen[str], seconds: float = 30.0) -> str:
    """The next line of output; nothing if it does not come in time."""
    return run.stdout.readline() if select.select([run.stdout], [], [], seconds)[0] else ""


def test_each_line_is_answered_before_the_next_one_comes(lines: list[str], tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text("".join(lines))
    whole = call("track", MAP, path, "--json", "--tum", tmp_path / "file.tum").ends(0)
    run, got = started("-", "--json", "--tum", tmp_path / "pipe.tum"), []
    for line in lines:
        run.stdin.write(line)
        run.stdin.flush()
        got.append(line_of(run))
    _, said = run.communicate()
    assert run.returncode == 0, said
    assert "".join(got) == whole.out
    assert (tmp_path / "pipe.tum").read_bytes() == (tmp_path / "file.tum").read_bytes()
    assert "from line in to line out p50" in said


def test_a_named_pipe_is_followed_and_a_cut_line_is_left_out(lines, tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    text = "\n" + "".join(lines[:3]) + lines[3][:40]
    writer = threading.Thread(target=path.write_text, args=(text,))
    writer.start()
    run = call("track", MAP, path, "--json", "--picture", tmp_path / "a.png")
    writer.join()
    assert run.code == 0, run.err
    assert [row["stamp"] for row in rows(run.out)] == [100, 101, 102]
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_a_file_that_grows_is_followed_through_its_rotation(lines, tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_text(lines[0] + lines[1][:50])
    run = started(path, "--json", "--follow", "--tum", tmp_path / "a.tum")
    assert json.loads(line_of(run))["stamp"] == 100
    with path.open("a") as file:
        file.write(lines[1][50:])
    assert json.loads(line_of(run))["stamp"] == 101
    shutil.move(path, tmp_path / "log.1")
    time.sleep(0.1)
    path.write_text(lines[2])
    row = json.loads(line_of(run))
    assert (row["stamp"], row["index"]) == (102, 2)
    run.send_signal(signal.SIGINT)
    _, said = run.communicate(timeout=30)
    assert run.returncode == 0, said
    assert (tmp_path / "a.tum").exists()


def test_scans_without_odometry_are_left_out_and_counted(lines: list[str]) -> None:
    bare = {k: v for k, v in json.loads(lines[1]).items() if k != "odom"}
    run = followed(lines[0] + json.dumps(bare) + "\n" + lines[2], "--json")
    assert run.code == 0, run.err
    assert [row["index"] for row in rows(run.out)] == [0, 2]
    assert "1 of 3 scans have no odometry" in run.err


@pytest.mark.parametrize(
    ("words", "text", "code", "expected"),
    [
        ((), '{"ranges": [1], \n', 4, "standard input: line 1: not valid JSON"),
        ((), '{"ranges": [1]}\n', 4, "standard input: line 1"),
        (("--follow",), "{}\n", 2, "--follow: is of a file that grows"),
    ],
)
def test_refuses(words: tuple[str, ...], text: str, code: int, expected: str) -> None:
    run = followed(text, *words)
    run.ends(code, expected, out="")


def carmen_of(line: str) -> str:
    """A scan of the log as CARMEN writes it: its laser sits 0.2 m before the robot's centre."""
    row = json.loads(line)
    x, y, theta = row["odom"]
    laser = (x + 0.2 * np.cos(theta), y + 0.2 * np.sin(theta), theta)
    ranges = " ".join(f"{r:.4f}" for r in row["ranges"])
    poses = " ".join(f"{value:.6f}" for value in (*laser, *row["odom"]))
    head = f"ROBOTLASER1 0 {-np.pi:.6f} {2 * np.pi:.6f} {np.deg2rad(3):.6f} 30 0.1 0"
    stamp = f"{row['stamp']:.6f}"
    return f"{head} {N_RAYS} {ranges} 0 {poses} 0 0 0 0 0 {stamp} robot {stamp}\n"


def test_a_carmen_log_is_followed_as_it_comes(lines: list[str], tmp_path: Path) -> None:
    log = ["# CARMEN Logfile\n", "PARAM robot_use_laser on\n", *map(carmen_of, lines)]
    path = tmp_path / "run.log"
    path.write_text("".join(log))
    whole = call("track", MAP, path, "--json").ends(0)
    assert followed("".join(log), "--json").out == whole.out
    assert rows(whole.out)[-1]["verdict"] == "unique"


def test_a_carmen_log_whose_laser_moves_on_the_robot_ends_it(lines: list[str]) -> None:
    moved = carmen_of(lines[1]).split(" ")
    moved[10 + N_RAYS] = f"{float(moved[10 + N_RAYS]) + 0.1:.6f}"
    run = followed(carmen_of(lines[0]) + " ".join(moved), "--json")
    assert (run.code, len(rows(run.out))) == (4, 1)
    assert "line 2: ROBOTLASER1: the laser has moved on the robot" in run.err


def test_ctrl_c_is_an_end_only_once_the_file_is_followed(lines: list[str], tmp_path: Path) -> None:
    """While the map is being prepared it interrupts, as it does in any command."""
    path, before = tmp_path / "log.jsonl", signal.getsignal(signal.SIGINT)
    path.write_text(lines[0])
    live = live_of(path, Logs(), lambda scan: scan, follow=True)
    assert live is not None
    assert signal.getsignal(signal.SIGINT) is before
    try:
        assert next(iter(live))[0].stamp == 100
        assert signal.getsignal(signal.SIGINT) is not before
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_stamp_that_goes_back_is_left_out(lines: list[str]) -> None:
    run = followed(lines[1] + lines[0] + lines[2], "--json")
    assert (run.code, len(rows(run.out))) == (0, 2)
    assert "standard input: scan 1: its stamp, 100.00, goes back; left out" in run.err


@pytest.fixture(scope="module")
def whole(lines: list[str]) -> str:
    """What is printed of all lines."""
    return followed("".join(lines), "--json").out


@pytest.mark.parametrize("broken", ["garbage", '{"odom": [NaN, 0, 0]}'])
def test_a_broken_line_of_a_stream_is_left_out_if_few_may_be(lines, whole, broken):
    text = "".join([*lines[:4], broken + "\n", *lines[4:]])
    run = followed(text, "--json", "--max-bad", "0.2")
    run.ends(0, "standard input: line 5: ", "the line is left out")
    assert run.out == whole  # as if it had not been there
    run = followed(text, "--json")
    assert (run.code, len(rows(run.out))) == (4, 4)
    two = "".join([*lines[:4], (broken + "\n") * 2, *lines[4:]])
    run = followed(two, "--json", "--max-bad", "0.2")
    assert (run.code, len(rows(run.out))) == (4, 4)  # two of six are too many
    assert "line 6: " in run.err


def test_a_first_stamp_that_cannot_be_is_named(lines: list[str]) -> None:
    run = followed(json.dumps(json.loads(lines[0]) | {"stamp": 1e300}) + "\n", "--json")
    run.ends(4, "standard input: stamps[0]: got 1e+300, expected seconds", out="")
