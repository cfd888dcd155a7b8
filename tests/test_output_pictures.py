"""Pictures: right way up, right colours, right places."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from imgloc import MapFeatures, OutputError, Picture, draw
from imgloc.geometry import transform_points
from imgloc.io.images import encode_png
from imgloc.model import (
    Evidence,
    GridInfo,
    Hypothesis,
    LaserScan,
    Likelihood,
    Localization,
    OccupancyGrid,
    OrientedPoints,
    Pose2D,
    compose,
)
from imgloc.output.canvas import (
    GREY,
    INK,
    PALETTE,
    PAPER,
    SHADE,
    TRUTH,
    TURQUOISE,
    Part,
    building,
    map_canvas,
    sheet,
    wheel,
)
from imgloc.output.features import (
    SUBJECTS,
    draw_bmap,
    draw_distance,
    draw_field,
    draw_map,
    draw_surface,
    draw_visibility,
)
from imgloc.output.pictures import _likelihood, _numbers, draw_hypotheses, draw_likelihood, mosaic
from imgloc.output.plots import AREA, ROBOT, Bar, _Sheet, framed


def close(colour, other, tolerance=12):
    return np.abs(np.asarray(colour, int) - np.asarray(other, int)).max(axis=-1) <= tolerance


def room(height=40, width=60, resolution=0.1, origin=None):
    occupied = np.zeros((height, width), dtype=bool)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    return OccupancyGrid(occupied, ~occupied, resolution, origin or Pose2D(0, 0, 0))


def stack(values, method="test"):
    values = np.asarray(values, dtype=np.float32)
    thetas = np.arange(len(values)) * 2 * np.pi / len(values)
    return Likelihood(values, thetas, GridInfo(*values.shape[1:], 0.1), method)


def hypothesis(x, y, theta, mass=0.5):
    return Hypothesis(Pose2D(x, y, theta), -1.0, mass, np.diag([1e-4, 1e-4, 1e-4]))


def test_row_0_of_the_grid_is_at_the_bottom():
    occupied = np.array([[1, 0, 0], [0, 0, 0]], dtype=bool)
    free = np.array([[0, 1, 0], [1, 1, 0]], dtype=bool)
    canvas = map_canvas(OccupancyGrid(occupied, free, 1.0), Part(scale=1), INK)
    assert canvas.image.tolist() == [
        [list(PAPER), list(PAPER), list(SHADE)],
        [list(INK), list(PAPER), list(SHADE)],
    ]


def test_cells_become_squares():
    grid = room(5, 7)
    big, small = (map_canvas(grid, Part(scale=scale)).image for scale in (3, 1))
    np.testing.assert_array_equal(big[::3, ::3], small)
    np.testing.assert_array_equal(big[2::3, 2::3], small)


@pytest.mark.parametrize(("side", "scale"), [(10, 16), (200, 5), (999, 2), (1000, 1), (3000, 1)])
def test_small_maps_are_enlarged(side, scale):
    assert map_canvas(room(8, side)).image.shape == (8 * scale, side * scale, 3)


def test_large_maps_are_shrunk_and_keep_their_walls():
    occupied = np.zeros((3, 9001), bool)
    occupied[1, [4, 9000]] = True
    canvas = map_canvas(OccupancyGrid(occupied, ~occupied, 0.1))
    assert canvas.image.shape == (1, 3001, 3)
    assert canvas.px_per_m == pytest.approx(1 / 0.3)
    walls = np.flatnonzero((canvas.image[0] == GREY).all(axis=1))
    assert walls.tolist() == [1, 3000]
    wide = np.full((2, 4001, 3), 200, np.uint8)
    wide[1, 7] = 10
    shrunk = sheet(wide, GridInfo(2, 4001, 0.1)).image
    assert shrunk[0, [2, 3, 4], 0].tolist() == [200, 10, 200]


def test_what_is_unknown_around_a_building_and_its_poses_is_left_out():
    free = np.pad(np.ones((40, 60), bool), 100)
    grid = OccupancyGrid(np.zeros_like(free), free, 0.1)
    canvas = map_canvas(grid, building(grid))
    assert canvas.box.round(3).tolist() == [[9.0, 9.0], [17.0, 15.0]]
    far = map_canvas(grid, building(grid, [Pose2D(25.95, 1.0)]))
    assert far.box.round(3).tolist() == [[9.0, 0.0], [26.0, 15.0]]
    (middle,) = np.rint(canvas.pixels(np.array([[10.0, 10.0]]))).astype(int)
    assert (canvas.image[middle[1], middle[0] - 2] == SHADE).all()
    assert (canvas.image[middle[1] - 2, middle[0] + 2] == PAPER).all()


def test_a_likelihood_is_black_white_and_turquoise():
    picture = draw_likelihood(stack([[[4, 2, 0], [-3, 1e-9, 1]]]), None, Part(scale=1)).image
    black, grey, white, light = (0, 0, 0), (128, 128, 128), (255, 255, 255), (191, 191, 191)
    assert picture.tolist() == [
        [list(TURQUOISE), list(white), list(light)],
        [list(black), list(grey), list(TURQUOISE)],
    ]
    over_theta = draw_likelihood(stack([[[4, 0]], [[0, 2]], [[1, 1]]]), None, Part(scale=1)).image
    assert over_theta[0, :, 0].tolist() == [0, 128]
    assert np.all(draw_likelihood(stack(np.zeros((2, 3, 4)))).image == TURQUOISE)


def test_a_log_likelihood_is_drawn_relative_to_its_maximum():
    lattice = stack([[[-500, -500 + np.log(0.5), -np.inf]]], method="beam")
    picture = draw_likelihood(lattice, None, Part(scale=1)).image
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert picture[0, 1, 0] in (127, 128)
    assert tuple(picture[0, 2]) == TURQUOISE
    nowhere = draw_likelihood(stack(np.full((2, 3, 3), -np.inf), method="beam"))
    assert np.all(nowhere.image == TURQUOISE)


def test_walls_lie_over_a_likelihood_of_another_cell_size():
    grid = room(6, 9, 0.1)
    lattice = Likelihood(np.ones((1, 3, 5)), np.zeros(1), GridInfo(3, 5, 0.2), "test")
    picture = draw_likelihood(lattice, grid, Part(scale=4)).image  # two pixels a cell of the map
    assert picture.shape == (12, 20, 3)
    black = np.all(picture == 0, axis=2)
    expected = np.zeros((12, 20), dtype=bool)
    expected[2:10, 2:16] = True
    np.testing.assert_array_equal(black, expected)
    np.testing.assert_array_equal(picture[:, 18:], np.full((12, 2, 3), SHADE))  # off the map


def at(picture, x, y):
    """The colour of a point of the plane."""
    (column, row), *_ = np.rint(picture.pixels(np.array([[x, y]]))).astype(int).tolist()
    return picture.image[row, column]


@pytest.mark.parametrize("theta", np.arange(8) * np.pi / 4)
def test_the_nose_of_a_robot_points_along_theta(theta):
    canvas = Picture(np.full((100, 100, 3), 255, np.uint8), 10.0)
    canvas.robot(5.0, 5.0, theta, (0, 0, 200), 12.0)
    y, x = np.nonzero(close(canvas.image, (0, 0, 200)))
    far = np.argmax(np.hypot(x - 49.5, y - 49.5))
    # Pixel rows go down: y is negated.
    angle = np.arctan2(49.5 - y[far], x[far] - 49.5)
    assert abs((angle - theta + np.pi) % (2 * np.pi) - np.pi) < 0.1


def test_centres_of_pixels_are_at_integers():
    canvas = Picture(np.zeros((40, 60, 3), np.uint8), 10.0)
    np.testing.assert_allclose(canvas.pixels(np.array([[0.05, 0.05]])), [[0, 39]])
    canvas.dots(np.array([[2.05, 1.05]]), (0, 0, 255), 3)
    np.testing.assert_allclose(np.argwhere(canvas.image[..., 2]).mean(axis=0), (29, 20))


def test_a_scan_lies_where_the_hypothesis_puts_it():
    grid = room()
    points = np.array([[1.0, 0.0], [0.0, 2.0]])
    picture = draw_hypotheses(grid, points, [hypothesis(4.1, 1.1, np.pi / 2)])
    # (1, 0) is straight ahead, upward; (0, 2) is to the left. Lines of the axes are elsewhere.
    for x, y in ((4.1, 2.1), (2.1, 1.1)):
        assert close(at(picture, x, y), PALETTE[0])
    assert close(at(picture, 3.15, 3.15), PAPER)


def test_the_best_hypothesis_is_drawn_over_the_others():
    both = [hypothesis(3.1, 2.1, 0.0, 0.6), hypothesis(3.1, 2.1, 0.0, 0.3)]
    picture = draw_hypotheses(room(), np.array([[1.0, 1.0]]), both)
    assert close(at(picture, 4.1, 3.1), PALETTE[0])


def test_the_ellipse_lies_along_the_greater_deviation():
    wide = Hypothesis(Pose2D(3, 2, 0), -1.0, 0.5, np.diag([0.25, 0.01, 0.01]))
    picture = draw_hypotheses(room(), np.empty((0, 2)), [wide])
    assert not close(at(picture, 3.9, 2.05), PAPER, 3)  # 0.9 m along x: within 2 sigma = 1 m
    assert close(at(picture, 3.05, 2.9), PAPER, 3)


def test_the_colours_of_opposite_directions_differ_and_weak_ones_fade():
    right, left, weak = wheel(np.array([0.0, np.pi, 0.0]), np.array([1.0, 1.0, 0.0])).astype(int)
    assert np.abs(right - left).max() > 100
    assert weak.tolist() == [255, 255, 255]
    np.testing.assert_array_equal(wheel(-0.001, 1.0), wheel(2 * np.pi, 1.0))


def test_a_field_shows_its_arrows_on_its_walls():
    vmap = np.zeros((2, 20, 30), dtype=np.float32)
    vmap[0, :, 8] = 1.0
    vmap[0, :, 12] = -1.0
    picture = draw_field(vmap, 0.1, Part(scale=8)).image
    assert picture.shape == (160, 240, 3)
    assert close(picture[:, :40], PAPER, 0).all()
    left, right = (picture[:, k * 8 + 1].astype(int) for k in (8, 12))
    assert np.abs(np.median(left, axis=0) - np.median(right, axis=0)).max() > 30
    ink = close(picture, INK, 40).any(axis=0)
    assert ink[60:80].any()
    assert ink[90:110].any()
    assert np.all(draw_field(np.zeros((2, 5, 7), dtype=np.float32), 0.1).image == 255)


def test_normals_stand_on_their_side_of_the_wall():
    occupied = np.zeros((20, 30), dtype=bool)
    occupied[:, 14] = True
    xy = np.column_stack((np.full(10, 1.5), np.linspace(0.3, 1.7, 10)))
    nan = np.full(10, np.nan)
    surface = OrientedPoints(xy, np.zeros(10), np.zeros(10), np.ones(10, dtype=bool))
    grid = OccupancyGrid(occupied, ~occupied, 0.1)
    picture = draw_surface(grid, surface, Part(scale=10)).image
    colourful = np.ptp(picture.astype(int), axis=2) > 60
    columns = np.flatnonzero(colourful.any(axis=0))
    assert 147 <= columns.min() <= 151
    assert 165 <= columns.max() <= 180
    blind = OrientedPoints(xy, nan, nan, np.zeros(10, dtype=bool))
    dots = draw_surface(grid, blind, Part(scale=10)).image
    assert not (np.ptp(dots.astype(int), axis=2) > 60).any()
    assert close(dots[200 - 30, 150], INK, 40)


@pytest.mark.parametrize(("alpha", "seen"), [(0.0, (0, 1)), (np.pi / 2, (-1, 0))])
def test_a_fan_covers_what_is_seen(alpha, seen):
    vis = np.zeros(36)
    vis[9] = 1.5  # 90 degrees from bin 0
    vis[27] = np.inf  # the other way, up to the horizon
    picture = draw_visibility(room(), (3.0, 2.0), vis, horizon=1.0, alpha=alpha)

    def tinted(x, y):
        return np.ptp(at(picture, x, y).astype(int)) > 15

    dx, dy = seen
    assert tinted(3.0 + 1.0 * 0.9 * dx, 2.0 + 1.0 * 0.9 * dy)
    assert not tinted(3.0 + 1.2 * dx, 2.0 + 1.2 * dy)  # longer than the horizon
    assert tinted(3.0 - 0.9 * dx, 2.0 - 0.9 * dy)
    assert not tinted(3.0 - 1.1 * dx, 2.0 - 1.1 * dy)
    assert not tinted(3.0 + 0.5 * dy, 2.0 - 0.5 * dx)


def test_a_mosaic_has_every_picture():
    colours = [(10, 20, 30), (40, 50, 60), (70, 80, 90)]
    pictures = [np.full((20 + 10 * k, 60, 3), c, np.uint8) for k, c in enumerate(colours)]
    laid = mosaic([Picture(p) for p in pictures], columns=2).image
    for picture, colour in zip(pictures, colours, strict=True):
        (rows, _) = np.nonzero(coloured(laid, colour))
        assert len(rows) == picture.shape[0] * picture.shape[1]
        assert rows.min() == (0 if colour != colours[2] else 38)


def test_drawing_leaves_its_inputs_alone_and_gives_the_same_bytes():
    grid, points, one = room(), np.ones((3, 2)), [hypothesis(2, 2, 1)]
    first, again = (draw_hypotheses(grid, points, one, truth=Pose2D(1, 1, 0)).image for _ in "ab")
    assert first.tobytes() == again.tobytes()
    assert np.all(points == 1)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous


def answer(*hypotheses, found=0, unlisted=0.0):
    evidence = Evidence(found=found, listed=len(hypotheses), unlisted=unlisted)
    return Localization(tuple(hypotheses), "ambiguous", 0.0, 1.0, elsewhere=0.1, evidence=evidence)


def test_one_call_draws_an_answer_in_the_map_frame():
    origin, here = Pose2D(-7.0, 9.0, np.pi / 2), Pose2D(4.1, 1.1, 0.0)
    there, grid = compose(origin, here), room(origin=origin)
    scan = LaserScan([1.0], [np.pi / 2], range_max=9.0)  # one point, on the left
    one = answer(hypothesis(there.x, there.y, there.theta))
    picture = draw(grid, one, scan, truth=there).image
    np.testing.assert_array_equal(draw(MapFeatures(grid), one, scan, truth=there).image, picture)
    about = {"notes": ["verdict: ambiguous; elsewhere: 10.0 %"], "truth": here}
    title = "Where the scan was taken: ambiguous"
    poses = [hypothesis(4.1, 1.1, 0.0)]
    same = draw_hypotheses(grid, np.array([(0.0, 1.0)]), poses, title=title, **about)
    np.testing.assert_array_equal(same.image, picture)
    assert close(at(same, 4.1, 2.1), PALETTE[0])
    assert close(at(same, 4.1, 1.1), INK)


def on_map(picture, grid):
    """The pixels of a framed picture that are the map's."""
    corners = np.array([(0, 0), grid.occupied.shape[::-1]]) * grid.resolution
    (left, low), (right, top) = np.rint(picture.pixels(corners) + 0.5).astype(int).tolist()
    return picture.image[top:low, left:right]


def coloured(image, colour):
    return np.all(image == colour, axis=2)


def test_a_title_a_legend_for_each_layer_and_no_place_without_mass():
    some = [hypothesis(1.0 + k, 2.0, 0.0, mass) for k, mass in enumerate((0.9, 0.0012, 0.0008))]
    scan = LaserScan([1.0], [0.5], range_max=9.0)
    plain = draw(room(), answer(*some, found=3), scan)
    fewer = draw(room(), answer(*some[:2], found=3, unlisted=0.0008), scan)
    np.testing.assert_array_equal(plain.image, fewer.image)
    titled = draw(room(), answer(*some, found=3), scan, title="attic: a.log, scan 3").image
    assert not np.array_equal(titled[:30], plain.image[:30])
    np.testing.assert_array_equal(titled[40:], plain.image[40:])
    shown = draw_hypotheses(room(), np.zeros((0, 2)), some[:2])
    assert coloured(on_map(shown, room()), PALETTE[0]).any()
    assert not coloured(shown.image, PALETTE[2]).any()


def test_the_maximum_and_the_true_pose_are_marked_on_a_likelihood():
    values = np.full((2, 40, 60), 0.2)
    values[1, 10, 45] = 1.0
    picture, grid = _likelihood(stack(values), room(), Pose2D(1.0, 3.0), ""), room()
    shown = on_map(picture, grid)
    for colour, (x, y) in ((PALETTE[1], (4.55, 1.05)), (TRUTH, (1.0, 3.0))):
        rows, columns = np.nonzero(coloured(shown, colour))
        assert 0 < len(rows) < 1000
        assert abs((rows.min() + rows.max()) / 2 - 160 * (4.0 - y)) < 8
        assert abs(columns.min() - 160 * x) < 40
    below = picture.image[-120:]
    for colour in (PALETTE[1], TRUTH, SHADE):  # of the legend
        assert coloured(below, colour).sum() > 20


def test_one_call_draws_a_map_a_likelihood_and_every_feature():
    grid = room()
    np.testing.assert_array_equal(draw(grid).image, draw_map(grid).image)
    features = MapFeatures(grid)
    pictures = [draw(features, what=what).image for what in SUBJECTS]
    assert len({p.tobytes() for p in pictures}) == len(SUBJECTS)


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi / 2, 2.5])
def test_ticks_are_where_the_axes_of_the_map_frame_have_them(turn, monkeypatch):
    """A tick's place on the grid has the coordinate of the map frame that its name states."""
    origin, ticks = Pose2D(-7.0, 9.0, turn), []
    add = _Sheet.add_ticks

    def noted(self, edge, x, y, spots, names):
        ticks.extend((edge, spot, name) for spot, name in zip(spots, names, strict=True))
        add(self, edge, x, y, spots, names)

    monkeypatch.setattr(_Sheet, "add_ticks", noted)
    canvas = Picture(np.full((400, 600, 3), 255, np.uint8), 100.0, (2.0, 1.0))
    framed(canvas, origin)
    swapped = abs(np.sin(turn)) > abs(np.cos(turn))
    for edge in (0, 1):
        mine = [(spot, name) for k, spot, name in ticks if k == edge]
        assert len(mine) >= 3
        for spot, name in mine:
            place = (2.0 + spot / 100, 1.0) if edge == 0 else (2.0, 1.0 + spot / 100)
            xy = transform_points(origin, np.array([place]))[0]
            assert xy[edge ^ swapped] == pytest.approx(float(name), abs=1e-6)


def test_a_cell_is_where_the_axes_say():
    """Half a cell off would show: each cell of a tiny grid is between the ticks of its edges."""
    occupied = np.array([[1, 0, 0], [0, 0, 1]], bool)
    picture = draw_map(OccupancyGrid(occupied, ~occupied, 1.0, Pose2D(10.0, 20.0)))
    for row in range(2):
        for column in range(3):
            colour = INK if occupied[row, column] else PAPER
            for dx, dy in ((0.12, 0.12), (0.4, 0.44), (0.88, 0.88)):
                assert close(at(picture, column + dx, row + dy), colour)
    (left, low), *_ = np.rint(picture.pixels(np.array([[0.0, 0.0]])) + 0.5).astype(int).tolist()
    ticks = np.flatnonzero(picture.image[low + 3, left - 1 :, 0] < 160)
    assert np.abs(ticks - 1 - [0, 32]).max() <= 1  # at 10 and 12 m of the map frame


def test_a_map_is_in_its_frame_pixel_by_pixel():
    rng = np.random.default_rng(1)
    canvas = Picture(rng.integers(0, 256, (60, 500, 3), dtype=np.uint8), 50.0)
    framed_map = framed(canvas, Pose2D(0.33, 0.27), "noise")
    assert framed_map.px_per_m == 50.0
    (left, low), *_ = np.rint(framed_map.pixels(np.zeros((1, 2))) + 0.5).astype(int).tolist()
    inner = framed_map.image[low - 60 : low, left : left + 500]
    same = np.all(inner == canvas.image, axis=2)
    for part in (same, same[0], same[-1], same[:, 0], same[:, -1]):
        assert part.mean() > 0.85  # but for the lines of the grid


@pytest.mark.parametrize("shape", [(900, 12), (12, 900), (20, 20), (700, 900)])
def test_nothing_is_cut_off(shape):
    canvas = Picture(np.full((*shape, 3), 255, np.uint8), 10.0)
    for words in ("west", "west_" * 40, "a b " * 60, "5 $ and 6 $ \x1b \u5b57"):
        entries = [(INK, AREA, words), (INK, "", "short"), (PALETTE[0], ROBOT, "1 2.0 3.0")]
        bar = Bar(np.zeros((1, 9, 3), np.uint8), 0.0, 1.0, 0.5, "share of much " * 5)
        picture = framed(canvas, Pose2D(-12345.5, 9.0), words, entries, bar=bar).image
        assert (picture[[0, 1, 2, 3, -4, -3, -2, -1]] == 255).all()
        assert (picture[:, :4] == 255).all()
        assert (picture[:, -4:] == 255).all()
        assert (picture < 128).any()


def test_no_setting_of_matplotlib_changes_a_picture():
    import matplotlib.style

    grid, one = room(), answer(hypothesis(3.0, 2.0, 0.5))
    plain = draw(grid, one, truth=Pose2D(1, 1)).image
    before = dict(matplotlib.rcParams)
    with matplotlib.style.context(["dark_background", "fivethirtyeight"]):
        matplotlib.rcParams.update({"font.size": 30, "font.family": "serif", "axes.grid": True})
        assert np.array_equal(draw(grid, one, truth=Pose2D(1, 1)).image, plain)
    assert dict(matplotlib.rcParams) == before


def test_pictures_of_several_threads_are_those_of_one():
    grid = room()
    answers = [answer(hypothesis(1.0 + k / 2, 2.0, 0.5 * k)) for k in range(6)]
    alone = [draw(grid, one).image for one in answers]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda one: draw(grid, one).image, answers * 2))
    for k, image in enumerate(together):
        assert np.array_equal(image, alone[k % 6])


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        (("map.png",), TypeError, "OccupancyGrid or MapFeatures"),
        ((room(), "fused"), TypeError, "Localization or a Likelihood"),
        ((room(), None, LaserScan([1.0], [0.0])), TypeError, "expected both"),
    ],
)
def test_what_cannot_be_drawn_is_said(arguments, error, words):
    with pytest.raises(error, match=words):
        draw(*arguments)
    with pytest.raises(ValueError, match=r"use imgloc\.prepare"):
        draw(room(), what="bmap")
    with pytest.raises(ValueError, match="expected one of map, bmap"):
        draw(MapFeatures(room()), what="walls")
    with pytest.raises(ValueError, match="at least one"):
        mosaic([])


def test_a_legend_says_what_is_left_out():
    def text_rows(*given, **more):
        return draw(room(), answer(*given, **more)).image.shape[0]

    seven = [hypothesis(1 + k / 2, 1, 0, 0.1) for k in range(7)]
    assert text_rows(seven[0]) < text_rows(*seven[:2]) < text_rows(*seven[:3])


def test_a_picture_is_saved_whole_and_never_over_another(tmp_path):
    picture = draw(room())
    picture.save(tmp_path / "a.png")
    data = (tmp_path / "a.png").read_bytes()
    assert data == picture._repr_png_()
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), 1), picture.image)
    with pytest.raises(OutputError, match="exists already"):
        picture.save(tmp_path / "a.png")
    picture.save(tmp_path / "a.png", force=True)
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


def test_distance_picture_is_dark_at_walls_with_a_line_each_metre() -> None:
    metres = np.tile(np.arange(25) * 0.1, (3, 1))
    picture = draw_distance(metres, GridInfo(3, 25, 0.1), Part(scale=1)).image
    grey = picture.astype(int).sum(axis=2)[1]
    assert grey.argmin() == 0
    assert grey[9] > grey[8]
    assert grey[9] > grey[11]


def test_blurred_map_is_upside_up() -> None:
    grid = GridInfo(2, 2, 0.1)
    picture = draw_bmap([[1.0, 1.0], [0.0, 0.5]], grid, Part(scale=1)).image
    assert picture[1].max() < 60  # row 0 is the lowest y
    assert picture[0, 0].tolist() == [255, 255, 255]
    assert 100 < picture[0, 1, 0] < 200


def test_hypotheses_are_as_bold_as_their_mass_and_numbered() -> None:
    grid = room()
    points = np.array([(0.5, 0.0), (0.5, 0.3)])
    strong, weak = hypothesis(1.0, 1.0, 0.0, 0.99), hypothesis(3.0, 2.0, 0.0, 0.001)
    both = draw_hypotheses(grid, points, [strong, weak])
    even = draw_hypotheses(grid, points, [strong, hypothesis(3.0, 2.0, 0.0, 0.99)])
    blue = np.array(PALETTE[1])
    counts = [coloured(on_map(p, grid), blue).sum() for p in (even, both)]
    assert counts[0] > 4 * counts[1]


def test_a_scan_that_is_small_on_the_map_gets_an_inset() -> None:
    wall = np.pad(np.zeros((200, 300), bool), 2, constant_values=True)
    grid = OccupancyGrid(wall, ~wall, 0.1)
    near = np.array([(0.5, 0.0), (0.5, 0.3)])
    small = draw_hypotheses(grid, near, [hypothesis(5.0, 5.0, 0.0)]).image
    large = draw_hypotheses(grid, 20 * near, [hypothesis(5.0, 5.0, 0.0)]).image
    assert len(small) > len(large) + 100
    assert abs(small.shape[1] - large.shape[1]) < 20  # a label
    robots = [coloured(image[-360:, -400:], PALETTE[0]).sum() for image in (small, large)]
    assert robots[0] > 100 > robots[1] == 0


def test_each_pose_has_its_number_once_and_those_at_one_place_share_a_label() -> None:
    canvas = map_canvas(room())
    turned = [Pose2D(3.0, 2.0, theta) for theta in (0.0, 1.6)]
    labels = _numbers(canvas, [*turned, Pose2D(1.0, 1.0), Pose2D(3.0, 2.05), Pose2D(5.9, 0.1)])
    assert [word for _, _, word in labels] == ["1, 2, 4", "3", "5"]
    for (x, y, _), pose in zip(labels, (turned[0], Pose2D(1.0, 1.0)), strict=False):
        assert x < pose.x - 0.05  # behind
        assert y == pytest.approx(pose.y)
    assert all(0 < x < 6.0 and 0 < y < 4.0 for x, y, _ in labels)


def test_distances_have_their_colours_where_robots_are() -> None:
    row = np.array([[0.5, 2.5, 3.0, 30.0]]).repeat(2, axis=1)  # lines are between metres
    image = draw_distance(row, GridInfo(1, 8, 0.1), Part(scale=4)).image
    colours = [image[1, 8 * k + 1].tolist() for k in range(4)]
    assert colours[2] == colours[3]
    assert colours[0] != colours[1]


def test_a_picture_that_is_saved_is_small_and_looks_the_same() -> None:
    def saved(picture):
        data = np.frombuffer(picture._repr_png_(), np.uint8)
        return cv2.imdecode(data, cv2.IMREAD_COLOR), len(data)

    picture = draw(room(), answer(*(hypothesis(3.0, 2.0, k, 0.5 / (k + 1)) for k in range(5))))
    back, size = saved(picture)
    assert np.abs(back.astype(int) - picture.image).max() <= 16
    for colour in (PAPER, PALETTE[0]):
        assert np.all(back[np.all(picture.image == colour, axis=2)] == colour)
    assert size < 0.5 * len(encode_png(picture.image))
    assert np.array_equal(saved(draw(room()))[0], draw_map(room()).image)
