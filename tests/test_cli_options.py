"""Priors, mounting, budgets and the map cache, through the real command."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import MAPS, call, rows, simulating, untimed

from imgloc import ConfigError, load_scans
from imgloc.io.files import write_bytes_atomic
from imgloc.io.images import encode_png
from imgloc.texts import byte_count

WORLD = MAPS / "visibility.yaml"  # 140 x 200 cells of 0.1 m


scans = simulating(WORLD, "-n", 3, "--seed", 4)


def first(scans: Path, *options: object) -> dict:
    code, out, err = call("localize", WORLD, scans, "--scans-index", 0, "--json", *options)
    assert code == 0, err
    return rows(out)[0]


@pytest.fixture(scope="module")
def plain(scans: Path) -> dict:
    """What is said without any option."""
    return first(scans)


def away(row: dict, scans: Path) -> float:
    poses = load_scans(scans).poses
    best = row["hypotheses"][0]
    return float(np.hypot(best["x"] - poses[0, 0], best["y"] - poses[0, 1]))


def test_heading_and_clearance_combine(scans: Path) -> None:
    row = first(scans, "--heading=-1.7,0.3", "--clearance", 0.5, "--top", 20)
    for h in row["hypotheses"]:
        assert abs(np.angle(np.exp(1j * (h["theta"] + 1.7)))) < 0.35
    assert set(row["parameters"]["prior"]) == {"heading", "clearance"}


def test_a_region_is_as_the_map_is_seen(scans: Path, tmp_path: Path) -> None:
    mask = np.zeros((140, 200), np.uint8)
    mask[-40:, :60] = 255  # the lower left of the image: x < 6 m, y < 4 m
    write_bytes_atomic(tmp_path / "mask.png", encode_png(mask))
    row = first(scans, "--region", tmp_path / "mask.png")
    assert away(row, scans) < 0.1
    assert all(h["x"] < 6 and h["y"] < 4 for h in row["hypotheses"])
    assert row["parameters"]["prior"]["region"] == {"cells": 2400}


def test_what_may_be_wrong_weighs_and_makes_nothing_unique(scans: Path, tmp_path: Path) -> None:
    plain = first(scans)
    grey = np.full((140, 200), 26, np.uint8)
    grey[-40:, :60] = 255
    write_bytes_atomic(tmp_path / "grey.png", encode_png(grey))
    for some in (("--near=2.5,1.5,-1.7", "--sd", "0.5,10deg"),
                 ("--prior-image", tmp_path / "grey.png")):  # fmt: skip
        row = first(scans, *some)
        assert row["hypotheses"][0]["mass"] >= plain["hypotheses"][0]["mass"]
        assert (row["verdict"], away(row, scans) < 0.1) == (plain["verdict"], True)
    write_bytes_atomic(tmp_path / "other.png", encode_png(255 - grey + 26))
    best = first(scans, "--prior-image", tmp_path / "other.png")["hypotheses"][0]
    assert best["x"] > 6 or best["y"] > 4


@pytest.mark.parametrize(
    ("options", "code", "expected"),
    [
        (("--near", "1,2,0,3", "--sd", "0.5,10deg"), 2, "--sd: expected with --near, of x, y"),
        (("--near", "1,2,0", "--sd", "0.5"), 2, "--sd: got '0.5', expected 2 numbers"),
        (("--prior-image", MAPS / "curved.png"), 2, "expected 200 x 140"),
        (("--near", "1,2,3,-4"), 2, "--near: got R -4"),
        (("--near", "1,2,3", "--heading", "1"), 2, "given twice"),
        (("--near", "-50,-50,0"), 2, "leaves no cell"),
        (("--clearance", "50"), 2, "leaves no cell"),
        (("--region", MAPS / "curved.png"), 2, "expected 200 x 140"),
        (("--region", MAPS / "none.png"), 3, "none.png"),
        (("--origin", "0,0,45"), 2, "are these degrees?"),
        (("--memory-budget", "lots"), 2, "number of bytes"),
        (("--memory-budget", "8M"), 2, "budget is 8 MiB"),
        (("--time-budget", "1", "--method", "cbml"), 2, "time budget"),
        (("--cache", ".", "--no-cache"), 2, "one of them"),
    ],
)
def test_refuses_what_cannot_be_meant(scans, options, code, expected):
    call("localize", WORLD, scans, *options).ends(code, expected, out="")


@pytest.mark.parametrize("channels", [3, 4], ids=["colour", "transparent"])
def test_what_is_coloured_dark_or_transparent_is_not_white(scans, tmp_path, channels):
    mask = np.full((140, 200, channels), 255, np.uint8)
    mask[70:, :, channels - 1] = 0  # coloured, or not seen
    mask[60:70, :, :3] = 110  # rather dark than light
    path = encoded(tmp_path / "mask.png", mask)
    row = first(scans, "--region", path)
    assert row["parameters"]["prior"]["region"] == {"cells": 60 * 200}


def encoded(path: Path, image: np.ndarray) -> Path:
    """An image that OpenCV has written."""
    ok, data = cv2.imencode(path.suffix, image)
    assert ok
    path.write_bytes(data.tobytes())
    return path


def test_a_region_may_be_a_jpeg_if_that_is_said(scans: Path, tmp_path: Path) -> None:
    mask = np.full((140, 200), 255, np.uint8)
    words = ("localize", WORLD, scans, "--scans-index", 0, "--json", "--region")
    words = (*words, encoded(tmp_path / "mask.jpg", mask))
    call(*words).ends(3, "--allow-lossy")
    (row,) = rows(call(*words, "--allow-lossy").out)
    assert row["parameters"]["prior"]["region"] == {"cells": mask.size}


def test_a_black_region_is_refused(scans: Path, tmp_path: Path) -> None:
    write_bytes_atomic(tmp_path / "black.png", encode_png(np.zeros((140, 200), np.uint8)))
    call("localize", WORLD, scans, "--region", tmp_path / "black.png").ends(2, "no white pixel")


def test_the_base_is_behind_a_sensor_mounted_in_front(scans: Path, plain: dict) -> None:
    mounted = first(scans, "--sensor", "0.5,0,0")
    assert plain["base_pose"] is None
    assert mounted["pose"] == plain["pose"]
    back = mounted["base_pose"]
    theta = plain["pose"]["theta"]
    assert back["x"] == pytest.approx(plain["pose"]["x"] - 0.5 * np.cos(theta))
    assert back["y"] == pytest.approx(plain["pose"]["y"] - 0.5 * np.sin(theta))
    assert mounted["hypotheses"][0]["base"] == back


def test_a_narrow_terminal_has_the_base_in_a_line_of_its_own(scans, monkeypatch):
    wide = call("localize", WORLD, scans, "--sensor", "0.5,0,0.1").out.splitlines()
    monkeypatch.setattr(sys.modules["imgloc.cli.localize"], "width", lambda: 80)
    narrow = call("localize", WORLD, scans, "--sensor", "0.5,0,0.1").out.splitlines()
    assert max(map(len, narrow)) < 80 < max(map(len, wide))
    assert narrow[0] == wide[0][: len(narrow[0])]
    for both, sensor, base in zip(wide[1:], narrow[1::2], narrow[2::2], strict=True):
        assert both.split() == [*sensor.split(), *base.split()[1:]]


def test_the_base_is_in_the_table_of_several_scans(scans: Path) -> None:
    plain = call("localize", WORLD, scans).out.splitlines()
    mounted = call("localize", WORLD, scans, "--sensor", "0.5,0,0.1").out.splitlines()
    assert mounted[0] == plain[0] + "     base x    base y  base theta"
    bases = [r["base_pose"] for r in rows(call(
        "localize", WORLD, scans, "--sensor", "0.5,0,0.1", "--json").out)]  # fmt: skip
    for before, after, base in zip(plain[1:], mounted[1:], bases, strict=True):
        assert after.startswith(before)
        x, y, degrees = map(float, after[len(before) :].split())
        assert [x, y] == pytest.approx([base["x"], base["y"]], abs=1e-3)
        assert np.deg2rad(degrees) == pytest.approx(base["theta"], abs=1e-3)


def test_a_scan_without_a_pose_has_no_base(scans: Path, tmp_path: Path) -> None:
    blind = np.full((2, 30), np.nan)
    np.savez(tmp_path / "blind.npz", ranges=blind, angles=np.arange(30) / 30)
    out = call("localize", WORLD, tmp_path / "blind.npz", "--sensor", "0.5,0,0").out.splitlines()
    assert {len(line) for line in out} == {len(out[0])}
    assert out[1].split()[1:] == ["invalid", *"---------"]


def test_the_mounting_is_recorded(scans: Path, plain: dict) -> None:
    parameters = plain["parameters"]
    assert (parameters["sensor"], parameters["flipped"]) == (None, False)
    parameters = first(scans, "--sensor", "0.5,0,0.1", "--flipped")["parameters"]
    assert parameters["sensor"] == {"x": 0.5, "y": 0.0, "theta": 0.1}
    assert parameters["flipped"] is True


def test_flipped_undoes_a_sensor_upside_down(scans: Path, plain: dict, tmp_path: Path) -> None:
    data = dict(np.load(scans))
    data["angles"] = -data["angles"]
    np.savez(tmp_path / "flipped.npz", **data)
    assert first(tmp_path / "flipped.npz")["verdict"] != "unique"
    assert first(tmp_path / "flipped.npz", "--flipped")["pose"] == plain["pose"]


def test_scans_that_fit_if_mirrored_bring_a_hint(tmp_path: Path) -> None:
    upright, hanging = tmp_path / "upright.npz", tmp_path / "hanging.npz"
    assert call("simulate", "curved", "-n", 2, "--seed", 1, "--out", upright).code == 0
    data = dict(np.load(upright))
    np.savez(hanging, **data | {"angles": -data["angles"]})

    def hints(*words: object) -> str:
        code, _, err = call("localize", "curved", *words)
        assert code == 0
        return " ".join(err.split())

    assert "Try --flipped" in hints(hanging)
    assert "Leave out --flipped" in hints(upright, "--flipped")
    assert hints(upright) == hints(hanging, "--flipped") == ""
    assert hints(hanging, "--time-budget", 100) == ""


def test_a_guess_is_said_to_be_one(scans: Path) -> None:
    row = first(scans, "--near", "15,3,0,1")
    assert row["verdict"] == "no-match"
    assert row["pose"] is None
    assert row["hypotheses"]
    out = call("localize", WORLD, scans, "--scans-index", 0, "--near", "15,3,0,1").out
    assert "no-match" in out
    assert "best guess" in out
    assert "not to be trusted" in out


def test_out_of_time_is_said(scans: Path) -> None:
    row = first(scans, "--time-budget", 0.001)
    assert row["complete"] is False
    assert row["hypotheses"]
    assert first(scans, "--time-budget", 1000)["complete"] is True
    assert (
        "out of time"
        in call("localize", WORLD, scans, "--scans-index", 0, "--time-budget", 0.001).out
    )
    table = call("localize", WORLD, scans, "--time-budget", 0.001, "--strict")
    assert table.code == 6  # what was not looked at may fit as well
    lines = table.out.splitlines()[1:]
    assert len(lines) > 1
    assert all(line.endswith("  out of time") for line in lines)
    assert not any(" unique " in line for line in lines)
    assert "out of time" not in call("localize", WORLD, scans).out


def test_the_second_run_starts_from_the_cache(scans: Path, tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    one = call("localize", WORLD, scans, "--json", "--cache", folder, "-v")
    (entry,) = folder.glob("*.npz")
    assert "kept the prepared map" in one.err
    before = entry.stat().st_ino
    two = call("localize", WORLD, scans, "--json", "--cache", folder, "-v")
    assert untimed(one.out) == untimed(two.out)
    assert "kept" not in two.err
    assert entry.stat().st_ino == before  # used, not written anew
    assert untimed(call("localize", WORLD, scans, "--json", "--no-cache").out) == untimed(one.out)


@pytest.mark.parametrize("text", ["", "-1", "M", "1e3", "2 GX"])
def test_no_bytes(text: str) -> None:
    with pytest.raises(ConfigError):
        byte_count(text)
