"""Shares of scans whose map is named, for scans whose map is known."""

import json

import numpy as np
import pytest
from command import run

from imgloc import ConfigError, Sensor, save_map, save_scans, simulate
from imgloc.simulation.worlds import WORLDS, render
from tools.trust.__main__ import main
from tools.trust.naming import ask_all, bound_all, naming_shares, scans_of


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    folder = tmp_path_factory.mktemp("naming")
    paths = {}
    for name in ("curved", "corridor"):
        paths[name] = folder / name / "map.yaml"
        paths[name].parent.mkdir()
        save_map(paths[name], render(WORLDS[name](), 0.1))
    return paths


def test_the_right_map_is_named_and_a_wrong_name_is_noticed(maps):
    asked = scans_of(maps, 4, 3)
    assert [name for name, _ in asked] == ["curved", "curved", "corridor", "corridor"]
    calls = []
    fits = ask_all(maps, asked, threads=1, advance=lambda: calls.append(1))
    assert len(calls) == 8
    bounds = bound_all(maps, asked, threads=1)
    found = naming_shares(asked, fits, bounds, sure=0.5, buildings={})
    assert found["as of a search of all maps to the end"]["trials"] == 8
    named = found["right"]["hits"]
    assert named >= 3
    assert len(found["not right"]) == 4 - named
    other = {"curved": "corridor", "corridor": "curved"}
    swapped = [(other[name], scan) for name, scan in asked]
    wrong = naming_shares(swapped, fits, bounds, sure=0.5, buildings={})
    assert (wrong["right"]["hits"], wrong["wrong"]["hits"]) == (0, named)
    one = naming_shares(swapped, fits, bounds, sure=0.5, buildings=dict.fromkeys(maps, "house"))
    assert (one["right"]["hits"], one["wrong"]["hits"]) == (named, 0)


def test_recorded_scans_come_before_simulated_ones(maps):
    recorded = simulate(render(WORLDS["curved"](), 0.1), 3, 9, Sensor(rays=31))
    path = maps["curved"].with_name("scans.npz")
    save_scans(path, recorded)
    try:
        asked = scans_of({"curved": maps["curved"]}, 2, 0)
    finally:
        path.unlink()
    assert len(asked) == 2
    assert all(len(scan.ranges) == 31 for _, scan in asked)
    assert all(np.isfinite(scan.ranges).any() for _, scan in asked)


@pytest.mark.parametrize(("n", "some", "said"), [(0, True, "at least 1"), (1, False, "no map")])
def test_nothing_to_ask(maps, n, some, said):
    with pytest.raises(ConfigError, match=said):
        scans_of(maps if some else {}, n, 0)


# --- the command


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two maps, one of them with scans beside it, and a map that is another name of one."""
    out = tmp_path_factory.mktemp("maps")
    for name in ("curved", "corridor"):
        (out / name).mkdir()
        grid = render(WORLDS[name](), 0.1)
        save_map(out / name / "map.yaml", grid)
    save_scans(out / "corridor" / "scans.npz", simulate(grid, 3, 3, Sensor()))
    return out


def test_recorded_and_simulated_scans_are_asked_of_all_maps(folder):
    done = run(main, "which", folder, "-n", 2).ends(0)
    found = json.loads(done.out)
    assert (found["scans"], found["maps"]) == (2, 2)
    named = found["named with 0.5 or more"]
    assert (named["right"]["hits"], named["wrong"]["hits"]) == (2, 0)
    assert named["not right"] == []
    assert named["silent without its map"]["trials"] == 2


def test_two_maps_of_one_building_count_as_one(folder):
    done = run(main, "which", folder, "-n", 2, "--same", "curved,corridor")
    named = json.loads(done.out)["named with 0.5 or more"]
    assert named["right"]["hits"] == 2
    assert named["silent without its map"]["hits"] == 2  # none is left
