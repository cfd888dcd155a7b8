"""`imgloc map check`, `imgloc map show` and the pictures behind them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from command import MAPS, call, rows

from imgloc.io.maps import bundled_maps
from imgloc.output.features import SUBJECTS


@pytest.fixture
def grey(tmp_path: Path) -> Path:
    """Write a map whose unknown grey, 205, is free by its thresholds."""
    image = np.full((30, 40), 205, np.uint8)
    image[5:25, 5:35] = 254
    cv2.rectangle(image, (5, 5), (34, 24), 0, 1)
    (tmp_path / "m.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    path = tmp_path / "m.yaml"
    path.write_text(
        "image: m.png\nresolution: 0.1\norigin: [1.0, 2.0, 0.5]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return path


def test_check_reports_classes_greys_and_warnings(grey: Path) -> None:
    code, out, err = call("map", "check", grey)
    assert (code, err) == (0, "")
    assert "40 x 30 of 0.1 m: 4.0 x 3.0 m" in out
    assert "yaw 28.65 deg" in out
    assert "    grey-205: 600 cells" in out
    (row,) = rows(call("map", "check", grey, "--json").out)
    assert row["shares"]["occupied"] == pytest.approx(96 / 1200)
    assert row["greys"][0] == {"value": 205.0, "cells": 600}
    assert row["origin"] == {"x": 1.0, "y": 2.0, "theta": 0.5}
    assert {w["code"] for w in row["warnings"]} == {"grey-205", "yaw"}


def test_check_strict_exits_with_3_only_on_warnings(grey: Path) -> None:
    assert call("map", "check", grey, "--strict").code == 3
    assert call("map", "check", grey, "--strict", "--origin", "0,0,0", "--free-thresh", 0.19) == (
        call("map", "check", grey, "--origin", "0,0,0", "--free-thresh", 0.19)
    )


def test_what_reads_a_map_is_written_into_a_yaml(grey: Path, tmp_path: Path) -> None:
    given = ("--origin", "3,1,90deg", "--negate", "--free-thresh", 0.3, "--mode", "scale")
    run = call("map", "check", grey, *given, "--json", "--write", tmp_path / "read.yaml")
    (row,) = rows(run.out)
    (again,) = rows(call("map", "check", tmp_path / "read.yaml", "--json").out)
    assert row.pop("origin") == pytest.approx(again.pop("origin"), abs=1e-6)
    assert row == again | {"path": row["path"]}
    assert call("map", "check", grey, "--write", tmp_path / "read.yaml").code == 1
    assert call("map", "check", grey, "--write", grey, "--force").code == 1
    run = call("simulate", grey, "--negate", "--out", tmp_path / "a.npz")
    assert (run.code, "imgloc map check MAP with it" in run.err) == (2, True)


def test_check_and_show_work_without_walls(tmp_path: Path) -> None:
    image = tmp_path / "blank.png"
    image.write_bytes(cv2.imencode(".png", np.full((20, 20), 254, np.uint8))[1].tobytes())
    check = call("map", "check", image, "--resolution", 0.05).ends(0)
    assert "no-walls" in check.out
    words = ["map", "show", image, "--resolution", 0.05, "--out", tmp_path / "o.png"]
    assert call(*words).code == 0
    code, _, err = call(*words, "--force", "--what", "surface")
    assert code == 3
    assert "none of its 400 cells is occupied" in err


@pytest.mark.parametrize("what", SUBJECTS)
def test_show_draws_every_subject(what: str, grey: Path, tmp_path: Path) -> None:
    out = tmp_path / f"{what}.png"
    code, text, err = call("map", "show", grey, "--what", what, "--out", out)
    assert (code, text) == (0, "")
    assert err.splitlines()[-1].startswith(f"imgloc: wrote {out}: {what}, ")
    picture = cv2.imdecode(np.frombuffer(out.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape[0] > picture.shape[1] * 3 // 4  # by a title and a legend
    assert len(np.unique(picture @ np.array([1, 1 << 8, 1 << 16]))) > 2  # colours
    before = out.read_bytes()
    assert call("map", "show", grey, "--what", what, "--out", out).code == 1
    assert call("map", "show", grey, "--what", what, "--out", out, "--force").code == 0
    assert out.read_bytes() == before


def test_show_visibility_takes_a_point_of_the_map_frame(tmp_path: Path) -> None:
    def fan(*words: object, path: Path = MAPS / "curved.yaml") -> int:
        out = tmp_path / "fan.png"
        call("map", "show", path, "--what", "visibility", "--out", out, *words).ends(0)
        picture = cv2.imdecode(np.frombuffer(out.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
        out.unlink()
        blue, _, red = picture[:-40].transpose(2, 0, 1).astype(int)  # above the legend
        return int(np.count_nonzero(red > blue + 50))  # pixels of the fan, which is orange

    # The same surface point, named in two frames.
    turned = ("--origin", "1,2,1.5707963", "--write", tmp_path / "turned.yaml")
    call("map", "check", MAPS / "curved.yaml", *turned).ends(0)
    other = fan("--at", "-4.4,6.2", path=tmp_path / "turned.yaml")
    assert fan("--at", "4.2,5.4") == pytest.approx(other, rel=1e-3)  # but for the lines of the axes
    assert fan("--at", "4.2,5.4") != fan()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--at 1,1", "--at: only --what visibility"),
        ("--at 500,500 --what visibility", "--at: 500,500 is not on the map"),
        ("--at 0,0 --what visibility", "not on the map"),  # left of its origin
    ],
)
def test_show_refuses_what_would_be_ignored(words, expected, grey, tmp_path):
    code, _, err = call("map", "show", grey, *words.split(), "--out", tmp_path / "o.png")
    assert code == 2
    assert expected in err
    assert not (tmp_path / "o.png").exists()


def test_bundled_maps_are_those_of_the_checkout() -> None:
    assert bundled_maps() == MAPS


def test_the_likelihood_of_a_scan_is_one_command(tmp_path: Path) -> None:
    scans, out = tmp_path / "a.npz", tmp_path / "l.png"
    assert call("simulate", "curved", "-n", 1, "--out", scans).code == 0
    words = ("map", "show", "curved", "--what", "likelihood", "--out", out)
    call(*words, "--scans", scans, "--method", "ght-v").ends(0, out="")
    picture = cv2.imdecode(np.frombuffer(out.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
    assert picture.min() == 0
    assert len(np.unique(picture[:, :, 0])) > 50
    words = (*words, "--force")
    for wrong in (words, ("map", "show", "curved", "--out", out, "--force", "--scans", scans)):
        assert call(*wrong).err.startswith("imgloc: error: --scans: expected with --what likelih")
    run = call(*words, "--scans", scans, "--method", "fused")
    assert "--method: got 'fused', expected one of cbml, cbml-o" in run.err
