"""Image files to arrays: the pixels as stored, or a clear refusal.

Nothing here knows what a map is; :mod:`imgloc.io.occupancy` gives the pixels their meaning.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import MapError
from imgloc.io.containers import (
    BMP_MAGIC,
    JPEG_MAGIC,
    PNG_MAGIC,
    Container,
    bmp_size,
    jpeg_size,
    open_bmp,
    open_jpeg,
    open_png,
    png_size,
)
from imgloc.io.files import PathLike, display, open_file, read_file
from imgloc.io.netpbm import decode_netpbm, is_netpbm, netpbm_header

MAX_PIXELS = 128_000_000
_HEAD = 4 << 20  # bytes in which the size is found, after comments and thumbnails
_KNOWN = "PNG, PGM, PPM, BMP or JPEG"
# Formats that people do try, for the message only.
_OTHERS = {
    b"GIF8": "GIF",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"RIFF": "WebP",
    b"%PDF": "PDF",
    b"<svg": "SVG",
    b"<?xm": "XML or SVG",
    b"PK\x03\x04": "zip",
    b"imag": "YAML",
}
_FORMATS: dict[
    bytes,
    tuple[str, Callable[[bytes, str], tuple[int, int]], Callable[[bytes, str], Container]],
] = {
    PNG_MAGIC: ("png", png_size, open_png),
    JPEG_MAGIC: ("jpeg", jpeg_size, open_jpeg),
    BMP_MAGIC: ("bmp", bmp_size, open_bmp),
}


@dataclass(frozen=True)
class MapImage:
    """The pixels of an image file, as stored.

    Parameters
    ----------
    pixels : (H, W), (H, W, 3) or (H, W, 4) array of uint8 or uint16
        Top row first; grey, BGR or BGRA.
    white : int
        The sample value that means white: 255, 65535, or the maxval of a PGM.
    kind : str
        ``png``, ``pgm``, ``bmp`` or ``jpeg``.
    """

    pixels: npt.NDArray[Any]
    white: int
    kind: str

    @property
    def channels(self) -> int:
        """1 (grey), 3 (BGR) or 4 (BGRA)."""
        return 1 if self.pixels.ndim == 2 else int(self.pixels.shape[2])


def read_image(
    path: PathLike, *, max_pixels: int = MAX_PIXELS, allow_lossy: bool = False
) -> MapImage:
    """Read an image file; see :func:`decode_image`.

    Raises
    ------
    MapError
        Missing, not a regular file, longer than `max_pixels` could need, or refused by
        :func:`decode_image`.
    """
    data = read_file(path, limit=_longest(max_pixels), error=MapError, what="map image")
    return decode_image(data, display(path), max_pixels=max_pixels, allow_lossy=allow_lossy)


def image_size(path: PathLike, *, max_pixels: int = MAX_PIXELS) -> tuple[int, int, int]:
    """Width and height of an image as its header says, pixels, and the length of its file, bytes.

    No more than the first 4 MiB are read, which have the header of any image of a map.

    Raises
    ------
    MapError
        Missing, not a regular file, too large, of an unknown format, or the header is damaged.
    """
    longest, name = _longest(max_pixels), display(path)
    with open_file(path, limit=longest, error=MapError, what="map image") as (file, length):
        data = file.read(_HEAD)
    if is_netpbm(data):
        _, width, height, _, _ = netpbm_header(data, name)
    else:
        size = next((how[1] for magic, how in _FORMATS.items() if data.startswith(magic)), None)
        if size is None:
            raise _unknown(data, name)
        width, height = size(data, name)
    check_size(width, height, max_pixels, name)
    return width, height, max(length, len(data))


def _longest(max_pixels: int) -> int:
    """Bytes of a file: 16-bit RGBA takes 8 a pixel, the samples of a text PPM up to 12."""
    return 12 * max_pixels + 65536


def decode_image(
    data: bytes, name: str, *, max_pixels: int = MAX_PIXELS, allow_lossy: bool = False
) -> MapImage:
    r"""Decode an image without interpreting it: no luma, no orientation, no rescaling.

    Parameters
    ----------
    data : bytes
        The whole file.
    name : str
        For messages.
    max_pixels : int
        Larger images are refused on the evidence of their header, before decoding.
    allow_lossy : bool
        Accept JPEG, whose greys differ from those that were drawn. A truncated JPEG is
        refused in any case: the missing part would be a grey area of the map.

    Returns
    -------
    MapImage

    Raises
    ------
    MapError
        Unknown format, too large, truncated, damaged, lossy, or 16-bit samples that can
        only be meant as 8-bit ones.

    Examples
    --------
    >>> decode_image(b"P2\n2 1\n100\n0 100\n", "x.pgm").white
    100
    """
    if is_netpbm(data):
        _, width, height, _, _ = netpbm_header(data, name)
        check_size(width, height, max_pixels, name)
        pixels, white = decode_netpbm(data, name)
        return _checked(MapImage(pixels, white, "pgm"), name)
    for magic, (kind, size, unpack) in _FORMATS.items():
        if data.startswith(magic):
            width, height = size(data, name)
            check_size(width, height, max_pixels, name)
            container = unpack(data, name)
            if kind == "jpeg" and not allow_lossy:
                raise MapError(
                    f"{name}: is a JPEG, whose compression alters the greys of walls and "
                    "unknown space; expected a PNG or PGM; export the map again, or pass "
                    "--allow-lossy"
                )
            pixels = _decode(container, name)
            return _checked(MapImage(pixels, int(np.iinfo(pixels.dtype).max), kind), name)
    raise _unknown(data, name)


def _unknown(data: bytes, name: str) -> MapError:
    found = next((kind for magic, kind in _OTHERS.items() if data.startswith(magic)), None)
    return MapError(
        f"{name}: not an image that can be read "
        f"({'it looks like ' + found if found else 'unknown content'}), expected {_KNOWN}"
    )


def check_size(width: int, height: int, max_pixels: int, name: str) -> None:
    """Refuse an image of more than `max_pixels` pixels.

    Raises
    ------
    MapError
        With both sizes.
    """
    if width * height > max_pixels:
        raise MapError(
            f"{name}: {width:,} x {height:,} = {width * height:,} pixels, expected at most "
            f"{max_pixels:,}; crop or downsample the map, or raise --max-pixels"
        )


def _decode(container: Container, name: str) -> npt.NDArray[Any]:
    # IMREAD_UNCHANGED: GRAYSCALE would drop alpha, weigh the colours, keep only the high
    # byte of 16 bits and rotate by EXIF.
    try:
        pixels: npt.NDArray[Any] | None = cv2.imdecode(
            np.frombuffer(container.data, np.uint8), cv2.IMREAD_UNCHANGED
        )
    except (cv2.error, MemoryError) as e:
        reason = str(e).strip().splitlines()[0] if str(e) else "out of memory"
        raise MapError(f"{name}: cannot be decoded: {reason}") from None
    if pixels is None:
        raise MapError(f"{name}: damaged: its pixels cannot be decoded; copy the file again")
    if pixels.shape[:2] != (container.height, container.width):
        raise MapError(
            f"{name}: decoded as {pixels.shape[1]} x {pixels.shape[0]} pixels, expected "
            f"{container.width} x {container.height}"
        )
    if pixels.dtype not in (np.uint8, np.uint16):
        raise MapError(f"{name}: samples of type {pixels.dtype}, expected 8 or 16 bits")
    if container.data.startswith(BMP_MAGIC) and pixels.ndim == 3 and pixels.shape[2] == 4:
        return np.ascontiguousarray(pixels[:, :, :3])  # the fourth byte of a BMP is padding
    if container.transparent_grey is not None and pixels.ndim == 2:
        opaque = np.where(pixels == container.transparent_grey, 0, np.iinfo(pixels.dtype).max)
        return np.dstack((pixels, pixels, pixels, opaque.astype(pixels.dtype)))
    return pixels


def _checked(image: MapImage, name: str) -> MapImage:
    """Refuse 16-bit images that use a sliver of their range: all of it would be black."""
    if image.white > 4095:
        top = int(image.pixels[..., :3].max() if image.channels > 1 else image.pixels.max())
        if 0 < top <= min(4095, image.white // 16):
            raise MapError(
                f"{name}: 16-bit image with samples 0..{top} of a declared {image.white:,}: "
                "all black as stored; expected samples up to the maximum; save it as 8-bit, "
                "or scale the samples"
            )
    return image
