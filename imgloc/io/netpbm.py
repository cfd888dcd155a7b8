"""PGM and PPM images, decoded here because cv2 ignores maxval and trips over CRLF headers."""

import re
import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from imgloc.errors import MapError

_SPACE = rb"(?:[ \t\r\n\v\f]|#[^\r\n]*[\r\n])"
_HEADER = re.compile(rb"P([2356])" + (_SPACE + rb"+(\d{1,9})") * 3)
_MAGIC = re.compile(rb"P[1-7Ff][ \t\r\n\v\f#]")


def is_netpbm(data: bytes) -> bool:
    """Whether `data` starts like a file of the Netpbm family (also the kinds refused here)."""
    return _MAGIC.match(data) is not None


def netpbm_header(data: bytes, name: str) -> tuple[str, int, int, int, int]:
    r"""Return kind (``"P5"``), width, height, maxval and the position of the first sample.

    Raises
    ------
    MapError
        If this is no PGM or PPM, or the header is damaged.

    Examples
    --------
    >>> netpbm_header(b"P5 # made by hand\n3 2\n255\n......", "x.pgm")
    ('P5', 3, 2, 255, 25)
    """
    match = _HEADER.match(data)
    if match is None:
        kind = data[:2].decode("latin-1")
        if kind not in ("P2", "P3", "P5", "P6"):
            raise MapError(
                f"{name}: is a Netpbm {kind} file, expected PGM (P2, P5) or PPM (P3, P6)"
            )
        raise MapError(f"{name}: damaged {kind} header, expected width, height and maxval")
    kind = "P" + match[1].decode()
    width, height, maxval = int(match[2]), int(match[3]), int(match[4])
    if width < 1 or height < 1:
        raise MapError(f"{name}: image of {width} x {height} pixels, expected at least 1 x 1")
    if not 1 <= maxval <= 65535:
        raise MapError(f"{name}: maxval {maxval}, expected 1..65535")
    return kind, width, height, maxval, match.end()


def decode_netpbm(data: bytes, name: str) -> tuple[npt.NDArray[Any], int]:
    r"""Decode a PGM or PPM; the samples are returned as stored, with their declared maximum.

    Parameters
    ----------
    data : bytes
        The whole file; its size in pixels has been checked (:func:`netpbm_header`).
    name : str
        For messages.

    Returns
    -------
    pixels : (H, W) or (H, W, 3) uint8 or uint16 array
        Top row first; colours as B, G, R as everywhere in OpenCV.
    maxval : int
        The value that means white.

    Raises
    ------
    MapError
        Damaged header, fewer or more samples than declared, or samples above maxval.

    Examples
    --------
    >>> decode_netpbm(b"P2\n2 1\n100\n0 100\n", "x.pgm")
    (array([[  0, 100]], dtype=uint8), 100)
    """
    kind, width, height, maxval, start = netpbm_header(data, name)
    channels = 3 if kind in ("P3", "P6") else 1
    count = width * height * channels
    if kind in ("P2", "P3"):
        samples = _ascii_samples(data[start:], count, name)
    else:
        samples = _binary_samples(data, start, count, maxval, name)
    if len(samples) != count:
        raise MapError(
            f"{name}: truncated: {len(samples):,} samples, expected {count:,} "
            f"({width} x {height} x {channels}); copy the file again"
        )
    if int(samples.max()) > maxval or int(samples.min()) < 0:
        raise MapError(f"{name}: sample {int(samples.max())}, expected 0..{maxval} (maxval)")
    pixels = samples.astype(np.uint8 if maxval < 256 else np.uint16)
    if channels == 1:
        return pixels.reshape(height, width), maxval
    return np.ascontiguousarray(pixels.reshape(height, width, 3)[:, :, ::-1]), maxval


def _ascii_samples(text: bytes, count: int, name: str) -> npt.NDArray[Any]:
    body = re.sub(rb"#[^\r\n]*", b"", text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # NumPy only warns when it meets something else
        try:
            # One sample too many is enough to notice.
            samples = np.fromstring(body.decode("ascii"), dtype=np.int64, sep=" ", count=-1)
        except (DeprecationWarning, ValueError, OverflowError):
            raise MapError(f"{name}: damaged: expected decimal numbers only") from None
    if len(samples) > count:
        raise MapError(f"{name}: {len(samples):,} samples, expected {count:,}")
    return samples


def _binary_samples(
    data: bytes, start: int, count: int, maxval: int, name: str
) -> npt.NDArray[Any]:
    dtype = np.dtype(np.uint8 if maxval < 256 else ">u2")
    size = count * dtype.itemsize
    # One white-space byte ends the header; a header written with CRLF ends in two, and its
    # line feed would be read as the first pixel and shift the whole image.
    start += 2 if data[start : start + 2] == b"\r\n" and len(data) - start >= size + 2 else 1
    body, extra = data[start : start + size], data[start + size :]
    if extra.strip():
        raise MapError(
            f"{name}: {len(extra):,} bytes follow the image, expected its end: the header "
            "does not belong to this data, or the file holds several images"
        )
    whole = len(body) - len(body) % dtype.itemsize
    return np.frombuffer(bytearray(body[:whole]), dtype=dtype)
