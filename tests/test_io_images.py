"""Image files: pixels as stored on every OpenCV, damage refused. `field-notes` section 4."""

import io
import re
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from badfiles import chunk, encode, png, room
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import imgloc
from imgloc.errors import MapError
from imgloc.io.files import display
from imgloc.io.images import IMAGE_ENDINGS, LOSSY_ENDINGS, decode_image, image_size, read_image

EXIF_ROTATED = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
PALETTE = chunk(b"PLTE", bytes([0, 255, 0, 9, 8, 7]))


@pytest.mark.parametrize(
    ("data", "expected", "white"),
    [
        (png(2, 1, 8, 0, [bytes([0, 205])]), [[0, 205]], 255),
        (png(4, 1, 1, 0, [bytes([0b10100000])]), [[255, 0, 255, 0]], 255),
        (png(4, 1, 2, 0, [bytes([0b00011011])]), [[0, 85, 170, 255]], 255),
        (png(2, 1, 16, 0, [struct.pack(">HH", 256, 65535)]), [[256, 65535]], 65535),
        # Grey with alpha: as BGRA.
        (png(1, 1, 8, 4, [bytes([205, 7])]), [[[205, 205, 205, 7]]], 255),
        (png(1, 1, 8, 2, [bytes([1, 2, 3])]), [[[3, 2, 1]]], 255),
        (png(1, 1, 8, 6, [bytes([1, 2, 3, 4])]), [[[3, 2, 1, 4]]], 255),
        (png(2, 1, 8, 3, [b"\0\1"], before=PALETTE), [[[0, 255, 0], [7, 8, 9]]], 255),
        # Transparency by colour or palette index.
        (
            png(2, 1, 8, 3, [b"\0\1"], before=PALETTE + chunk(b"tRNS", b"\0")),
            [[[0, 255, 0, 0], [7, 8, 9, 255]]],
            255,
        ),
        (
            png(2, 1, 8, 0, [bytes([0, 205])], before=chunk(b"tRNS", b"\0\xcd")),
            [[[0, 0, 0, 255], [205, 205, 205, 0]]],
            255,
        ),
        (
            png(2, 1, 2, 0, [bytes([0b00100000])], before=chunk(b"tRNS", b"\0\2")),
            [[[0, 0, 0, 255], [170, 170, 170, 0]]],
            255,
        ),
        # Gamma and orientation do not belong to the pixels of a map.
        (
            png(
                2,
                1,
                8,
                0,
                [bytes([100, 205])],
                before=chunk(b"gAMA", struct.pack(">I", 20000)) + chunk(b"eXIf", EXIF_ROTATED),
            ),
            [[100, 205]],
            255,
        ),
    ],
)
def test_png_pixels_are_as_stored(data: bytes, expected: object, white: int) -> None:
    image = decode_image(data, "map.png")
    np.testing.assert_array_equal(image.pixels, expected)
    assert image.white == white
    assert image.channels == (1 if image.pixels.ndim == 2 else image.pixels.shape[2])


def test_every_pass_of_an_interlaced_png_is_counted() -> None:
    rows, columns = np.mgrid[:19, :21]
    # The pass that each pixel of a block of eight by eight comes with (the PNG specification, 8.2).
    block = ["16462646", "77777777", "56565656", "77777777",
             "36463646", "77777777", "56565656", "77777777"]  # fmt: skip
    number = np.array([list(map(int, row)) for row in block])[rows % 8, columns % 8]
    lines = [(number[row] == k).sum() for k in range(1, 8) for row in range(19)]
    data = b"".join(bytes(1 + count) for count in lines if count)  # a filter byte before each line
    good = png(21, 19, 8, 0, [], idat=zlib.compress(data), interlace=1)
    assert decode_image(good, "m.png").pixels.shape == (19, 21)
    with pytest.raises(MapError, match="truncated PNG: "):
        decode_image(png(21, 19, 8, 0, [], idat=zlib.compress(data[:-1]), interlace=1), "m.png")


def test_interlaced_png_is_whole_or_refused() -> None:
    # Adam7 of a 3 x 3 image: passes 1, 5 (row 2), 6 (column 1) and 7 (row 1) hold pixels,
    # pass 4 holds column 2; each row has its filter byte.
    want = np.arange(9, dtype=np.uint8).reshape(3, 3) * 10
    rows = [want[0:1, 0:1], want[0:1, 2:3], want[2:3, 0:3:2], want[0:1, 1:2], want[2:3, 1:2]]
    data = b"".join(b"\0" + r.tobytes() for r in [*rows, want[1:2, :]])
    good = png(3, 3, 8, 0, [], idat=zlib.compress(data), interlace=1)
    np.testing.assert_array_equal(decode_image(good, "i.png").pixels, want)
    short = png(3, 3, 8, 0, [], idat=zlib.compress(data[:-1]), interlace=1)
    with pytest.raises(MapError, match="truncated PNG: 14 of 15 bytes"):
        decode_image(short, "i.png")


@pytest.mark.parametrize(("top", "fine"), [(0, True), (255, False), (4095, False), (4096, True)])
def test_16_bits_that_hold_fewer_are_refused(top: int, fine: bool) -> None:
    data = encode(".png", np.array([[0, top]], np.uint16))
    if fine:
        assert decode_image(data, "d.png").pixels.tolist() == [[0, top]]
    else:
        with pytest.raises(MapError, match="16-bit"):
            decode_image(data, "d.png")


PGM_ROWS = bytes([0, 50, 100, 10, 20, 30])


@pytest.mark.parametrize(
    ("data", "expected", "white"),
    [
        (b"P5\n3 2\n100\n" + PGM_ROWS, [[0, 50, 100], [10, 20, 30]], 100),
        (b"P5 3 2 100 " + PGM_ROWS, [[0, 50, 100], [10, 20, 30]], 100),
        (b"P5\r\n3 2\r\n100\r\n" + PGM_ROWS, [[0, 50, 100], [10, 20, 30]], 100),
        (b"P5\n# of\n# two lines\n3 2 # wide\n100\n" + PGM_ROWS, [[0, 50, 100], [10, 20, 30]], 100),
        (b"P5\n3 2\n100\n" + PGM_ROWS + b"\n", [[0, 50, 100], [10, 20, 30]], 100),
        # A header that ends in LF, before a pixel of 10 = LF; and one that ends in CR.
        (b"P5\n2 1\n100\n\n\x05", [[10, 5]], 100),
        (b"P5\n2 1\n100\r\n\x05", [[10, 5]], 100),
        (b"P5\n2 1\n4095\n" + struct.pack(">HH", 4095, 300), [[4095, 300]], 4095),
        (b"P2\n3 1 # comment\n15\n0 7 # another\n15\n", [[0, 7, 15]], 15),
        (b"P3 1 1 255 1 2 3", [[[3, 2, 1]]], 255),
        (b"P6 1 1 255 \x01\x02\x03", [[[3, 2, 1]]], 255),
    ],
)
def test_netpbm_honours_maxval_and_line_endings(data: bytes, expected: object, white: int) -> None:
    image = decode_image(data, "map.pgm")
    np.testing.assert_array_equal(image.pixels, expected)
    assert image.white == white


def test_crlf_header_is_where_cv2_shifts_the_image() -> None:
    data = b"P5\r\n4 1\r\n255\r\n" + bytes([1, 2, 3, 4])
    assert decode_image(data, "c.pgm").pixels.tolist() == [[1, 2, 3, 4]]
    theirs = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert theirs is None or theirs.tolist() != [[1, 2, 3, 4]]


def test_jpeg_only_on_request_and_never_half() -> None:
    jpeg = encode(".jpg", room())
    with pytest.raises(MapError, match="`allow_lossy=True`"):
        decode_image(jpeg, "a.jpg")
    image = decode_image(jpeg, "a.jpg", allow_lossy=True)
    assert image.kind == "jpeg"
    assert image.pixels.shape == (40, 50)
    assert np.abs(image.pixels.astype(int) - room()).max() < 60
    for end in (200, len(jpeg) // 2, len(jpeg) - 1):
        with pytest.raises(MapError, match="truncated"):
            decode_image(jpeg[:end], "a.jpg", allow_lossy=True)


def test_jpeg_is_not_turned_by_exif() -> None:
    jpeg = encode(".jpg", room())
    body = b"Exif\0\0" + EXIF_ROTATED
    turned = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:]
    there = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert there.shape == (50, 40)  # the tag does say "rotate"
    assert decode_image(turned, "a.jpg", allow_lossy=True).pixels.shape == (40, 50)


def test_bmp_padding_is_not_alpha() -> None:
    grey = decode_image(encode(".bmp", room()), "a.bmp")
    np.testing.assert_array_equal(grey.pixels.reshape(40, 50, -1)[:, :, 0], room())
    # 32 bits a pixel, the fourth byte 0 as the format allows: not transparent.
    header = struct.pack("<2sIHHI", b"BM", 62, 0, 0, 54)
    header += struct.pack("<IiiHHIIiiII", 40, 2, 1, 1, 32, 0, 8, 0, 0, 0, 0)
    image = decode_image(header + bytes([1, 2, 3, 0, 4, 5, 6, 0]), "b.bmp")
    assert image.pixels.tolist() == [[[1, 2, 3], [4, 5, 6]]]
    # 5, 6 and 5 bits of a pixel.
    header = header[:28] + struct.pack("<HI", 16, 3) + header[34:]
    masks = struct.pack("<3I", 0xF800, 0x07E0, 0x001F)
    header = header[:10] + struct.pack("<I", 66) + header[14:]
    image = decode_image(header + masks + struct.pack("<HH", 0xFFFF, 0xF800), "c.bmp")
    assert image.pixels.tolist() == [[[255, 255, 255], [0, 0, 255]]]
    with pytest.raises(MapError, match="compressed BMP"):
        decode_image(header[:28] + struct.pack("<HI", 8, 1) + header[34:] + bytes(2000), "d.bmp")


def test_size_is_refused_on_the_header_alone() -> None:
    data = encode(".png", room())
    assert decode_image(data, "a.png", max_pixels=2000).pixels.shape == (40, 50)
    with pytest.raises(MapError, match=r"a\.png: 50 x 40 = 2,000 pixels, expected at most 1,999"):
        decode_image(data[:48], "a.png", max_pixels=1999)  # no pixels are there


def test_file_longer_than_its_pixels_could_need_is_not_read(tmp_path) -> None:
    path = tmp_path / "sparse.png"
    with path.open("wb") as file:
        file.truncate(10**10)  # a sparse file: no disk is used
    with pytest.raises(MapError, match="10,000,000,000 bytes"):
        read_image(path)


def test_undecodable_names_do_not_crash(tmp_path) -> None:
    path = tmp_path / "x"
    raw = path.with_name(b"caf\xe9.png".decode("utf-8", "surrogateescape"))
    try:
        raw.write_bytes(encode(".png", room()))
    except OSError:
        pytest.skip("this file system refuses names that are not text")
    np.testing.assert_array_equal(read_image(raw).pixels, room())
    with pytest.raises(MapError, match=r"caf\\xe9\.jpg: no such file; beside it .*caf\\xe9\.png"):
        read_image(raw.with_suffix(".jpg"))


def test_display_is_one_printable_line() -> None:
    assert display("a\nb\x1b[31m.png") == "a\\nb\\x1b[31m.png"
    assert display("größe.png") == "größe.png"


def test_null_byte_in_a_name() -> None:
    with pytest.raises(MapError, match="null byte"):
        read_image("a\0b.png")


def saved(kind: str, image: Image.Image, **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


def noise(mode: str) -> Image.Image:
    rng = np.random.default_rng(len(mode))
    if mode == "I;16":
        return Image.fromarray(rng.integers(0, 65536, (9, 7), np.uint16))
    return Image.fromarray(rng.integers(0, 256, (9, 7, 3), np.uint8)).convert(mode)


@pytest.mark.parametrize("mode", ["1", "L", "I;16", "P", "LA", "RGB", "RGBA"])
@pytest.mark.parametrize("compression", [None, "packbits", "tiff_lzw", "tiff_adobe_deflate"])
def test_tiff_pixels_are_as_stored(mode: str, compression: str | None) -> None:
    drawn = noise(mode)
    image = decode_image(saved("TIFF", drawn, compression=compression), "a.tif")
    as_read = {"1": "L", "P": "RGB", "LA": "RGBA"}.get(mode, mode)
    expected = np.asarray(drawn if as_read == mode else drawn.convert(as_read))
    order = ([2, 1, 0], [2, 1, 0, 3])[expected.shape[-1] - 3] if expected.ndim == 3 else None
    np.testing.assert_array_equal(image.pixels, expected if order is None else expected[..., order])
    assert image.white == (65535 if mode == "I;16" else 255)
    assert (image.kind, image.lossy) == ("tiff", False)


def test_16_bit_colours_keep_all_bits(tmp_path) -> None:
    wide = np.random.default_rng(0).integers(0, 65536, (90, 70, 3), np.uint16)
    for ending in (".png", ".tif"):
        (tmp_path / f"a{ending}").write_bytes(encode(ending, wide))
        image = read_image(tmp_path / f"a{ending}")
        np.testing.assert_array_equal(image.pixels, wide)
        assert image.white == 65535
        half = encode(ending, wide)
        with pytest.raises(MapError, match="truncated"):
            decode_image(half[: len(half) // 2], "half")


def test_files_of_every_format_are_read_as_their_bytes(tmp_path) -> None:
    for ending, data in GOOD.items():
        path = tmp_path / f"a{ending}"
        path.write_bytes(data)
        image, known = read_image(path, allow_lossy=True), decode_image(data, "a", allow_lossy=True)
        np.testing.assert_array_equal(image.pixels, known.pixels)
        assert image_size(path)[:3] == (12, 12, len(data))


@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA"])
def test_lossless_webp_is_as_stored_and_lossy_is_refused(mode: str) -> None:
    drawn = noise(mode)
    image = decode_image(saved("WEBP", drawn, lossless=True), "a.webp")
    expected = np.asarray(drawn.convert("RGB"))[..., ::-1]
    np.testing.assert_array_equal(image.pixels[..., :3], expected)
    extended = saved("WEBP", drawn, lossless=True, exif=b"Exif\0\0" + EXIF_ROTATED)
    np.testing.assert_array_equal(decode_image(extended, "a.webp").pixels, image.pixels)
    lossy = saved("WEBP", drawn)
    with pytest.raises(MapError, match=r"is a lossy WebP.*`allow_lossy=True`"):
        decode_image(lossy, "a.webp")
    allowed = decode_image(lossy, "a.webp", allow_lossy=True)
    assert (allowed.kind, allowed.lossy) == ("webp", True)


WIDTH = struct.Struct("<HHII")  # an entry of a TIFF: tag 256, type, one value of
WIDE_TIFF = saved("TIFF", noise("L"), tiffinfo={256: 7})
for _kind in (3, 4):
    WIDE_TIFF = WIDE_TIFF.replace(WIDTH.pack(256, _kind, 1, 7), WIDTH.pack(256, 4, 1, 100_007))
PAGES = {"save_all": True, "append_images": [noise("RGB").rotate(180)]}


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (saved("TIFF", noise("L"), compression="jpeg"), "is a TIFF of JPEGs"),
        (saved("TIFF", noise("L").convert("F")), "TIFF of type F"),
        (saved("TIFF", noise("CMYK")), "TIFF of type CMYK"),
        (saved("JPEG", noise("CMYK")), "JPEG of type CMYK"),
        (saved("TIFF", noise("L"), tiffinfo={274: 6}), "orientation 6, expected 1"),
        (saved("TIFF", noise("I;16"), tiffinfo={262: 0}), "0 is white"),
        (saved("TIFF", noise("RGB"), **PAGES), "several images"),
        (saved("WEBP", noise("RGB"), lossless=True, **PAGES), "several images"),
        (saved("PNG", noise("RGB"), **PAGES), "animated PNG"),
        (WIDE_TIFF, "100,007 x 9 pixels, expected at most 32,767 a side"),
    ],
)
def test_what_pillow_accepts_and_a_map_must_not_be(data: bytes, expected: str) -> None:
    with pytest.raises(MapError, match=expected):
        decode_image(data, "a.img", max_pixels=10_000)


def test_pillow_alone_would_make_walls_of_missing_rows() -> None:
    data = png(8, 8, 8, 0, [b"\xff" * 8] * 3)
    assert np.asarray(Image.open(io.BytesIO(data)))[3:].max() == 0
    with pytest.raises(MapError, match="truncated PNG: 27 of 72 bytes"):
        decode_image(data, "a.png")


GOOD = {ending: encode(ending, room()[:12, :12]) for ending in (".png", ".pgm", ".bmp", ".jpg")}
GOOD[".tif"] = saved("TIFF", Image.fromarray(room()[:12, :12]), compression="tiff_adobe_deflate")
GOOD[".webp"] = saved("WEBP", Image.fromarray(room()[:12, :12]), lossless=True)


@given(st.sampled_from(sorted(GOOD)), st.data())
def test_every_truncation_is_refused(ending: str, data: st.DataObject) -> None:
    good = GOOD[ending]
    end = data.draw(st.integers(0, len(good) - 1))
    if ending == ".tif" and end >= len(good) - 4:
        assert decode_image(good[:end], "t.img").pixels.tolist() == room()[:12, :12].tolist()
        return  # only the place of a next image, of which there is none, is cut
    with pytest.raises(MapError, match=r"^t\.img: "):
        decode_image(good[:end], "t.img", allow_lossy=True)


@given(st.data())
def test_every_flipped_bit_of_a_png_is_noticed(data: st.DataObject) -> None:
    good = bytearray(GOOD[".png"])
    at = data.draw(st.integers(0, len(good) - 1))
    good[at] ^= 1 << data.draw(st.integers(0, 7))
    with pytest.raises(MapError):
        decode_image(bytes(good), "f.png")


@given(st.sampled_from(sorted(GOOD)), st.data())
def test_garbage_gives_pixels_or_a_map_error(ending: str, data: st.DataObject) -> None:
    good = GOOD[ending]
    at = data.draw(st.integers(0, len(good)))
    bad = good[:at] + data.draw(st.binary(max_size=12)) + good[at + data.draw(st.integers(0, 12)) :]
    message = "g.img: "
    try:
        assert decode_image(bad, "g.img", allow_lossy=True, max_pixels=100_000).pixels.size
    except MapError as e:
        message = str(e)
    assert message.startswith("g.img: ")
    assert "\n" not in message


def test_the_page_in_the_browser_takes_the_same_endings_for_images() -> None:
    page = (Path(imgloc.__file__).parent / "live" / "page" / "files.js").read_text()
    (pattern,) = re.findall(r"IMAGES = /(.*)/i", page)
    for ending in (*IMAGE_ENDINGS, *LOSSY_ENDINGS):
        assert re.search(pattern, f"a{ending}"), ending
