"""From files to cells: orientation, semantics of Nav2 and ROS 1, options, bad files."""

import math
from pathlib import Path

import numpy as np
import pytest
from badfiles import chunk, encode, png, room, yaml_with

from imgloc import ConfigError, MapError, OccupancyGrid, OutputError, Pose2D, check_map
from imgloc.io.maps import load_map, require_usable, save_map


def classes(grid: OccupancyGrid) -> list[str]:
    """Rows from the top, as one sees them: # wall, . free, ? unknown."""
    signs = np.where(grid.occupied, "#", np.where(grid.free, ".", "?"))
    return ["".join(row) for row in signs[::-1]]


@pytest.fixture
def write(tmp_path: Path):
    """Write an image and a YAML with extra or replaced lines; return the YAML's path."""

    def write(image: bytes, *lines: str) -> Path:
        text = yaml_with("image", "image: m.png")
        for line in lines:
            key = line.split(":")[0]
            text = "".join(x for x in text.splitlines(True) if not x.startswith(key + ":"))
            text += line + "\n"
        (tmp_path / "m.png").write_bytes(image)
        (tmp_path / "m.yaml").write_text(text)
        return tmp_path / "m.yaml"

    return write


def row(*greys: int) -> bytes:
    return png(len(greys), 1, 8, 0, [bytes(greys)])


@pytest.mark.parametrize("load", [load_map, check_map])
def test_a_misspelt_argument_is_not_ignored(write, load) -> None:
    with pytest.raises(TypeError, match="unexpected arguments: resoluton"):
        load(write(row(0, 254)), resoluton=0.1)


def test_row_0_is_the_lowest_and_columns_go_right(write) -> None:
    grid = load_map(write(encode(".png", np.array([[0, 205, 254], [254, 254, 0]], np.uint8))))
    assert classes(grid) == ["#?.", "..#"]
    assert grid.occupied.tolist() == [[False, False, True], [True, False, False]]
    assert not (grid.occupied & grid.free).any()
    assert grid.occupied.flags.c_contiguous
    assert grid.free.flags.c_contiguous


def test_resolution_origin_and_yaw(write) -> None:
    path = write(encode(".png", room()), "resolution: 0.25", "origin: [-3, 4.5, 3.14]")
    grid = load_map(path)
    assert grid.resolution == 0.25
    assert grid.origin == Pose2D(-3, 4.5, 3.14)
    assert grid.info.shape == (40, 50)


@pytest.mark.parametrize(
    ("semantics", "expected"),
    [
        # grey 204 is occ = 0.2 exactly, grey 51 is 0.8 exactly: Nav2 includes, ROS 1 does not.
        ("nav2", ["##?..."]),
        ("ros1", ["#???.."]),
    ],
)
def test_thresholds_themselves(write, semantics: str, expected: list[str]) -> None:
    path = write(row(0, 51, 52, 204, 205, 254), "free_thresh: 0.2", "occupied_thresh: 0.8")
    assert classes(load_map(path, semantics=semantics)) == expected


GREEN = png(2, 1, 8, 2, [bytes([0, 255, 0, 255, 255, 255])])
CLEAR = png(2, 1, 8, 4, [bytes([128, 0, 128, 255])])
RAW, SCALE = row(0, 19, 20, 64, 65, 100, 101, 254, 255), row(254, 205, 204, 150, 90, 89, 0)
ROS1 = {"semantics": "ros1"}


@pytest.mark.parametrize(("image", "line", "options", "expected"), [
    (row(0, 205, 254), "", {}, "#?."),
    (row(0, 205, 254), "", {"free_thresh": 0.25}, "#.."),
    (row(0, 128, 255), "negate: 1", {}, ".?#"),
    (row(0, 128, 255), "negate: 1", {"negate": False}, "#?."),
    (CLEAR, "mode: scale", ROS1, "??"),
    # r = (occ - .196) / (.65 - .196) rounds to 0 and to 100 per cent next to the thresholds.
    (SCALE, "mode: scale", {}, "..???##"),
    (SCALE, "mode: scale", ROS1, ".????##"),
    (RAW, "mode: raw", {}, "..??##???"),
    (RAW, "mode: raw", {"free_thresh": 0.25}, "...?##???"),
    # ROS 1 negates raw values, Nav2 does not.
    (RAW, "mode: raw", {"negate": True}, "..??##???"),
    (RAW, "mode: raw", {"negate": True, **ROS1}, "???????.."),
    # Pure green: mean 85, occ 0.67, a wall; its luma is 150, unknown.
    (GREEN, "", {}, "#."),
])  # fmt: skip
def test_greys(write, image: bytes, line: str, options: dict, expected: str) -> None:
    assert classes(load_map(write(image, *[line] * bool(line)), **options)) == [expected]


# opaque wall, opaque free, transparent black, transparent white, nearly opaque white
RGBA = png(
    5,
    1,
    8,
    6,
    [bytes([0, 0, 0, 255, 254, 254, 254, 255, 0, 0, 0, 0, 254, 254, 254, 0, 254, 254, 254, 250])],
)


@pytest.mark.parametrize(
    ("mode", "semantics", "expected"),
    [
        ("trinary", "nav2", "#.???"),
        # The mean of (0, 0, 0, 255) is 63.75: occ 0.75; of (254, 254, 254, 0) 190.5: 0.25.
        ("trinary", "ros1", "#.#?."),
        ("scale", "nav2", "#.???"),
        ("scale", "ros1", "#.#.."),
    ],
)
def test_alpha(write, mode: str, semantics: str, expected: str) -> None:
    assert classes(load_map(write(RGBA), mode=mode, semantics=semantics)) == [expected]


def test_palette_is_looked_up(write) -> None:
    colours = chunk(b"PLTE", bytes([254, 254, 254, 0, 0, 0, 205, 205, 205]))
    path = write(png(3, 1, 8, 3, [bytes([0, 1, 2])], before=colours))
    assert classes(load_map(path)) == [".#?"]


def test_16_bits_and_maxval_are_scaled(write) -> None:
    wide = (np.array([[0, 205, 254]], np.uint32) * 257).astype(np.uint16)
    assert classes(load_map(write(encode(".png", wide)))) == ["#?."]
    assert classes(load_map(write(b"P5\n3 1\n100\n" + bytes([0, 80, 100])))) == ["#?."]


def test_pgm_and_png_are_the_same_map(write) -> None:
    a, b = load_map(write(encode(".png", room()))), load_map(write(encode(".pgm", room())))
    np.testing.assert_array_equal(a.occupied, b.occupied)
    np.testing.assert_array_equal(a.free, b.free)


def test_bare_image_needs_a_resolution_and_names_the_yaml_beside(write) -> None:
    image = write(row(0, 254)).with_suffix(".png")
    with pytest.raises(MapError, match=r"m\.png: resolution: missing; give .*m\.yaml instead"):
        load_map(image)
    grid = load_map(image, resolution=0.05)
    assert (grid.resolution, grid.origin) == (0.05, Pose2D(0, 0, 0))
    assert load_map(image, resolution=0.05, origin=(1, 2, math.pi)).origin == Pose2D(1, 2, math.pi)


def test_options_win_over_the_yaml(write) -> None:
    path = write(row(0, 100, 254), "mode: raw")
    assert classes(load_map(path)) == [".#?"]
    grid = load_map(path, mode="trinary", occupied_thresh=0.55, resolution=1.0, origin=(1, 1, 0))
    assert classes(grid) == ["##."]
    assert (grid.resolution, grid.origin) == (1.0, Pose2D(1, 1, 0))


@pytest.mark.parametrize(
    "options",
    [
        {"resolution": 0.0},
        {"resolution": math.nan},
        {"mode": "fancy"},
        {"semantics": "ros3"},
        {"origin": (0, 0)},
        {"origin": (0, 0, math.nan)},
        {"free_thresh": 0.7},
        {"occupied_thresh": 1.5},
        {"occupied_thresh": math.nan},
        {"max_pixels": 0},
    ],
)
def test_options_out_of_range_are_the_callers_fault(write, options) -> None:
    with pytest.raises(ConfigError, match="expected"):
        load_map(write(row(0, 254)), **options)


def test_a_map_without_walls_loads_but_is_not_usable(write) -> None:
    grid = load_map(write(row(254, 254, 205)))
    with pytest.raises(MapError, match="hall: none of its 3 cells is occupied"):
        require_usable(grid, "hall")
    with pytest.raises(MapError, match="none of its 2 cells is free"):
        require_usable(load_map(write(row(0, 205))), "hall")
    require_usable(load_map(write(row(0, 254))), "hall")


def test_save_and_load_give_the_same_map(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    kind = rng.integers(0, 3, (7, 5))
    origin = Pose2D(-1 / 3, 1e-7, 0.1 + 0.2)
    movable = (kind == 1) & (rng.random((7, 5)) < 0.5)
    grid = OccupancyGrid(kind == 0, kind == 1, 0.05, origin, movable)
    image = save_map(tmp_path / "a map: #1.yaml", grid)
    assert image.name == "a map: #1.png"
    again = load_map(tmp_path / "a map: #1.yaml")
    assert again == grid
    np.testing.assert_array_equal(again.furnished.occupied, grid.occupied | grid.movable)
    assert load_map(image, resolution=0.05).movable is None  # as map_server reads it
    assert check_map(image.with_suffix(".yaml")).movable == pytest.approx(movable.mean())
    assert check_map(image, resolution=0.05).movable is None
    ros1 = load_map(tmp_path / "a map: #1.yaml", semantics="ros1")
    np.testing.assert_array_equal(ros1.unknown, grid.unknown)


def test_save_does_not_overwrite(tmp_path: Path) -> None:
    grid = OccupancyGrid(np.eye(3, dtype=bool), ~np.eye(3, dtype=bool), 0.1)
    (tmp_path / "m.png").write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"m\.png: exists already"):
        save_map(tmp_path / "m.yaml", grid)
    assert not (tmp_path / "m.yaml").exists()
    save_map(tmp_path / "m.yaml", grid, force=True)
    assert load_map(tmp_path / "m.yaml").occupied.trace() == 3
    with pytest.raises(ConfigError, match=r"\.yaml"):
        save_map(tmp_path / "m.png", grid)


# ---- map check -------------------------------------------------------------------------


def codes(path: Path, **options) -> dict[str, str]:
    return {w.code: w.text for w in check_map(path, **options).warnings}


def test_report_of_a_healthy_map(write) -> None:
    report = check_map(write(encode(".png", room()), "origin: [-1, -2, 0]"))
    assert (report.width, report.height, report.kind) == (50, 40, "png")
    assert report.size == pytest.approx((5.0, 4.0))
    free = np.count_nonzero(room() == 254)
    assert report.area == pytest.approx(free * 0.01)
    assert report.shares["free"] == free / 2000
    assert sum(report.shares.values()) == pytest.approx(1)
    assert report.greys[0] in ((254.0, free), (205.0, 800))
    assert dict(report.greys) == {0.0: np.count_nonzero(room() == 0), 205.0: 800, 254.0: free}
    assert report.grey_levels == 3
    assert report.semantics_differ == 0
    assert report.warnings == ()


def test_free_space_falls_into_parts_between_which_one_cannot_go(write) -> None:
    image = np.full((6, 20), 254, np.uint8)
    image[:, [7, 12]] = 0
    image[5, 13:] = 205
    image[4, 19], image[4, 18], image[3, 19] = 254, 0, 0  # a cell that only a corner joins
    report = check_map(write(encode(".png", image)), resolution=0.5)
    assert report.free_parts == (42 * 0.25, 32 * 0.25, 24 * 0.25, 0.25)
    assert sum(report.free_parts) == pytest.approx(report.area)
    dots = np.zeros((24, 24), np.uint8)
    dots[::2, ::2] = 254
    assert check_map(write(encode(".png", dots)), resolution=1.0).free_parts == (1.0,) * 10
    assert check_map(write(row(0, 205))).free_parts == ()


def test_grey_205_trap(write) -> None:
    path = write(encode(".png", room()), "free_thresh: 0.25")
    assert "800 cells of grey 205" in codes(path)["grey-205"]
    assert "grey-205" not in codes(path, free_thresh=0.196)
    # 205 of 255, whatever the depth.
    deep = encode(".png", room().astype(np.uint16) * 257)
    assert "800 cells" in codes(write(deep, "free_thresh: 0.25"))["grey-205"]


def test_cells_that_nav2_and_ros1_read_differently(write) -> None:
    path = write(row(0, 51, 204, 254), "free_thresh: 0.2", "occupied_thresh: 0.8")
    report = check_map(path)
    assert report.semantics_differ == 2
    assert str(report.warnings[0]).startswith("semantics: 2 cells differ")
    assert check_map(path, semantics="ros1").semantics_differ == 2


@pytest.mark.parametrize(
    ("greys", "lines", "code"),
    [
        ((254, 254), (), "no-walls"),
        ((0, 205), (), "no-free"),
        ((0, 0, 0, 254), (), "mostly-occupied"),
        ((0, 254), ("origin: [0, 0, 3.14]",), "yaw"),
        ((0, 254), ("resolution: 0.5",), "coarse"),
        ((0, 254), ("free_tresh: 0.1",), "unknown-key"),
        (tuple(range(0, 255, 5)), (), "many-greys"),
    ],
)
def test_warnings(write, greys, lines, code: str) -> None:
    assert code in codes(write(row(*greys), *lines))
    assert code not in codes(write(row(0, 205, 254)))


def test_missing_threshold_is_reported(tmp_path: Path) -> None:
    (tmp_path / "good.png").write_bytes(row(0, 254))
    (tmp_path / "m.yaml").write_text(yaml_with("free_thresh", ""))
    assert "0.196" in codes(tmp_path / "m.yaml")["default-threshold"]


def test_transparency_colour_and_lossy_are_reported(write) -> None:
    assert "3 cells are not opaque" in codes(write(RGBA))["transparent"]
    assert "1 cells are coloured" in codes(write(png(1, 1, 8, 2, [b"\0\xff\0"])))["colour"]
    assert "lossy" in codes(write(encode(".jpg", room())))


def test_too_many_cells_a_side_are_refused_by_the_header(write) -> None:
    path = write(png(40000, 2, 1, 0, [b"no rows"]))
    for look in (load_map, codes):
        with pytest.raises(MapError, match=r"40,000 x 2 pixels, expected at most 32,767 a side"):
            look(path)


def test_real_maps_have_nothing_to_hide(shared: Path) -> None:
    paths = sorted((shared / "data").glob("*/map.yaml"))
    assert paths
    for path in paths:
        report = check_map(path)
        assert report.grey_levels <= 3, path
        assert {w.code for w in report.warnings} <= {"yaw"}, path
        grid = load_map(path)
        require_usable(grid, str(path))
        assert grid.free.mean() == pytest.approx(report.shares["free"])
    yaw = check_map(shared / "data" / "map_mit_basement" / "map.yaml")
    assert yaw.origin == Pose2D(25.9, 48.5, 3.14)
    assert [w.code for w in yaw.warnings] == ["yaw"]


def test_real_map_as_pgm_and_png(shared: Path) -> None:
    a = load_map(shared / "problem" / "mapA.yaml")
    b = load_map(shared / "problem" / "mapA.pgm", resolution=0.1)
    np.testing.assert_array_equal(a.occupied, b.occupied)
    np.testing.assert_array_equal(a.free, b.free)
