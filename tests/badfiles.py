"""Every kind of bad file, written into a folder: each must give one clear error."""

import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from PIL import Image


class BadFile(NamedTuple):
    name: str
    path: Path
    kind: str  # "map" or "scan"
    expected: str  # must be in the message


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(
    width: int, height: int, depth: int, colour: int, rows: Sequence[bytes], *, before: bytes = b"",
    idat: bytes | None = None, interlace: int = 0,
) -> bytes:  # fmt: skip
    """Write a PNG by hand: `rows` without their filter bytes, `before` = chunks before IDAT."""
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlace)
    pixels = zlib.compress(b"".join(b"\0" + row for row in rows)) if idat is None else idat
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + before
        + chunk(b"IDAT", pixels)
        + chunk(b"IEND", b"")
    )


def room() -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Draw a map that is well: a room of 4 x 3 m at 10 cm, with noise that PNG cannot shrink."""
    image = np.full((40, 50), 205, np.uint8)
    image[5:35, 5:45] = 254
    cv2.rectangle(image, (5, 5), (44, 34), 0, 1)
    image[20, 10:25] = np.random.default_rng(0).integers(0, 2, 15) * 254
    return image


def encode(ending: str, image: np.ndarray[Any, Any]) -> bytes:
    ok, buffer = cv2.imencode(ending, image)
    assert ok
    return buffer.tobytes()


YAML = (
    "image: good.png\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\n"
    "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
)


def yaml_with(key: str, line: str) -> str:
    """Replace the line of `key` in a good YAML by `line`."""
    return "".join(
        line + "\n" * bool(line) if old.startswith(key + ":") else old + "\n"
        for old in YAML.splitlines()
    )


def npz(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def npz_members(**members: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, data in members.items():
            archive.writestr(f"{key}.npy", data)
    return buffer.getvalue()


def npy_header(shape: tuple[int, ...], descr: str) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"shape": shape, "fortran_order": False, "descr": descr}
    )
    return buffer.getvalue()


def _image_faults() -> dict[str, tuple[bytes, str]]:
    good = encode(".png", room())
    half_noise = encode(".png", np.random.default_rng(1).integers(0, 255, (64, 64), np.uint8))
    jpeg = encode(".jpg", np.random.default_rng(1).integers(0, 255, (64, 64), np.uint8))
    small16 = room().astype(np.uint16)
    bit_rows = zlib.compressobj(1)
    row = b"\0" + b"\xff" * 2500
    bomb = b"".join(bit_rows.compress(row * 1000) for _ in range(20)) + bit_rows.flush()
    flipped = bytearray(good)
    flipped[len(good) // 2] ^= 0x10
    ppm = b"P6\n2 2\n255\n" + bytes(12)
    return {
        "empty.png": (b"", "empty"),
        "text.png": (b"this is not a picture\n", "not an image"),
        "yaml_as.png": (YAML.encode(), "looks like YAML"),
        "gif_as.png": (b"GIF89a" + bytes(50), "looks like GIF"),
        "truncated.png": (half_noise[: len(half_noise) // 2], "truncated"),
        "header_only.png": (good[:20], "truncated"),
        "crc.png": (bytes(flipped), "checksum"),
        "short_data.png": (png(8, 8, 8, 0, [bytes(8)] * 3), "truncated"),
        "bad_filter.png": (
            png(8, 8, 8, 0, [], idat=zlib.compress((b"\x09" + bytes(8)) * 8)),
            "damaged",
        ),
        "animated.png": (png(1, 1, 8, 0, [b"\0"], before=chunk(b"acTL", bytes(8))), "animated"),
        "huge_header.png": (png(60000, 60000, 8, 0, [b""]), "pixels, expected at most"),
        "huge_no_data.png": (png(30000, 30000, 8, 0, [b""]), "pixels, expected at most"),
        "bomb.png": (png(20000, 20000, 1, 0, [], idat=bomb), "pixels, expected at most"),
        "too_long_side.png": (png(40000, 2, 1, 0, [bytes(5000)] * 2), "32,767"),
        "depth_16_of_8.png": (encode(".png", small16), "16-bit"),
        "lossy.jpg": (jpeg, "JPEG"),
        "half.jpg": (jpeg[: len(jpeg) // 2], "truncated JPEG"),
        "huge.jpg": (_with_jpeg_size(jpeg, 60000), "pixels, expected at most"),
        "lossy.webp": (_pillow("WEBP"), "lossy WebP"),
        "half.webp": (_pillow("WEBP", lossless=True)[:-40], "truncated WebP"),
        "half.tif": (_pillow("TIFF")[:-300], "truncated TIFF"),
        "pages.tif": (_pillow("TIFF", save_all=True, append_images=[_PAGE]), "several images"),
        "floats.tif": (_pillow("TIFF", "F"), "of type F"),
        "truncated.bmp": (encode(".bmp", room())[:1500], "truncated BMP"),
        "truncated.pgm": (encode(".pgm", room())[:1500], "truncated"),
        "huge.pgm": (b"P5\n60000 60000\n255\n", "pixels, expected at most"),
        "above_maxval.pgm": (b"P5\n2 1\n100\n" + bytes([0, 200]), "maxval"),
        "maxval_0.pgm": (b"P5\n2 1\n0\n" + bytes(2), "maxval 0"),
        "no_numbers.pgm": (b"P5\nwide high\n255\n" + bytes(4), "header"),
        "words.pgm": (b"P2\n2 2\n255\n0 1 two 3\n", "decimal numbers"),
        "too_many.pgm": (b"P2\n2 2\n255\n0 1 2 3 4\n", "expected 4"),
        "two_images.ppm": (ppm + ppm, "follow the image"),
        "bitmap.pbm": (b"P4\n8 1\n\xff", "P4"),
        "all_free.png": (encode(".png", np.full((20, 20), 254, np.uint8)), "is occupied"),
        "all_wall.png": (encode(".png", np.zeros((20, 20), np.uint8)), "is free"),
    }


_PAGE = Image.fromarray(room())


def _pillow(kind: str, mode: str = "L", **options: Any) -> bytes:
    buffer = io.BytesIO()
    _PAGE.convert(mode).save(buffer, kind, **options)
    return buffer.getvalue()


def _with_jpeg_size(jpeg: bytes, side: int) -> bytes:
    at = jpeg.index(b"\xff\xc0")
    return jpeg[: at + 5] + struct.pack(">HH", side, side) + jpeg[at + 9 :]


def _yaml_faults() -> dict[str, tuple[str | bytes, str]]:
    r, o = "resolution", "origin"
    return {
        "no_image": (yaml_with("image", ""), "image: missing"),
        "image_gone": (yaml_with("image", "image: gone.png"), "gone.png: no such file"),
        "image_number": (yaml_with("image", "image: 7"), "image: got 7"),
        "image_is_folder": (yaml_with("image", "image: ."), "is a folder"),
        "no_resolution": (yaml_with(r, ""), "resolution: missing"),
        "resolution_0": (yaml_with(r, "resolution: 0"), "resolution: got 0"),
        "resolution_minus": (yaml_with(r, "resolution: -0.05"), "resolution: got -0.05"),
        "resolution_cm": (yaml_with(r, "resolution: 50"), "resolution: got 50"),
        "resolution_nan": (yaml_with(r, "resolution: .nan"), "resolution: got nan"),
        "resolution_inf": (yaml_with(r, "resolution: .inf"), "resolution: got inf"),
        "resolution_comma": (yaml_with(r, "resolution: 0,05"), "decimal point"),
        "resolution_word": (yaml_with(r, "resolution: fine"), "resolution: got 'fine'"),
        "resolution_bool": (yaml_with(r, "resolution: true"), "resolution: got True"),
        "resolution_long": (
            yaml_with(r, "resolution: " + "9" * 5000),
            "an integer of 5,000 digits",
        ),
        "no_origin": (yaml_with(o, ""), "origin: missing"),
        "origin_2": (yaml_with(o, "origin: [0, 0]"), "origin: got [0, 0]"),
        "origin_nan": (yaml_with(o, "origin: [0, .nan, 0]"), "origin: got [0, nan, 0]"),
        "origin_degrees": (yaml_with(o, "origin: [0, 0, 90]"), "radians"),
        "origin_scalar": (yaml_with(o, "origin: 0"), "origin: got 0"),
        "thresholds_swapped": (yaml_with("free_thresh", "free_thresh: 0.9"), "free_thresh 0.9"),
        "threshold_percent": (yaml_with("free_thresh", "free_thresh: 25"), "free_thresh: got 25"),
        "negate_2": (yaml_with("negate", "negate: 2"), "negate: got 2"),
        "mode_odd": (YAML + "mode: fancy\n", "mode: got 'fancy'"),
        "alias": (YAML + "a: &a [x]\nb: *a\n", "anchor"),
        "alias_alone": (YAML + "b: *a\n", "alias"),
        "tag": (YAML + "a: !!python/object/apply:os.system [ls]\n", "tag"),
        "twice": (YAML + "resolution: 0.2\n", "more than once"),
        "merge": (YAML + "<<: {resolution: 0.2}\n", "merge"),
        "a_list": ("- image\n- resolution\n", "key: value"),
        "a_word": ("hello\n", "key: value"),
        "empty_text": ("# nothing\n", "key: value"),
        "two_documents": (YAML + "---\n" + YAML, "second document"),
        "deep": ("image: " + "[" * 5000, "nested too deeply"),
        "broken": ("image: [good.png\nresolution: 1\n", "not valid YAML"),
        "binary": (b"\x89PNG\r\n\xff\xfe\0", "UTF-8"),
        "too_long": (YAML + "# " + "x" * 70000, "at most 65,536"),
        "bad_date": (YAML + "made: 2024-13-45\n", "not valid YAML"),
    }


def _scan_faults() -> dict[str, tuple[bytes, str]]:
    angles = np.linspace(-1, 1, 5)
    ranges = np.ones((3, 5), np.float32)
    good = {"ranges": ranges, "angles": angles, "range_max": 10.0}

    def but(**change: Any) -> bytes:
        return npz(**(good | change))

    def jsonl(*lines: Any) -> bytes:
        return "\n".join(s if isinstance(s, str) else json.dumps(s) for s in lines).encode()

    whole = npz(**good)
    bent = angles.copy()
    bent[2] = np.nan
    entry = {"ranges": [1, 2], "angle_min": 0, "angle_increment": 0.1}
    head = b"# angle_min=-1, angle_max=1\n"
    return {
        "empty.npz": (b"", "empty"),
        "text.npz": (b"not a zip at all", "damaged NPZ"),
        "array.npz": (npy_header((1, 5), "<f8") + bytes(40), "one array of NumPy: np.savez"),
        "truncated.npz": (whole[: len(whole) // 2], "damaged NPZ"),
        "bad_crc.npz": (_flip(npz_members(ranges=npy_header((1, 5), "<f8") + bytes(40))), "NPZ"),
        "pickled.npz": (but(ranges=np.array([[1], [1, 2]], dtype=object)), "pickled"),
        "bomb.npz": (
            npz_members(ranges=npy_header((1000, 60_000), "|u1") + bytes(60_000_000)),
            "at most",
        ),
        "void_bomb.npz": (npz_members(ranges=npy_header((1,), "|V60000000")), "expected numbers"),
        "lying_shape.npz": (npz_members(ranges=npy_header((1000, 1000), "<f8")), "copy the file"),
        "bad_header.npz": (npz_members(ranges=b"\x93NUMPY\x01\x00\x10\x00nonsense"), "header"),
        "no_ranges.npz": (npz(angles=angles), "ranges: got angles.npy, expected ranges"),
        "no_angles.npz": (npz(ranges=ranges), "angles: missing"),
        "no_scans.npz": (but(ranges=ranges[:0]), "at least one"),
        "ranges_3d.npz": (but(ranges=ranges[None]), "ranges: got shape (1, 3, 5)"),
        "ranges_text.npz": (but(ranges=ranges.astype("U4")), "ranges: got type"),
        "ranges_complex.npz": (but(ranges=ranges * 1j), "ranges: got type complex"),
        "angles_nan.npz": (but(angles=bent), "angles[2]: got nan"),
        "angles_length.npz": (but(angles=angles[:-1]), "angles: got shape (4,)"),
        "angles_degrees.npz": (but(angles=np.rad2deg(angles)), "degrees"),
        "range_max_nan.npz": (but(range_max=np.nan), "range_max: got nan"),
        "range_max_low.npz": (but(range_min=20.0), "range_max: got 10"),
        "range_min_minus.npz": (but(range_min=-1.0), "range_min: got -1"),
        "range_max_shape.npz": (but(range_max=np.ones(2)), "range_max: got shape (2,)"),
        "poses_nan.npz": (but(poses=np.full((3, 3), np.nan)), "poses[0, 0]: got nan"),
        "poses_shape.npz": (but(poses=np.zeros((2, 3))), "poses: got shape (2, 3)"),
        "stamps_shape.npz": (but(stamps=np.zeros(2)), "stamps: got shape (2,)"),
        "bad_word.csv": (head + b"1,2,3\n1,oops,3\n", "line 3: column 2: got 'oops'"),
        "ragged.csv": (head + b"1,2,3\n1,2\n", "line 3: 2 numbers, expected 3"),
        "words.csv": (head + b"1,2,3\nfar;near;5\n", "line 3: column 1: got 'far'"),
        "no_angles.csv": (b"1,2,3\n", "angles: missing"),
        "no_lines.csv": (head, "no scan"),
        "half_pose.csv": (head + b"x,y,r0,r1\n1,2,3,4\n", "columns x, y"),
        "bytes.csv": (head + b"# caf\x81\n1,2\n", "UTF-8"),
        "bad_json.jsonl": (jsonl("{'ranges': [1]}", entry), "line 1: not valid JSON"),
        "deep.jsonl": (b"[" * 200_000, "not valid JSON"),
        "list.jsonl": (jsonl([1, 2]), "line 1: got list"),
        "no_ranges.jsonl": (jsonl(entry, {"angles": [1]}), "line 2: ranges: missing"),
        "no_angles.jsonl": (jsonl({"ranges": [1, 2]}), "line 1: angles: missing"),
        "angles_length.jsonl": (jsonl({"ranges": [1], "angles": [0, 1]}), "angles: got 2"),
        "angle_max.jsonl": (jsonl(entry | {"angle_max": 1.5}), "angle_max: got 1.5"),
        "nested.jsonl": (jsonl(entry | {"ranges": [[1, 2], [3]]}), "line 1: ranges"),
        "word.jsonl": (jsonl(entry | {"ranges": [1, "far"]}), "ranges[1]: got 'far'"),
        "range_max.jsonl": (jsonl(entry | {"range_max": 0}), "line 1: range_max: got 0"),
        "long.jsonl": (jsonl(entry | {"angle_min": 10**400}), "line 1: angle_min: got a number of"),
        "some_poses.jsonl": (jsonl(entry, entry | {"pose": [0, 0, 0]}), "in 1 of 2 scans"),
        "short_pose.jsonl": (jsonl(entry | {"pose": [0, 0]}), "pose: got 2"),
        "scans.xyz": (b"1 2 3\n", "is no scan format"),
    }


def _flip(archive: bytes) -> bytes:
    at = archive.index(b"ranges.npy") + 14
    return archive[:at] + bytes([archive[at] ^ 0xFF]) + archive[at + 1 :]


def write_bad_files(folder: Path) -> list[BadFile]:
    """Write all of them into `folder`; image faults get a YAML that is well beside them."""
    bad: list[BadFile] = []
    (folder / "good.png").write_bytes(encode(".png", room()))
    for name, (data, expected) in _image_faults().items():
        (folder / name).write_bytes(data)
        beside = folder / (name.replace(".", "_") + ".yaml")
        beside.write_text(yaml_with("image", f"image: {name}"))
        bad.append(BadFile(name, beside, "map", expected))
    for name, (text, expected) in _yaml_faults().items():
        path = folder / f"{name}.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        bad.append(BadFile(name, path, "map", expected))
    for name, (data, expected) in _scan_faults().items():
        path = folder / f"scan_{name}"
        path.write_bytes(data)
        bad.append(BadFile(path.name, path, "scan", expected))
    return bad + _not_files(folder)


def _not_files(folder: Path) -> list[BadFile]:
    bad = [
        BadFile("bare image", folder / "good.png", "map", "resolution: missing"),
        BadFile("map gone", folder / "gone.yaml", "map", "no such file"),
        BadFile("map is folder", folder, "map", "is a folder"),
        BadFile("scan gone", folder / "gone.npz", "scan", "no such file"),
    ]
    for ending, kind, expected in (
        (".yaml", "map", "is a folder"),
        (".npz", "scan", "is a folder"),
    ):
        (folder / f"folder{ending}").mkdir()
        bad.append(BadFile(f"folder{ending}", folder / f"folder{ending}", kind, expected))
    if hasattr(os, "mkfifo"):
        for ending, kind in ((".yaml", "map"), (".npz", "scan"), (".csv", "scan")):
            path = folder / f"fifo{ending}"
            os.mkfifo(path)
            bad.append(BadFile(path.name, path, kind, "pipe or device"))
        os.mkfifo(folder / "fifo.png")
        (folder / "fifo_image.yaml").write_text(yaml_with("image", "image: fifo.png"))
        bad.append(BadFile("fifo image", folder / "fifo_image.yaml", "map", "pipe or device"))
        for ending, kind in ((".yaml", "map"), (".npz", "scan")):
            path = folder / f"endless{ending}"
            path.symlink_to("/dev/zero")
            bad.append(BadFile(path.name, path, kind, "pipe or device"))
        # A name that is no text: cv2.imread would crash the process on it.
        name = os.fsdecode(b"caf\xe9.png")
        (folder / name).write_bytes(b"not a picture")
        raw = folder / os.fsdecode(b"caf\xe9.npz")
        raw.write_bytes(b"not scans")
        bad.append(BadFile("undecodable scan", raw, "scan", "caf\\xe9.npz"))
        raw = folder / os.fsdecode(b"\xff.yaml")
        raw.write_bytes(b"nothing")
        bad.append(BadFile("undecodable map", raw, "map", "\\xff.yaml"))
    return bad
