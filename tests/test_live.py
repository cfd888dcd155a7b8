"""One live core: maps held ready, one scan at a time, what is dropped is said."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from command import MAPS

import imgloc
from imgloc import Dropped, LaserScan, Localizer, MapFeatures
from imgloc.model import to_json
from imgloc.output.rows import answer_row

NAMES = ("curved", "corridor", "visibility")


@pytest.fixture(scope="module")
def scans() -> list[LaserScan]:
    grid = imgloc.load_map(MAPS / "curved.yaml")
    made = imgloc.simulate(grid, 6, seed=1)
    return [replace(scan, stamp=float(k)) for k, scan in enumerate(made.scans)]


@pytest.fixture(scope="module")
def core() -> Iterator[Localizer]:
    made = {n: (lambda n=n: imgloc.load_map(MAPS / f"{n}.yaml")) for n in NAMES}
    with Localizer(made, background=True) as core:
        assert core.wait(60)
        yield core


def same(row: dict[str, object]) -> str:
    return to_json({**row, "timings_ms": None})


def test_an_answer_is_that_of_localize_and_says_whose_it_is(
    core: Localizer, scans: list[LaserScan]
) -> None:
    features = imgloc.prepare(imgloc.load_map(MAPS / "curved.yaml"))
    for scan in scans[:3]:
        answer = core.localize(scan, "curved")
        alone = imgloc.localize(features, scan)
        assert same(answer_row(answer.value, scan)) == same(answer_row(alone, scan))
        assert (answer.map, answer.stamp) == ("curved", scan.stamp)
        assert answer.took_ms > 0
        assert json.loads(to_json(answer.about()))["stamp"] == scan.stamp


def made_lazily(features: MapFeatures) -> dict[str, set[str]]:
    """Names of what a map holds, and of what its thinner walls hold."""
    out = {"0": set(vars(features))}
    for cells, there in vars(features).get("_thinner", {}).items():
        out[str(cells)] = set(vars(there))
    return out


def test_nothing_is_made_of_a_map_after_it_is_ready(scans: list[LaserScan]) -> None:
    features = imgloc.prepare(imgloc.load_map(MAPS / "curved.yaml"))
    with Localizer(features) as core:
        assert core.ready
        before = made_lazily(features)
        rng = np.random.default_rng(1)
        strange = [replace(s, ranges=s.ranges * 1.06) for s in scans[:2]]
        strange += [replace(s, ranges=rng.uniform(1, 9, len(s.ranges))) for s in scans[:2]]
        strange += [replace(s, ranges=s.ranges + 0.15) for s in scans[:2]]
        for scan in scans + strange:
            core.localize(scan)
            core.update(replace(scan, stamp=math.nan), np.zeros(3))
    assert made_lazily(features) == before


def test_a_newer_scan_replaces_the_one_that_waits(core: Localizer, scans: list[LaserScan]) -> None:
    before = core.dropped
    asked = [core.localize_soon(scan, "curved", source="a") for scan in scans]
    other = core.localize_soon(scans[0], "curved", source="b")
    told = []
    for scan, future in zip(scans, asked, strict=True):
        try:
            told.append(future.result().stamp == scan.stamp)
        except Dropped as error:
            told.append(error.why == "replaced")
    assert all(told)
    last = asked[-1].result()
    assert last.stamp == scans[-1].stamp
    assert last.dropped == core.dropped - before
    assert last.dropped >= len(scans) - 2
    assert other.result().dropped == 0
