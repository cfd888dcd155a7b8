"""Which map a scan is from: evidence across maps, and the command."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call, rows

from imgloc import ConfigError, Options, Sensor, Trust, load_map, prepare, save_map, simulate
from imgloc.choice.choose import LUCK, choose, fit, log_evidence, names_of, unknown_evidence
from imgloc.io.folders import find_maps
from imgloc.model import Evidence, Hypothesis, Localization, OccupancyGrid, Pose2D
from imgloc.numbers import number
from imgloc.simulation.worlds import WORLDS, render


def made(*scores: float, log_volume: float = -10.0) -> Localization:
    """An answer by 100 readings, each worth 1.5 nats at best, and half a nat on no map.

    The map explains 20 pieces of the scan, or none where it fits badly.
    """
    hypotheses = tuple(Hypothesis(Pose2D(0, 0), s, 0.5, np.eye(3)) for s in scores)
    misfit = 1.5 - scores[0] / 100 if scores else np.nan
    temperature = Trust().temperature_at(misfit)
    gained = (scores[0] - 50) / temperature.value if scores else np.nan
    evidence = Evidence(
        100, 1.5, misfit, 0.5, gained, -number("weigh.pieces") * np.log(1 + 20 * (misfit < 2)),
        temperature=temperature, log_volume=log_volume,
    )  # fmt: skip
    return Localization(hypotheses, "unique", 0.0, 1.0, evidence=evidence)


def test_evidence_is_a_sum_over_modes() -> None:
    assert log_evidence(made(120.0, 120.0), 1.0) == pytest.approx(120 - 10 + np.log(2))
    assert log_evidence(made(120.0), 4.0) == pytest.approx(30 - 10 + 1.5 * np.log(4))
    assert log_evidence(made(), 1.0) == -np.inf


def test_of_two_maps_that_fit_alike_the_smaller_is_likelier() -> None:
    choice = choose({"large": made(140.0, log_volume=-13.0), "small": made(140.0)})
    assert list(choice.probability) == ["small", "large"]
    odds = choice.probability["small"] / choice.probability["large"]
    assert odds == pytest.approx(np.exp(3))


def test_probabilities_and_none_sum_to_one() -> None:
    choice = choose({"a": made(140.0), "b": made(139.0), "c": made()})
    assert choice.log_evidence["a"] == 0.0
    assert choice.log_evidence["c"] < choice.log_evidence["b"] < 0.0
    assert sum(choice.probability.values()) + choice.none == pytest.approx(1)
    assert choice.probability["c"] == 0
    assert choice.verdict == "undecided"
    assert choose({"a": made(140.0), "b": made(139.0)}, sure=0.5).verdict == "a"
    assert choose({"a": made(140.0), "b": made(120.0)}).verdict == "a"
    assert choose({"a": made(140.0), "b": made(140.0)}).verdict == "undecided"


def test_of_few_maps_only_one_in_which_the_place_is_unique_is_named() -> None:
    twins = replace(made(140.0), verdict="ambiguous")
    others = {f"other {k}": made(-60.0) for k in range(4)}
    assert choose({"a": twins}).verdict == "undecided"
    assert choose({"a": made(140.0)}).verdict == "a"
    assert choose({"a": twins} | dict(list(others.items())[:3])).verdict == "undecided"
    assert choose({"a": twins} | others).verdict == "a"


def test_the_better_fit_is_named_and_a_bad_one_is_none() -> None:
    assert choose({"a": made(140.0), "b": made(-100.0)}).verdict == "a"
    assert choose({"a": made(-300.0), "b": made(-310.0)}).verdict == "none"
    assert choose({"a": made(), "b": made()}).verdict == "none"


def test_a_map_is_not_named_for_fitting_by_chance() -> None:
    chance = {"a": made(50.0), "b": made(30.0), "c": made(30.0)}  # 1 nat per reading is missing
    assert choose({"a": chance["a"], "b": chance["b"]}).verdict == "a"  # two say nothing of chance
    choice = choose(chance)
    assert choice.verdict == "none"
    assert sum(choice.probability.values()) + choice.none == pytest.approx(1)
    assert choose(chance | {"own": made(120.0)}).verdict == "own"


def test_chance_is_what_the_third_best_map_reaches() -> None:
    twins = {"floor": made(70.0), "half": made(69.0)}
    some = {f"other {k}": made(-60.0) for k in range(9)}
    choice = choose(twins | some, sure=0.5)
    assert choice.verdict == "floor"  # two maps of one building are no evidence against it
    assert choice.none == pytest.approx(choose(twins | {"other": made(-60.0)}).none, abs=1e-3)
    assert choose(twins | some | {"third": made(68.0)}, sure=0.5).verdict == "none"


def test_what_fits_too_well_for_chance_is_not_none() -> None:
    floors = {name: made(140.0) for name in ("first", "second", "third")}
    choice = choose(floors)
    assert choice.verdict == "undecided"
    assert choice.none < 0.1


def test_an_unknown_building_may_lead_the_third_best() -> None:
    assert unknown_evidence([-9.0, -8.0, 31.0, -12.0], 6.0) == -3.0
    assert unknown_evidence([50.0, 49.0, 48.0], 6.0) == LUCK
    assert unknown_evidence([50.0, 49.0], 6.0) == -np.inf
    assert unknown_evidence([50.0, 49.0, -np.inf], 6.0) == -np.inf


def test_the_temperature_is_that_of_the_best_fit() -> None:
    both = choose({"a": made(140.0), "b": made(-100.0)})
    assert both.temperature == choose({"a": made(140.0)}).temperature


def test_the_temperature_is_the_answers_own_with_the_size_of_the_cells() -> None:
    grid = load_map(MAPS / "visibility.yaml")
    scan, (height, width) = simulate(grid, 1, seed=4)[0], grid.info.shape
    fine = grid.occupied[: height // 4 * 4, : width // 4 * 4]
    walls = fine.reshape(height // 4, 4, width // 4, 4).any(axis=(1, 3))
    answer = fit(prepare(OccupancyGrid(walls, ~walls, 4 * grid.resolution, grid.origin)), scan)
    assert answer.evidence.temperature.cell > 1
    assert choose({"coarse": answer}).temperature == answer.evidence.temperature.value


def test_the_order_of_the_maps_does_not_matter() -> None:
    a, b = made(140.0), made(140.0)
    assert choose({"a": a, "b": b}) == choose({"b": b, "a": a})


def test_a_scan_that_is_invalid_everywhere_says_nothing_of_its_map() -> None:
    blind = Localization((), "invalid", 0.0, 0.0)
    choice = choose({"a": blind, "b": blind})
    assert choice.verdict == "invalid"
    assert list(choice.probability) == ["a", "b"]
    assert np.isnan([choice.none, *choice.probability.values()]).all()


def test_something_to_choose_from_is_needed() -> None:
    with pytest.raises(ConfigError, match="at least one map"):
        choose({})


def test_votes_have_no_common_scale() -> None:
    grid = render(WORLDS["curved"](), 0.1)
    scan = simulate(grid, 1, 0, Sensor()).scans[0]
    with pytest.raises(ConfigError, match="fused"):
        fit(prepare(grid), scan, Options("ght"))


def test_of_four_other_worlds_none_is_named() -> None:
    sensor = Sensor(range_max=20.0)
    simulated = simulate(render(WORLDS["curved"](), 0.1), 20, 0, sensor).scans
    scans = [simulated[k] for k in (6, 15)]  # of the others, one fits better than the next
    fits: list[dict[str, Localization]] = [{} for _ in scans]
    for name, world in WORLDS.items():
        features = prepare(render(world(), 0.1))
        for scan, found in zip(scans, fits, strict=True):
            found[name] = fit(features, scan)
    assert [choose(found).verdict for found in fits] == ["curved"] * 2
    away = [{name: f for name, f in found.items() if name != "curved"} for found in fits]
    assert not {choose(found).verdict for found in away} & set(WORLDS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two worlds, one of them in a folder of its own, and scans from the first."""
    folder = tmp_path_factory.mktemp("which")
    (folder / "floors" / "second").mkdir(parents=True)
    save_map(folder / "floors" / "curved.yaml", render(WORLDS["curved"](), 0.1))
    save_map(folder / "floors" / "second" / "map.yaml", render(WORLDS["double_wall"](), 0.1))
    scans = folder / "scans.npz"
    assert call("simulate", MAPS / "curved.yaml", "-n", 4, "--out", scans).code == 0
    return folder


def test_the_command_names_the_map(folder: Path) -> None:
    code, out, err = call("which", folder / "floors", folder / "scans.npz", "--json")
    assert (code, err) == (0, "")
    answers = rows(out)
    assert [a["index"] for a in answers] == [0, 1, 2, 3]
    assert [a["verdict"] for a in answers] == ["curved"] * 4
    for answer in answers:
        assert {m["map"] for m in answer["maps"]} == {"curved", "second"}
        assert answer["none"] + sum(m["probability"] for m in answer["maps"]) == pytest.approx(1)
        assert answer["maps"][0]["pose"] is not None


def test_without_its_map_a_scan_is_from_none(folder: Path) -> None:
    out = call("which", folder / "floors" / "second", folder / "scans.npz", "--json").out
    verdicts = [a["verdict"] for a in rows(out)]
    assert sum(v in ("none", "undecided") for v in verdicts) >= 3  # one niche looks like it


def test_text_has_a_line_for_each_scan(folder: Path) -> None:
    out = call("which", folder / "floors", folder / "scans.npz").out.splitlines()
    assert len(out) == 5
    assert out[0].split()[:2] == ["index", "verdict"]
    assert "curved" in out[1]
    assert "theta" in out[1]


def test_a_map_that_cannot_be_used_is_left_out(folder: Path, tmp_path: Path) -> None:
    save_map(tmp_path / "good.yaml", render(WORLDS["curved"](), 0.1))
    blank = np.ones((9, 9), bool)
    save_map(tmp_path / "blank.yaml", OccupancyGrid(~blank, blank, 0.1))
    (tmp_path / "broken.yaml").write_text("image: [")
    run = call("which", tmp_path, folder / "scans.npz", "--json").ends(5)
    assert run.err.count("left out") == 2
    assert all(a["verdict"] == "good" for a in rows(run.out))
    (tmp_path / "good.yaml").unlink()
    call("which", tmp_path, folder / "scans.npz").ends(3, out="")


def test_a_scan_without_readings_is_invalid(folder: Path, tmp_path: Path) -> None:
    np.savez(tmp_path / "blind.npz", ranges=np.full((1, 90), np.nan), angles=np.arange(90) / 90)
    (row,) = rows(call("which", folder / "floors", tmp_path / "blind.npz", "--json").out)
    assert (row["verdict"], row["none"]) == ("invalid", None)
    assert [m["probability"] for m in row["maps"]] == [None, None]
    line = call("which", folder / "floors", tmp_path / "blind.npz").out.splitlines()[1]
    assert line.split() == ["0", "invalid", "-", "-", "too", "few", "readings"]


@pytest.mark.parametrize("where", ["nowhere", "."])
def test_a_folder_without_maps(where: str, tmp_path: Path, folder: Path) -> None:
    call("which", tmp_path / where, folder / "scans.npz").ends(2, "map", out="")


def test_names_tell_maps_apart() -> None:
    paths = [Path(p) for p in ("m/a.yaml", "m/a/map.yaml", "m/b/c.yaml", "m/map.yaml")]
    assert names_of(paths, Path("m")) == ["a.yaml", "a/map.yaml", "b/c", "map"]
    same = [Path(p) for p in ("m/a.yaml", "m/a.yml", "m/none.yaml", "m/undecided/map.yaml")]
    assert names_of(same, Path("m")) == ["a.yaml", "a.yml", "none.yaml", "undecided/map.yaml"]
    odd = [Path(p) for p in ("m/a.yaml", "m/a.yml", "m/a.yaml/map.yaml")]
    assert len(set(names_of(odd, Path("m")))) == 3
    assert len(find_maps(MAPS)) == 5
