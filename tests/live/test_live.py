"""One live core: maps held ready, one scan at a time, what is dropped is said."""

import contextlib
import gc
import math
import subprocess
import sys
import threading
import time
import weakref
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from dataclasses import replace

import numpy as np
import pytest
from command import MAPS
from places import drive, hall

import imgloc
from imgloc import (
    Dropped,
    Known,
    LaserScan,
    Limits,
    Localizer,
    MapFeatures,
    OccupancyGrid,
    Options,
    Pose2D,
    ScanSet,
    Site,
    Tracking,
)
from imgloc.errors import ConfigError, MapError, ScanError
from imgloc.io.calibration import calibration_path, load_calibrations, save_calibrations
from imgloc.live.line import Key, Line
from imgloc.model import to_json
from imgloc.options import Calibration, Shared
from imgloc.output.rows import answer_row, moment_row
from imgloc.search.priors import prior_of

NAMES = ("curved", "corridor", "visibility")
N = 10


@pytest.fixture(scope="module")
def scans() -> list[LaserScan]:
    grid = imgloc.load_map(MAPS / "curved.yaml")
    made = imgloc.simulate(grid, 6, seed=1)
    return [replace(scan, stamp=float(k)) for k, scan in enumerate(made.scans)]


@pytest.fixture(scope="module")
def core() -> Iterator[Localizer]:
    made = {n: (lambda n=n: imgloc.load_map(MAPS / f"{n}.yaml")) for n in NAMES}
    with Localizer(made, background=True) as core:
        assert core.wait(60)
        yield core


@pytest.fixture(scope="module")
def log() -> ScanSet:
    """Ten scans along a corridor of `visibility`, half a metre apart, with odometry."""
    poses = np.array([[4.0 + 0.5 * k, 7.0, 0.02 * k] for k in range(N)])
    return drive(poses)


def room() -> OccupancyGrid:
    return hall(40, 60, np.s_[2:20, 30:34])


def whole(row: dict[str, object]) -> str:
    """A row, but for its times."""
    return to_json({**row, "timings_ms": None})


class Gate:
    """Work in a line that waits until it is let go."""

    def __init__(self, core: Localizer) -> None:
        self.entered, self.go = threading.Event(), threading.Event()
        self.work = core._line.put(Key("gate", self), self._wait)
        assert self.entered.wait(60)

    def _wait(self, _: float) -> None:
        self.entered.set()
        assert self.go.wait(30)


@contextlib.contextmanager
def held(core: Localizer) -> Iterator[None]:
    """Nothing is looked at meanwhile: scans wait."""
    gate = Gate(core)
    try:
        yield
    finally:
        gate.go.set()
        gate.work.result(10)


def why_of(future: "Future[object]") -> str:
    with pytest.raises(Dropped) as caught:
        future.result(10)
    return caught.value.why


# What is answered.


def test_an_answer_is_that_of_localize_and_says_whose_it_is(core, scans):
    features = imgloc.prepare(imgloc.load_map(MAPS / "curved.yaml"))
    for scan in scans[:3]:
        answer = core.localize(scan, "curved")
        alone = imgloc.localize(features, scan)
        assert whole(answer_row(answer.value, scan)) == whole(answer_row(alone, scan))
        assert (answer.map, answer.stamp) == ("curved", scan.stamp)
        assert answer.about()["stamp"] == scan.stamp
        assert answer.took_ms > 0
        assert answer.waited_ms >= 0


def test_update_is_follow(core: Localizer, log: ScanSet) -> None:
    features = imgloc.prepare(imgloc.load_map(MAPS / "visibility.yaml"))
    filter_ = imgloc.make_filter("tracker", features, Options())
    alone = [moment_row(m) for m in imgloc.follow(features, log, filter_)]
    core.reset("visibility")
    for _ in range(2):  # also after a reset
        live = [core.update(s, o) for s, o in zip(log.scans, log.odom, strict=True)]
        assert [moment_row(answer.value) for answer in live] == alone
        assert [answer.stamp for answer in live] == [scan.stamp for scan in log.scans]
        core.reset()
    assert alone[-1]["verdict"] == "unique"


def test_what_is_known_and_what_was_calibrated_counts(scans, tmp_path):
    grid = imgloc.load_map(MAPS / "curved.yaml")
    imgloc.save_map(tmp_path / "a.yaml", grid)
    path = calibration_path(tmp_path / "a.yaml")
    fitted, shared = {"ght": Calibration(0.3, 0.3, 0.2)}, Shared(1.01, 0)
    save_calibrations(path, grid, fitted, {}, shared=shared)
    site = Site(imgloc.prepare(grid), *load_calibrations(path, grid))
    known = Known(heading=(0.5, 0.2))
    expected = replace(Options(prior=prior_of(known, grid)), shared=shared)
    with Localizer(site) as core:
        answer = core.localize(scans[0], known=known).value
        assert whole(answer.as_row()) == whole(
            imgloc.localize(site.features, scans[0], expected).as_row()
        )
        assert answer.parameters["shared"] == vars(Shared(1.01))
        votes = core.localize(scans[0], options=Options("ght")).value
        assert votes.parameters["calibration"]["temperature"] == 0.2
        own = core.localize(scans[0], options=Options(shared=Shared(0.98))).value
        assert own.parameters["shared"]["scale"] == 0.98


def test_ages_are_by_the_clock_that_is_given(scans: list[LaserScan]) -> None:
    with Localizer(room(), clock=lambda: 7.5) as core:
        assert core.localize(scans[2]).age == 5.5
        assert core.update(scans[2], np.zeros(3)).age == 5.5
        silent = core.localize(replace(scans[0], stamp=math.nan))
        assert math.isnan(silent.age)
        assert silent.about()["age"] is None


# Maps.


def made_lazily(features: MapFeatures) -> dict[int, set[str]]:
    """Names of what a map holds, and of what it holds with thinner walls."""
    return {0: set(vars(features))} | {
        cells: set(vars(there)) for cells, there in vars(features).get("_thinner", {}).items()
    }


@pytest.mark.parametrize("tracking", [Tracking(), Tracking("grid")])
def test_nothing_is_made_of_a_map_after_it_is_ready(scans, tracking):
    features = imgloc.prepare(imgloc.load_map(MAPS / "curved.yaml"))
    with Localizer(features, tracking=tracking) as core:
        assert core.ready
        before = made_lazily(features)
        rng = np.random.default_rng(1)
        strange = [replace(s, ranges=s.ranges * 1.06) for s in scans[:2]]
        strange += [replace(s, ranges=rng.uniform(1, 9, len(s.ranges))) for s in scans[:2]]
        strange += [replace(s, ranges=s.ranges + 0.15) for s in scans[:2]]
        for k, scan in enumerate(scans[:2] + strange):
            core.localize(scan)
            core.update(replace(scan, stamp=math.nan), np.array([0.6 * k, 0, 0]))
        core.which(scans[0])
        assert made_lazily(features) == before


def test_ready_is_said_once_every_map_is(core: Localizer) -> None:
    go = threading.Event()

    def late() -> OccupancyGrid:
        assert go.wait(30)
        return room()

    with Localizer({"early": room(), "late": late}, background=True) as core:
        assert core.site("early").features.grid.resolution == 0.1
        assert (core.ready, core.state("late"), core.errors) == (False, "preparing", {})
        assert not core.wait(0.01)
        scan = LaserScan([1.0, 2.0], [0.0, 1.0], range_max=9.0)
        assert core.localize(scan, "early").value.verdict == "invalid"  # it does not wait
        for ask in (core.localize_soon, core.which_soon):
            with pytest.raises(Dropped, match="still being prepared"):
                ask(scan, "late") if ask == core.localize_soon else ask(scan)
        with pytest.raises(Dropped) as caught:
            core.localize(scan, "late", timeout=0.05)
        assert caught.value.why == "late"
        answers = list[object]()
        asking = threading.Thread(target=lambda: answers.append(core.localize(scan, "late")))
        asking.start()
        go.set()
        assert core.wait(30)
        asking.join(30)
        assert len(answers) == 1
        assert core.ready


def test_a_map_that_fails_says_why_each_time() -> None:
    nothing = OccupancyGrid(np.zeros((9, 9), bool), np.ones((9, 9), bool), 0.1)
    scan = LaserScan([1.0, 2.0], [0.0, 1.0], range_max=9.0)
    with pytest.raises(MapError, match="none of its 81 cells is occupied"):
        Localizer(nothing)

    def missing() -> OccupancyGrid:
        return imgloc.load_map("nowhere.yaml")

    with Localizer({"a": room(), "b": missing, "c": nothing}, background=True) as core:
        assert not core.wait(30)
        assert not core.ready
        assert {name: core.state(name) for name in core.names} == {
            "a": "ready", "b": "failed", "c": "failed",
        }  # fmt: skip
        assert "nowhere.yaml" in str(core.errors["b"])
        depth = []
        for _ in range(3):
            with pytest.raises(MapError, match=r"nowhere\.yaml") as caught:
                core.localize(scan, "b")
            depth.append(len(caught.traceback))
        assert len(set(depth)) == 1  # nothing grows
        with pytest.raises(MapError):
            core.which(scan)
        with pytest.raises(MapError):
            core.put("a", nothing, background=False)
        assert core.state("a") == "ready"
        core.drop("b")
        core.put("c", room(), background=False)
        assert core.ready
        assert core.names == ("a", "c")


def test_a_prepared_map_is_shown_and_what_fails_there_fails_the_map() -> None:
    seen = []
    with Localizer(room(), prepared=lambda name, site: seen.append((name, site))) as core:
        assert seen == [("map", core.site())]

    def refuse(*_: object) -> None:
        raise ValueError("no room")

    with Localizer(room, prepared=refuse, background=True) as core:
        assert not core.wait(30)
        assert "no room" in str(core.errors["map"])


def test_the_name_of_a_map_is_needed_among_several(core: Localizer) -> None:
    scan = LaserScan([1.0, 2.0], [0.0, 1.0], range_max=9.0)
    with pytest.raises(ConfigError, match="`map`: got no name, expected curved, corridor"):
        core.localize(scan)
    with pytest.raises(ConfigError, match="`map`: got 'attic', expected curved"):
        core.localize(scan, "attic")
    with pytest.raises(ConfigError, match="there is none"):
        Localizer({}).localize(scan)
    with pytest.raises(TypeError, match="scan must be LaserScan"):
        core.localize([1.0], "curved")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="`near` belongs to one map"):
        core.which(scan, known=Known(near=(1, 1, 0, 1, 1)))


def test_a_map_that_is_replaced_starts_its_robots_anew(log: ScanSet) -> None:
    with Localizer({"a": room(), "b": room()}) as core:
        here, there = core.robot("a"), core.robot("b")
        for robot in (here, there):
            robot.update(log[0], np.zeros(3))
        eras = here.era, there.era
        old = core.localize(log[0], "a").era
        core.put("a", imgloc.load_map(MAPS / "visibility.yaml"), background=False)
        assert (here.era > eras[0], there.era) == (True, eras[1])
        assert here.update(log[0], np.zeros(3)).value.index == 0
        assert there.update(log[1], np.zeros(3)).value.index == 1
        assert core.localize(log[0], "a").era > old


# Who waits.


def test_a_newer_scan_replaces_the_one_that_waits(core: Localizer, scans: list[LaserScan]) -> None:
    before = core.dropped
    with held(core):
        asked = [core.localize_soon(scan, "curved", source="a") for scan in scans]
        other = core.localize_soon(scans[0], "curved", source="b")
        choice = core.which_soon(scans[0], source="a")
        assert core.waiting == 3
        assert core.busy
    assert [why_of(future) for future in asked[:-1]] == ["replaced"] * (len(scans) - 1)
    last = asked[-1].result(30)
    assert (last.stamp, last.dropped) == (scans[-1].stamp, len(scans) - 1)
    assert last.waited_ms > 0
    assert (other.result(30).dropped, choice.result(30).dropped) == (0, 0)
    assert core.dropped - before == len(scans) - 1
    assert core.waiting == 0


def test_lasers_of_one_robot_wait_beside_each_other_in_the_order_of_time(log: ScanSet) -> None:
    order = []
    with Localizer(room()) as core:
        with held(core):
            asked = [
                core.update_soon(replace(log[0], stamp=stamp), np.zeros(3), source=source)
                for stamp, source in ((1.0, "front"), (1.5, "rear"), (2.0, "front"))
            ]
            for future in asked[1:]:
                future.add_done_callback(lambda done: order.append(done.result().stamp))
        assert why_of(asked[0]) == "replaced"
        assert [future.result(30).stamp for future in asked[1:]] == [1.5, 2.0]
        assert order == [1.5, 2.0]
        late = replace(log[0], stamp=1.9, laser="front")
        assert why_of(core.update_soon(late, np.zeros(3))) == "old"
        rear = replace(late, laser="rear")  # a little out of order is none of its faults
        assert core.update(rear, np.zeros(3)).value.index == 2


def test_lasers_of_one_robot_take_turns(log: ScanSet) -> None:
    """Whoever looked last waits, though its scan be older: none is heard alone."""
    order = list[str]()
    with Localizer(room()) as core:
        for k in range(6):
            with held(core):
                asked = {
                    name: core.update_soon(replace(log[0], stamp=k + late, laser=name), np.zeros(3))
                    for name, late in (("front", 0.0), ("rear", 0.08))
                }
                for name, future in asked.items():
                    future.add_done_callback(lambda _, name=name: order.append(name))
            for future in asked.values():
                future.result(30)
    assert order == ["front", "rear"] * 6


def test_one_stamp_ahead_of_the_clock_does_not_make_the_scans_after_it_old(log: ScanSet) -> None:
    def at(stamp: float) -> LaserScan:
        return replace(log[0], stamp=stamp)

    with Localizer(room(), clock=lambda: 10.0) as core:
        assert why_of(core.update_soon(at(3600.0), np.zeros(3))) == "ahead"
        stamps = [9.0, 9.1, 3600.0, 9.2, 11.5, 9.3, 11.6, 11.7, 11.8]
        taken = list[float]()
        for stamp in stamps:
            with contextlib.suppress(Dropped):
                taken.append(core.update(at(stamp), np.zeros(3)).stamp)
    # Two in a row are a sensor whose clock is ahead.
    assert taken == [9.0, 9.1, 9.2, 9.3, 11.7, 11.8]


def test_what_is_cancelled_or_late_leaves_the_line(core: Localizer, scans: list[LaserScan]) -> None:
    before = core.dropped
    with held(core):
        asked = core.localize_soon(scans[0], "curved", source=object())
        assert asked.cancel()
        assert core.waiting == 0
        with pytest.raises(CancelledError):
            asked.result()
        with pytest.raises(Dropped) as caught:
            core.localize(scans[0], "curved", source=object(), timeout=0.05)
        assert caught.value.why == "late"
        assert core.waiting == 0
    assert core.dropped - before == 2
    assert not core._line.counts.keys() & {Key("localize", None)}


def test_threads_get_their_own_answers_and_every_scan_is_answered_or_dropped() -> None:
    grid = room()
    features = imgloc.prepare(grid)
    made = [
        replace(s, stamp=float(k)) for k, s in enumerate(imgloc.simulate(grid, 4, seed=3).scans)
    ]
    alone = [whole(imgloc.localize(features, scan).as_row()) for scan in made]
    told, wrong = Counter[str](), list[object]()

    def hammer(core: Localizer, seed: int, source: object) -> None:
        rng = np.random.default_rng(seed)
        for k in rng.integers(len(made), size=8):
            try:
                answer = core.localize(made[k], source=source)
            except Dropped as error:
                told[error.why] += 1
                continue
            told["answered"] += 1
            if answer.stamp != k or whole(answer.value.as_row()) != alone[k]:
                wrong.append((k, answer))

    with Localizer(features) as core:
        sources = ["one", "one", "one", "two", "two", object(), object(), object()]
        work = [threading.Thread(target=hammer, args=(core, n, s)) for n, s in enumerate(sources)]
        for thread in work:
            thread.start()
        for thread in work:
            thread.join(120)
        assert not wrong
        assert sum(told.values()) == 8 * len(sources)
        assert told["answered"] + told["replaced"] == 8 * len(sources)
        assert told["answered"] >= 3 * 8  # those of their own source are never replaced
        assert core.dropped == told["replaced"]
        assert (core.waiting, core.busy) == (0, False)


def test_closing_drops_what_waits_and_refuses_the_rest(scans: list[LaserScan]) -> None:
    core = Localizer(room())
    with held(core):
        asked = core.localize_soon(scans[0])
        core.close()
    assert why_of(asked) == "closed"
    assert not core.ready
    for ask in (
        lambda: core.localize(scans[0]),
        lambda: core.update(scans[0], np.zeros(3)),
        lambda: core.put("b", room()),
    ):
        with pytest.raises(Dropped, match="closed"):
            ask()


# Robots.


def test_a_reset_drops_what_is_looked_at_and_waits_for_nothing(log, monkeypatch):
    """The step of an old belief goes on, but changes nothing and answers nobody."""
    entered, go = threading.Event(), threading.Event()
    step = imgloc.filters.follow.Follower.step

    def slow(self: object, *args: object) -> object:
        entered.set()
        assert go.wait(30)
        return step(self, *args)

    with Localizer(imgloc.load_map(MAPS / "visibility.yaml")) as core:
        core.update(log[0], np.zeros(3))
        with monkeypatch.context() as patch:
            patch.setattr("imgloc.filters.follow.Follower.step", slow)
            running = core.update_soon(log[1], np.zeros(3))
            assert entered.wait(60)
            waiting = core.update_soon(log[2], np.zeros(3))
            core.reset()
            assert why_of(waiting) == "reset"
            assert not running.done()
            go.set()
        assert why_of(running) == "reset"
        answer = core.update(log[0], np.zeros(3))  # time may start anew
        assert (answer.value.index, answer.value.metres, answer.era) == (0, 0.0, 1)
        assert answer.dropped == core.dropped == 2


def test_a_robot_that_is_told_where_it_is_is_there(log: ScanSet) -> None:
    with Localizer(imgloc.load_map(MAPS / "visibility.yaml")) as core:
        core.update(log[5], np.zeros(3))
        core.start_at(Pose2D(*log.poses[0]))
        told = [core.update(s, o).value for s, o in zip(log.scans, log.odom, strict=True)]
        assert told[0].index == 0
        assert told[3].belief.verdict == "unique"
        assert np.hypot(told[3].pose.x - log.poses[3, 0], told[3].pose.y - 7.0) < 0.2
        with pytest.raises(ConfigError, match="is outside of the map"):
            core.start_at(Pose2D(900, 0, 0))
        assert core.update(log[-1], log.odom[-1]).value.index == N  # nothing was forgotten


def test_robots_do_not_know_of_each_other(log: ScanSet) -> None:
    strict = Tracking(limits=Limits(0.001, 0.0001))
    with Localizer(imgloc.load_map(MAPS / "visibility.yaml")) as core:
        one, other = core.robot(), core.robot(tracking=strict)
        last = None
        for scan, odom in zip(log.scans, log.odom, strict=True):
            a, b = one.update_soon(scan, odom), other.update_soon(scan, odom)
            last = a.result(30), b.result(30)
        assert last[0].value.belief.verdict == "unique"
        assert last[1].value.withheld == "wide"
        assert last[1].value.best == last[0].value.best
        one.end()
        other.end()


def test_odometry_out_of_reason_changes_nothing(log: ScanSet) -> None:
    with Localizer(room()) as core:
        core.update(log[0], np.zeros(3))
        with pytest.raises(ScanError, match="damaged"):
            core.update(log[1], np.array([1e9, 0, 0]))
        assert core.update(log[2], np.zeros(3)).value.index == 1


# The line itself.


def test_a_line_serves_in_order_and_an_error_is_of_who_asked() -> None:
    line, order = Line(), list[int]()

    def number(k: int) -> Callable[[float], int]:
        def work(_: float) -> int:
            order.append(k)
            if k == 2:
                raise ValueError("two")
            return k

        return work

    gate = threading.Event()
    line.put(Key("gate", None), lambda _: gate.wait(30))
    asked = [line.put(Key("a", k), number(k), stamp=-k) for k in range(2)]
    asked += [line.put(Key("b", 2), number(2)), line.put(Key("a", 3), number(3), stamp=-3.0)]
    time.sleep(0.01)
    gate.set()
    assert [asked[k].result(10) for k in (0, 1, 3)] == [0, 1, 3]
    with pytest.raises(ValueError, match="two"):
        asked[2].result(10)
    assert order == [3, 1, 0, 2]
    line.close()
    with pytest.raises(Dropped):
        line.put(Key("a", 1), number(1))


def test_an_answer_is_gone_once_nobody_has_it(core: Localizer, scans: list[LaserScan]) -> None:
    gc.collect()
    gc.disable()  # what goes round in circles would wait for it, and a service would grow
    try:
        held = [weakref.ref(core.localize(scan, "curved", source=object())) for scan in scans]
        core.which(scans[0])  # the thread has gone on to another piece of work
        assert [one() for one in held] == [None] * len(scans)
    finally:
        gc.enable()


_LEAVES = """
import subprocess
import sys
import threading, cv2, numpy as np
from imgloc.live.localizer import Localizer
begun = threading.Event()
def made():
    begun.set()
    for _ in range(40):
        cv2.GaussianBlur(np.zeros((1500, 1500), np.float32), (31, 31), 5)
    raise OSError("no map")
core = Localizer(made, background=True)
begun.wait()
{closes}
"""


@pytest.mark.parametrize("closes", ["", "core.close(wait=True)"])
def test_a_process_ends_though_a_map_is_under_way_inside_opencv(closes) -> None:
    words = [sys.executable, "-c", _LEAVES.format(closes=closes)]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
