import cv2
import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgloc.errors import ConfigError
from imgloc.geometry import uniform_thetas
from imgloc.likelihoods import correlate as engines
from imgloc.likelihoods import shift
from imgloc.likelihoods.correlate import EXACT, choose_engine, correlate
from imgloc.likelihoods.spectral import multiply_packed, needs_double

seeds = st.integers(0, 2**32 - 1)
every_engine = pytest.mark.parametrize("engine", EXACT)
ONE = np.zeros(1)


def random_case(seed, shape=(7, 10), n=12, reach=0.7):
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, shape).astype(np.uint8)
    return image, rng.uniform(-reach, reach, (n, 2))


@every_engine
@pytest.mark.parametrize("k", [1, 3, 4, 6])
def test_full_circle_equals_algorithm_2(engine, k):
    image, xy = random_case(k)
    thetas = uniform_thetas(2 * np.pi / k)
    expected = naive.cbml_faster(image, xy, thetas, 0.1)
    np.testing.assert_array_equal(correlate(image, xy, thetas, 0.1, engine=engine), expected)


@every_engine
def test_lost_and_far_points_add_nothing(engine):
    image, xy = random_case(3)
    lost = [[np.nan, 0], [np.inf, 0], [0, -np.inf], [np.nan, np.nan], [1e12, 0], [0.05, -1e300]]
    thetas = np.array([0.0, 1.0, np.pi])
    np.testing.assert_array_equal(
        correlate(image, np.concatenate((xy, lost)), thetas, 0.1, engine=engine),
        correlate(image, xy, thetas, 0.1, engine=engine),
    )


@every_engine
def test_no_points_and_no_headings(engine):
    image, xy = random_case(4)
    nothing = correlate(image, np.empty((0, 2)), np.arange(3.0), 0.1, engine=engine)
    np.testing.assert_array_equal(nothing, np.zeros((3, 7, 10)))
    assert correlate(image, xy, np.empty(0), 0.1, engine=engine).shape == (0, 7, 10)


@every_engine
def test_sums_beyond_16_bits(engine):
    # 700 readings of 255 on one map: 178500 > 65535, half of them in one cell.
    image = np.full((12, 15), 255, dtype=np.uint8)
    image[3, 4] = 254
    xy = np.random.default_rng(5).uniform(-0.3, 0.3, (700, 2))
    xy[::2] = 0.011
    expected = naive.cbml(image, xy, ONE, 0.1)
    assert expected.max() > 2 * 65535
    np.testing.assert_array_equal(correlate(image, xy, ONE, 0.1, engine=engine), expected)


@pytest.mark.parametrize("shape", [(600, 620), (3, 1500), (130, 90)])
def test_engines_agree_to_the_bit_over_several_tiles(shape):
    image, xy = random_case(6, shape, n=60, reach=8.0)
    thetas = uniform_thetas(np.pi)
    stacks = [correlate(image, xy, thetas, 0.1, engine=engine) for engine in EXACT]
    np.testing.assert_array_equal(stacks[0], stacks[1])
    np.testing.assert_array_equal(stacks[0], stacks[2])


def test_double_precision_is_for_many_readings_in_one_cell():
    image = np.full((100, 100), 255, np.uint8)
    apart = np.stack(np.divmod(np.arange(100), 10), axis=-1)[None]
    assert not needs_double(image, apart)  # norms of 10 and 25,500, of which 6e-8: 0.015
    assert needs_double(image, np.zeros_like(apart))  # a norm of 100: 0.15, and 0.1 is allowed
    assert not needs_double(image, np.zeros_like(apart)[:, :60])


def test_dft_is_exact_where_single_precision_is_not():
    image = np.full((300, 300), 255, dtype=np.uint8)
    xy = np.random.default_rng(7).uniform(-3, 3, (9000, 2))
    xy[::2] = 0.5  # a kernel of one huge weight
    stacks = [correlate(image, xy, ONE + 0.4, 0.1, engine=engine) for engine in ("dft", "shift")]
    assert stacks[0].max() > 2e6
    np.testing.assert_array_equal(*stacks)


@every_engine
def test_float_images(engine):
    image, xy = random_case(8)
    real = (image / np.float32(51)).astype(np.float32)
    thetas = np.array([0.2, 0.2 + np.pi])
    np.testing.assert_allclose(
        correlate(real, xy, thetas, 0.1, engine=engine),
        naive.cbml(real, xy, thetas, 0.1),
        atol=2e-5,
    )


@every_engine
@pytest.mark.parametrize("k", [1, 5, 6])
def test_any_number_of_threads_gives_the_same_bits(engine, k):
    image, xy = random_case(9, (40, 31), 50, 2.0)
    real = image.astype(np.float32) / 7
    thetas = uniform_thetas(2 * np.pi / k)
    before = cv2.getNumThreads()
    for source in (image, real):
        one, *more = (
            correlate(source, xy, thetas, 0.1, engine=engine, threads=t) for t in (1, 2, 3, 9)
        )
        for stack in more:
            np.testing.assert_array_equal(stack, one)
    assert cv2.getNumThreads() == before


@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize(("top", "n"), [(5, 51), (4, 64), (85, 3), (255, 1), (128, 2), (0, 9)])
def test_sums_up_to_255_fit_a_byte_and_others_do_not(monkeypatch, flat, top, n):
    if not flat:
        monkeypatch.setattr(engines, "FLAT_CELLS", 0)
    image, _ = random_case(13, (9, 12))
    image = (image.astype(int) % (top + 1)).astype(np.uint8)
    image[4, 5] = top
    xy = np.tile([0.1, 0.0], (n, 1))  # all in one cell: the largest sum there is
    thetas = np.array([0.0, 1.0])
    stack = correlate(image, xy, thetas, 0.1, engine="shift")
    np.testing.assert_array_equal(stack, naive.cbml(image, xy, thetas, 0.1))
    assert stack.max() == top * n


@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize("piece", [0, 1 << 20])
@every_engine
def test_a_stack_of_bytes_holds_the_sums_that_fit(monkeypatch, engine, flat, piece):
    if not flat:
        monkeypatch.setattr(engines, "FLAT_CELLS", 0)
    monkeypatch.setattr(shift, "FLAT_PIECE", piece)
    image, xy = random_case(16, (8, 11))
    image, thetas = image // 13, np.array([0.3, 0.3 + np.pi, 2.0])  # 12 points of at most 19
    where = image > 2
    sums = correlate(image, xy, thetas, 0.1, where=where, engine="filter2d")
    out = np.empty(sums.shape, np.uint8)
    assert correlate(image, xy, thetas, 0.1, engine=engine, where=where, out=out) is out
    np.testing.assert_array_equal(out, sums)
    assert sums.max() > 30
    for bad, divisor in ((image + np.uint8(5), 1.0), (image, 2.0), (image / np.float32(9), 1.0)):
        with pytest.raises(ValueError, match="do not fit"):
            correlate(bad, xy, thetas, 0.1, engine=engine, out=out, divisor=divisor)


@every_engine
def test_divisor(engine):
    image, xy = random_case(14, (8, 9))
    thetas = np.array([0.3, 0.3 + np.pi, 2.0])
    where = image > 20
    sums = correlate(image, xy, thetas, 0.1, engine=engine, where=where)
    means = correlate(image, xy, thetas, 0.1, engine=engine, where=where, divisor=255)
    np.testing.assert_array_equal(means, sums / np.float32(255))
    assert 0 < means.max() < sums.max()


@pytest.mark.parametrize("height", [1, 2, 5, 6])
@pytest.mark.parametrize("width", [1, 2, 3, 8, 9])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("conjugate", [False, True])
def test_packed_spectra_are_multiplied_as_opencv_does(height, width, kind, conjugate):
    rng = np.random.default_rng(15)
    a, b = (cv2.dft(rng.normal(size=(height, width)).astype(kind)) for _ in range(2))
    out = np.full_like(a, np.nan)
    multiply_packed(a, b, out, conjugate=conjugate)
    expected = cv2.mulSpectrums(a, b, 0, conjB=conjugate)
    np.testing.assert_allclose(out, expected, atol=1e-4 if kind is np.float32 else 1e-12)


@every_engine
def test_only_wanted_poses(engine):
    image, xy = random_case(10, (20, 30), 40, 1.0)
    image[:, :9] = 0  # an unknown border, to be skipped altogether
    image[15:] = 0
    where = np.zeros(image.shape, dtype=bool)
    where[4:9, 12:20] = True
    where[6, 15] = False
    thetas = uniform_thetas(np.pi / 3)
    full = correlate(image, xy, thetas, 0.1, engine=engine)
    out = np.full(full.shape, np.nan, dtype=np.float32)
    result = correlate(image, xy, thetas, 0.1, engine=engine, where=where, out=out)
    assert result is out
    np.testing.assert_array_equal(result, np.where(where, full, 0))
    nowhere = correlate(image, xy, thetas, 0.1, engine=engine, where=np.zeros_like(where), out=out)
    assert not nowhere.any()


def test_image_may_be_any_view():
    image, xy = random_case(12, (14, 20))
    thetas = np.array([0.0, 1.1])
    for view in (image[::2, ::2], image.T, image[::-1, ::-1]):
        view.flags.writeable = False
        for engine in EXACT:
            np.testing.assert_array_equal(
                correlate(view, xy, thetas, 0.1, engine=engine), naive.cbml(view, xy, thetas, 0.1)
            )


@pytest.mark.parametrize(
    "out",
    [
        np.empty((2, 7, 9), np.float32),
        np.empty((1, 7, 10)),
        np.empty((1, 7, 20), np.float32)[..., ::2],
        np.frombuffer(bytes(280), np.float32).reshape(1, 7, 10),  # may not be written to
    ],
)
def test_refuses_an_output_that_does_not_fit(out):
    image, xy = random_case(13)
    with pytest.raises(ValueError, match="out must be"):
        correlate(image, xy, ONE, 0.1, out=out)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("engine", "fft", "auto, filter2d, shift, dft, remap, got 'fft'"),
        ("threads", 0, "threads"),
        ("resolution", 0.0, "resolution"),
        ("resolution", np.nan, "resolution"),
        ("image", np.zeros((3, 3)), "uint8 or float32, got float64"),
        ("image", np.zeros((3, 3, 3), np.uint8), "H, W"),
        ("xy", np.zeros((5, 3)), r"\(N, 2\)"),
        ("where", np.ones((3, 3), dtype=bool), "where"),
        ("where", np.ones((7, 10)), "where"),
    ],
)
def test_refuses_what_does_not_fit(name, value, words):
    image, xy = random_case(14)
    good = {"image": image, "xy": xy, "thetas": ONE, "resolution": 0.1}
    with pytest.raises((ConfigError, ValueError), match=words):
        correlate(**{**good, name: value})


def test_cost_model():
    rng = np.random.default_rng(16)
    tiles = shift.tiles_of((400, 500))

    def chosen(n, reach, tiles=tiles):
        offsets = rng.integers(-reach, reach + 1, (8, n, 2))
        return choose_engine("auto", offsets, (400, 500), tiles)

    assert chosen(40, 100) == "shift"
    assert chosen(300, 100) == "dft"
    assert chosen(181, 390) == "shift"  # most shifts leave little of the map
    where = np.zeros((400, 500), dtype=bool)
    where[:40, :50] = True
    assert chosen(300, 100, shift.tiles_of((400, 500), where)) == "shift"  # few poses wanted
    assert chosen(0, 1) == "shift"


def test_tiles_cover_every_pose_once():
    for shape in [(1, 1), (5, 3000), (3000, 5), (700, 1025)]:
        covered = np.zeros(shape, dtype=int)
        for t in shift.tiles_of(shape):
            assert (t.r1 - t.r0) * (t.c1 - t.c0) <= shift.TILE_CELLS
            covered[t.r0 : t.r1, t.c0 : t.c1] += 1
        assert (covered == 1).all()


@settings(max_examples=60)
@given(seeds, st.sampled_from(EXACT), st.integers(1, 9), st.integers(1, 9))
def test_random_cases_equal_the_listing(seed, engine, height, width):
    image, xy = random_case(seed, (height, width), reach=1.2)
    thetas = np.random.default_rng(seed).uniform(-9, 9, 3)
    stack = correlate(image, xy, thetas, 0.1, engine=engine)
    np.testing.assert_array_equal(stack, naive.cbml(image, xy, thetas, 0.1))
