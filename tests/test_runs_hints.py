"""What a batch says at its end of scans that fit nowhere: the cause, tried, and where."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import MAPS

from imgloc import BatchSummary, Evidence, Options, ScanSet, Sensor, prepare, run_batch, save_scans
from imgloc.answers.diagnose import doubts
from imgloc.errors import as_options
from imgloc.output.report import render_report
from imgloc.output.tables import batch_text
from imgloc.runs.hints import Doubtful
from imgloc.runs.jobs import Item
from imgloc.runs.results import read_rows
from imgloc.simulation.scans import simulate
from imgloc.simulation.worlds import WORLDS, render

MILLIMETRES = "are they millimetres? Try `range_scale=0.001`"


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, BatchSummary]:
    """A batch of two maps with two files of one of them, one of these in millimetres."""
    folder = tmp_path_factory.mktemp("site")
    for name in ("floors", "scans"):
        (folder / name).mkdir()
    for name in ("curved", "visibility"):
        for ending in (".yaml", ".png"):
            (folder / "floors" / f"{name}{ending}").write_bytes(
                (MAPS / (name + ending)).read_bytes()
            )
    scans = simulate(render(WORLDS["curved"](), 0.1), 2, 5, Sensor(rays=180, fov=2 * np.pi))
    save_scans(folder / "scans" / "good.npz", scans)
    with np.load(folder / "scans" / "good.npz") as held:
        changed = dict(held) | {"ranges": 1000 * held["ranges"], "range_max": 30_000.0}
    np.savez(folder / "scans" / "mm.npz", **changed)
    with ThreadPoolExecutor(2) as threads:
        summary = run_batch(folder / "floors", folder / "scans", folder / "out", executor=threads)
    return folder, summary


def test_a_batch_ends_with_what_keeps_scans_from_fitting(found: tuple[Path, BatchSummary]) -> None:
    folder, summary = found
    (hint,) = summary.hints
    assert hint["hint"].endswith(MILLIMETRES)
    # What fits one of the maps is not doubtful on the other.
    names = ["mm.npz on curved", "mm.npz on visibility"]
    assert (hint["items"], hint["of"], hint["first"]) == (2, 2, names)
    text = batch_text(summary, "out")
    assert "2 of 2 doubtful items tried again, for example mm.npz on curved: half of" in text
    assert json.loads((folder / "out" / "summary.json").read_text())["hints"] == summary.hints
    page = render_report(folder / "out")
    assert "What to look at next" in page
    assert as_options(MILLIMETRES) in page


def test_known_poses_are_said_to_count_on_every_map(found: tuple[Path, BatchSummary]) -> None:
    _, summary = found
    assert (summary.known, summary.pairs, summary.files) == (8, 4, 2)
    text = batch_text(summary, "out")
    assert "of 8 scans with a known pose 2 are right (25.0 %), 0 unique and wrong" in text
    assert "2 files count on every map, in 4 pairs; a CSV of pairs (map,scans) assigns" in text
    assert "pairs" not in batch_text(BatchSummary(known=3, hits=3, pairs=2, files=2), "out")


def test_a_run_with_nothing_left_to_do_keeps_the_hints(found: tuple[Path, BatchSummary]) -> None:
    folder, summary = found
    with ThreadPoolExecutor(1) as threads:
        where = (folder / "floors", folder / "scans", folder / "out")
        again = run_batch(*where, executor=threads, resume=True)
    assert (again.new, again.hints) == (0, summary.hints)


def test_doubtful_items_are_of_many_files_and_maps(found: tuple[Path, BatchSummary]) -> None:
    folder, _ = found
    rows = list(read_rows(folder / "out"))
    item = Item("curved", "mm.npz", ())
    doubtful = Doubtful()
    assert list(doubtful.noting(rows)) == rows
    assert [it.id for it, _ in doubtful.of([item])] == [item.id]
    (bad,) = (row for row in rows if (row["map"], row["scans"]) == item.id)
    many = Doubtful()
    items = [Item(f"m{m}", f"f{f}.npz", ()) for m in range(5) for f in range(40)]
    for _ in many.noting(bad | {"map": it.map, "scans": it.scans} for it in items):
        pass
    tried = [it for it, _ in many.of(items)]
    assert len(tried) == 12
    assert len({it.scans for it in tried}) >= 8
    assert len({it.map for it in tried}) >= 4


@pytest.mark.parametrize(("lost", "tried"), [(15, 0), (25, 12)])
def test_a_file_of_one_scan_is_doubtful_where_most_are(found, lost, tried):
    rows = {(row["map"], row["scans"]): row for row in read_rows(found[0] / "out")}
    good, bad = (rows["curved", name] for name in ("good.npz", "mm.npz"))
    items = [Item("curved", f"f{k}.npz", ()) for k in range(40)]
    doubtful = Doubtful()
    for k, item in enumerate(items):
        row = bad if k < lost else good
        said = {"scans": item.scans, "answers": row["answers"][:1]}
        list(doubtful.noting([row | said]))
    assert len(doubtful.of(items)) == tried


@pytest.mark.parametrize("error", [{"scale": 1.04}, {"thinner": 2}])
def test_a_few_scans_that_are_bent_are_no_reason_to_say_so(found, error):
    folder, _ = found
    rows = {(row["map"], row["scans"]): row for row in read_rows(folder / "out")}
    good = rows["curved", "good.npz"]
    bent = json.loads(json.dumps(good))
    for answer in bent["answers"]:
        answer["evidence"] |= error
    for straight, count in ((3, 0), (1, 2)):
        some = [bent, bent, *[good] * straight]
        doubtful, items = Doubtful(), [Item("curved", f"{k}", ()) for k in range(len(some))]
        named = (row | {"scans": item.scans} for row, item in zip(some, items, strict=True))
        assert len(list(doubtful.noting(named))) == len(some)
        assert len(doubtful.of(items)) == count


def test_where_several_places_fit_as_they_are_nothing_else_is_tried() -> None:
    grid = render(WORLDS["large"](), 0.1)
    features, scans = prepare(grid, ready=False), simulate(grid, 1, 1, Sensor(rays=91)).scans
    hanging = [scan.flipped for scan in scans]
    for misfit, count in ((0.1, 0), (0.5, 1)):
        said = [("ambiguous", Evidence(misfit=misfit))]
        found = doubts(features, ScanSet(tuple(hanging)), said, Options())
        assert len(found) == count
    assert "Try `flipped=True`" in found[0].said
    assert doubts(features, ScanSet(tuple(hanging)), [("no-match", Evidence())], Options()) == found
    noise = [
        replace(hanging[0], ranges=np.random.default_rng(0).uniform(1, 9, hanging[0].ranges.size))
    ]
    (found,) = doubts(features, ScanSet(tuple(noise)), [("no-match", Evidence())], Options())
    assert found.short.startswith("another map?")


@pytest.mark.parametrize(
    ("verdicts", "misfit", "looked_at"),
    [
        (("ambiguous",) * 3, 2.0, 1),  # several places, none of them well
        (("ambiguous",) * 3, 0.1, 0),  # several places, as they are
        (("unique",) * 2 + ("no-match",) * 4 + ("ambiguous",) * 4, 0.1, 0),
        (("unique",) * 2 + ("no-match",) * 4 + ("ambiguous",) * 4, 2.0, 1),
    ],
)
def test_what_is_looked_at_again_is_what_is_doubtful(found, verdicts, misfit, looked_at):
    row = next(read_rows(found[0] / "out"))
    answers = [
        answer | {"verdict": verdict, "evidence": answer["evidence"] | {"misfit": misfit}}
        for verdict, answer in zip(verdicts, row["answers"][:1] * len(verdicts), strict=True)
    ]
    doubtful = Doubtful()
    list(doubtful.noting([row | {"map": "m", "scans": "s.npz", "answers": answers}]))
    assert len(doubtful.of([Item("m", "s.npz", ())])) == looked_at
