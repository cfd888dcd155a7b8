"""Hashes of files, of a map or scans: the same contents are the same map."""

import contextlib
import hashlib
import os
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from imgloc.errors import ImglocError, ScanError
from imgloc.io.calibration import calibration_path
from imgloc.io.files import open_regular
from imgloc.io.mapyaml import YAML_ENDINGS, image_named


def files_of(path: Path) -> list[Path]:
    """All files on which answers about a map depend, whether they exist or not."""
    files = [path, calibration_path(path)]
    if path.suffix.lower() in YAML_ENDINGS:
        with contextlib.suppress(ImglocError, OSError, ValueError):
            about = path.stat()
            files.append(_image_of(path, about.st_mtime_ns, about.st_size))
    return files


@lru_cache(maxsize=4096)
def _image_of(path: Path, _mtime: int, _size: int) -> Path:
    return image_named(path)


def content_hash(paths: Sequence[Path]) -> str | None:
    """40 hexadecimal digits of the contents of some files; None if the first cannot be read."""
    digests = [_digest(path) for path in paths]
    if not digests or digests[0] is None:
        return None
    return hashlib.blake2b("/".join(map(str, digests)).encode(), digest_size=20).hexdigest()


def _digest(path: Path) -> str | None:
    try:
        about = path.stat()
    except (OSError, ValueError):
        return None
    return _digest_of(path, about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=4096)
def _digest_of(path: Path, _mtime: int, _size: int) -> str | None:
    with (
        contextlib.suppress(ImglocError, OSError),
        os.fdopen(open_regular(path, ScanError, "file"), "rb") as file,
    ):
        digest = hashlib.blake2b(digest_size=20)
        while block := file.read(1 << 20):
            digest.update(block)
        return digest.hexdigest()
    return None
