"""The index of a folder: coarse levels of its maps in one file, so that `which` opens few maps.

The level of a map is the one that a search of it begins with: its cells are four times as large as
those of the poses, or eight times on a large map.

An entry of a map is valid while the contents of its files are the same. The times and sizes of the
files are compared first. If these differ, the contents are compared.
"""

import hashlib
import io
import json
import logging
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from imgloc.choice.mosaic import Mosaic, best_fits, mosaics
from imgloc.errors import ConfigError, ImglocError, MapError, OutputError
from imgloc.features.budget import check_budget
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.pyramid import Level
from imgloc.features.scanpoints import one_per_place
from imgloc.features.store import code_digest
from imgloc.io.contents import content_hash, files_of
from imgloc.io.files import display, reason, write_bytes_atomic
from imgloc.io.own import map_arrays, parse_json, write_arrays
from imgloc.model import FloatArray, LaserScan
from imgloc.numbers import number
from imgloc.options import Options

LOG = logging.getLogger("imgloc")
# Readings of a scan: many, because a map that is dropped here is not looked at again.
_READINGS = number("folder_index.readings")
_FORMAT = "imgloc index of maps, 2"
_YOUNG = 2_000_000_000  # ns before the index was written; a younger file may change unnoticed
_LIMIT = 1 << 36  # most bytes of a file
_STAMP = [str, (int, None), (int, None)]
_ABOUT = {
    "format": str, "code": str, "written": int, "levels": [[str, int, int, float, float]],
    "maps": {str: [[_STAMP], str]},
}  # fmt: skip
_BESIDE = 6  # bytes for each cell of a level: the level, its mosaic, and the sums of that


@dataclass(frozen=True)
class MapIndex:
    """The coarse levels of some maps, in their order."""

    names: tuple[str, ...]
    levels: tuple[Level, ...]
    turns: tuple[float, ...]  #: yaws of the origins, radians

    @cached_property
    def tiles(self) -> tuple[Mosaic, ...]:
        """The levels of all maps, side by side."""
        return tuple(mosaics(self.levels, self.turns))

    def bounds(self, scan: LaserScan, options: Options) -> FloatArray:
        """Bound on the share of a scan that can fall on walls, for each map: (M,), 0..1.

        It is the largest share over all poses with a heading of the prior on the coarse level. A
        finer level nearly never reaches more.
        """
        fused = options.fused
        xy = one_per_place(scan, fused.place).spread(_READINGS).xy
        return best_fits(
            self.tiles, xy, len(self.names), theta_step=2 * fused.theta_step,
            prior=options.prior, threads=options.threads,
        )  # fmt: skip


def index_of(maps: Mapping[str, MapFeatures]) -> MapIndex:
    """Make the index of prepared maps."""
    levels = tuple(features.pyramid[-1] for features in maps.values())
    turns = tuple(features.grid.origin.theta for features in maps.values())
    return MapIndex(tuple(maps), levels, turns)


def open_index(
    maps: Mapping[str, Path], prepare: Callable[[Path], MapFeatures], *, about: str,
    file: Path | None = None, memory_budget: int | None = None,
    advance: Callable[[], object] = lambda: None,
) -> tuple[MapIndex, dict[str, MapError | ConfigError]]:  # fmt: skip
    """Read the index of some maps, and prepare the maps that are missing in it or have changed.

    Parameters
    ----------
    maps : mapping of str to Path
        Path of each map by its name.
    prepare : callable
        Reads and prepares one of the maps.
    about : str
        How the maps are read, which also decides the levels.
    file : path, optional
        File of the index. It is written if it does not exist or has changed.
    memory_budget : int, optional
        Most bytes of the index. None is half of the available memory.
    advance : callable
        Called after each map.

    Returns
    -------
    index, errors : MapIndex, dict of str to MapError or ConfigError
        Maps that cannot be used are not in the index, but among the errors.

    Raises
    ------
    OutputError
        If the file is no index, or cannot be written.
    ConfigError
        If the index takes more bytes than `memory_budget`.
    """
    kept = _Kept() if file is None else _load(file, memory_budget)
    levels, turns, names = list[Level](), list[float](), list[str]()
    errors: dict[str, MapError | ConfigError] = {}
    seen, used, cells = dict[str, list[Any]](), dict[str, tuple[Level, float]](), 0
    for name, path in maps.items():
        path = path.absolute()
        stamps, digest = kept.find(path, about)
        entry = kept.entries.get(digest)
        try:
            if entry is None:
                features = prepare(path)
                entry = features.pyramid[-1], features.grid.origin.theta
                del features
            cells += entry[0].image.size
            what = f"the index of {len(names) + 1:,} maps"
            check_budget(_BESIDE * cells, memory_budget, what, "look at fewer maps")
        except (MapError, ConfigError) as error:
            errors[name] = error
        else:
            names.append(name)
            levels.append(entry[0])
            turns.append(entry[1])
            seen[str(path)], used[digest] = [stamps, digest], entry
        advance()
    if file is not None and (kept.stale or kept.seen.keys() != seen.keys()):
        _save(file, used, seen)
    return MapIndex(tuple(names), tuple(levels), tuple(turns)), errors


class _Kept:
    """The contents of an index file."""

    def __init__(self) -> None:
        self.entries: dict[str, tuple[Level, float]] = {}  # level and yaw by contents
        self.seen: dict[str, list[Any]] = {}  # by map the stamps of its files, and contents
        self.written = 0  # ns
        self.stale = False  # whether contents had to be looked at

    def find(self, path: Path, about: str) -> tuple[list[list[Any]], str]:
        """Stamps of the files of a map, and the hash of their contents."""
        if str(path) in self.seen:
            stamps, digest = self.seen[str(path)]
            now = [_stamp(Path(stamp[0])) for stamp in stamps]
            if now == stamps and all((s[1] or 0) < self.written - _YOUNG for s in stamps):
                return stamps, str(digest)
            self.stale = True
        files = files_of(path)
        text = f"{content_hash(files)} {about}"
        digest = hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
        return [_stamp(file) for file in files], digest


def _stamp(file: Path) -> list[Any]:
    """Name, time in ns and size of a file; time and size are None if there is no such file."""
    try:
        about = file.stat()
    except (OSError, ValueError):
        return [str(file), None, None]
    return [str(file), about.st_mtime_ns, about.st_size]


def _save(
    file: Path, entries: Mapping[str, tuple[Level, float]], seen: Mapping[str, object]
) -> None:
    levels = [level for level, _ in entries.values()]
    shapes = [
        [digest, *level.image.shape, level.resolution, turn]
        for digest, (level, turn) in entries.items()
    ]
    about = {
        "format": _FORMAT, "code": code_digest(), "written": time.time_ns(),
        "levels": shapes, "maps": seen,
    }  # fmt: skip
    nothing = [np.empty(0, np.uint8)]
    images = np.concatenate([level.image.ravel() for level in levels] or nothing)
    free = np.concatenate([level.free.ravel() for level in levels] or nothing)
    head = np.frombuffer(json.dumps(about).encode(), np.uint8)
    buffer = io.BytesIO()
    write_arrays(buffer, {"about": head, "images": images, "free": free.astype(bool)})
    write_bytes_atomic(file, buffer.getvalue(), force=True)


def _load(file: Path, memory_budget: int | None) -> _Kept:
    """Read an index file; an empty result if it does not exist or is of another version."""
    kept = _Kept()
    if not os.path.lexists(file):
        return kept
    name = display(file)
    try:
        arrays, size = map_arrays(file, limit=_LIMIT, what="map index")
        check_budget(_BESIDE * size, memory_budget, f"{name}: an index", "look at fewer maps")
        about = parse_json(arrays["about"].tobytes(), _ABOUT)
        if about["format"].rpartition(",")[0] != _FORMAT.rpartition(",")[0]:
            raise ValueError("of another kind")
        if (about["format"], about["code"]) != (_FORMAT, code_digest()):
            LOG.info("%s: made by another version, built anew", name)
            return kept
        images, free, at = arrays["images"], arrays["free"], 0
        if images.dtype != np.uint8 or free.dtype != np.bool_ or free.shape != images.shape:
            raise ValueError("images and free cells of other sizes")
        for digest, height, width, resolution, turn in about["levels"]:
            if not (min(height, width, resolution) > 0 and at + height * width <= images.size):
                raise ValueError("levels of other sizes")
            part, shape = slice(at, at + height * width), (height, width)
            level = Level(images[part].reshape(shape), free[part].reshape(shape), resolution)
            kept.entries[digest] = level, turn
            at += height * width
        kept.seen, kept.written = about["maps"], about["written"]
        return kept
    except ImglocError:  # the file cannot be read, or is too large: its contents are not at fault
        raise
    except Exception as e:  # a damaged file can raise anything
        raise OutputError(
            f"{name}: is no index of maps ({reason(e)}); expected another name, or remove it"
        ) from None
