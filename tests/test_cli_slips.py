"""Small slips that mislead: each is refused or said, alike by localize, track, batch and Python."""

import codecs
import json
import logging
import shutil
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from command import MAPS, call, rows
from places import drive

from imgloc import ConfigError, Options, follow, load_map, load_scans, make_filter, save_scans
from imgloc.io.cache import cache_limit
from imgloc.pipeline import prepare

MAP, N = MAPS / "visibility.yaml", 6
ANGLES = np.deg2rad(np.arange(-180, 180, 3.0))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive, its reach and odometry known."""
    poses = np.array([[4.0 + 0.5 * k, 8.0, 0.02 * k] for k in range(N)])
    path = tmp_path_factory.mktemp("slips") / "log.npz"
    save_scans(path, drive(poses))
    return path


def by_all(map_path: Path, log: Path, folder: Path, *words: object) -> dict[str, str]:
    """What each command says on standard error; each must succeed."""
    runs = {
        "localize": call("localize", map_path, log, "--scans-index", 0, *words),
        "track": call("track", map_path, log, *words),
        "batch": call("batch", map_path, log, "--out", folder / "out", "--workers", 1, *words),
    }
    assert {name: run.code for name, run in runs.items()} == dict.fromkeys(runs, 0), runs
    return {name: run.err for name, run in runs.items()}


# --- scans


def test_a_byte_order_mark_takes_no_scan_of_a_log(log: Path, tmp_path: Path) -> None:
    ranges = [scan.ranges for scan in load_scans(log).scans]
    lines = [
        f"FLASER {len(r)} {' '.join(f'{v:.3f}' for v in r)} 0 0 0 {k} 0 0 {100 + k} robot {k}"
        for k, r in enumerate(ranges)
    ]
    for name in ("plain.log", "marked.log", "marked"):
        mark = codecs.BOM_UTF8 if "marked" in name else b""
        (tmp_path / name).write_bytes(mark + "\n".join(lines).encode())
        got = load_scans(tmp_path / name, fov=2 * np.pi)
        assert len(got) == N
        np.testing.assert_allclose(got[0].ranges, ranges[0], atol=1e-3)
    words = ("--fov-deg", 360, "--scans-index", 0, "--json")
    poses = [
        rows(call("localize", MAP, tmp_path / name, *words).out)[0]["pose"]
        for name in ("plain.log", "marked.log")
    ]
    assert poses == 2 * poses[:1] != [None, None]
    np.savez(tmp_path / "bare.npz", ranges=ranges)
    assert load_scans(tmp_path / "bare.npz", fov=2 * np.pi)[0].angles[0] == -np.pi


def coded(log: Path, path: Path, code: float) -> list[int]:
    """The log as a driver writes it that says no reach, a fifth of its rays being a code."""
    scans = load_scans(log)
    lines, real = [], []
    for k, scan in enumerate(scans.scans):
        ranges = np.where(np.arange(len(ANGLES)) % 5 == k % 5, code, np.minimum(scan.ranges, 29.0))
        real.append(int((ranges != code).sum()))
        odom, about = scans.odom[k].tolist(), {"stamp": 100.0 + k}
        line = {"ranges": ranges.tolist(), "angles": ANGLES.tolist(), "odom": odom, **about}
        lines.append(json.dumps(line))
    path.write_text("\n".join(lines))
    return real


def test_a_code_for_nothing_seen_is_no_wall(log: Path, tmp_path: Path, caplog, monkeypatch) -> None:
    path = tmp_path / "coded.jsonl"
    real = coded(log, path, 81.83)
    said = "range_max = 81.83; add range_max to the file if these are distances"
    for name, err in by_all(MAP, path, tmp_path).items():
        assert err.count(said) == 1, (name, err)
    run = call("localize", MAP, path, "--json")
    assert [row["counts"]["valid"] for row in rows(run.out)] == real
    assert {row["verdict"] for row in rows(run.out)} == {"unique"}
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)  # as in a program
    with caplog.at_level(logging.WARNING):
        assert {scan.range_max for scan in load_scans(path).scans} == {81.83}
    assert said in caplog.text
    saved = tmp_path / "coded.npz"  # an NPZ is looked at as well
    np.savez(saved, ranges=np.stack([s.ranges for s in load_scans(path).scans]), angles=ANGLES)
    assert load_scans(saved)[0].range_max == 81.83


def test_ranges_that_repeat_are_no_codes(log: Path, tmp_path: Path) -> None:
    """A round room, readings in whole metres, a wall that one scan sees: none of them is a code."""
    rng = np.random.default_rng(0)
    wall = np.where(np.arange(120) < 30, 9.0, rng.random(120) * 8)
    far = [rng.random(120) * 12 for _ in range(3)]
    for name, ranges in (
        ("round", np.full((2, 120), 4.2)),
        ("whole", rng.integers(1, 6, (2, 120)).astype(float)),
        ("wall", np.stack([wall, *far])),
    ):
        np.savez(tmp_path / f"{name}.npz", ranges=ranges, angles=ANGLES)
        assert np.isinf(load_scans(tmp_path / f"{name}.npz")[0].range_max), name
    np.savez(tmp_path / "one.npz", ranges=wall, angles=ANGLES)
    assert load_scans(tmp_path / "one.npz")[0].range_max == 9.0
    np.savez(tmp_path / "said.npz", ranges=wall, angles=ANGLES, range_max=30.0)
    assert load_scans(tmp_path / "said.npz")[0].range_max == 30.0  # who says it, is believed


def test_a_mount_in_a_json_line_is_where_the_sensor_sits(log: Path, tmp_path: Path) -> None:
    scan = load_scans(log)[0]
    line = {"ranges": scan.ranges.tolist(), "angles": ANGLES.tolist(), "range_max": 30}
    path = tmp_path / "one.jsonl"
    for mount in ([0.3, 0.0, 3.0], {"x": 0.3, "y": 0.0, "theta": 3.0}):
        path.write_text(json.dumps(line | {"mount": mount}))
        (row,) = rows(call("localize", MAP, path, "--json").out)
        away = np.subtract(*([row[k]["x"], row[k]["y"]] for k in ("pose", "base_pose")))
        assert np.hypot(*away) == pytest.approx(0.3)
        assert call("localize", MAP, path, "--sensor", "0.1,0,0").code == 0


def test_odometry_that_starts_late_costs_only_the_scans_before_it(
    log: Path, tmp_path: Path, caplog, monkeypatch
) -> None:
    scans = load_scans(log)
    lines = []
    for k, (scan, (x, y, theta)) in enumerate(zip(scans.scans, scans.odom, strict=True)):
        start = f"RAWLASER1 0 {ANGLES[0]} 6.2832 {np.deg2rad(3)} 30 0.01 0 {len(scan.ranges)}"
        ranges = " ".join(f"{r:.4f}" for r in np.nan_to_num(scan.ranges, posinf=31.0))
        lines.append(f"{start} {ranges} 0 {100 + k} robot {100 + k}")
        if k >= 3:  # what comes before it has none: it is not held
            lines.append(f"ODOM {x} {y} {theta} 0 0 0 {100 + k} robot {100 + k}")
    path = tmp_path / "late.log"
    path.write_text("\n".join(lines) + "\n")
    got = load_scans(path)
    assert len(got) == N  # nothing is lost to those who need no odometry
    assert np.isfinite(got.odom).all(axis=1).tolist() == [False] * 3 + [True] * 3
    run = call("track", MAP, path, "--json", "--picture", tmp_path / "track.png").ends(0)
    assert [row["index"] for row in rows(run.out)] == [3, 4, 5]
    said = "3 of 6 scans, from 0 to 2, have no odometry and are left out"
    assert run.err.count(said) == 1
    run = call("localize", MAP, path, "--json")
    assert [row["index"] for row in rows(run.out)] == list(range(N))
    save_scans(tmp_path / "late.npz", got)
    assert call("track", MAP, tmp_path / "late.npz").err.count(said) == 1
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    features = prepare(load_map(MAP))
    with caplog.at_level(logging.WARNING):
        moments = list(follow(features, got, make_filter("tracker", features, Options())))
    assert [moment.index for moment in moments] == [3, 4, 5]
    assert said in caplog.text


# --- maps


@pytest.fixture
def few(log: Path, tmp_path: Path) -> Path:
    """The first two scans of the drive."""
    save_scans(tmp_path / "few.npz", load_scans(log).take([0, 1]))
    return tmp_path / "few.npz"


def copy_of_map(folder: Path, **changes: object) -> Path:
    """The map in a folder of its own, some values of its YAML changed."""
    shutil.copy(MAP.with_suffix(".png"), folder)
    said = {"image": "visibility.png", "resolution": 0.1, "origin": "[0, 0, 0]"} | changes
    (folder / MAP.name).write_text("".join(f"{key}: {value}\n" for key, value in said.items()))
    return folder / MAP.name


def test_an_image_beside_its_yaml_is_in_another_frame(few: Path, tmp_path: Path) -> None:
    image = copy_of_map(tmp_path, origin="[-12.5, -8, 0]", negate=1).with_suffix(".png")
    resolution = load_map(MAP).resolution
    said = f"{image}: visibility.yaml, which is of this image, is ignored: origin [-12.5, -8, 0]"
    for name, err in by_all(image, few, tmp_path, "--resolution", resolution).items():
        assert err.count(said) == 1, (name, err)
        assert "negate true there, false here; poses are" in err
    both = ("--resolution", 2 * resolution, "--scans-index", 0)
    assert f"resolution {resolution:g} there" in call("localize", image, few, *both).err
    same = ("--resolution", resolution, "--origin", "-12.5,-8,0", "--scans-index", 0)
    assert "is ignored" not in call("localize", image, few, *same, "--negate").err
    (tmp_path / MAP.name).unlink()
    assert "frame" not in call("localize", image, few, *same[:2], "--scans-index", 0).err


def test_unknown_cells_that_count_as_free_are_said(few, tmp_path, caplog, monkeypatch):
    pixels = np.array(PIL.Image.open(MAP.with_suffix(".png")))
    pixels[pixels > 128] = 254
    pixels[:20] = 205
    path = copy_of_map(tmp_path, free_thresh=0.25)
    PIL.Image.fromarray(pixels).save(path.with_suffix(".png"))
    said = f"{20 * pixels.shape[1]:,} cells of grey 205, map_saver's unknown, count as free"
    for name, err in by_all(path, few, tmp_path).items():
        assert err.count(said) == 1, (name, err)
        assert "0.196 keep them unknown" in err
    assert said in call("map", "check", path).out
    assert said not in call("localize", path, few, "--scans-index", 0, "--free-thresh", 0.196).err
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    with caplog.at_level(logging.WARNING):
        load_map(path)
    assert said in caplog.text


# --- the environment


def test_a_limit_of_the_cache_that_is_no_number_is_refused(log, tmp_path, monkeypatch):
    for value in ("abc", "-5", "1e3", "٣", "9" * 400):
        monkeypatch.setenv("IMGLOC_CACHE_MIB", value)
        with pytest.raises(ConfigError, match="expected a whole number of MiB, such as 2048"):
            cache_limit()
    monkeypatch.setenv("IMGLOC_CACHE_MIB", "abc")
    for run in (
        call("localize", MAP, log),
        call("track", MAP, log),
        call("batch", MAP, log, "--out", tmp_path / "out"),
        call("cache"),
    ):
        run.ends(2, "IMGLOC_CACHE_MIB: got 'abc', expected a whole number of MiB, such as")
    assert call("localize", MAP, log, "--scans-index", 0, "--no-cache").code == 0
    monkeypatch.setenv("IMGLOC_CACHE_MIB", "3")
    assert cache_limit() == 3 << 20
