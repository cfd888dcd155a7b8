"""`imgloc simulate` and `imgloc localize`, from file to file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call, rows, simulating, spawn, untimed

import imgloc
from imgloc import ALL_METHODS, ScanSet, load_map, load_scans, save_map, save_scans
from imgloc.geometry import transform_poses
from imgloc.model import LaserScan, Pose2D

CURVED = MAPS / "curved.yaml"
KEYS = [
    "index",
    "verdict",
    "pose",
    "base_pose",
    "hypotheses",
    "elsewhere",
    "protection",
    "things",
    "evidence",
    "complete",
    "entropy",
    "explained",
    "counts",
    "timings_ms",
    "parameters",
]


scans = simulating(CURVED, "-n", 3, "--dropped", 0.1)


def test_simulate_writes_what_it_was_asked_for(tmp_path: Path) -> None:
    out = tmp_path / "s.npz"
    words = ["simulate", CURVED, "-n", 4, "--rays", 90, "--fov-deg", 270, "--range-max", 3]
    words += ["--seed", 5, "--dropped", 0.2, "--out", out]
    code, text, err = call(*words)
    assert (code, text) == (0, "")
    assert err == f"imgloc: wrote {out}: 4 scans of 90 readings, with their poses\n"
    made = load_scans(out)
    assert len(made) == 4
    assert made[0].range_max == 3
    np.testing.assert_allclose(np.rad2deg(made[0].angles[[0, -1]]), [-135, 135])
    ranges = np.stack([s.ranges for s in made.scans])
    assert 0.1 < np.isnan(ranges).mean() < 0.3
    assert np.isinf(ranges).any()
    assert ranges[np.isfinite(ranges)].max() <= 3
    first = out.read_bytes()
    assert call(*words).code == 1  # it exists
    assert call(*words, "--force").code == 0
    assert out.read_bytes() == first


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (["--sigma", "nan"], 2, "--sigma: got nan"),
        (["-n", "10000000"], 2, "MiB: simulate fewer scans"),
        (["--clearance", "50"], 3, "50.0 m away"),
        (["--out", "no/such/folder.npz"], 1, "there is no folder"),
        (["--out", "scans.txt"], 2, "ends in .npz"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_simulate_refuses(words: list[str], code: int, expected: str, tmp_path: Path) -> None:
    call("simulate", CURVED, "--out", tmp_path / "s.npz", *words).ends(code, expected)
    assert not list(tmp_path.iterdir())


def test_json_has_the_documented_keys_and_the_right_poses(scans: Path) -> None:
    code, out, err = call("localize", CURVED, scans, "--json", "--top", 2)
    assert (code, err) == (0, "")
    answers = rows(out)
    assert [a["index"] for a in answers] == [0, 1, 2]
    truth = load_scans(scans).poses
    for answer, pose in zip(answers, truth, strict=True):
        assert list(answer) == KEYS
        assert answer["verdict"] == "unique"
        assert list(answer["pose"]) == ["x", "y", "theta"]
        assert np.hypot(answer["pose"]["x"] - pose[0], answer["pose"]["y"] - pose[1]) < 0.1
        assert 1 <= len(answer["hypotheses"]) <= 2
        best = answer["hypotheses"][0]
        assert list(best) == ["x", "y", "theta", "mass", "log_likelihood", "covariance"]
        assert np.linalg.eigvalsh(best["covariance"]).min() > 0
        assert answer["counts"]["nan"] > 0
        assert sum(answer["counts"].values()) == 181
        assert answer["parameters"]["range_max"] == 30


def test_the_evidence_is_in_the_json_and_in_the_text(scans: Path) -> None:
    words = ("localize", CURVED, scans, "--scans-index", 0, "--method", "fused", "--top", 1)
    (answer,) = rows(call(*words, "--json").out)
    evidence = answer["evidence"]
    assert list(evidence) == [
        "readings", "misfit", "temperature", "base", "strain", "number", "cell",
        "unmapped", "gained", "against", "mapped", "through", "scale", "thinner",
        "bent", "found", "listed", "unlisted", "floor", "floor_distance", "floor_direction",
    ]  # fmt: skip
    t = (evidence["base"] + evidence["strain"]) * evidence["number"] * evidence["cell"]
    assert evidence["temperature"] == pytest.approx(t)
    assert evidence["listed"] == len(answer["hypotheses"]) == 1 < evidence["found"]
    mass = answer["hypotheses"][0]["mass"]
    assert mass + evidence["unlisted"] + answer["elsewhere"] == pytest.approx(1)
    line = next(x for x in call(*words).out.splitlines() if x.startswith("  poses "))
    assert f"1 of {evidence['found']} places shown; the rest share " in line
    assert line.endswith(" that none is right")


def test_the_same_bytes_for_every_run_and_number_of_threads(scans: Path) -> None:
    words = ("localize", CURVED, scans, "--json", "--threads")
    once, again, two = spawn(*words, 1), call(*words, 1), call(*words, 2)
    assert once.code == 0
    assert len(rows(once.out)) == 3
    assert untimed(once.out) == untimed(again.out) == untimed(two.out)


@pytest.mark.parametrize("method", ALL_METHODS)
def test_every_method_answers(method: str, scans: Path) -> None:
    words = ["localize", CURVED, scans, "--json", "--method", method, "--scans-index", 1]
    (answer,) = rows(call(*words, "--theta-step-deg", 10, "--cell", 0.2).ends(0).out)
    assert answer["index"] == 1
    parameters = answer["parameters"]
    assert parameters["method"] == method
    assert parameters["map"]["cell"] == pytest.approx(0.2)
    step = parameters["fused"]["theta_step"] if method == "fused" else parameters["theta_step"]
    assert step == pytest.approx(np.deg2rad(10))


def test_origin_with_a_yaw_moves_every_pose(scans: Path, tmp_path: Path) -> None:
    origin, turned = Pose2D(3.0, -2.0, 0.7), tmp_path / "turned.yaml"
    save_map(turned, replace(load_map(CURVED), origin=origin))
    by_yaml = rows(call("localize", turned, scans, "--json").out)
    by_option = rows(call("localize", CURVED, scans, "--json", "--origin", "3,-2,0.7").out)
    for a, b in zip(by_yaml, by_option, strict=True):
        assert a["hypotheses"] == b["hypotheses"]
    # Simulated poses are of the map frame too.
    for path, name in ((CURVED, "a"), (turned, "b")):
        assert call("simulate", path, "-n", 2, "--out", tmp_path / f"{name}.npz").code == 0
    a, b = (load_scans(tmp_path / f"{name}.npz") for name in "ab")
    np.testing.assert_allclose(b.poses, transform_poses(origin, a.poses), atol=1e-9)
    np.testing.assert_array_equal(a[1].ranges, b[1].ranges)
    text = call("localize", turned, tmp_path / "b.npz", "--scans-index", 0).out
    error = next(line for line in text.splitlines() if line.startswith("  error")).split()
    assert float(error[1]) < 0.1


def test_text_is_a_table_for_one_scan_and_a_line_for_each_of_several(scans: Path) -> None:
    one = call("localize", CURVED, scans, "--scans-index", 2).ends(0)
    assert one.out.startswith("scan 2: unique\n  pose       x ")
    assert "| 1 | " in one.out
    assert one.out.isascii()
    several = call("localize", CURVED, scans).out.splitlines()
    assert several[0].split()[:2] == ["index", "verdict"]
    assert [line.split()[:2] for line in several[1:]] == [[str(k), "unique"] for k in range(3)]


def test_a_line_says_how_much_mass_is_not_listed(tmp_path: Path) -> None:
    words = ["corridor", tmp_path / "short.npz", "--top", 1]
    assert call("simulate", "corridor", "-n", 2, "--range-max", 3, "--out", words[1]).code == 0
    answers = rows(call("localize", *words, "--json").out)
    header, *lines = call("localize", *words).out.splitlines()
    assert max(map(len, [header, *lines])) <= 80
    start = header.index("unlisted")
    for line, answer in zip(lines, answers, strict=True):
        rest = 100 * (1 - answer["hypotheses"][0]["mass"])
        assert line[start : start + 8].split() == [f"{rest:.1f}", "%"]
    assert max(1 - answer["hypotheses"][0]["mass"] for answer in answers) > 0.1


def test_pictures_are_numbered_when_there_are_several(scans: Path, tmp_path: Path) -> None:
    words = ["localize", CURVED, scans, "--picture", tmp_path / "out.png", "--threads", 1]
    assert call(*words, "--scans-index", 1).code == 0
    assert [p.name for p in tmp_path.iterdir()] == ["out.png"]
    assert call(*words, "--force").code == 0
    numbered = [f"out-000{k}.png" for k in range(3)]
    assert sorted(p.name for p in tmp_path.iterdir()) == [*numbered, "out.png"]
    assert (tmp_path / "out-0001.png").read_bytes() == (tmp_path / "out.png").read_bytes()
    (tmp_path / "out.png").unlink()
    (tmp_path / "out-0001.png").write_text("mine")
    code, out, err = call(*words)
    assert (code, out) == (1, "")  # before anything is computed
    assert "out-0000.png: exists already; pass --force" in err
    assert (tmp_path / "out-0001.png").read_text() == "mine"


def test_strict_exits_with_6_after_all_answers(tmp_path: Path) -> None:
    blind = LaserScan(np.full(20, np.nan), np.linspace(-1, 1, 20), range_max=10.0)
    path = tmp_path / "blind.npz"
    save_scans(path, ScanSet((blind, blind)))
    code, out, err = call("localize", CURVED, path, "--json", "--strict")
    assert (code, err) == (6, "")
    assert [r["verdict"] for r in rows(out)] == ["invalid", "invalid"]
    assert all(r["pose"] is None and r["hypotheses"] == [] for r in rows(out))
    assert call("localize", CURVED, path).code == 0
    text = call("localize", CURVED, path, "--scans-index", 0, "--picture", tmp_path / "p.png")
    assert text.out.startswith("scan 0: invalid\n  readings   0 valid")
    assert (tmp_path / "p.png").exists()


def test_a_scan_without_a_limit_has_no_infinity_in_json(tmp_path: Path, scans: Path) -> None:
    scan = load_scans(scans)[0]
    path = tmp_path / "unlimited.npz"
    save_scans(path, ScanSet((LaserScan(scan.ranges, scan.angles),)))
    (row,) = rows(call("localize", CURVED, path, "--json").out)
    assert row["parameters"]["range_max"] is None
    assert row["verdict"] == "unique"


@pytest.mark.parametrize(
    ("sentinel", "method"), [(1e6, "fused"), (1.7e308, "fused"), (1.7e308, "beam")]
)
def test_codes_for_no_return_need_no_limit_of_the_range(sentinel, method, scans, tmp_path):
    scan = load_scans(scans)[0]
    answers = []
    for name, value in (("plain", np.inf), ("coded", sentinel)):
        ranges = scan.ranges.copy()
        ranges[::7] = value
        np.savez(tmp_path / f"{name}.npz", ranges=ranges, angles=scan.angles)
        words = ("--json", "--method", method, "--theta-step-deg", 10, "--cell", 0.2)
        code, out, err = call("localize", CURVED, tmp_path / f"{name}.npz", *words)
        assert (code, err) == (0, "")  # no warning of NumPy's, either
        answers.append(untimed(out))
    assert rows(answers[0][0])[0]["counts"]["no_return"] == 26
    assert answers[0] == answers[1]


def test_a_picture_names_map_file_scan_and_verdict_and_has_axes(tmp_path: Path) -> None:
    """A map that is just called map.yaml goes by its folder."""
    folder = tmp_path / "attic"
    folder.mkdir()
    text = (MAPS / "curved.yaml").read_text()
    (folder / "map.yaml").write_text(text.replace("curved.png", "map.png"))
    (folder / "map.png").write_bytes((MAPS / "curved.png").read_bytes())
    features = imgloc.prepare(imgloc.load_map(folder / "map.yaml"))
    scans = imgloc.simulate(features.grid, 3, seed=4)
    imgloc.save_scans(tmp_path / "run.npz", scans)
    target = tmp_path / "where.png"
    asked = ("--scans-index", 2, "--picture", target, "--no-cache")
    call("localize", folder / "map.yaml", tmp_path / "run.npz", *asked).ends(0)
    answer = imgloc.localize(features, scans[2])
    about = {"truth": imgloc.Pose2D(*scans.poses[2]), "title": "attic: run.npz, scan 2"}
    imgloc.draw(features, answer, scans[2], **about).save(tmp_path / "same.png")
    assert target.read_bytes() == (tmp_path / "same.png").read_bytes()
