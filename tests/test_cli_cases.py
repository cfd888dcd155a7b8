"""Files of strangers through the command: the true cause is named, and no false one."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call, rows

from imgloc.io.images import encode_png, read_image


def test_the_image_of_another_machine_has_another_ending_here(tmp_path: Path) -> None:
    (tmp_path / "map.png").write_bytes(encode_png(np.full((9, 9), 254, np.uint8)))
    for name in ("map", "maps"):
        said = f"image: /root/.ros/{name}.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n"
        (tmp_path / "a.yaml").write_text(said)
        run = call("map", "check", tmp_path / "a.yaml")
        assert "; beside it there is map.png" in run.err


@pytest.mark.parametrize("image", [
    "/home/someone/maps/a.png", "file:///home/x/a.png", "package://my_maps/maps/a.png",
    "C:\\Users\\me\\maps\\a.png", "~/maps/a.png", "../other/a.png", "$(find maps)/a.png",
])  # fmt: skip
def test_the_image_of_another_machine_lies_beside(image: str, tmp_path: Path) -> None:
    shutil.copy(MAPS / "curved.png", tmp_path / "a.png")
    (tmp_path / "a.yaml").write_text(f"image: '{image}'\nresolution: 0.1\norigin: [0, 0, 0]\n")
    run = call("map", "check", tmp_path / "a.yaml")
    run.ends(3, "; a.png lies beside the YAML: write 'image: a.png'")
    (tmp_path / "a.png").unlink()
    assert "lies beside" not in call("map", "check", tmp_path / "a.yaml").err


def test_a_yaml_of_windows_is_read_or_told_what_to_write(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    shutil.copy(MAPS / "curved.png", tmp_path / "maps" / "a.png")
    text = "image: {}\nresolution: 0.1\norigin: [0, 0, 0]\n"
    (tmp_path / "a.yaml").write_text(text.format("maps/a.png"), "utf-16")
    call("map", "check", tmp_path / "a.yaml").ends(0)
    (tmp_path / "a.yaml").write_text(text.format("maps\\a.png"))
    call("map", "check", tmp_path / "a.yaml").ends(3, "write 'image: maps/a.png'")


@pytest.mark.parametrize(("name", "hint"), [
    ("a.pbstream", "cartographer_pbstream_to_ros_map"), ("a.posegraph", "map_saver_cli"),
    ("a.pdf", "imgloc map plan"), ("a.dxf", "imgloc map plan"), ("a.bt", "octomap_server"),
])  # fmt: skip
def test_what_is_no_map_is_told_what_makes_one(name: str, hint: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"some bytes")
    for words in (["map", "check", tmp_path / name], ["localize", tmp_path / name, "a.npz"]):
        run = call(*words).ends(3, hint)
        assert "--resolution" not in run.err


@pytest.mark.parametrize("head", [b"#ROSBAG V1.2\n", b"#ROSRECORD V1.1\n"])
def test_an_old_bag_is_not_called_damaged(head: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(head + bytes(99))
    call("inspect", tmp_path / "a.bag").ends(4, "version before 2.0; rosbag fix")


def greyed(folder: Path, kind: str) -> Path:
    """A map in which grey 205 is read as free: few of it, one grey of many, or the unknown."""
    pixels = read_image(MAPS / "curved.png").pixels.copy()
    rng = np.random.default_rng(1)
    unknown = pixels == 205
    if kind == "probabilities":
        pixels[pixels == 254] = rng.integers(150, 256, np.count_nonzero(pixels == 254))
    pixels[unknown] = 254 if kind == "few" else 205 if kind == "unknown" else 120
    if kind == "few":
        pixels.flat[:: pixels.size // 12] = 205
    if kind == "unknown":
        pixels[:20] = 205
    (folder / "m.png").write_bytes(encode_png(pixels))
    (folder / "m.yaml").write_text(
        "image: m.png\nresolution: 0.1\norigin: [0,0,0]\nfree_thresh: 0.25\n"
    )
    return folder / "m.yaml"


@pytest.mark.parametrize("kind", ["few", "probabilities", "unknown"])
def test_grey_205_is_warned_of_where_it_is_the_unknown(kind: str, tmp_path: Path) -> None:
    (row,) = rows(call("map", "check", greyed(tmp_path, kind), "--json").out)
    assert ("grey-205" in [w["code"] for w in row["warnings"]]) == (kind == "unknown")


def test_the_cases_give_what_their_kind_should(shared, monkeypatch):
    monkeypatch.chdir(shared / "cases")
    said = {
        "inspect 04-nodding-laser/nod.bag": "left out 53 of 60 scans",
        "inspect 06-next-command-drops-options/map.png scans.yaml --resolution 0.1 --origin 5,5,0 "
        "--sensor 0.1,0,0": "--scans-index 4 --sensor 0.1,0,0 --resolution 0.1 --origin 5,5,0",
        "inspect 11-csv-exports/n_rostopic_p.csv": "6 of 360 rays",
        "inspect 11-csv-exports/n2_ros2_csv.csv": "6 of 360 rays",
        "inspect 11-csv-exports/n3_bagpy.csv": "6 of 360 rays",
        "inspect 12-time-and-angles-read-as-ranges/n5_first_row_angles.csv": "6 of 181 rays",
        "inspect 17-json-wrappers/o_rosbridge.jsonl": "6 of 360 rays",
        "inspect 17-json-wrappers/r_csm.json": "6 of 181 rays, -90 to 90 degrees",
        "inspect 09-max-bad-has-no-effect-on-bags/one_of_300.bag": "left out 1 of 300 scans",
        "inspect 09-max-bad-has-no-effect-on-bags/one_empty.yaml --max-bad 0.5": "left out 1 of 6",
        "localize visibility 07-range-max-zero/scans.bag --range-max 12 --scans-index 0": "pose",
        "map check 08-nan-origin/map.yaml --origin 0,0,0": "yaw 0.00 deg",
        "map check 10-grey-205-false-alarm/map.yaml": "many-greys",
        "inspect 14-upside-down-and-turned/both.npz": "--flipped --sensor 0,0,180deg",
        "inspect 15-echo-text/lost_message.yaml": "lacks 1 message",
        "inspect 17-json-wrappers/r_csm.json --fov-deg 90": "--fov-deg is not used: the file",
        "inspect 05-nan-percent-when-standing/still.bag --height 0,1": "--height is not used: /",
    }  # fmt: skip
    for words, text in said.items():
        words = words.replace(" scans.yaml", " 06-next-command-drops-options/scans.yaml")
        run = call(*words.split()).ends(0)
        assert text in run.out
        assert "nan %" not in run.out
        assert "    jump:" not in run.out
        assert "odometry-units" not in run.out
        assert "    grey-205" not in run.out


INVALID = {
    "Each scan has 5 rays; it takes valid readings in 10 directions or more": {"ranges": [2.0] * 5},
    "All rays point in 1 direction(s): is angle_increment right?": {"angle_increment": 0},
    "Most readings are 0, which drivers write where": {"ranges": [0.0] * 90 + [2.0] * 9},
    "Most readings are NaN": {"ranges": [None] * 90 + [2.0] * 9},
    "Most readings are nearer than range_min, 3 m": {"range_min": 3.0},
    "Most rays met nothing within range_max, 1 m": {"range_max": 1.0},
    "It takes valid readings in 10 directions or more; a scan has 8": {
        "ranges": [2.0] * 8 + [None] * 40 + [0.0] * 40
    },
}


@pytest.mark.parametrize("cause", INVALID)
def test_each_cause_of_invalid_has_a_sentence(cause: str, tmp_path: Path) -> None:
    scan = {"angle_min": -1.5, "angle_increment": 0.03, "range_min": 0.1, "range_max": 30.0}
    entry = {**scan, "ranges": [2.0 + 0.01 * k for k in range(99)], **INVALID[cause]}
    (tmp_path / "a.jsonl").write_text(json.dumps(entry))
    run = call("localize", "visibility", tmp_path / "a.jsonl")
    assert "scan 0: invalid" in run.out
    assert f"this scan has too few readings to be placed: of {len(entry['ranges'])}" in run.err
    assert cause in run.err


@pytest.mark.parametrize(("words", "hint"), [
    ("check office.yaml", "expected imgloc map check"), ("show office.yaml", "imgloc map show"),
    ("map office.yaml", "imgloc map check office.yaml"), ("run.bag", "imgloc inspect run.bag"),
    ("map show office.yaml --output a.png", "--output: expected --out"),
    ("localize office.yaml a.npz --output a.json", "--json as JSON, and --picture FILE draws"),
    ("localize office.yaml a.npz -o a.json", "> FILE keeps them"),
])  # fmt: skip
def test_a_slip_of_the_command_line_is_told_what_would_do(words: str, hint: str) -> None:
    call(*words.split()).ends(2, hint, out="")


def test_the_help_has_groups_and_whole_sentences() -> None:
    text = call("--help").out
    assert "..." not in text.split("Options:")[1].split("Examples:")[0]
    assert [text.index(f"\n{title}:") for title in ("First steps", "Folders", "Maps", "Measure")]
    text = call("localize", "--help").out
    usual = text.split("\nOptions:\n")[1].split("\n\n")[0]
    assert usual.count("\n  --") + 1 == 10
    for title in ("Search", "Known of the pose", "Scans", "Map image", "Program", "More options"):
        assert f"\n{title}:\n" in text


@pytest.mark.parametrize(("name", "text", "hint"), [
    ("a.log", "@SENS 30-01-99 15:46:02\n#ROBOT 12.1 -21.2 91.2\n", "follows '#LASER ...:' as CSV"),
    ("a.txt", "r = {8.18 7.95\n 7.78 7.2}\n", "without angles: write np.savez('scans.npz'"),
    ("a.txt", "- 8.18\n- .inf\n- 7.78\n- 7\n", "or echo the whole topic, not a field of it"),
    ("a.csv", "<!DOCTYPE html><html>", "a page of the web, not the file itself"),
    ("a.csv", "version https://git-lfs.github.com/spec/v1\noid sha256:4d\n", "git lfs pull"),
    ("a.db3.zstd", "bytes", "packed: unpack it"),
    ("a.klg", "bytes", "--fov-deg, --range-scale 0.01"),
    ("a.log", "## Player version 3.0.2 \n0001.5 1 6665 laser 00 1 1", "Player"),
    ("a.txt", "time {\n  sec: 12\n  nsec: 5\n}\nangle_min: -1.5\nranges: 1\n", "ros_gz_bridge"),
    ("a.csv", "header {\n  data {\n    key: \"seq\"\n  }\n}\nangle_step: 1\n", "gz topic"),
])  # fmt: skip
def test_texts_of_simulators_get_a_hint(name: str, text: str, hint: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    run = call("inspect", tmp_path / name).ends(4, hint)
    assert "expected a number" not in run.err
