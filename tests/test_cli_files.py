"""What the commands read and write: no input is lost, and bundled maps have names."""

import shutil
from pathlib import Path

import pytest
from command import MAPS, call

from imgloc.cli.inputs import check_target, files_of
from imgloc.cli.options import find_map
from imgloc.errors import ConfigError, OutputError
from imgloc.io.calibration import calibration_path


@pytest.fixture
def office(tmp_path: Path) -> Path:
    """A folder with a map and one scan in it."""
    for ending in (".yaml", ".png"):
        shutil.copy(MAPS / f"curved{ending}", tmp_path)
    words = ("-n", 1, "--rays", 61, "--out", tmp_path / "scan.npz")
    assert call("simulate", tmp_path / "curved.yaml", *words).code == 0
    return tmp_path


def content(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


@pytest.mark.parametrize(
    "words",
    [
        "map show curved.yaml --out curved.png",
        "map show curved.png --resolution 0.1 --out curved.png",
        "localize curved.yaml scan.npz --picture curved.png",
        "localize curved.yaml scan.npz --picture mask.png --region mask.png",
        "localize curved.yaml several.npz --picture many.png --region many-0001.png",
        "atlas curved.yaml --step 5 --headings 1 --out curved.png",
        "atlas curved.yaml --step 5 --headings 1 --out ./../office/curved.png",
        "sample curved.yaml scan.csv --out scan.csv",
    ],
)
def test_no_input_is_overwritten(words, office, tmp_path, monkeypatch):
    folder = tmp_path / "office"
    folder.mkdir()
    for path in list(office.glob("*.*")):
        path.rename(folder / path.name)
    monkeypatch.chdir(folder)
    for mask in ("mask.png", "many-0001.png"):
        shutil.copy("curved.png", mask)
    assert call("simulate", "curved.yaml", "-n", 2, "--out", "several.npz").code == 0
    Path("scan.csv").write_text("# angle_min=-1 angle_max=1 range_max=30\n" + "2," * 30 + "2\n")
    before = content(folder)
    code, out, err = call(*words.split(), "--force")
    assert (code, out) == (1, "")
    assert "is read by this command" in err
    assert content(folder) == before


def test_a_bundled_map_survives_the_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    before = (MAPS / "curved.png").read_bytes()
    run = call("demo", "--out", MAPS / "curved.png", "--force")
    if (MAPS / "curved.png").read_bytes() != before:  # others read it meanwhile
        (MAPS / "curved.png").write_bytes(before)
    run.ends(1, "is read by this command")


def test_targets(tmp_path: Path) -> None:
    (tmp_path / "a.png").touch()
    (tmp_path / "b.png").hardlink_to(tmp_path / "a.png")
    check_target(tmp_path / "b.png", ".png", force=True, inputs=[tmp_path / "none.png"])
    with pytest.raises(OutputError, match="is read by"):
        check_target(tmp_path / "b.png", ".png", force=True, inputs=[tmp_path / "a.png"])
    with pytest.raises(OutputError, match="exists already"):
        check_target(tmp_path / "b.png", ".png", force=False)
    with pytest.raises(OutputError, match="no folder"):
        check_target(tmp_path / "c" / "d.png", ".png", force=True)
    with pytest.raises(ConfigError, match="ends in"):
        check_target(tmp_path / "d.jpg", ".png", force=True)


def test_a_map_is_a_yaml_its_image_and_its_calibration(tmp_path: Path) -> None:
    own = calibration_path(MAPS / "curved.yaml")
    assert files_of(MAPS / "curved.yaml") == [MAPS / "curved.yaml", own, MAPS / "curved.png"]
    (tmp_path / "bad.yaml").write_text("image: [")
    for name in ("a.png", "bad.yaml"):
        assert files_of(tmp_path / name) == [tmp_path / name, calibration_path(tmp_path / name)]


def test_a_name_is_that_of_a_file_before_that_of_a_bundled_map(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_map("curved") == MAPS / "curved.yaml"
    for name in ("curved.yaml", "./curved/", "x/curved", "office"):
        assert find_map(Path("sub") / name) == Path("sub") / name
    (tmp_path / "curved").touch()
    assert find_map("curved") == Path("curved")
