"""Is a robot ever told a wrong place? Node and player are killed at random moments, and go on."""

import json
import math
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from imgloc import Options, Pose2D, ScanSet, follow, load_map, load_scans, make_filter, prepare
from imgloc.geometry import pose_errors
from imgloc.model import FloatArray

NEAR = (0.5, math.radians(10.0))
"""A pose that is farther from the true one is wrong: metres, radians."""
WAY = 1.5
"""Metres of driving that confirm a pose."""
REINITIALIZE = "reinitialize_global_localization"
_DELIVERED = 0.5  # seconds more that a busy machine takes to deliver it


@dataclass
class Told:
    """What was told on /initialpose."""

    max_age: float = 2.0  #: seconds that a scan may be old when its pose is published
    kills: dict[str, int] = field(default_factory=dict)  #: of whom
    poses: int = 0
    wrong: int = 0  #: farther than `NEAR` from the true one
    strange: int = 0  #: whose stamp is that of no scan
    stale: int = 0  #: that came later than the node may publish them
    worst_m: float = 0.0
    worst_deg: float = 0.0
    oldest_s: float = 0.0

    @property
    def right(self) -> bool:
        """Whether there were poses, and nothing was wrong with any."""
        return self.poses > 0 and not (self.wrong or self.strange or self.stale)


def environment(domain: int | None = None) -> dict[str, str]:
    """The environment of processes that hear each other alone."""
    if domain is None:
        domain = 1 + os.getpid() % 100
    return {
        **os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOCALHOST_ONLY": "1", "RCUTILS_LOGGING_BUFFERED_STREAM": "0",
    }  # fmt: skip


def spawned(
    module: str, *words: object, environment: Mapping[str, str], out: Any = subprocess.DEVNULL
) -> "subprocess.Popen[bytes]":
    """A process of ours."""
    command = [sys.executable, "-m", module, *map(str, words)]
    return subprocess.Popen(command, env=dict(environment), stdout=out, stderr=out)  # noqa: S603


@contextmanager
def ending(processes: Iterable["subprocess.Popen[bytes]"]) -> Iterator[None]:
    """End the processes that there are in the end, however this ends."""
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def true_poses(map_path: Path, log: ScanSet, start: Pose2D) -> FloatArray:
    """Poses (N, 3) of the robot's base: a filter that is told where it starts follows the log."""
    features = prepare(load_map(map_path))
    chosen = make_filter("tracker", features, Options())
    moments = follow(features, log, chosen, start=start, deviation=(0.3, 0.1))
    found = np.array([(m.index, *m.best) for m in moments if m.best is not None])
    # Scans without odometry are left out; each of them stands for the next one that is not.
    return found[np.searchsorted(found[:, 0], np.arange(len(log))).clip(max=len(found) - 1), 1:]


def lines_of(path: Path) -> list[dict[str, Any]]:
    """The objects in a file that is being written."""
    if not path.exists():
        return []
    return [
        json.loads(line) for line in path.read_text().splitlines(keepends=True) if line[-1:] == "\n"
    ]


def judged(told: Told, heard: Sequence[Mapping[str, Any]], played: Sequence[Mapping[str, Any]],
           truth: FloatArray) -> Told:  # fmt: skip
    """Hold what was heard against what was played."""
    index_at = {round(one["stamp"], 6): one["index"] for one in played}
    for pose in heard:
        told.poses += 1
        told.oldest_s = max(told.oldest_s, pose["heard"] - pose["stamp"])
        told.stale += pose["heard"] - pose["stamp"] > told.max_age + _DELIVERED
        index = index_at.get(round(pose["stamp"], 6))
        if index is None:
            told.strange += 1
            continue
        here = np.array([[pose["x"], pose["y"], math.radians(pose["theta_deg"])]])
        metres, radians = pose_errors(here, Pose2D(*truth[index]))[0].tolist()
        told.worst_m = max(told.worst_m, metres)
        told.worst_deg = max(told.worst_deg, math.degrees(radians))
        told.wrong += metres > NEAR[0] or radians > NEAR[1]
    return told


def soonest(truth: FloatArray) -> list[int]:
    """The scans of the first half of a log after which the robot drives :data:`WAY` sooner."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))))
    half = len(truth) // 2
    scans = np.searchsorted(way, way[:half] + WAY) - np.arange(half)
    return [int(k) for k in np.argsort(scans, kind="stable")[: max(1, half // 2)]]


def kill_loop(
    map_path: Path, log_path: Path, start: Pose2D, n: int, seed: int, longest: float
) -> Told:
    """Kill node or player `n` times, at most `longest` seconds apart; the other one goes on.

    Three times of four a pose is waited for before, three times as long at most. When a player
    begins, the node is asked to begin anew, as a behaviour tree asks it.
    """
    log, rng, around = load_scans(log_path), random.Random(seed), environment()  # noqa: S311
    truth = true_poses(map_path, log, start)
    mount, firsts = log[0].mount, soonest(truth)
    sensor = f"{mount.x},{mount.y},{mount.theta}"
    told, asking = Told(kills={"node": 0, "player": 0}), list["subprocess.Popen[bytes]"]()
    with TemporaryDirectory() as folder:
        played, heard = Path(folder, "played"), Path(folder, "heard")

        def begin(who: str) -> "subprocess.Popen[bytes]":
            if who == "node":
                return spawned("imgloc", "node", "--sensor", sensor, environment=around)
            words = ("play", map_path, log_path, "--first", rng.choice(firsts), "--times", 99)
            asking.append(spawned("tools.robot", "ask", REINITIALIZE, environment=around))
            return spawned("tools.robot", *words, "--write", played, environment=around)

        listener = spawned("tools.robot", "listen", "--write", heard, environment=around)
        running = {who: begin(who) for who in ("node", "player")}
        with ending([listener]), ending(running.values()), ending(asking):
            for k in range(n):
                before, until = len(lines_of(heard)), time.monotonic() + 3 * longest
                while k % 4 and len(lines_of(heard)) == before and time.monotonic() < until:
                    time.sleep(0.1)
                time.sleep(rng.uniform(0.5, longest))
                who = rng.choice(("node", "player"))
                running[who].send_signal(signal.SIGKILL)
                running[who].wait()
                told.kills[who] += 1
                time.sleep(rng.uniform(0.0, 2.0))
                running[who] = begin(who)
            time.sleep(longest)
        return judged(told, lines_of(heard), lines_of(played), truth)
