"""What PNG, JPEG and BMP files say about themselves, checked before OpenCV sees them.

``cv2.imdecode`` answers damage with None, with a partly grey image or with an exception,
depending on the format, and allocates whatever the header asks for. So the size is read
here first, and a file that is not whole is refused with the reason.
"""

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

from imgloc.errors import MapError

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
JPEG_MAGIC = b"\xff\xd8\xff"
BMP_MAGIC = b"BM"
# Samples per pixel of each PNG colour type, and the bit depths it may have.
_PNG_TYPES = {
    0: (1, (1, 2, 4, 8, 16)),
    2: (3, (8, 16)),
    3: (1, (1, 2, 4, 8)),
    4: (2, (8, 16)),
    6: (4, (8, 16)),
}
# Adam7: (first column, first row, column step, row step) of each pass.
_ADAM7 = (
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
)
# A JPEG marker inside entropy-coded data; FF 00 is a stuffed byte, FF D0..D7 a restart.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")


@dataclass(frozen=True)
class Container:
    """Size of an image, in pixels, and the bytes to be given to the decoder.

    `transparent_grey` is the sample of a grey PNG that its tRNS chunk declares transparent
    (cv2 ignores that chunk on grey images), already expanded to the decoded depth.
    """

    width: int
    height: int
    data: bytes
    transparent_grey: int | None = None


def png_size(data: bytes, name: str) -> tuple[int, int]:
    """Return width and height of a PNG from its header chunk.

    Raises
    ------
    MapError
        If the file ends before, or does not begin with, a header chunk.
    """
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise MapError(f"{name}: truncated or damaged PNG header; copy the file again")
    width, height = struct.unpack(">II", data[16:24])
    if not (0 < width < 2**31 and 0 < height < 2**31):
        raise MapError(f"{name}: PNG of {width} x {height} pixels, expected at least 1 x 1")
    return width, height


def open_png(data: bytes, name: str) -> Container:
    """Check every checksum of a PNG and keep only the chunks that decide its pixels.

    Dropping the rest makes all decoders agree: no orientation (eXIf), gamma or colour
    profile is applied to a map, and no text chunk is inflated.

    Raises
    ------
    MapError
        Truncated, damaged or animated file.
    """
    width, height = png_size(data, name)
    depth, colour, compression, filtering, interlace = data[24:29]
    channels, depths = _PNG_TYPES.get(colour, (0, ()))
    if depth not in depths or compression or filtering or interlace > 1:
        raise MapError(f"{name}: damaged PNG header (depth {depth}, colour type {colour})")
    kept = [PNG_MAGIC]
    pixels: list[bytes] = []
    grey = None
    for kind, chunk in _png_chunks(data, name):
        body = chunk[8:-4]
        if kind == b"acTL":
            raise MapError(f"{name}: is an animated PNG, expected a single image")
        if kind == b"tRNS" and colour == 0 and len(body) == 2:
            grey = int.from_bytes(body, "big") * (255 // (2**depth - 1) if depth < 8 else 1)
        if kind == b"IDAT":
            pixels.append(body)
        if kind in (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"):
            kept.append(chunk)
        elif kind[:1].isupper():
            raise MapError(f"{name}: PNG chunk {kind.decode('latin-1')!r} is not known")
    bits = channels * depth
    _check_inflated(pixels, _png_bytes(width, height, bits, interlace), name)
    return Container(width, height, b"".join(kept), grey)


def _png_chunks(data: bytes, name: str) -> Iterator[tuple[bytes, bytes]]:
    at = len(PNG_MAGIC)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        kind, end = data[at + 4 : at + 8], at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise MapError(
                f"{name}: damaged PNG: wrong checksum (CRC) in chunk "
                f"{kind.decode('latin-1')!r} at byte {at:,}; copy the file again"
            )
        yield kind, data[at:end]
        if kind == b"IEND":
            return
        at = end
    raise MapError(
        f"{name}: truncated PNG: {len(data):,} bytes without an end; copy the file again"
    )


def _png_bytes(width: int, height: int, bits: int, interlace: int) -> int:
    """Return the length of the inflated data: each row has a filter byte in front."""
    passes = _ADAM7 if interlace else ((0, 0, 1, 1),)
    total = 0
    for x, y, dx, dy in passes:
        columns, rows = -(-(width - x) // dx), -(-(height - y) // dy)
        if columns > 0 and rows > 0:
            total += rows * (1 + -(-columns * bits // 8))
    return total


def _check_inflated(parts: list[bytes], expected: int, name: str) -> None:
    inflater, total = zlib.decompressobj(), 0
    try:
        for part in parts:
            rest = part
            while rest and total <= expected:
                total += len(inflater.decompress(rest, 1 << 20))
                rest = inflater.unconsumed_tail
        while total < expected and (tail := inflater.decompress(b"", 1 << 20)):
            total += len(tail)
    except zlib.error as e:
        raise MapError(f"{name}: damaged PNG data ({e}); copy the file again") from None
    if total < expected:
        raise MapError(
            f"{name}: truncated PNG: {total:,} of {expected:,} bytes of pixels; copy the file again"
        )


def jpeg_size(data: bytes, name: str) -> tuple[int, int]:
    """Return width and height of a JPEG from its frame header.

    Raises
    ------
    MapError
        No frame header, or not 1 (grey) or 3 (colour) components.
    """
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        kind, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if kind == 0xFF:  # fill byte
            at += 1
            continue
        # SOF0..15 without DHT (C4), JPG (C8) and DAC (CC).
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC) and at + 10 <= len(data):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            if width < 1 or height < 1 or data[at + 9] not in (1, 3):
                raise MapError(
                    f"{name}: JPEG of {width} x {height} pixels and {data[at + 9]} components, "
                    "expected at least 1 x 1 and grey or colour"
                )
            return width, height
        at += 2 + length
    raise MapError(f"{name}: truncated or damaged JPEG header; copy the file again")


def open_jpeg(data: bytes, name: str) -> Container:
    """Check that a JPEG goes on to its end marker (cv2 fills what is missing with grey).

    Raises
    ------
    MapError
        Truncated or damaged file.
    """
    width, height = jpeg_size(data, name)
    at = 2
    while at + 4 <= len(data):
        marker = _JPEG_MARKER.search(data, at)
        if marker is None:
            break
        kind, at = data[marker.end() - 1], marker.end()
        if kind == 0xD9:
            return Container(width, height, data)
        at += int.from_bytes(data[at : at + 2], "big")
    raise MapError(
        f"{name}: truncated JPEG: no end marker in {len(data):,} bytes; copy the file again"
    )


def bmp_size(data: bytes, name: str) -> tuple[int, int]:
    """Return width and height of a BMP; a negative height (top row first) is made positive.

    Raises
    ------
    MapError
        Truncated header, or an old OS/2 one.
    """
    if len(data) < 54 or int.from_bytes(data[14:18], "little") < 40:
        raise MapError(f"{name}: truncated or unsupported BMP header")
    width, height = struct.unpack("<ii", data[18:26])
    if width < 1 or height == 0:
        raise MapError(f"{name}: BMP of {width} x {height} pixels, expected at least 1 x 1")
    return width, abs(height)


def open_bmp(data: bytes, name: str) -> Container:
    """Check that an uncompressed BMP holds all the rows it declares.

    Raises
    ------
    MapError
        Truncated or compressed file.
    """
    width, height = bmp_size(data, name)
    offset = int.from_bytes(data[10:14], "little")
    bits, compression = struct.unpack("<HI", data[28:34])
    if compression not in (0, 3):
        raise MapError(f"{name}: is a compressed BMP, expected a plain one; convert it to PNG")
    expected = offset + (width * bits + 31) // 32 * 4 * height
    if len(data) < expected:
        raise MapError(
            f"{name}: truncated BMP: {len(data):,} bytes, expected {expected:,}; "
            "copy the file again"
        )
    return Container(width, height, data)
