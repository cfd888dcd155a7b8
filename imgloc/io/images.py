"""Image files to arrays: the pixels as stored, or a clear refusal; and arrays to PNG.

Pillow decodes. What it lets pass and a map must not be is refused here: rows that are missing,
several images in one, compression that alters greys. PGM and PPM are read here, because Pillow
scales samples (which `mode: raw` must not), ignores those above maxval and what follows the
image, and shifts an image whose header ends in CRLF.
"""

import contextlib
import io
import re
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import PIL.Image
from PIL import BmpImagePlugin, JpegImagePlugin, PngImagePlugin, TiffImagePlugin, WebPImagePlugin
from PIL.ImageFile import ImageFile

from imgloc.errors import ConfigError, MapError, OutputError
from imgloc.io.files import OTHERS, PathLike, display, open_file

Pixels = npt.NDArray[Any]  # uint8 or uint16

MAX_SIDE = 32_767
"""Pixels a side: the limit of Nav2 (map_io) and of ``cv2.remap``; more are not decoded."""
MAX_PIXELS = 128_000_000
"""Pixels of a map at most, by default: more than the 10,000 x 10,000 that imgloc works with."""

IMAGE_ENDINGS = (".png", ".pgm", ".ppm", ".bmp", ".tif", ".tiff", ".webp")  #: without loss
LOSSY_ENDINGS = (".jpg", ".jpeg")

_HEAD = 1 << 16  # bytes in which the header of a PGM ends, comments and all
_KNOWN = "PNG, PGM, PPM, TIFF, BMP, WebP or JPEG"
# The readers themselves, and not Image.open: that says of damage only that it knows no such
# image, and its limit on pixels is global.
_READERS: dict[bytes, tuple[str, type[ImageFile]]] = {
    b"\x89PNG\r\n\x1a\n": ("PNG", PngImagePlugin.PngImageFile),
    b"\xff\xd8\xff": ("JPEG", JpegImagePlugin.JpegImageFile),
    b"BM": ("BMP", BmpImagePlugin.BmpImageFile),
    b"RIFF": ("WebP", WebPImagePlugin.WebPImageFile),
}
for _magic in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
    _READERS[_magic] = ("TIFF", TiffImagePlugin.TiffImageFile)
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type
_PNG_END = (0, b"IEND", b"\xaeB`\x82")  # length, name, checksum
# Adam7: (first column, first row, column step, row step) of each pass.
_ADAM7 = (
    (0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4),
    (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2),
)  # fmt: skip
_GREY_MODES = ("1", "L", "I;16", "I;16B")  # of Pillow
_TIFF_ORIENTATION, _TIFF_PHOTOMETRIC = 274, 262
_SPACE = rb"(?:[ \t\r\n\v\f]|#[^\r\n]*[\r\n])"
_NETPBM = re.compile(rb"P([2356])" + (_SPACE + rb"+(\d{1,9})") * 3)
_NETPBM_KIND = re.compile(rb"P[1-7Ff](?=[ \t\r\n\v\f#])")


@dataclass(frozen=True)
class MapImage:
    """The pixels of an image file, as stored."""

    pixels: Pixels  #: (H, W), (H, W, 3) or (H, W, 4), top row first; grey, BGR or BGRA
    white: int  #: the sample value that means white: 255, 65535, or the maxval of a PGM
    kind: str  #: ``png``, ``pgm``, ``tiff``, ``bmp``, ``webp`` or ``jpeg``
    lossy: bool = False  #: whether compression has altered the pixels

    @property
    def channels(self) -> int:
        """1 (grey), 3 (BGR) or 4 (BGRA)."""
        return 1 if self.pixels.ndim == 2 else int(self.pixels.shape[2])


def read_image(
    path: PathLike, *, max_pixels: int = MAX_PIXELS, allow_lossy: bool = False
) -> MapImage:
    """Read an image file that is no longer than `max_pixels` could need; see `decode_image`."""
    with open_file(path, limit=_longest(max_pixels), error=MapError, what="map image") as (file, _):
        return decode_image(file, display(path), max_pixels=max_pixels, allow_lossy=allow_lossy)


class ImageSize(NamedTuple):
    """The header of an image: pixels, bytes of the file, whether it is only grey."""

    width: int
    height: int
    file_bytes: int
    grey: bool


def image_size(path: PathLike) -> ImageSize:
    """Look at the header of an image file, and nothing else of it; errors as in `read_image`."""
    limit, name = _longest(MAX_PIXELS), display(path)
    with open_file(path, limit=limit, error=MapError, what="map image") as (file, length):
        image = _opened(file, name, MAX_PIXELS)
    grey = image.mode in _GREY_MODES and "transparency" not in image.info
    return ImageSize(*image.size, length, grey)


def decode_image(
    data: bytes | BinaryIO, name: str, *, max_pixels: int = MAX_PIXELS, allow_lossy: bool = False
) -> MapImage:
    r"""Decode an image without interpreting it: no luma, no orientation, no rescaling.

    MapError if it is unknown, too large, truncated, damaged, animated, several images in one,
    lossy, or has 16-bit samples that can only be meant as 8-bit ones.

    Parameters
    ----------
    data : bytes or file
        The whole of it; `name` is for messages.
    max_pixels : int
        Larger images are refused on the evidence of their header, before decoding.
    allow_lossy : bool
        Accept JPEG and lossy WebP, whose greys differ from those that were drawn. A truncated
        one is refused in any case: the missing part would be a grey area of the map.

    Examples
    --------
    >>> decode_image(b"P2\n2 1\n100\n0 100\n", "x.pgm").white
    100
    """
    file = io.BytesIO(data) if isinstance(data, bytes) else data
    image = _opened(file, name, max_pixels)
    if isinstance(image, _Netpbm):
        found = MapImage(_netpbm_pixels(file, image, name), image.maxval, "pgm")
    else:
        found = _decode_with_pillow(file, image, name)
    if found.lossy and not allow_lossy:
        kind = {"jpeg": "a JPEG", "webp": "a lossy WebP"}.get(found.kind, "a TIFF of JPEGs")
        raise MapError(
            f"{name}: is {kind}, whose compression alters the greys of walls and unknown space; "
            "expected a PNG or PGM; export the map again, or pass `allow_lossy=True`"
        )
    if found.white > 4095:  # a sliver of 16 bits would be black, all of it
        top = int(found.pixels[..., :3].max() if found.channels > 1 else found.pixels.max())
        if 0 < top <= min(4095, found.white // 16):
            raise MapError(
                f"{name}: 16-bit image with samples 0..{top} of a declared {found.white:,}: all "
                "black as stored; expected samples up to the maximum; save it as 8-bit, or scale "
                "the samples"
            )
    return found


def encode_png(image: npt.NDArray[np.generic]) -> bytes:
    r"""Encode a picture, (H, W) or (H, W, 3) uint8, top row first, grey or BGR, as PNG in memory.

    ValueError for another shape or type, OutputError if OpenCV cannot.

    Examples
    --------
    >>> encode_png(np.zeros((2, 3), np.uint8))[:4]
    b'\x89PNG'
    """
    shaped = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
    if image.dtype != np.uint8 or not shaped or 0 in image.shape:
        raise ValueError(f"image {image.shape} {image.dtype} must be uint8, grey or BGR")
    try:
        ok, buffer = cv2.imencode(".png", np.ascontiguousarray(image))
    except cv2.error as e:
        raise OutputError(f"a picture of {image.shape} cannot be encoded: {e}") from None
    if not ok:
        raise OutputError(f"a picture of {image.shape} cannot be encoded")
    return buffer.tobytes()


def encode_picture(image: npt.NDArray[np.uint8], form: str = "png") -> bytes:
    r"""Encode a picture to look at, (H, W, 3) uint8 BGR, as PNG with 256 colours: a third as large.

    With more colours than that some are off, by fewer grey levels than anybody sees. A `form` of
    ``jpeg`` or ``webp`` keeps all; ConfigError for another one.

    Examples
    --------
    >>> encode_picture(np.zeros((2, 3, 3), np.uint8))[:4]
    b'\x89PNG'
    """
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise ValueError(f"image {image.shape} {image.dtype} must be uint8 BGR")
    pixels = np.ascontiguousarray(image[..., ::-1])
    full, out = PIL.Image.fromarray(pixels), io.BytesIO()
    if form != "png":
        if form not in ("jpeg", "webp"):
            raise ConfigError(f"a picture .{form}: expected a name in .png, .jpg or .webp")
        full.save(out, form.upper(), quality=90)
        return out.getvalue()
    method = PIL.Image.Quantize.MAXCOVERAGE
    few = full.quantize(256, method, dither=PIL.Image.Dither.NONE)
    # The mean of what it stands for: greys stay grey, and large areas keep their colour.
    index = np.asarray(few).ravel()
    count = np.maximum(1, np.bincount(index, minlength=256))
    sums = [np.bincount(index, pixels[..., k].ravel(), minlength=256) for k in range(3)]
    few.putpalette(np.rint(np.array(sums) / count).T.astype(int).ravel().tolist())
    few.save(out, "png")
    return out.getvalue()


def _longest(max_pixels: int) -> int:
    """Bytes of a file: 16-bit RGBA takes 8 a pixel, the samples of a text PPM up to 12."""
    return 12 * max_pixels + 65536


class _Netpbm(NamedTuple):
    """Header of a PGM or PPM: its number (``P5`` is 5), maxval, and where samples begin."""

    number: int
    size: tuple[int, int]
    maxval: int
    start: int
    mode: str  # as Pillow has it, like the next
    info: Mapping[str, object] = {}


def _opened(file: BinaryIO, name: str, max_pixels: int) -> ImageFile | _Netpbm:
    """Look at the header of a file; refuse what is no image, or of more than `max_pixels`."""
    head = file.read(_HEAD)
    file.seek(0)
    found = [how for magic, how in _READERS.items() if head.startswith(magic)]
    if _NETPBM_KIND.match(head):
        image: ImageFile | _Netpbm = _netpbm_header(head, name)
    elif found:
        with _explained(name, found[0][0]):
            image = found[0][1](file)
    else:
        like = (
            k for magic, k in OTHERS["images"].items() if head.startswith(magic.encode("latin-1"))
        )
        what = f"it looks like {kind}" if (kind := next(like, "")) else "unknown content"
        raise MapError(f"{name}: not an image that can be read ({what}), expected {_KNOWN}")
    width, height = image.size
    found_size, hint = f"{width:,} x {height:,}", "crop or downsample the map"
    if max(width, height) > MAX_SIDE:
        raise MapError(f"{name}: {found_size} pixels, expected at most {MAX_SIDE:,} a side; {hint}")
    if width * height > max_pixels:
        found_size += f" = {width * height:,} pixels"
        raise MapError(f"{name}: {found_size}, expected at most {max_pixels:,}; {hint}")
    return image


def _damaged(name: str, what: str) -> MapError:
    return MapError(f"{name}: {what}; copy the file again")


@contextlib.contextmanager
def _explained(name: str, kind: str) -> Iterator[None]:
    """Turn whatever Pillow makes of damage into one error."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # metadata; what spoils pixels is an error
            yield
    except MapError:
        raise
    except MemoryError:
        raise MapError(f"{name}: cannot be decoded: out of memory") from None
    except Exception as e:  # decoders of hostile bytes raise anything
        why = " ".join(str(e).split()) or type(e).__name__
        raise _damaged(name, f"damaged or truncated {kind} ({why})") from None


def _decode_with_pillow(file: BinaryIO, image: ImageFile, name: str) -> MapImage:
    kind, size = (image.format or "").replace("WEBP", "WebP"), image.size
    depth, lossy = 8, kind == "JPEG"
    with _explained(name, kind):
        if kind == "PNG":
            image.verify()  # checksums
            depth = _check_png(file, name, size)
            file.seek(0)
            image = PngImagePlugin.PngImageFile(file)
        elif getattr(image, "n_frames", 1) > 1:
            raise MapError(f"{name}: {kind} with several images, expected a single one")
        elif kind == "BMP" and image.info.get("compression") not in (None, 0, 3):
            raise MapError(f"{name}: is a compressed BMP, expected a plain one; convert it to PNG")
        elif isinstance(image, TiffImagePlugin.TiffImageFile):
            lossy = image.info.get("compression") in ("jpeg", "tiff_jpeg", "webp")
            if (turned := image.tag_v2.get(_TIFF_ORIENTATION, 1)) != 1:
                raise MapError(f"{name}: TIFF of orientation {turned}, expected 1: save it upright")
            if image.mode.startswith("I;16") and image.tag_v2.get(_TIFF_PHOTOMETRIC) == 0:
                hint = "16-bit TIFF in which 0 is white, expected black; save it anew"
                raise MapError(f"{name}: {hint}")
        elif kind == "WebP":
            lossy = not _is_lossless_webp(file)
        elif kind == "JPEG":
            file.seek(0)
            data = file.read()
            # Without an end after its (last) scan; the rows before may all be there.
            if data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda"):
                raise _damaged(name, f"truncated JPEG: no end marker in {len(data):,} bytes")
            file.seek(0)
        wide, stored = None, str(image.tile and image.tile[0].args)
        if kind in ("PNG", "TIFF") and image.mode in ("RGB", "RGBA") and ";16" in stored:
            file.seek(0)  # Pillow keeps the high bytes only
            wide = cv2.imdecode(np.frombuffer(file.read(), np.uint8), cv2.IMREAD_UNCHANGED)
            if wide is None or wide.dtype != np.uint16 or wide.shape[1::-1] != size:
                raise MapError(f"{name}: cannot be decoded; save it as grey, or with 8 bits")
        image.load()
        pixels = _pixels(image, name, depth) if wide is None else wide
    return MapImage(pixels, int(np.iinfo(pixels.dtype).max), kind.lower(), lossy)


def _pixels(image: ImageFile, name: str, depth: int) -> Pixels:
    """Samples of a loaded image, BGR; `depth` is that of a grey PNG in the file."""
    mode, clear = image.mode, image.info.get("transparency")
    if mode in ("P", "PA") or (mode == "RGB" and clear is not None):
        alpha = mode == "PA" or clear is not None
        stored = np.asarray(image.convert("RGBA" if alpha else "RGB"))
    elif mode in (*_GREY_MODES, "LA", "RGB", "RGBA"):
        stored = np.asarray(image)
    else:
        raise MapError(f"{name}: {image.format} of type {mode}, expected grey or colours")
    if mode == "1":
        stored = stored.astype(np.uint8) * 255
    elif mode.startswith("I;16"):
        stored = stored.astype(np.uint16, copy=False)
    if stored.ndim == 2 and isinstance(clear, int):
        # Pillow gives this grey as it is in the file, where 2 bits have 3 for white.
        opaque = np.where(stored == clear * {2: 85, 4: 17}.get(depth, 1), 0, ~stored.dtype.type(0))
        return np.dstack((stored, stored, stored, opaque.astype(stored.dtype)))
    if stored.ndim == 2:
        return stored
    order = {2: [0, 0, 0, 1], 3: [2, 1, 0], 4: [2, 1, 0, 3]}[stored.shape[2]]
    used = 3 if image.format == "BMP" else 4  # the fourth byte of a BMP is padding
    return np.ascontiguousarray(stored[..., order[:used]])


def _check_png(file: BinaryIO, name: str, size: tuple[int, int]) -> int:
    """Refuse a verified PNG that lacks rows (Pillow would make walls of them); return its depth."""
    file.seek(8)
    inflater, total, expected, depth = zlib.decompressobj(), 0, 0, 8
    while True:
        length, kind = struct.unpack(">I4s", file.read(8))
        if kind == b"IEND":
            break
        after = file.tell() + length + 4
        body = file.read(length) if kind in (b"IHDR", b"IDAT") else b""
        file.seek(after)
        if kind == b"IHDR":
            depth, colour, interlaced = body[8], body[9], body[12]
            expected = _png_bytes(size, _PNG_CHANNELS[colour] * depth, bool(interlaced))
        elif kind == b"acTL":
            raise MapError(f"{name}: is an animated PNG, expected a single image")
        elif kind == b"IDAT":
            try:
                while body and total <= expected:
                    total += len(inflater.decompress(body, 1 << 20))
                    body = inflater.unconsumed_tail
            except zlib.error as e:
                raise _damaged(name, f"damaged PNG data ({e})") from None
        elif kind != b"PLTE" and kind[:1].isupper():
            raise MapError(f"{name}: PNG chunk {kind.decode('latin-1')!r} is not known")
    if (length, kind, file.read(4)) != _PNG_END:
        raise _damaged(name, "damaged PNG: wrong checksum of its end")
    while total < expected and (tail := inflater.decompress(b"", 1 << 20)):
        total += len(tail)
    if total < expected:
        raise _damaged(name, f"truncated PNG: {total:,} of {expected:,} bytes of pixels")
    return depth


def _png_bytes(size: tuple[int, int], bits: int, interlaced: bool) -> int:
    """Length of the inflated data, with `bits` a pixel: each row has a filter byte in front."""
    passes = _ADAM7 if interlaced else ((0, 0, 1, 1),)
    parts = [(-(-(size[0] - x) // dx), -(-(size[1] - y) // dy)) for x, y, dx, dy in passes]
    return sum(rows * (1 + -(-columns * bits // 8)) for columns, rows in parts if columns > 0)


def _is_lossless_webp(file: BinaryIO) -> bool:
    file.seek(12)
    while len(head := file.read(8)) == 8:
        kind, length = struct.unpack("<4sI", head)
        if kind in (b"VP8 ", b"VP8L"):
            return bool(kind == b"VP8L")
        file.seek(length + length % 2, io.SEEK_CUR)
    return False


def _netpbm_header(head: bytes, name: str) -> _Netpbm:
    match = _NETPBM.match(head)
    if match is None:
        kind = head[:2].decode("latin-1")
        what = f"damaged {kind} header, expected width, height and maxval"
        if kind not in ("P2", "P3", "P5", "P6"):
            what = f"is a Netpbm {kind} file, expected PGM (P2, P5) or PPM (P3, P6)"
        raise MapError(f"{name}: {what}")
    number, width, height, maxval = map(int, match.groups())
    if width < 1 or height < 1:
        raise MapError(f"{name}: image of {width} x {height} pixels, expected at least 1 x 1")
    if not 1 <= maxval <= 65535:
        raise MapError(f"{name}: maxval {maxval}, expected 1..65535")
    mode = "L" if number in (2, 5) else "RGB"
    return _Netpbm(number, (width, height), maxval, match.end(), mode)


def _netpbm_pixels(file: BinaryIO, header: _Netpbm, name: str) -> Pixels:
    """Samples as stored; fewer, more, or some above maxval are refused."""
    (width, height), maxval = header.size, header.maxval
    channels = 3 if header.mode == "RGB" else 1
    count, text = width * height * channels, header.number < 4
    file.seek(header.start)
    binary = np.dtype(np.uint8 if maxval < 256 else ">u2")
    samples = _text_samples(file, count, name) if text else _samples(file, count, binary, name)
    if len(samples) != count:
        size = f"{count:,} ({width} x {height} x {channels})"
        raise _damaged(name, f"truncated: {len(samples):,} samples, expected {size}")
    if int(samples.max()) > maxval or int(samples.min()) < 0:
        raise MapError(f"{name}: sample {int(samples.max())}, expected 0..{maxval} (maxval)")
    pixels = samples.astype(np.uint8 if maxval < 256 else np.uint16, copy=False)
    if channels == 1:
        return pixels.reshape(height, width)
    return np.ascontiguousarray(pixels.reshape(height, width, 3)[:, :, ::-1])


def _text_samples(file: BinaryIO, count: int, name: str) -> npt.NDArray[Any]:
    body = re.sub(rb"#[^\r\n]*", b"", file.read())
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # NumPy only warns when it meets something else
        try:
            samples = np.fromstring(body.decode("ascii"), dtype=np.int64, sep=" ")
        except (DeprecationWarning, ValueError, OverflowError):
            raise MapError(f"{name}: damaged: expected decimal numbers only") from None
    if len(samples) > count:
        raise MapError(f"{name}: {len(samples):,} samples, expected {count:,}")
    return samples


def _samples(file: BinaryIO, count: int, dtype: np.dtype[Any], name: str) -> npt.NDArray[Any]:
    """Read samples from the end of the header on; no more than white space may follow them."""
    start, size = file.tell(), count * dtype.itemsize
    length = file.seek(0, io.SEEK_END)
    file.seek(start)
    # One white-space byte ends the header; a header written with CRLF ends in two, and its
    # line feed would be read as the first pixel and shift the whole image.
    start += 2 if file.read(2) == b"\r\n" and length - start >= size + 2 else 1
    file.seek(start)
    body, extra = file.read(size), length - start - size
    if extra > 0 and file.read(_HEAD).strip():
        why = "the header does not belong to this data, or the file contains several images"
        raise MapError(f"{name}: {extra:,} bytes follow the image, expected its end: {why}")
    return np.frombuffer(body, dtype, count=len(body) // dtype.itemsize)
