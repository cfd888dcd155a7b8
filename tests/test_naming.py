"""Shares of scans whose map is named, for scans whose map is known."""

import numpy as np
import pytest

from imgloc.errors import ConfigError
from imgloc.io.maps import save_map
from imgloc.io.scans import save_scans
from imgloc.simulate import Sensor, simulate_set
from imgloc.worlds import WORLDS, render
from tools.trust.naming import ask_all, naming_shares, scans_of


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
    found = naming_shares(asked, fits, sure=0.5, buildings={})
    named = found["right"]["hits"]
    assert named >= 3
    assert len(found["not right"]) == 4 - named
    other = {"curved": "corridor", "corridor": "curved"}
    swapped = [(other[name], scan) for name, scan in asked]
    wrong = naming_shares(swapped, fits, sure=0.5, buildings={})
    assert (wrong["right"]["hits"], wrong["wrong"]["hits"]) == (0, named)
    one = naming_shares(swapped, fits, sure=0.5, buildings=dict.fromkeys(maps, "house"))
    assert (one["right"]["hits"], one["wrong"]["hits"]) == (named, 0)


def test_recorded_scans_come_before_simulated_ones(maps):
    recorded = simulate_set(render(WORLDS["curved"](), 0.1), 3, 9, Sensor(rays=31))
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
