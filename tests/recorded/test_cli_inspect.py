"""`imgloc inspect`: each disturbance of a table is named, and nothing of logs as they are."""

import functools
import itertools
import math
import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from command import MAPS, call, rows
from places import POSES, grid_of

import imgloc
from imgloc import LaserScan, Pose2D, ScanSet
from imgloc.answers.scanmotion import odd_laser
from imgloc.simulation.scans import simulate_ranges

LOGS = {
    "fr079": ("raw/fr079.log", "fr079/map.yaml"),
    "belgioioso": ("raw/belgioioso.log", "belgioioso/map.yaml"),
    "olin_mac": ("olin_mac/bags/macfirst_floor_take_2", "olin_mac/maps/mac_1st_floor_final.yaml"),
}


@functools.cache
def recorded(shared: Path, name: str) -> ScanSet:
    if name == "olin_mac":
        pytest.importorskip("rosbags", reason="reads bags: the extra ros")
    scans, _ = imgloc.load_scans(shared / "data" / LOGS[name][0]).with_odometry(name)
    scans = each(
        scans.take(range(min(len(scans), 300))),  # and each third ray: these are enough
        lambda s: replace(s, ranges=s.ranges[::3], angles=s.angles[::3]),
    )
    stamps = np.arange(len(scans)) * 0.5 if scans.stamps is None else scans.stamps
    return replace(scans, stamps=stamps)


def each(scans: ScanSet, change: Callable[[LaserScan], LaserScan], step: int = 1) -> ScanSet:
    return replace(
        scans, scans=tuple(change(s) if k % step == 0 else s for k, s in enumerate(scans.scans))
    )


def ranged(change: Callable[[LaserScan], Any], **more: float) -> Callable[[ScanSet], ScanSet]:
    return lambda scans: each(scans, lambda s: replace(s, ranges=change(s), **more))


def turned(angle: float, step: int = 1) -> Callable[[ScanSet], ScanSet]:
    return lambda scans: each(scans, lambda s: replace(s, angles=s.angles + angle), step)


def moved(change: Callable[[Any, Any], Any]) -> Callable[[ScanSet], ScanSet]:
    """Other odometry, of that and of the stamps."""
    return lambda scans: replace(scans, odom=change(scans.odom, scans.stamps))


def late(odom, stamps):
    by = 5 * float(np.median(np.diff(stamps)))
    heading = np.unwrap(odom[:, 2])
    columns = [np.interp(stamps - by, stamps, c) for c in (odom[:, 0], odom[:, 1], heading)]
    columns[2] = (columns[2] + math.pi) % math.tau - math.pi
    return np.stack(columns, axis=1)


def coded(code: float) -> Callable[[LaserScan], Any]:
    """A code for nothing seen in place of each tenth reading, and of those beyond it."""
    return lambda s: np.where(
        (np.arange(len(s.ranges)) % 10 == 3) | (s.ranges > code), code, s.ranges
    )


def jittering(scan: LaserScan) -> Any:
    """Three values side by side in place of each tenth reading."""
    code = np.array([51.05, 51.1, 51.15])[np.arange(len(scan.ranges)) % 3]
    return np.where(np.arange(len(scan.ranges)) % 10 == 3, code, np.minimum(scan.ranges, 40.0))


def stamped(change: Callable[[Any], None]) -> Callable[[ScanSet], ScanSet]:
    def made(scans: ScanSet) -> ScanSet:
        stamps = scans.stamps.copy()
        change(stamps)
        return replace(scans, stamps=stamps)

    return made


def swap(stamps) -> None:
    stamps[[100, 101]] = stamps[[101, 100]]


def longest_way(scans: ScanSet) -> ScanSet:
    """Without the scans of a part in which the robot goes far, the stamps being as they are."""
    far = np.hypot(*(scans.odom[:, :2] - scans.odom[40, :2]).T)
    end = next((k for k in range(50, len(scans)) if far[k] > 5.5), int(far.argmax()))
    return scans.take([*range(40), *range(end, len(scans))])


def jumped(odom, _):
    return odom + (np.arange(len(odom)) > 200)[:, None] * (4.0, 3.0, 0.0)


def some_unknown(odom, _):
    return np.where((np.arange(len(odom)) // 50 == 1)[:, None], np.nan, odom)


def repeated(scans: ScanSet) -> ScanSet:
    return replace(scans, scans=tuple(scans[k - k % 3] for k in range(len(scans))))


def body(scan: LaserScan) -> Any:
    at = np.arange(len(scan.ranges))
    return np.where(at < len(at) // 12, 0.3 + 0.001 * at / len(at), scan.ranges)


class Case(NamedTuple):
    change: Callable[[ScanSet], ScanSet]
    code: str
    on_map: bool = False


DISTURBED = {
    "millimetres": Case(ranged(lambda s: 1000 * s.ranges), "units"),
    "centimetres": Case(ranged(lambda s: 100 * s.ranges), "units"),
    "stamps in milliseconds": Case(lambda s: replace(s, stamps=1000 * s.stamps), "stamps"),
    "a code and no range_max": Case(ranged(coded(45.5), range_max=math.inf), "codes"),
    "a code below range_max": Case(ranged(coded(9.5)), "codes"),
    "a code that jitters": Case(
        lambda scans: each(scans, lambda s: replace(s, ranges=jittering(s), range_max=80.0)),
        "codes",
    ),
    "nothing seen is 0": Case(
        ranged(lambda s: np.where(np.arange(len(s.ranges)) % 20, 0.0, s.ranges)), "few"
    ),
    "most rays see nothing, which is 0": Case(
        ranged(lambda s: np.where(np.arange(len(s.ranges)) % 4, 0.0, s.ranges)), "too-close"
    ),
    "joined to itself": Case(lambda s: s.take([*range(len(s)), *range(len(s))]), "twice"),
    "range_max too small": Case(ranged(lambda s: s.ranges, range_max=0.4, range_min=0), "few"),
    "the robot in view": Case(ranged(body, range_min=0), "own-body"),
    "upside down": Case(lambda scans: each(scans, lambda s: s.flipped), "flipped"),
    "backwards": Case(turned(math.pi), "mounting"),
    "upside down and backwards": Case(
        lambda scans: turned(math.pi)(each(scans, lambda s: s.flipped)), "flipped"
    ),
    "backwards in millimetres": Case(
        lambda scans: each(turned(math.pi)(scans), lambda s: s.scaled(8)), "disagree"
    ),
    "to the left": Case(turned(-math.pi / 2), "mounting"),
    "a narrower view": Case(
        lambda scans: each(scans, lambda s: replace(s, angles=s.angles * 2 / 3)), "view"
    ),
    "two lasers": Case(turned(math.pi, 2), "two-lasers"),
    "old buffers": Case(repeated, "repeats"),
    "odometry of zeros": Case(moved(lambda odom, _: 0 * odom), "odometry-zero"),
    "odometry in millimetres": Case(
        moved(lambda odom, _: odom * (1000, 1000, 1)), "odometry-units"
    ),
    "odometry that turns the other way": Case(moved(lambda o, _: o * (1, 1, -1)), "odometry-turn"),
    "odometry of some scans": Case(moved(some_unknown), "odometry-part"),
    "odometry that lags": Case(moved(late), "lag"),
    "odometry that jumps": Case(moved(jumped), "jump"),
    "stamps swapped": Case(stamped(swap), "order"),
    "a gap": Case(longest_way, "gap"),
    "poses of another map": Case(lambda scans: replace(scans, poses=scans.odom + 7), "poses", True),
}


def codes(run) -> list[str]:
    assert run.code == 0, run.err
    return [finding["code"] for finding in rows(run.out)[-1]["findings"]]


@pytest.mark.parametrize(
    ("what", "name"), [*zip(DISTURBED, itertools.cycle(LOGS), strict=False)]
)  # of each log a third: they take turns
def test_each_disturbance_is_named(shared: Path, tmp_path: Path, what: str, name: str) -> None:
    case = DISTURBED[what]
    file = tmp_path / "log.npz"
    imgloc.save_scans(file, case.change(recorded(shared, name)))
    beside = [shared / "data" / LOGS[name][1]] if case.on_map else []
    found = codes(run := call("inspect", *beside, file, "--json", "--no-cache"))
    if case.code in ("lag", "odometry-turn"):  # then the scans alone tell the motion
        assert rows(run.out)[-1]["next"].endswith("--odom scans")
    assert {case.code} == set(found) & {case.code, "gap" if case.code == "odometry-part" else ""}


def test_lasers_with_names_are_looked_at_apart(shared: Path, tmp_path: Path) -> None:
    right = recorded(shared, next(iter(LOGS))).take(range(120))
    hanging, odd = turned(2.0, 2)(each(right, lambda s: s.flipped, 2)), ["two-lasers"]
    cases = (right, []), (turned(math.pi, 2)(right), odd), (hanging, odd)
    for scans, found in cases:
        named = tuple(replace(scan, laser="ab"[k % 2]) for k, scan in enumerate(scans.scans))
        imgloc.save_scans(tmp_path / "log.npz", replace(scans, scans=named), force=True)
        run = call("inspect", tmp_path / "log.npz", "--json", "--no-cache")
        assert codes(run) == found
        assert rows(run.out)[-1]["next"].startswith("imgloc track")
        assert ("upside down" in run.out) == (scans is hanging)
        assert ("--topic " in rows(run.out)[-1]["next"]) == bool(found)
    # Scans that agree with no other one say nothing of the place that they are from.
    rng = np.random.default_rng(1)
    odd = [
        replace(scan, ranges=rng.uniform(1, 8, len(scan.ranges))) if scan.laser == "b" else scan
        for scan in (replace(s, laser="ab"[k % 2]) for k, s in enumerate(right.scans))
    ]
    assert odd_laser(replace(right, scans=tuple(odd)), right.odom) is None


def text_of(scans: ScanSet, robot: bool = True) -> list[str]:
    """ROBOTLASER1 lines; without the robot's poses if those are not to be known."""
    lines = []
    for scan, odom, stamp in zip(scans.scans, scans.odom, scans.stamps, strict=True):
        mount = scan.T_base_laser or Pose2D(0.0, 0.0)
        at = imgloc.model.compose(Pose2D(*odom), mount)
        step = scan.angles[1] - scan.angles[0]
        ranges = " ".join(f"{r:.3f}" for r in np.nan_to_num(scan.ranges, posinf=99.0))
        pose = " ".join(f"{v:.4f}" for v in (odom if robot else 0 * odom))
        lines.append(
            f"ROBOTLASER1 0 {scan.angles[0]:.6f} 3 {step:.8f} {scan.range_max} 0.01 0 "
            f"{len(scan.ranges)} {ranges} 0 {at.x:.4f} {at.y:.4f} {at.theta:.5f} {pose} 0 0 0 0 0 "
            f"{stamp:.4f} host 0"
        )
    return lines


@pytest.mark.parametrize(("far", "found"), [(1, []), (5, ["codes"])])
def test_one_far_reading_is_no_code(tmp_path: Path, far: int, found: list[str]) -> None:
    ranges, angles = np.linspace(2.0, 4.0, 181), np.deg2rad(np.arange(-90, 91.0))
    ranges[10 : 10 + far] = 12.0
    file = tmp_path / "scan.npz"
    imgloc.save_scans(file, ScanSet((LaserScan(ranges, angles, range_max=30.0),)))
    assert codes(call("inspect", file, "--json")) == found


@pytest.mark.parametrize("name", LOGS)
def test_what_a_reader_forgives_is_named(shared: Path, tmp_path: Path, name: str) -> None:
    scans, file = recorded(shared, name), tmp_path / "run.log"
    file.write_text("\n".join(lines := text_of(scans)) + "\n")
    assert codes(call("inspect", file, "--json")) == []
    file.write_text("\n".join([*lines[:7], lines[7][:99], *lines[8:]]) + "\n")
    assert codes(call("inspect", file, "--json")) == ["broken"]
    file.write_text("\n".join([*lines, lines[0][:200]]))
    assert codes(call("inspect", file, "--json")) == ["cut"]
    file.write_text("\n".join(text_of(scans, robot=False)) + "\n")
    run = call("inspect", file, "--json")
    assert codes(run) == ["odometry-zero"]
    assert not run.err


@pytest.mark.parametrize("name", ["fr079", "belgioioso"])
def test_the_map_tells_a_mirrored_image(shared: Path, tmp_path: Path, name: str) -> None:
    grid = imgloc.load_map(shared / "data" / LOGS[name][1], free_thresh=0.196)
    mirrored = imgloc.OccupancyGrid(grid.occupied[::-1], grid.free[::-1], grid.resolution)
    imgloc.save_map(tmp_path / "map.yaml", mirrored)
    imgloc.save_scans(tmp_path / "log.npz", recorded(shared, name))
    found = codes(call("inspect", tmp_path / "map.yaml", tmp_path / "log.npz", "--json"))
    assert found == ["mirrored"]


def test_a_scale_that_scans_share_is_the_map_s_where_they_fit_with_it(shared, tmp_path) -> None:
    data, few = shared / "data", tmp_path / "few.npz"
    scans = imgloc.load_scans(data / "jarvis_inesc" / "complex.npz")
    imgloc.save_scans(few, scans.take(range(0, len(scans), 36)))
    run = call("inspect", data / "jarvis_inesc" / "map.yaml", few, "--resolution", 0.0106)
    assert "the cells of the map are of 0.01 m. Try --resolution 0.01\n" in run.out
    foreign = data / "guardian_crob" / "lab_slam.yaml", data / "wean" / "scans.npz"
    assert "multiplied by" not in call("inspect", *foreign).out


def test_a_map_that_explains_two_lasers_of_three_is_not_mirrored(shared, tmp_path) -> None:
    scans, place = recorded(shared, "fr079"), shared / "data" / "fr079" / "map.yaml"
    named = [replace(scan, laser="abc"[k % 3]) for k, scan in enumerate(scans.scans)]
    named = [scan.flipped if scan.laser == "c" else scan for scan in named]
    imgloc.save_scans(tmp_path / "log.npz", replace(scans, scans=tuple(named), odom=None))
    run = call("inspect", place, tmp_path / "log.npz", "--json")
    assert codes(run) == ["two-lasers"]
    assert rows(run.out)[-1]["findings"][0]["options"] == "--topic 0,1"


UNDISTURBED = {
    "fr079/scans.npz": [], "belgioioso/scans.npz": [], "gh25/scans.npz": ["gap"],
    "malaga_campus/scans.npz": ["gap"], "factory_changed/scans.npz": [], "wean/scans.npz": ["gap"],
    "raw/fr079.log": [], "raw/duke_loop5.dpslam.log": ["disagree"], "olin_pen/left_side.bag": [],
    "olin_mac/bags/macfirst_floor_take_2": [], "guardian_crob/guardian_controller_2.npz": [],
    "jarvis_inesc/circular.npz": [],
}  # fmt: skip


ON_THEIR_MAP = {f"{name}/scans.npz" for name in ("fr079", "belgioioso", "factory_changed", "gh25")}


@pytest.mark.parametrize("name", UNDISTURBED)
def test_only_what_is_there_is_found_in_a_log_as_it_was_recorded(shared: Path, name: str) -> None:
    folder = shared / "data" / name.split("/")[0]
    maps = [folder / "map.yaml"] if name in ON_THEIR_MAP else []
    found = codes(call("inspect", *maps, shared / "data" / name, "--json"))
    assert found == UNDISTURBED[name]


@pytest.mark.parametrize("what", ["", "upside down", "backwards"])
def test_the_command_to_go_on_with_works(shared: Path, tmp_path: Path, what: str) -> None:
    scans, place = recorded(shared, "fr079"), shared / "data" / "fr079" / "map.yaml"
    file = tmp_path / "a log.npz"
    few = DISTURBED[what].change(scans) if what else scans
    imgloc.save_scans(file, few.take(range(80, 120)))
    run = call("inspect", place, file).ends(0)
    words = shlex.split(run.out.splitlines()[-1].split(None, 1)[1])
    assert words[0] == "imgloc"
    done = call(*words[1:]).ends(0)
    verdicts = done.out.count("unique")
    assert verdicts >= (25 if words[1] == "track" else 1)


def test_track_says_the_same_where_it_matters(shared: Path, tmp_path: Path) -> None:
    scans, place = recorded(shared, "fr079"), shared / "data" / "fr079" / "map.yaml"
    file, some = tmp_path / "log.npz", DISTURBED["odometry that turns the other way"].change(scans)
    imgloc.save_scans(file, some.take(range(80, 110)))
    run = call("track", place, file).ends(0)
    assert "with theta of the odometry negated" in run.err


TYPED = (  # with a scan upside down or not; what excludes one another is in the other line
    (False, "--topic FLASER --fov-deg 180 --range-scale 1.001 --max-bad 0.02 --range-max 20 "
     "--sensor 0.1,0,0.1 --resolution 0.1 --origin 1,2,0 --mode scale --occupied-thresh 0.6 "
     "--free-thresh 0.2 --no-negate --no-cache --memory-budget 2G"),
    (True, "--straighten forward --flipped --semantics ros1 --allow-lossy --cache {folder} "
     "--height=-1,1 --odom scans"),
    (False, "--negate"),
)  # fmt: skip


@pytest.mark.parametrize(("reverse", "typed"), TYPED)
def test_the_command_to_go_on_with_has_what_was_typed(tmp_path, reverse, typed):
    angles = np.deg2rad(np.arange(-90, 90.0))
    ranges = simulate_ranges(grid_of("curved"), [POSES["curved"]], angles, range_max=20.0)[0]
    said = " ".join(f"{r:.3f}" for r in (ranges[::-1] if reverse else ranges))
    lines = [f"FLASER 180 {said} 0 0 0 0 0 0 {k}.5 host {k}.5" for k in (1, 2)]
    file = tmp_path / "a.log"
    file.write_text("\n".join(lines) + "\n")
    typed = typed.format(folder=tmp_path)
    run = call("inspect", MAPS / "curved.yaml", file, *typed.split()).ends(0)
    commands = [s.split(None, 1)[1] for s in run.out.splitlines() if s.startswith("  next ")]
    for command in commands:
        call(*shlex.split(command)[1:]).ends(0)
    of_map, of_log = (command.replace("=", " ") for command in commands)
    for one in re.split(r" (?=--)", typed.replace("=", " ")):
        flag = one.split()[0]
        name = flag[2:].replace("-", "_").removeprefix("no_")
        of_maps = name in imgloc.options.Reading.__annotations__
        assert one in of_log
        assert (one in of_map) == (of_maps or flag == "--memory-budget"), one


def test_each_option_of_inspect_is_tried() -> None:
    (text,) = [call("inspect", "--help").out]
    own = {"--json", "--picture", "--force", "--help"}
    named = set(re.findall(r"--[a-z][a-z-]+", text.split("Options:")[1].split("Examples:")[0]))
    there = {
        word for word in named if re.search(rf"^ +(-\S, )?({word}|--\S+ / {word})\b", text, re.M)
    }
    assert there - own <= {word.split("=")[0] for _, typed in TYPED for word in typed.split()}
