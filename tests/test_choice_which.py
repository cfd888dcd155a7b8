"""Which of many maps: a coarse look at all of them, an index of it on disk, a close look at few."""

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import MAPS, call, rows
from places import hall, room_with_a_post

from imgloc import MapFeatures, load_map, prepare, save_map, save_scans, simulate, which
from imgloc.choice import choose as choosing
from imgloc.choice import folder_index
from imgloc.choice.choose import FIRST, MOST, bounds_of, choose, search
from imgloc.choice.folder_index import MapIndex, index_of, open_index
from imgloc.choice.mosaic import best_fits, mosaics
from imgloc.errors import ConfigError, MapError, OutputError
from imgloc.features.pyramid import Level
from imgloc.io.calibration import calibration_path, said_scale, save_calibrations
from imgloc.io.folders import files_in, find_maps
from imgloc.likelihoods.correlate import correlate
from imgloc.model import LaserScan, Localization, OccupancyGrid, Pose2D
from imgloc.options import Options, Prior, Sensor, Shared
from imgloc.runs.results import read_rows
from imgloc.simulation.worlds import WORLDS, render
from tools.trust.thousand import ask_thousand, make_thousand, pieces, turned


def test_a_mosaic_says_of_each_map_what_its_own_stack_does() -> None:
    rng = np.random.default_rng(1)
    sizes = [(9, 12), (7, 12), (9, 11), (30, 4), (1, 1), (12, 40)]
    levels = [
        Level((rng.random(s) ** 4 * 255).astype(np.uint8), rng.random(s) < 0.5, 0.4) for s in sizes
    ]
    xy = rng.normal(size=(20, 2)) * 2
    tiles = list(mosaics(levels, [0.0] * 6))
    assert sorted(k for tile in tiles for k in tile.maps) == list(range(6))
    assert len(tiles) < 6
    found = best_fits(tiles, xy, 6, theta_step=0.3)
    thetas = np.arange(21) * (2 * np.pi / 21)
    for level, best in zip(levels, found, strict=True):
        grey = np.rint(level.image * np.float32(12 / 255)).astype(np.uint8)
        stack = correlate(grey, xy, thetas, 0.4, where=level.free)
        assert best == pytest.approx(stack.max() / (12 * 20))
    assert found.tolist() == best_fits(tiles, xy, 6, theta_step=0.3, threads=3).tolist()


def test_headings_that_may_be_are_those_of_the_map_frame() -> None:
    image = np.zeros((5, 5), np.uint8)
    image[2, 3] = 255  # ahead, or wherever the map says that is
    free = np.zeros((5, 5), bool)
    free[2, 2] = True
    tiles = list(mosaics([Level(image, free, 1.0)] * 2, [0.0, np.pi / 2]))
    ahead = Prior(None, (0.0, 0.1))
    found = best_fits(tiles, np.array([[1.0, 0.0]]), 2, theta_step=0.5, prior=ahead)
    assert found.tolist() == [1.0, 0.0]


@pytest.fixture(scope="module")
def world() -> MapFeatures:
    return prepare(render(WORLDS["curved"](), 0.1))


@pytest.fixture(scope="module")
def crowd(world: MapFeatures) -> dict[str, MapFeatures]:
    """The world, and many pieces of others."""
    others = [render(WORLDS[name](), 0.1) for name in ("corridor", "visibility", "double_wall")]
    made = pieces(others, 9, 0, 3)
    return {f"piece {k}": prepare(p.grid) for k, p in enumerate(made)} | {"curved": world}


def test_of_many_maps_few_are_searched(crowd: dict[str, MapFeatures], monkeypatch) -> None:
    scan = simulate(crowd["curved"].grid, 1, 6, Sensor(range_max=20.0)).scans[0]
    for name, value in (("FIRST", 4), ("NEXT", 1), ("MOST", 6)):
        monkeypatch.setattr(choosing, name, value)
    found = which(crowd, scan)
    assert found.verdict == "curved"
    assert 4 <= len(found.probability) <= 6
    assert found.ruled_out == len(crowd) - len(found.probability)
    monkeypatch.setattr(choosing, "FIRST", len(crowd))
    full = which(crowd, scan)
    assert (full.verdict, full.ruled_out) == ("curved", 0)
    assert full.none == pytest.approx(found.none, abs=0.01)


def answers(scores: dict[str, float]) -> dict[str, Localization]:
    from test_choice import made

    return {name: made(score) for name, score in scores.items()}


def as_they_are(name: str) -> Any:
    return choosing.nullcontext((name, choosing.OPTIONS))


def test_more_maps_are_searched_while_the_best_three_change(monkeypatch) -> None:
    def run(scores: list[float]) -> int:
        names = [f"{k:02d}" for k in range(len(scores))]
        known = answers(dict(zip(names, scores, strict=True)))
        monkeypatch.setattr(choosing, "fit", lambda features, scan, options: known[features])

        bounds = {name: -float(name) for name in names}  # best first
        (fits,) = search([None], names, lambda _: bounds, as_they_are)  # type: ignore[list-item]
        assert list(fits) == names[: len(fits)]
        return len(fits)

    falling = [140.0 - k for k in range(40)]
    assert run(falling) == FIRST
    assert run([*falling[: FIRST - 1], 150.0, *falling[FIRST:]]) == FIRST + choosing.NEXT
    assert run(falling[::-1]) == MOST
    assert run([0.0] * 5) == 5


def test_of_maps_that_are_all_searched_no_bound_is_asked_for(monkeypatch) -> None:
    known = answers({f"{k:02d}": 100.0 - k for k in range(MOST + 2)})
    monkeypatch.setattr(choosing, "fit", lambda features, scan, options: known[features])
    asked: list[None] = []

    def bounds(scan: None) -> dict[str, float]:
        asked.append(scan)
        return {name: -float(name) for name in known}

    for count, of_bounds in ((MOST + 1, 0), (MOST + 2, 1)):
        names = list(known)[:count]
        (fits,) = search([None], names, bounds, as_they_are)  # type: ignore[list-item,arg-type]
        assert (len(fits), len(asked)) == (FIRST if of_bounds else count, of_bounds)


def test_parts_of_a_scan_propose_on_the_maps_that_lead_alone(monkeypatch) -> None:
    known = answers({f"{k:02d}": 100.0 - k for k in range(FIRST)})
    asked: list[tuple[str, bool]] = []

    def fit(name: str, scan: None, options: Options) -> Localization:
        asked.append((name, np.isfinite(options.fused.unfit)))
        return known[name]

    monkeypatch.setattr(choosing, "fit", fit)
    for names in (list(known), list(known)[:3]):
        asked.clear()
        search([None], names, dict, as_they_are)  # type: ignore[list-item,arg-type]
        assert [name for name, parts in asked if parts] == ["00", "01", "02"]
        assert [name for name, parts in asked if not parts] == (names if len(names) > 3 else [])


def test_a_map_that_cannot_be_opened_is_made_up_for(monkeypatch) -> None:
    known = answers({f"{k:02d}": 100.0 - k for k in range(30)})
    monkeypatch.setattr(choosing, "fit", lambda features, scan, options: known[features])
    asked: list[str] = []

    def opened(name: str):
        asked.append(name)
        return choosing.nullcontext(None if name == "03" else (name, choosing.OPTIONS))

    bounds = {name: -float(name) for name in known}
    (fits,) = search([None], known, lambda _: bounds, opened)  # type: ignore[list-item]
    assert "03" not in fits
    assert len(fits) == FIRST
    assert asked.count("03") == 1


def test_ruled_out_maps_count_as_asked() -> None:
    from test_choice import made

    some = {"a": replace(made(140.0), verdict="ambiguous"), "b": made(-60.0)}
    assert choose(some).verdict == "undecided"
    assert choose(some, ruled_out=3).verdict == "a"
    assert choose(some, ruled_out=3).as_row(some)["ruled_out"] == 3


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder of three small maps, and the file of a scan of one of them."""
    floors = tmp_path / "floors"
    floors.mkdir()
    grid = room_with_a_post()
    save_map(floors / "post.yaml", grid)
    save_map(floors / "turned.yaml", turned(grid, (3.0, 2.0), np.array([7, 6]), 0.5, mirrored=True))
    save_map(floors / "hall.yaml", hall(50, 70))
    save_scans(tmp_path / "s.npz", simulate(grid, 2, 1, Sensor(rays=90, fov=6.0, range_max=9.0)))
    old = 1_700_000_000
    for path in floors.iterdir():
        os.utime(path, (old, old))
    return tmp_path


def opened_index(site: Path, file: Path | None = None, **more) -> tuple[MapIndex, list[str], dict]:
    """An index, and the maps that had to be prepared for it."""
    prepared: list[str] = []

    def take(path: Path) -> MapFeatures:
        prepared.append(path.stem)
        return prepare(load_map(path), path.stem)

    maps = {path.stem: path for path in find_maps(site / "floors")}
    index, errors = open_index(maps, take, about="", file=file, **more)
    return index, prepared, errors


def test_an_index_keeps_what_has_not_changed(site: Path) -> None:
    file = site / "index.npz"
    fresh, prepared, _ = opened_index(site, file)
    assert prepared == ["hall", "post", "turned"]
    kept, prepared, _ = opened_index(site, file)
    assert prepared == []
    assert kept.names == fresh.names
    for a, b in zip(kept.levels, fresh.levels, strict=True):
        assert (a.image == b.image).all()
        assert (a.free == b.free).all()
        assert a.resolution == b.resolution
    written = file.read_bytes()
    assert opened_index(site, file)[1] == []
    assert file.read_bytes() == written
    # Another time, but the same contents; then other contents of the same time and size.
    image = site / "floors" / "hall.png"
    os.utime(image)
    assert opened_index(site, file)[1] == []
    data = bytearray((site / "floors" / "hall.yaml").read_bytes())
    (site / "floors" / "hall.yaml").write_bytes(data.replace(b"0.1", b"0.2"))
    assert opened_index(site, file)[1] == ["hall"]
    (site / "floors" / "post.yaml").unlink()
    index, prepared, _ = opened_index(site, file)
    assert (index.names, prepared) == (("hall", "turned"), [])


def test_maps_that_cannot_be_used_are_not_in_the_index(site: Path) -> None:
    (site / "floors" / "broken.yaml").write_text("image: [")
    blank = np.ones((9, 9), bool)
    save_map(site / "floors" / "blank.yaml", OccupancyGrid(~blank, blank, 0.1))
    for _ in range(2):
        index, _, errors = opened_index(site, site / "index.npz")
        assert index.names == ("hall", "post", "turned")
        assert errors.keys() == {"broken", "blank"}
        assert all(isinstance(error, MapError) for error in errors.values())


def test_what_is_no_index_is_not_overwritten(site: Path) -> None:
    for data in (b"a diary", (site / "s.npz").read_bytes()):
        file = site / "mine.npz"
        file.write_bytes(data)
        with pytest.raises(OutputError, match="is no index of maps") as said:
            opened_index(site, file)
        assert "pickle" not in str(said.value)
        assert file.read_bytes() == data
    with pytest.raises(OutputError, match="is a folder, expected a map index") as said:
        opened_index(site, site)
    assert "remove it" not in str(said.value)


def test_an_index_of_another_version_is_made_anew(site: Path, monkeypatch) -> None:
    file = site / "index.npz"
    opened_index(site, file)
    monkeypatch.setattr(folder_index, "code_digest", lambda: "tomorrow")
    assert len(opened_index(site, file)[1]) == 3
    assert opened_index(site, file)[1] == []


def test_an_index_is_held_within_the_budget(site: Path) -> None:
    _, _, errors = opened_index(site, memory_budget=3000)
    assert {type(error) for error in errors.values()} == {ConfigError}
    opened_index(site, site / "index.npz")
    with pytest.raises(ConfigError, match="an index needs"):
        opened_index(site, site / "index.npz", memory_budget=3000)


def test_bounds_see_the_heading_that_is_known(site: Path) -> None:
    features = prepare(room_with_a_post())
    scan = simulate(features.grid, 1, 1, Sensor(rays=90, fov=6.0, range_max=9.0))
    index = index_of({"post": features})
    yaw = Pose2D(*scan.poses[0]).theta
    right, wrong = (
        index.bounds(scan.scans[0], Options(prior=Prior(None, (theta, 0.05))))[0]
        for theta in (yaw, yaw + 0.8)
    )
    assert right > 0.98
    assert wrong < right


def test_the_command_makes_and_uses_an_index(site: Path) -> None:
    file = site / "index.npz"
    given = ("which", site / "floors")
    call(*given, "--maps-index", file).ends(0, "3 maps", out="")
    given = (*given, site / "s.npz", "--sure", 0.8, "--json")  # two of the three are mirror images
    with_index = call(*given, "--maps-index", file)
    assert with_index == call(*given)
    assert [row["verdict"] for row in rows(with_index.out)] == ["post", "post"]
    assert [row["ruled_out"] for row in rows(with_index.out)] == [0, 0]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["{}/s.npz", "--near", "1,2,0"], "--near: is no option here; imgloc localize has it"),
        (["{}/s.npz", "--region", "a.png"], "No such option: --region"),
        ([], "expected scans"),
        (["{}/s.npz", "--maps-index", "{}/index.txt"], "ends in .npz"),
        (["{}/s.npz", "--clearance", "90"], "--clearance: no map has a place"),
        (["{}/s.npz", "--picture", "{}/floors/post.png", "--force"], "will not be overwritten"),
    ],
)
def test_what_cannot_be_meant_is_refused(words: list[str], said: str, site: Path) -> None:
    if "--picture" in words:  # of one scan it is the name itself
        one = np.load(site / "s.npz")
        np.savez(site / "s.npz", **{k: v[:1] if k == "ranges" else v for k, v in one.items()
                                    if k != "poses"})  # fmt: skip
    run = call("which", site / "floors", *(word.format(site) for word in words))
    assert run.code in (2, 1) or "overwritten" in run.err
    assert run.out == ""
    assert said in run.err


def test_priors_that_many_maps_share(site: Path) -> None:
    truth = np.load(site / "s.npz")["poses"][0, 2]
    given = ("which", site / "floors", site / "s.npz", "--json")
    told = rows(call(*given, "--heading", f"{truth},0.1", "--clearance", 0.1).out)[0]
    assert told["verdict"] == "post"
    for row in told["maps"]:
        if row["pose"] is not None:
            assert abs(np.angle(np.exp(1j * (row["pose"]["theta"] - truth)))) < 0.11


def test_a_picture_of_the_best_map(site: Path) -> None:
    call("which", site / "floors", site / "s.npz", "--picture", site / "p.png").ends(0)
    assert {path.name for path in site.glob("p*.png")} == {"p-0000.png", "p-0001.png"}
    again = call("which", site / "floors", site / "s.npz", "--picture", site / "p.png")
    assert again.code != 0
    assert "--force" in again.err


def test_bare_images_are_maps_with_a_resolution(site: Path) -> None:
    for path in (site / "floors").glob("*.yaml"):
        path.unlink()
    given = ("which", site / "floors", site / "s.npz", "--json")
    call(*given).ends(2, "pass --resolution to use its 3 images as maps")
    run = call(*given, "--resolution", 0.1)
    assert {m["map"] for m in rows(run.out)[0]["maps"]} == {"hall", "post", "turned"}
    assert max(rows(run.out)[0]["maps"], key=lambda m: m["probability"])["map"] == "post"


def test_linked_folders_are_looked_into_once(tmp_path: Path) -> None:
    tree, other = tmp_path / "tree", tmp_path / "other"
    (tree / "b").mkdir(parents=True)
    (other / "deep").mkdir(parents=True)
    for path in (tree / "b" / "m.yaml", other / "o.yaml", other / "deep" / "d.yaml"):
        shutil.copy(MAPS / "curved.yaml", path)
    links = {"a": tree / "b", "loop": tree, "up": tmp_path, "other": other, "twice": other,
             "z": other / "deep"}  # fmt: skip
    for name, target in links.items():
        (tree / name).symlink_to(target, target_is_directory=True)
    (other / "back").symlink_to(tree, target_is_directory=True)
    names = [path.relative_to(tree).as_posix() for path in files_in(tree)]
    assert names == ["b/m.yaml", "other/o.yaml", "z/d.yaml"]
    assert files_in(tree, aside=other) == [tree / "b" / "m.yaml", tree / "z" / "d.yaml"]


def test_pieces_are_turned_and_mirrored() -> None:
    grid = OccupancyGrid(np.eye(40, dtype=bool), ~np.eye(40, dtype=bool), 0.1)
    size, middle = np.array([4.0, 4.0]), (2.0, 2.0)
    same = turned(grid, middle, size, 0.0, mirrored=False)
    assert (same.occupied == grid.occupied).all()
    quarter = turned(grid, middle, size, np.pi / 2, mirrored=False)
    assert (quarter.occupied == np.rot90(grid.occupied)).all()
    mirror = turned(grid, middle, size, 0.0, mirrored=True)
    assert (mirror.occupied == grid.occupied[:, ::-1]).all()
    part = turned(grid, (1.0, 1.0), np.array([1.0, 2.0]), 0.0, mirrored=False)
    assert (part.occupied == grid.occupied[:20, 5:15]).all()


def test_pieces_keep_away_from_the_places_set_aside() -> None:
    grids = [render(WORLDS["large"](), 0.1)]
    made = list(pieces(grids, 12, 1, 0))
    home = made[0]
    assert not home.mirrored
    for piece in made[1:]:
        apart = float(np.hypot(*np.subtract(piece.centre, home.centre)))
        assert piece.mirrored or apart > piece.half + home.half
    assert {piece.mirrored for piece in made} == {False, True}
    again = list(pieces(grids, 12, 1, 0))
    assert all((a.grid.free == b.grid.free).all() for a, b in zip(made, again, strict=True))
    tiny = np.zeros((20, 20), bool)
    with pytest.raises(ConfigError, match="no 200 places"):
        list(pieces([OccupancyGrid(tiny, ~tiny, 0.1)], 1, 0, 0))
    with pytest.raises(ConfigError, match="no free cells"):
        list(pieces([OccupancyGrid(tiny, tiny, 0.1)], 1, 0, 0))


def test_a_blind_scan_is_invalid_in_many_maps(crowd: dict[str, MapFeatures]) -> None:
    blind = LaserScan(np.full(20, np.inf), np.linspace(0, 3, 20), range_max=9.0)
    found = which(crowd, blind)
    assert found.verdict == "invalid"


def test_a_thousand_maps_in_short(tmp_path: Path) -> None:
    scans = make_thousand([MAPS / "curved.yaml", MAPS / "visibility.yaml"], tmp_path, 5, 1, 0)
    found = ask_thousand(tmp_path, scans, full=True)
    assert (found.maps, found.scans, found.searched) == (5, 1, [5])
    assert (found.right, found.wrong, found.same) == (1, 0, 1)
    assert 0 < found.one < found.query


def test_what_is_calibrated_for_a_map_counts_for_which(tmp_path: Path) -> None:
    maps = tmp_path / "maps"
    maps.mkdir()
    for name in ("curved", "double_wall", "visibility"):
        for ending in (".yaml", ".png"):
            shutil.copy(MAPS / f"{name}{ending}", maps)
    whole = simulate(load_map(MAPS / "curved.yaml"), 2, 5, Sensor(rays=90, fov=6.2))
    short = replace(whole, scans=tuple(scan.scaled(0.9) for scan in whole.scans))
    scans = tmp_path / "short.npz"
    save_scans(scans, short)
    curved = maps / "curved.yaml"
    save_calibrations(calibration_path(curved), load_map(curved), {}, {}, shared=Shared(1 / 0.9))
    found = rows(call("which", maps, scans, "--json").out)
    out = tmp_path / "out"
    assert call("batch", maps, scans, "--job", "which", "--out", out, "--workers", 1).code == 0
    (row,) = read_rows(out)
    for answers in (found, row["answers"]):
        assert [answer["verdict"] for answer in answers] == ["curved"] * 2
        for answer, truth in zip(answers, whole.poses, strict=True):
            pose = answer["maps"][0]["pose"]
            assert np.hypot(pose["x"] - truth[0], pose["y"] - truth[1]) < 0.1


def test_a_bound_is_that_of_the_scale_that_is_known(tmp_path: Path) -> None:
    save_map(tmp_path / "post.yaml", grid := room_with_a_post())
    scan = simulate(grid, 1, 3, Sensor(rays=90, fov=6.2))[0].scaled(0.7)
    index = index_of({"post": prepare(grid)})

    def bound() -> float:
        return bounds_of(index, [said_scale(tmp_path / "post.yaml")], scan, choosing.OPTIONS)[
            "post"
        ]

    unknown, said = bound(), calibration_path(tmp_path / "post.yaml")
    save_calibrations(said, grid, {}, {}, shared=Shared(1 / 0.7))
    assert bound() > unknown + 0.02
    for damaged in ("[]", "{}", '{"shared": {"scale": "wide"}}', '{"shared": 5}', "[" * 9999):
        said.write_text(damaged)
        assert bound() == unknown


def test_what_is_no_folder_of_maps_says_why(site: Path, tmp_path: Path) -> None:
    scans = next(site.rglob("*.npz"), site)
    run = call("which", tmp_path / "nodir", scans)
    assert (run.code, "nodir: no such folder, expected a folder of maps" in run.err) == (2, True)
    (tmp_path / "a.yaml").write_text("")
    run = call("which", tmp_path / "a.yaml", scans)
    assert (run.code, "a.yaml: is no folder, expected a folder of maps" in run.err) == (2, True)


def test_maps_of_which_one_is_damaged_are_at_fault_whatever_the_others_are(site: Path) -> None:
    folder = site / "unfit"
    folder.mkdir()
    (folder / "a.yaml").write_text("image: gone.png\nresolution: 0.1\norigin: [0, 0, 0]\n")
    shutil.copy(MAPS / "large.yaml", folder)
    shutil.copy(MAPS / "large.png", folder)
    scans = next(site.glob("*.npz"))
    run = call("which", folder, scans, "--memory-budget", "3M", "--no-cache")
    assert "none of its 2 maps can be used" in run.err, run.err
    assert run.code == 3
    (folder / "a.yaml").unlink()
    run = call("which", folder, scans, "--memory-budget", "3M", "--no-cache")
    assert "none of its 1 maps can be used" in run.err, run.err
    assert run.code == 2  # too little memory is no fault of the map


def test_the_metadata_of_a_recording_is_no_map(site: Path) -> None:
    maps = find_maps(site)
    (site / "bag").mkdir()
    for name in ("metadata.yaml", "bag_0.db3"):
        (site / "bag" / name).touch()
    assert find_maps(site) == maps
    (site / "bag" / "bag_0.db3").unlink()
    assert len(find_maps(site)) == len(maps) + 1
