"""`imgloc calibrate`, from the command line to the file that localize and evaluate find."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call, rows

from imgloc import ScanSet, Sensor, Shared, load_map, load_scans, save_scans, simulate
from imgloc.io.calibration import load_calibrations
from imgloc.options import DEFAULTS
from imgloc.simulation.worlds import WORLDS, render

QUICK = ("--method", "ght-v", "-n", 20, "--rays", 61, "--theta-step-deg", 15, "--cell", 0.2,
         "--threads", 1)  # fmt: skip


def office_in(folder: Path) -> Path:
    for ending in (".yaml", ".png"):
        shutil.copy(MAPS / f"curved{ending}", folder)
    return folder / "curved.yaml"


@pytest.fixture
def office(tmp_path: Path) -> Path:
    return office_in(tmp_path)


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a quick calibration writes."""
    there = office_in(tmp_path_factory.mktemp("quick"))
    path = there.with_name("curved.calibration.json")
    run = call("calibrate", there, *QUICK).ends(0, f"wrote {path}")
    assert run.out.count("ght-v") == 1
    return path


@pytest.fixture
def calibrated(office: Path, quick: Path) -> Path:
    """A map with a quick calibration beside it."""
    shutil.copy(quick, office.parent)
    return office


def test_what_is_fitted_is_used(calibrated: Path) -> None:
    office, path = calibrated, calibrated.with_name("curved.calibration.json")
    content = json.loads(path.read_text())
    about = content["about"]["ght-v"]
    assert about["seed"] == 1000
    assert about["trials"] == 20
    assert about["sensor"]["rays"] == 61
    assert about["theta_step_deg"] == 15
    assert about["index"]["calibrated"]["trials"] == 20
    fitted = load_calibrations(path, load_map(office))[0]
    assert list(fitted) == ["ght-v"]
    assert fitted["ght-v"] != DEFAULTS["ght-v"]
    scans = office.with_name("scans.npz")
    assert call("simulate", office, "-n", 1, "--rays", 61, "--out", scans).code == 0
    for words in (
        ("localize", office, scans, "--method", "ght-v", "--json"),
        ("evaluate", office, "-n", 1, "--method", "ght-v", "--json"),
    ):
        (row,) = rows(call(*words).out)
        assert row["parameters"]["calibration"] == vars(fitted["ght-v"])
    (other,) = rows(call("localize", office, scans, "--method", "ght", "--json").out)
    assert other["parameters"]["calibration"] == vars(DEFAULTS["ght"])
    # At another resolution it is another map.
    _, out, err = call("localize", office, scans, "--method", "ght-v", "--json",
                       "--resolution", 0.101)  # fmt: skip
    assert rows(out)[0]["parameters"]["calibration"] == vars(DEFAULTS["ght-v"])
    assert "ignored, the defaults are used" in err


def test_the_same_seed_the_same_bytes_for_every_number_of_threads(office, quick) -> None:
    call("calibrate", office, *QUICK[:-1], 2).ends(0)
    files = office.with_name(quick.name), quick
    one, other = (path.read_text().replace(path.parent.name, "folder") for path in files)
    assert one == other


def test_a_dry_run_stores_nothing() -> None:
    before = sorted(MAPS.iterdir())
    words = ("--method", "ght,beam", "--cell", 0.2, "--theta-step-deg", 15, "-n", 20)
    (row,) = rows(call("calibrate", "curved", *words, "--dry-run", "--json").out)
    assert sorted(MAPS.iterdir()) == before
    assert list(row["methods"]) == ["ght", "beam"]
    index = row["about"]["index"]["ght"]
    assert index["calibrated"]["value"] > index["bare"]["value"]


def test_maps_that_share_a_fit(office: Path) -> None:
    twin = office.with_name("twin.yaml")
    shutil.copy(office, twin)
    words = [10 if word == 20 else word for word in QUICK]  # 20 in all
    assert call("calibrate", office, twin, *words).code == 0
    one, two = (
        load_calibrations(p.with_suffix(".calibration.json"), load_map(p))[0]
        for p in (office, twin)
    )
    assert one == two != {}


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (["--method", "fused"], 2, "--method: got 'fused', expected cbml,"),
        (["MAP"], 2, "the same map twice"),
        (["-n", "1"], 2, "got 1 in all, expected at least 20"),
        (["-n", "19", "--dry-run"], 2, "got 19 in all, expected at least 20"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_refuses(office: Path, words: list[str], code: int, expected: str) -> None:
    given = [str(office) if w == "MAP" else w for w in words]
    run = call("calibrate", office, *given).ends(code, out="")
    assert expected in " ".join(run.err.split())
    assert not office.with_name("curved.calibration.json").exists()


def test_other_methods_keep_their_fits(calibrated: Path) -> None:
    path, grid = calibrated.with_name("curved.calibration.json"), load_map(calibrated)
    votes = load_calibrations(path, grid)[0]
    assert call("calibrate", calibrated, "--method", "cbml", *QUICK[2:], "--force").code == 0
    both = load_calibrations(path, grid)[0]
    assert list(both) == ["ght-v", "cbml"]
    assert both["ght-v"] == votes["ght-v"]


def test_nothing_is_kept_among_the_files_of_the_program_by_name() -> None:
    run = call("calibrate", "curved", *QUICK)
    run.ends(2, str(MAPS / "curved.calibration.json"), "--dry-run", out="")
    assert not (MAPS / "curved.calibration.json").exists()


def test_refuses_to_overwrite_before_any_work(office: Path) -> None:
    path = office.with_name("curved.calibration.json")
    path.write_text("mine")
    code, out, err = call("calibrate", office)
    assert (code, out) == (1, "")
    assert "--force" in err
    assert path.read_text() == "mine"


def test_recorded_scans_say_what_error_they_share(office: Path) -> None:
    scans, path = office.with_name("scans.npz"), office.with_name("curved.calibration.json")
    words = ("simulate", office, "-n", 5, "--rays", 91, "--fov-deg", 360, "--out", scans)
    assert call(*words).code == 0
    longer = ("--resolution", 0.096)  # 4 % too small: so are the walls
    said = " ".join(call("localize", office, scans, *longer).err.split())
    assert "most scans fit this map far better with their ranges multiplied by 0.9" in said
    assert "imgloc calibrate MAP --scans FILE" in said
    code, out, err = call("calibrate", office, *longer, "--scans", scans)
    assert (code, f"wrote {path}" in err) == (0, True)
    content = json.loads(path.read_text())
    assert content["shared"]["scale"] == pytest.approx(0.96, abs=0.01)
    assert content["about"]["shared"]["asked"] == 5
    assert "5 of 5 fit at one place" in out
    (side,) = re.findall(r"cells are of ([0-9.]+) m", out)
    assert float(side) == pytest.approx(0.1, abs=1e-3)
    run = call("localize", office, scans, *longer, "--json")
    assert "most scans" not in run.err
    for row in rows(run.out):
        assert row["parameters"]["shared"] == content["shared"]
        assert row["evidence"]["scale"] == content["shared"]["scale"]
    # What is simulated in the map as it is has no such error.
    quick = ("-n", 1, "--method", "fused", "--json", *longer)
    (row,) = rows(call("evaluate", office, *quick).out)
    assert row["parameters"]["shared"] == vars(Shared())
    assert (
        call("localize", office, scans, "--scans-index", 0).code == 0
    )  # of another resolution: unused


def test_scans_from_elsewhere_say_nothing(office: Path) -> None:
    scans = office.with_name("scans.csv")
    scans.write_text("".join(f"{0.1 * k},{1 + 0.1 * (k % 3)}\n" for k in range(-15, 16)))
    run = call("calibrate", office, "--scans", scans).ends(2, out="")
    assert "of 1 scans fit this map at one place, expected at least 5" in " ".join(run.err.split())
    run = call("calibrate", office, MAPS / "visibility.yaml", "--scans", scans)
    run.ends(2, "--scans: expected one MAP", out="")
    assert not office.with_name("curved.calibration.json").exists()


def test_which_says_why_scans_of_a_map_have_none(shared: Path, tmp_path: Path) -> None:
    for name in ("fr079", "gh25"):
        (tmp_path / "maps" / name).mkdir(parents=True)
        for file in (shared / "data" / name).glob("map.*"):
            (tmp_path / "maps" / name / file.name).write_bytes(file.read_bytes())
    some = load_scans(shared / "data" / "fr079" / "scans.npz").take([5, 28, 99, 147, 150])
    stretched = tuple(replace(scan, ranges=1.07 * scan.ranges) for scan in some.scans)
    save_scans(tmp_path / "a.npz", replace(some, scans=stretched))
    run = call("which", tmp_path / "maps", tmp_path / "a.npz", "--no-cache").ends(0)
    named = sum(line.split()[1] == "fr079" for line in run.out.splitlines()[1:])
    assert named < 3
    where = tmp_path / "maps" / "fr079" / "map.yaml"
    told = run.err.splitlines()[-1]
    assert "fr079: most scans fit this map far better with their ranges multiplied by 0.9" in told
    assert "imgloc calibrate MAP --scans FILE finds it once for all" in told
    call("calibrate", where, "--scans", tmp_path / "a.npz").ends(0)
    run = call("which", tmp_path / "maps", tmp_path / "a.npz", "--no-cache")
    assert all(line.split()[1] == "fr079" for line in run.out.splitlines()[1:]), run.out


def test_calibrate_prints_what_it_stores(office: Path) -> None:
    sensor = Sensor(rays=180, fov=2 * np.pi)
    scans = simulate(render(WORLDS["curved"](), 0.1), 5, 5, sensor).scans
    path = office.with_name("b.npz")
    save_scans(path, ScanSet(tuple(replace(s, ranges=1.0008 * s.ranges) for s in scans)))
    run = call("calibrate", office, "--scans", path).ends(0)
    stored = json.loads(office.with_name("curved.calibration.json").read_text("utf-8"))["shared"][
        "scale"
    ]
    (line,) = [line for line in run.out.splitlines() if line.startswith("scale")]
    assert f"ranges x {stored:.4f} +-" in line
    assert stored != Shared().scale
    assert line.endswith(": imgloc uses that, though the map's scale may be right")
