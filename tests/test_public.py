"""What scripts and notebooks import: each name is there, documented, hidden by no module."""

import inspect
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from command import MAPS, ROOT, spawn

import imgloc
from imgloc import LaserScan, Options, Pose2D

FUNCTIONS = {
    "check_map", "draw", "evaluate", "explain", "likelihood", "load_map", "load_plan", "load_scans",
    "localize", "plan_to_map", "prepare", "run_batch", "sample_poses", "save_map", "save_scans",
    "simulate", "which",
}  # fmt: skip


def test_every_name_is_there_and_documented():
    assert len(set(imgloc.__all__)) == len(imgloc.__all__)
    assert set(imgloc.__all__) >= FUNCTIONS
    for name in imgloc.__all__:
        value = getattr(imgloc, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert value.__doc__, name
    assert set(imgloc.__all__) <= set(dir(imgloc))
    with pytest.raises(AttributeError, match=r"attribute '?nothing"):
        imgloc.nothing  # noqa: B018


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_functions_say_what_they_take_and_raise_and_show_an_example(name):
    function = getattr(imgloc, name)
    text = inspect.getdoc(function)
    module = inspect.getdoc(inspect.getmodule(function)) or ""
    assert "Parameters" in text, name
    assert ">>>" in text or ">>>" in module, name


def test_no_module_hides_a_function_of_its_name():
    # Whatever has been imported before, in a process of its own.
    code = (
        "import pkgutil, importlib, imgloc\n"
        "for m in pkgutil.walk_packages(imgloc.__path__, 'imgloc.'):\n"
        "    if not m.name.endswith('__main__'): importlib.import_module(m.name)\n"
        f"assert all(callable(getattr(imgloc, n)) for n in {sorted(FUNCTIONS)!r})\n"
    )
    spawn(code=code).ends(0)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """The bundled map `curved` as map.yaml, and scans of it."""
    folder = tmp_path_factory.mktemp("script")
    grid = imgloc.load_map(MAPS / "curved.yaml")
    imgloc.save_map(folder / "map.yaml", grid)
    scans = imgloc.simulate(grid, 2, seed=1)
    imgloc.save_scans(folder / "scans.npz", scans)
    return folder, scans


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda f, scan: imgloc.localize(f.grid, scan), r"features must be MapFeatures, .*prepare"),
        (
            lambda _, scan: imgloc.localize("map.png", scan),
            "features must be MapFeatures, got str",
        ),
        (lambda f, scan: imgloc.localize(f, scan, "ght-v"), "options must be Options, got str 'gh"),
        (lambda f, _: imgloc.localize(f, f.grid), "scan must be LaserScan, got OccupancyGrid"),
        (lambda *_: imgloc.prepare("map.png"), r"grid must be OccupancyGrid, got str .*load_map"),
        (lambda f, scan: imgloc.likelihood(f.grid, scan, "cbml"), "features must be MapFeatures"),
        (lambda f, scan: imgloc.explain(f, scan, "unique"), "answer must be Localization"),
        (lambda f, scan: imgloc.explain(f.grid, scan, None), "features must be MapFeatures"),
        (lambda f, scan: imgloc.evaluate(f, [scan], Options()), "scans must be ScanSet, got list"),
        (lambda f, _: imgloc.simulate(f, 1, seed=0), "grid must be OccupancyGrid"),
        (lambda f, scan: imgloc.which([f], scan), r"maps must be Mapping, .*\{name: prepare"),
        (lambda f, _: imgloc.sample_poses(f, "scan.csv", 1, None), "scan must be LaserScan"),
        (lambda f, scan: next(imgloc.follow(f, scan, None)), "scans must be ScanSet"),
        (lambda *_: imgloc.plan_to_map("plan.png", 0.02), "grey must be ndarray, got str"),
    ],
)
def test_arguments_of_another_kind_are_named(call, says):
    wall = np.pad(np.zeros((8, 9), bool), 1, constant_values=True)
    features = imgloc.prepare(imgloc.OccupancyGrid(wall, ~wall, 0.1))
    with pytest.raises(TypeError, match=says):
        call(features, LaserScan([0.4, 0.5], [0.0, 1.0], range_max=9.0))


def test_the_robot_stands_where_its_sensor_is_not():
    mount = Pose2D(0.5, 0.0, np.pi / 2)
    there = imgloc.Hypothesis(Pose2D(2.0, 1.0, np.pi / 2), 0.0, 1.0, np.eye(3))
    answer = imgloc.Localization((there,), "unique", 0.0, 1.0, T_base_laser=mount)
    assert answer.base_pose.x == pytest.approx(1.5)
    assert answer.base_pose.y == pytest.approx(1.0)
    assert answer.base_pose.theta == pytest.approx(0.0)
    row = json.loads(answer.to_json())
    assert row["base_pose"]["x"] == pytest.approx(1.5)
    assert row["hypotheses"][0]["base"]["x"] == pytest.approx(1.5)
    lost = imgloc.Localization((), "no-match", 0.0, float("nan"))
    assert lost.base_pose is None
    assert json.loads(lost.to_json())["explained"] is None
    assert "<tr>" in lost._repr_html_()
    assert LaserScan([1.0], [0.0]).T_base_laser is None


def test_a_bundled_map_has_a_name_in_python_too() -> None:
    assert imgloc.load_map("large").info == imgloc.load_map(MAPS / "large.yaml").info
    with pytest.raises(imgloc.MapError, match="huge: no such file"):
        imgloc.load_map("huge")


# --- arguments that do not belong together


@pytest.fixture(scope="module")
def curved():
    """The features of the bundled map, and two scans in it."""
    features = imgloc.prepare(imgloc.load_map(MAPS / "curved.yaml"))
    return features, imgloc.simulate(features.grid, 2, seed=1)


def test_the_same_work_gives_equal_answers(curved):
    features, scans = curved
    one, same, other = (imgloc.localize(features, scans[k]) for k in (0, 0, 1))
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    assert one.timings_ms != same.timings_ms
    assert imgloc.explain(features, scans[0], one) == imgloc.explain(features, scans[0], same)
    assert scans == imgloc.simulate(features.grid, 2, seed=1)


def test_the_answer_of_another_scan_is_not_explained(curved):
    features, scans = curved
    answer = imgloc.localize(features, scans[0])
    assert imgloc.explain(features, scans[0], answer).fits
    with pytest.raises(imgloc.ConfigError, match="answer: got that of another scan"):
        imgloc.explain(features, scans[1], answer)


@pytest.mark.parametrize(
    ("call", "error", "said"),
    [
        (lambda f, s: imgloc.map_changes(f.grid, [s[0]], [[np.nan, 0, 0]]), imgloc.ConfigError,
         r"poses\[0\]: got \[nan, 0.0, 0.0\], expected metres and radians"),
        (lambda f, s: imgloc.localize(f, s[0], Options(prior=imgloc.Prior(np.ones((3, 3))))),
         imgloc.ConfigError, r"the prior has cells of shape \(3, 3\), expected that of the map"),
        (lambda f, s: imgloc.save_scans("scans.npz", [s[0]]), TypeError,
         r"scans must be ScanSet, got list .*ScanSet\(\[scan\]\) makes one"),
    ],
    ids=["changes", "prior", "scans"],
)  # fmt: skip
def test_arguments_that_cannot_be_are_refused(curved, call, error, said):
    with pytest.raises(error, match=said):
        call(*curved)


@pytest.mark.parametrize(
    ("pose", "deviation"),
    [
        ((np.nan, 0, 0), (0.1, 0.1)), ((5.0, 5.0, np.nan), (0.1, 0.1)),
        ((5.0, 5.0, 0.0), (np.nan, 0.1)), ((5.0, 5.0, 0.0), (0.1, -1.0)),
        ((5.0, 5.0, 0.0), (np.inf, 0.1)),
    ],
)  # fmt: skip
def test_a_robot_starts_somewhere(curved, pose, deviation):
    with imgloc.Localizer(curved[0].grid) as core:
        robot = core.robot()
        with pytest.raises(imgloc.ConfigError, match="pose: "):
            robot.start_at(Pose2D(*pose), deviation)
        robot.start_at(Pose2D(5.0, 5.0, 0.0), (0.0, 0.1))


def test_the_file_of_the_command_runs_by_itself():
    """Its folder has modules of the names of some in the standard library."""
    run = subprocess.run(
        [sys.executable, ROOT / "imgloc" / "__main__.py", "--version"],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.startswith("imgloc ")


def test_the_guide_to_own_parts_runs(capsys):
    page = (ROOT / "tools" / "docs" / "extending.md").read_text("utf-8")
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(compile(block, "extending.md", "exec"), names)
    near, tags, own, *moments = capsys.readouterr().out.splitlines()
    assert all(one.startswith("<Localization unique: x ") for one in (near, tags))
    assert own.startswith("<Localization ")
    x, y, _ = names["scans"].poses[0]
    answer = imgloc.localize(names["features"], names["scan"], names["options"],
                             stack=names["ends_on_walls"])  # fmt: skip
    assert np.hypot(answer.best.x - x, answer.best.y - y) < 0.5
    assert [line.split()[0] for line in moments] == ["0", "1", "2", "3"]


def test_what_is_printed_is_one_line(room, monkeypatch, tmp_path):
    folder, scans = room
    features = imgloc.prepare(imgloc.load_map(folder / "map.yaml"))
    answer = imgloc.localize(features, scans[0])
    reason, picture = imgloc.explain(features, scans[0], answer), imgloc.draw(features, answer)
    for value in (answer, reason, picture, scans, scans[0], features.grid):
        assert len(repr(value)) < 250
        assert "\n" not in repr(value)
    assert answer._repr_html_().count("<tr>") == 1 + len(answer.hypotheses)
    assert reason._repr_html_().count("<tr>") == 1 + len(reason.fits)
    for name, magic in (("a.png", b"\x89PNG"), ("a.jpg", b"\xff\xd8"), ("a.webp", b"RIFF")):
        picture.save(tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(magic)
    with pytest.raises(imgloc.ConfigError, match=r"expected a name in .png, .jpg or .webp"):
        picture.save(tmp_path / "a.gif")


def test_degrees_are_refused():
    with pytest.raises(imgloc.ConfigError, match=r"theta: got 90, .*are these degrees"):
        Pose2D(1, 2, 90)
    with pytest.raises(imgloc.ConfigError, match=r"angles\[0\]: got -90, .*are these degrees"):
        LaserScan(np.ones(181), np.arange(-90, 91.0))
    assert Pose2D(0, 0, 4 * np.pi).theta == pytest.approx(0)
    counted = imgloc.ScanSet((), odom=np.empty((0, 3)))
    assert len(counted) == 0
    scan = LaserScan(np.ones(9), np.linspace(-6, 6, 9))
    wound = imgloc.ScanSet((scan,), odom=np.array([[1.0, 2.0, 100.0]]))
    assert Pose2D(*wound.odom[0]).theta == pytest.approx(100 - 32 * np.pi)


def test_a_prior_of_a_region_is_checked(room):
    folder, _ = room
    grid = imgloc.load_map(folder / "map.yaml")
    with pytest.raises(imgloc.ConfigError, match="cells: got bool"):
        imgloc.region(grid, np.ones((3, 3), bool))
    with pytest.raises(imgloc.ConfigError):
        imgloc.near(grid, 1.0, 2.0, 0.0, radius=-1.0)
