"""Pictures: right way up, right colours, right places."""

import cv2
import numpy as np
import pytest

from imgloc.errors import OutputError
from imgloc.features.mapfeatures import MapFeatures
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
from imgloc.output.axes import draw_grid, framed, wrapped
from imgloc.output.canvas import (
    INK,
    PALETTE,
    PAPER,
    SHADE,
    TURQUOISE,
    Canvas,
    draw_map,
    enlarged,
    text,
    wheel,
)
from imgloc.output.features import (
    SUBJECTS,
    draw_bmap,
    draw_distance,
    draw_field,
    draw_surface,
    draw_visibility,
)
from imgloc.output.pictures import (
    _not_drawn,
    draw,
    draw_hypotheses,
    draw_likelihood,
    mosaic,
)


def close(colour, other, tolerance=12):
    return np.abs(np.asarray(colour, int) - np.asarray(other, int)).max(axis=-1) <= tolerance


def room(height=40, width=60, resolution=0.1, origin=None):
    occupied = np.zeros((height, width), dtype=bool)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    return OccupancyGrid(occupied, ~occupied, resolution, origin or Pose2D(0, 0, 0))


def stack(values, thetas=None):
    values = np.asarray(values, dtype=np.float32)
    thetas = np.arange(len(values)) * 2 * np.pi / len(values) if thetas is None else thetas
    return Likelihood(values, thetas, GridInfo(*values.shape[1:], 0.1), "test")


def hypothesis(x, y, theta, mass=0.5):
    return Hypothesis(Pose2D(x, y, theta), -1.0, mass, np.diag([1e-4, 1e-4, 1e-4]))


def test_row_0_of_the_grid_is_at_the_bottom():
    occupied = np.array([[1, 0, 0], [0, 0, 0]], dtype=bool)
    free = np.array([[0, 1, 0], [1, 1, 0]], dtype=bool)
    picture = draw_map(OccupancyGrid(occupied, free, 1.0), scale=1, bar=False)
    assert picture.tolist() == [
        [list(PAPER), list(PAPER), list(SHADE)],
        [list(INK), list(PAPER), list(SHADE)],
    ]


def test_cells_become_squares():
    grid = room(5, 7)
    big = draw_map(grid, scale=3, bar=False)
    np.testing.assert_array_equal(big[::3, ::3], draw_map(grid, scale=1, bar=False))
    np.testing.assert_array_equal(big[2::3, 2::3], draw_map(grid, scale=1, bar=False))


@pytest.mark.parametrize(("side", "scale"), [(10, 16), (200, 5), (999, 2), (1000, 1), (3000, 1)])
def test_small_maps_are_enlarged(side, scale):
    assert draw_map(room(8, side)).shape == (8 * scale, side * scale, 3)


def test_the_scale_bar_has_its_length_and_covers_no_wall():
    grid = room(100, 200)  # 20 m wide: the longest round length up to a fifth is 2 m
    bare, barred = draw_map(grid, scale=4, bar=False), draw_map(grid, scale=4)
    changed = np.any(bare != barred, axis=2)
    assert not np.any(changed & close(bare, INK, 0))
    runs = [np.flatnonzero(row).size for row in close(barred, INK, 0) & changed]
    assert max(runs) == 2 * 10 * 4 + 1


def test_a_likelihood_is_black_white_and_turquoise():
    picture = draw_likelihood(stack([[[4, 2, 0], [-3, 1e-9, 1]]]), scale=1)
    black, grey, white, light = (0, 0, 0), (128, 128, 128), (255, 255, 255), (191, 191, 191)
    assert picture.tolist() == [
        [list(TURQUOISE), list(white), list(light)],
        [list(black), list(grey), list(TURQUOISE)],
    ]


def test_a_likelihood_is_maximised_over_theta():
    picture = draw_likelihood(stack([[[4, 0]], [[0, 2]], [[1, 1]]]), scale=1)
    assert picture[0, :, 0].tolist() == [0, 128]


def test_a_likelihood_of_nothing_is_turquoise_all_over():
    assert np.all(draw_likelihood(stack(np.zeros((2, 3, 4)))) == TURQUOISE)


def test_a_log_likelihood_is_drawn_relative_to_its_maximum():
    picture = draw_likelihood(stack([[[-500, -500 + np.log(0.5), -np.inf]]]), scale=1, log=True)
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert picture[0, 1, 0] in (127, 128)
    assert tuple(picture[0, 2]) == TURQUOISE
    nowhere = draw_likelihood(stack(np.full((2, 3, 3), -np.inf)), scale=1, log=True)
    assert np.all(nowhere == TURQUOISE)


def test_walls_lie_over_a_likelihood_of_another_cell_size():
    grid = room(6, 9, 0.1)
    lattice = Likelihood(np.ones((1, 3, 5)), np.zeros(1), GridInfo(3, 5, 0.2), "test")
    picture = draw_likelihood(lattice, grid=grid, scale=4)  # two pixels per cell of the map
    assert picture.shape == (12, 20, 3)
    black = np.all(picture == 0, axis=2)
    expected = np.zeros((12, 20), dtype=bool)
    expected[2:10, 2:16] = True
    np.testing.assert_array_equal(black, expected)
    np.testing.assert_array_equal(picture[:, 18:], np.full((12, 2, 3), SHADE))  # off the map


def test_the_true_pose_is_marked_where_it_is():
    lattice = stack(np.ones((1, 40, 60)))
    plain, marked = draw_likelihood(lattice), draw_likelihood(lattice, truth=Pose2D(1.0, 3.0, 0))
    rows, columns = np.nonzero(np.any(plain != marked, axis=2))
    px = plain.shape[1] / 6.0
    assert abs(rows.mean() - 1.0 * px) < 0.06 * px
    assert abs(columns.mean() - 1.0 * px) < 0.2 * px  # the nose pulls it to the right


@pytest.mark.parametrize("theta", np.arange(8) * np.pi / 4)
def test_the_nose_of_a_robot_points_along_theta(theta):
    canvas = Canvas(np.full((100, 100, 3), 255, np.uint8), 10.0)
    canvas.robot(5.0, 5.0, theta, (0, 0, 200), 12.0)
    y, x = np.nonzero(close(canvas.image, (0, 0, 200)))
    far = np.argmax(np.hypot(x - 49.5, y - 49.5))
    # Pixel rows go down: y is negated.
    angle = np.arctan2(49.5 - y[far], x[far] - 49.5)
    assert abs((angle - theta + np.pi) % (2 * np.pi) - np.pi) < 0.1


def test_centres_of_pixels_are_at_integers():
    canvas = Canvas(np.zeros((40, 60, 3), np.uint8), 10.0)
    np.testing.assert_allclose(canvas.pixels(np.array([[0.05, 0.05]])), [[0, 39]])
    canvas.dots(np.array([[2.05, 1.05]]), (0, 0, 255), 3)
    np.testing.assert_allclose(np.argwhere(canvas.image[..., 2]).mean(axis=0), (29, 20))


def test_a_scan_lies_where_the_hypothesis_puts_it():
    grid = room()
    points = np.array([[1.0, 0.0], [0.0, 2.0]])
    picture = draw_hypotheses(grid, points, [hypothesis(4.0, 1.0, np.pi / 2)], scale=10)
    # (1, 0) is straight ahead, upward; (0, 2) is to the left.
    for x, y in ((4.0, 2.0), (2.0, 1.0)):
        row, column = 400 - round(y * 100), round(x * 100)
        assert close(picture[row, column], PALETTE[0])
    assert close(picture[400 - 300, 300], PAPER)


def test_the_best_hypothesis_is_drawn_over_the_others():
    both = [hypothesis(3.0, 2.0, 0.0, 0.6), hypothesis(3.0, 2.0, 0.0, 0.3)]
    picture = draw_hypotheses(room(), np.array([[1.0, 1.0]]), both, scale=10)
    assert close(picture[400 - 300, 400], PALETTE[0])


def test_a_legend_names_each_hypothesis_with_its_mass():
    grid, points = room(), np.zeros((1, 2))
    none = draw_hypotheses(grid, points, [], scale=10)
    assert none.shape == (400, 600, 3)
    some = [hypothesis(1, 1, 0, 0.5), hypothesis(2, 2, 1, 0.25), hypothesis(3, 3, 2, 0.0)]
    heights = [draw_hypotheses(grid, points, some[:n], scale=10).shape[0] for n in (1, 2, 3)]
    assert np.diff(heights).tolist() == [24, 24]
    legend = draw_hypotheses(grid, points, some, scale=10)[400:, 60:200]
    bars = [np.all(legend == colour, axis=2).any(axis=0).sum() for colour in PALETTE[:3]]
    assert bars == [60, 30, 0]
    assert draw_hypotheses(grid, points, some, scale=10, top=1).shape[0] == heights[0]


def test_the_legend_is_in_the_map_frame_and_the_picture_in_the_grid_frame():
    one = [hypothesis(2, 2, 1)]
    here = draw_hypotheses(room(), np.ones((1, 2)), one, scale=10)
    there = draw_hypotheses(room(origin=Pose2D(-7, 9, 0.5)), np.ones((1, 2)), one, scale=10)
    np.testing.assert_array_equal(here[:400], there[:400])
    assert not np.array_equal(here[400:], there[400:])


def test_a_narrow_map_leaves_room_for_the_legend():
    picture = draw_hypotheses(room(60, 10), np.ones((1, 2)), [hypothesis(0.5, 2, 1)], scale=2)
    assert picture.shape[1] > 400
    assert picture.shape[0] > 120


def test_the_true_pose_gets_a_cross_and_a_line():
    one, points = [hypothesis(2, 2, 1)], np.ones((1, 2))
    plain = draw_hypotheses(room(), points, one, scale=10)
    crossed = draw_hypotheses(room(), points, one, scale=10, truth=Pose2D(5.0, 1.0, 0.0))
    assert crossed.shape[0] - plain.shape[0] == 24
    assert close(crossed[400 - 100, 500], INK)


def test_the_ellipse_lies_along_the_greater_deviation():
    wide = Hypothesis(Pose2D(3, 2, 0), -1.0, 0.5, np.diag([0.25, 0.01, 0.01]))
    picture = draw_hypotheses(room(), np.empty((0, 2)), [wide], scale=10)
    assert not close(picture[200, 300 + 90], PAPER, 3)  # 0.9 m along x: within 2 sigma = 1 m
    assert close(picture[200 - 90, 300], PAPER, 3)


def test_the_colours_of_opposite_directions_differ_and_weak_ones_fade():
    right, left, weak = wheel(np.array([0.0, np.pi, 0.0]), np.array([1.0, 1.0, 0.0])).astype(int)
    assert np.abs(right - left).max() > 100
    assert weak.tolist() == [255, 255, 255]
    np.testing.assert_array_equal(wheel(-0.001, 1.0), wheel(2 * np.pi, 1.0))


def test_a_field_shows_its_arrows_on_its_walls():
    vmap = np.zeros((2, 20, 30), dtype=np.float32)
    vmap[0, :, 8] = 1.0
    vmap[0, :, 12] = -1.0
    picture = draw_field(vmap, 0.1, scale=8)
    assert picture.shape == (160, 240, 3)
    assert close(picture[:, :40], PAPER, 0).all()
    left, right = (picture[:, k * 8 + 1].astype(int) for k in (8, 12))
    assert np.abs(np.median(left, axis=0) - np.median(right, axis=0)).max() > 30
    ink = close(picture, INK, 40).any(axis=0)
    assert ink[60:80].any()
    assert ink[90:110].any()


def test_a_field_of_nothing_is_white():
    assert np.all(draw_field(np.zeros((2, 5, 7), dtype=np.float32), 0.1) == 255)


def test_normals_stand_on_their_side_of_the_wall():
    occupied = np.zeros((20, 30), dtype=bool)
    occupied[:, 14] = True
    xy = np.column_stack((np.full(10, 1.5), np.linspace(0.3, 1.7, 10)))
    nan = np.full(10, np.nan)
    surface = OrientedPoints(xy, np.zeros(10), np.zeros(10), np.ones(10, dtype=bool))
    grid = OccupancyGrid(occupied, ~occupied, 0.1)
    picture = draw_surface(grid, surface, scale=10)
    colourful = np.ptp(picture.astype(int), axis=2) > 60
    columns = np.flatnonzero(colourful.any(axis=0))
    assert 147 <= columns.min() <= 151
    assert 165 <= columns.max() <= 180
    blind = OrientedPoints(xy, nan, nan, np.zeros(10, dtype=bool))
    dots = draw_surface(grid, blind, scale=10)
    assert not (np.ptp(dots.astype(int), axis=2) > 60).any()
    assert close(dots[200 - 30, 150], INK, 40)


@pytest.mark.parametrize(("alpha", "seen"), [(0.0, (0, 1)), (np.pi / 2, (-1, 0))])
def test_a_fan_covers_what_is_seen(alpha, seen):
    vis = np.zeros(36)
    vis[9] = 1.5  # 90 degrees from bin 0
    vis[27] = np.inf  # the other way, up to the horizon
    picture = draw_visibility(room(), (3.0, 2.0), vis, horizon=1.0, alpha=alpha, scale=10)

    def tinted(x, y):
        return np.ptp(picture[400 - round(y * 100), round(x * 100)].astype(int)) > 15

    dx, dy = seen
    assert tinted(3.0 + 1.0 * 0.9 * dx, 2.0 + 1.0 * 0.9 * dy)
    assert not tinted(3.0 + 1.2 * dx, 2.0 + 1.2 * dy)  # longer than the horizon
    assert tinted(3.0 - 0.9 * dx, 2.0 - 0.9 * dy)
    assert not tinted(3.0 - 1.1 * dx, 2.0 - 1.1 * dy)
    assert not tinted(3.0 + 0.5 * dy, 2.0 - 0.5 * dx)


def test_a_mosaic_holds_every_picture_and_its_caption():
    colours = [(10, 20, 30), (40, 50, 60), (70, 80, 90)]
    pictures = [np.full((20 + 10 * k, 60, 3), c, np.uint8) for k, c in enumerate(colours)]
    sheet = mosaic([(f"({k})", p) for k, p in enumerate(pictures)], columns=2)
    assert sheet.dtype == np.uint8
    for picture, colour in zip(pictures, colours, strict=True):
        assert np.all(sheet == colour, axis=2).sum() == picture.shape[0] * picture.shape[1]
        rows, columns = np.nonzero(np.all(sheet == colour, axis=2))
        below = sheet[rows.max() + 1 : rows.max() + 26, columns.min() : columns.max()]
        assert (below < 128).any()
    assert np.all(sheet[:16] == 255)


def test_an_empty_mosaic_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        mosaic([])


def test_drawing_leaves_its_inputs_alone_and_gives_the_same_bytes():
    grid, points, one = room(), np.ones((3, 2)), [hypothesis(2, 2, 1)]
    first = draw_hypotheses(grid, points, one, truth=Pose2D(1, 1, 0))
    assert first.tobytes() == draw_hypotheses(grid, points, one, truth=Pose2D(1, 1, 0)).tobytes()
    assert np.all(points == 1)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous


def answer(*hypotheses, found=0, unlisted=0.0):
    evidence = Evidence(found=found, listed=len(hypotheses), unlisted=unlisted)
    return Localization(tuple(hypotheses), "ambiguous", 0.0, 1.0, elsewhere=0.1, evidence=evidence)


def inner(picture, size=(640, 960)):
    """The map of a picture with axes, without what is around it."""
    left = picture.shape[1] - 6 - size[1]
    return picture[6 : 6 + size[0], left : left + size[1]]


def test_one_call_draws_an_answer_in_the_map_frame():
    origin = Pose2D(-7.0, 9.0, np.pi / 2)
    at = compose(origin, Pose2D(4.0, 1.0, 0.0))
    scan = LaserScan([1.0], [np.pi / 2], range_max=9.0)  # one point, on the left
    picture = draw(room(origin=origin), answer(hypothesis(at.x, at.y, at.theta)), scan).image
    px = 960 / 6.0
    assert close(inner(picture)[round((4.0 - 2.0) * px), round(4.0 * px)], PALETTE[0])
    same = draw(MapFeatures(room(origin=origin)), answer(hypothesis(at.x, at.y, at.theta)), scan)
    np.testing.assert_array_equal(same.image, picture)
    crossed = draw(room(origin=origin), answer(hypothesis(at.x, at.y, at.theta)), truth=at).image
    assert close(inner(crossed)[round((4.0 - 1.0) * px), round(4.0 * px)], INK)


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi / 2])
def test_a_pose_is_found_by_the_ticks(turn):
    """Lines of the grid cross where their labels say, whichever way the map frame is turned."""
    origin = Pose2D(-7.0, 9.0, turn)
    canvas = Canvas(np.full((400, 600, 3), 255, np.uint8), 100.0)
    ticks = draw_grid(canvas, origin)
    assert len({tick.label for tick in ticks}) == len(ticks) > 5
    for tick in ticks:
        pixel = (tick.at + 0.5, 400.0) if tick.below else (0.0, tick.at + 0.5)
        xy = transform_points(origin, np.array([[pixel[0] / 100, (400 - pixel[1]) / 100]]))[0]
        axis, _, value = tick.label.rpartition(" ")
        axis = axis or ("x" if tick.below else "y")
        assert xy["xy".index(axis)] == pytest.approx(float(value), abs=0.02)
    dark = np.all(canvas.image < 240, axis=2)
    for tick in ticks:
        spot = dark[-3:, round(tick.at) - 2 : round(tick.at) + 3]
        assert not tick.below or spot.any()


def test_a_title_a_legend_for_each_layer_and_no_place_without_mass():
    some = [hypothesis(1.0 + k, 2.0, 0.0, mass) for k, mass in enumerate((0.9, 0.0012, 0.0008))]
    scan = LaserScan([1.0], [0.5], range_max=9.0)
    plain = draw(room(), answer(*some, found=3), scan).image
    fewer = draw(room(), answer(*some[:2], found=3, unlisted=0.0008), scan).image
    np.testing.assert_array_equal(plain, fewer)
    titled = draw(room(), answer(*some, found=3), scan, title="attic: a.log, scan 3").image
    assert len(titled) == len(plain) + 24
    np.testing.assert_array_equal(titled[24 + 6 :], plain[6:])
    assert np.all(inner(plain) == PALETTE[0], axis=2).any()
    assert not np.all(inner(plain) == PALETTE[2], axis=2).any()


def test_the_maximum_of_a_likelihood_is_marked():
    values = np.full((2, 40, 60), 0.2)
    values[1, 10, 45] = 1.0
    shown = inner(draw(room(), stack(values)).image)
    x, y = round(45.5 * 16), 640 - round(10.5 * 16)
    assert np.all(shown[y - 12 : y + 12, x - 12 : x + 12] == PALETTE[1], axis=2).any()
    assert np.all(shown == PALETTE[1], axis=2).sum() < 1000


def test_one_call_draws_a_map_a_likelihood_and_every_feature():
    grid, lattice = room(), stack(np.ones((1, 40, 60)))
    np.testing.assert_array_equal(draw(grid).image, draw_map(grid))
    shown = draw(grid, lattice, truth=Pose2D(1, 1)).image
    bare = draw_likelihood(lattice, grid=grid, truth=Pose2D(1, 1), origin=grid.origin)
    np.testing.assert_array_equal(shown[: len(bare)], bare)
    assert len(shown) > len(bare) + 38  # by a bar of the greys, and a legend
    features = MapFeatures(grid)
    pictures = [draw(features, what=what).image for what in SUBJECTS]
    assert len({p.tobytes() for p in pictures}) == len(SUBJECTS)


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


def test_a_legend_says_what_is_left_out():
    def text_rows(*given, **more):
        return draw(room(), answer(*given, **more)).image.shape[0]

    seven = [hypothesis(1 + k / 2, 1, 0, 0.1) for k in range(7)]
    assert _not_drawn(answer(*seven, found=9, unlisted=0.05)) == (
        "3 other poses: 15.0 %, elsewhere: 10.0 %"
    )
    assert _not_drawn(answer(seven[0], found=1)) == "elsewhere: 10.0 %"
    assert text_rows(seven[0]) == text_rows(*seven[:2]) - 24
    assert text_rows() == 640 + 32 + 24 + 28  # the verdict, if nothing else


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
    picture = draw_distance(metres, GridInfo(3, 25, 0.1), scale=1)
    grey = picture.astype(int).sum(axis=2)[1]
    assert grey.argmin() == 0
    assert grey[9] > grey[8]
    assert grey[9] > grey[11]


def test_blurred_map_is_upside_up() -> None:
    picture = draw_bmap([[1.0, 1.0], [0.0, 0.5]], GridInfo(2, 2, 0.1), scale=1)
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
    assert (even == blue).all(axis=2).sum() > 4 * (both == blue).all(axis=2).sum()


def test_a_scan_that_is_small_on_the_map_gets_an_inset() -> None:
    wall = np.pad(np.zeros((200, 300), bool), 2, constant_values=True)
    grid = OccupancyGrid(wall, ~wall, 0.1)
    near = np.array([(0.5, 0.0), (0.5, 0.3)])
    small = draw_hypotheses(grid, near, [hypothesis(5.0, 5.0, 0.0)])
    large = draw_hypotheses(grid, 20 * near, [hypothesis(5.0, 5.0, 0.0)])
    assert len(small) > len(large) + 200
    assert small.shape[1] == large.shape[1]


def test_numbers_of_poses_at_one_place_stand_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    written = list[tuple[str, int, int]]()

    def write(image, message, x, y, colour=INK, size=13):
        if colour == INK and message.isdigit() and size == 15:
            written.append((message, x, y))
        return text(image, message, x, y, colour, size)

    monkeypatch.setattr("imgloc.output.canvas.text", write)
    turned = [hypothesis(3.0, 2.0, theta, 0.2) for theta in (0.0, 0.0, 1.6, 3.1, 0.0)]
    draw_hypotheses(room(), np.zeros((0, 2)), turned, scale=10, truth=Pose2D(3.0, 2.0, 0.0))
    assert [message for message, _, _ in written] == list("12345")
    for k, (_, x, y) in enumerate(written):
        for _, u, v in written[:k]:
            assert abs(x - u) >= 9 or abs(y - v) >= 14
        assert max(abs(x + 4 - 300), abs(y - 5 - 200)) > 15  # and off the cross


def test_the_legend_stands_beside_a_high_map_and_is_as_high() -> None:
    wall = np.pad(np.zeros((320, 100), bool), 2, constant_values=True)
    points = np.array([(0.5, 0.0), (0.5, 0.3)])
    grid = OccupancyGrid(wall, ~wall, 0.1)
    high = draw_hypotheses(grid, points, [hypothesis(5.0, 5.0, 0.0)], scale=4)
    assert high.shape[0] == 4 * 324
    frame = np.argwhere(np.all(high[:, 4 * 104 :] == INK, axis=2))
    assert np.ptp(frame[:, 0]) > 0.6 * 4 * 324  # the inset takes what is left


def test_what_is_unknown_around_a_map_is_left_out() -> None:
    occupied, points = np.zeros((400, 600), bool), np.zeros((0, 2))
    occupied[150:250, 200] = occupied[150:250, 300] = True
    free = np.zeros_like(occupied)
    free[150:250, 201:300] = True
    grid = OccupancyGrid(occupied, free, 0.1)
    near = draw_hypotheses(grid, points, [hypothesis(25.0, 20.0, 0.0)], scale=4)
    assert near.shape[1] < 4 * 300
    there = np.argwhere(np.all(near == (146, 140, 134), axis=2))
    assert np.ptp(there[:, 0]) + 1 == 400
    far = draw_hypotheses(grid, points, [hypothesis(25.0, 20.0, 0.0), hypothesis(59.0, 1.0, 0.0)],
                          scale=4)  # fmt: skip
    assert far.shape[1] == 4 * (600 - 187)  # up to the pose that is out there


def test_a_note_stands_below_and_wraps() -> None:
    short, long = (draw(room(), answer(), note=note).image for note in ("mm?", "word " * 90))
    assert len(short) == 640 + 32 + 2 * 24 + 28
    assert len(long) > len(short) + 4 * 24
    assert long.shape[1] == short.shape[1] < 1000


def test_words_grow_with_the_picture() -> None:
    few = draw_hypotheses(room(), np.zeros((0, 2)), [hypothesis(1.0, 1.0, 0.0)], scale=10)
    many = draw_hypotheses(room(), np.zeros((0, 2)), [hypothesis(1.0, 1.0, 0.0)], scale=80)
    height = len(room().occupied)
    assert len(many) - 80 * height > 1.5 * (len(few) - 10 * height)


def test_distances_have_their_colours_where_robots_are() -> None:
    row = np.array([[0.5, 2.5, 3.0, 30.0]]).repeat(2, axis=1)  # lines are between metres
    image = draw_distance(row, GridInfo(1, 8, 0.1), scale=4)
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
    assert np.array_equal(saved(draw(room()))[0], draw_map(room()))


@pytest.mark.parametrize("shape", [(900, 12), (12, 900), (20, 20)])
def test_no_title_is_cut_on_a_strip(shape: tuple[int, int]) -> None:
    image = np.full((*shape, 3), 255, np.uint8)
    f = enlarged(image)
    for title in ("west", "west: monday.npz, scan 3", "west_" * 40, "a b " * 60):
        out = framed(image, [], title)
        inked = np.flatnonzero((out[: -shape[0] - round(26 * f)] < 128).any(axis=(0, 2)))
        assert inked[-1] < out.shape[1] - 2  # the last letter ends before the picture does
        assert out.shape[1] <= max(shape[1] + 40 * f, 480 * f)
        lines = wrapped(title, out.shape[1] - 2 * round(6 * f), round(14 * f))
        assert "".join(lines).replace(" ", "") == title.replace(" ", "")
        assert len(out) >= shape[0] + len(lines) * round(24 * f)
