"""Input of a job, alike for one map and for many: maps and scans, within the memory.

A :class:`Desk` is what a process works at: its threads and memory, and the maps that it has
prepared already.
"""

import contextlib
import logging
import os
import sys
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, TypeVar

from imgloc.answers.causes import Given
from imgloc.answers.truth import tried_of
from imgloc.errors import STDERR, ConfigError, OutputError, ScanError
from imgloc.features.budget import (
    MIB,
    PROCESS,
    check_budget,
    default_budget,
    scans_bytes,
    simulate_bytes,
)
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.store import load_features, save_features
from imgloc.io.badlines import held
from imgloc.io.bags import BAG_ENDINGS, read_bag_map
from imgloc.io.contents import content_hash, files_of
from imgloc.io.files import display
from imgloc.io.images import ImageSize, image_size
from imgloc.io.maps import (
    SWAPPED,
    load_bytes,
    load_map,
    looks_swapped,
    reading_of,
    require_usable,
    resolve_settings,
)
from imgloc.io.scans import has_topics, load_scans, scans_size
from imgloc.io.scanset import ScanSet
from imgloc.model import LaserScan, OccupancyGrid, Pose2D, check_mount
from imgloc.options import Chosen, Logs, Options, Reading
from imgloc.pipeline import prepare
from imgloc.ranges import Checked
from imgloc.robot.recording import SCANS
from imgloc.search.asked import answer_bytes
from imgloc.simulation.scans import FINE, fine_factor

T = TypeVar("T")
LOG = logging.getLogger("imgloc")
COARSER = "crop the map, use a larger `cell` or `theta_step`"
_STREAM = 1 << 28  # bytes of standard input
_KEPT = 0.5  # share of a worker's memory that prepared maps may take


@dataclass(frozen=True)
class MapFiles(Checked):
    """The way in which images of maps are read."""

    reading: Reading = field(default_factory=lambda: Reading())  #: as of :func:`imgloc.load_map`
    allow_lossy: bool = False
    #: there may be several maps: of those with a YAML this alone says resolution and origin
    many: bool = True


@dataclass(frozen=True)
class ScanFiles(Logs):
    """The way in which files of scans are read, and the place of their sensor on the robot."""

    chosen: Chosen = field(default_factory=Chosen)  #: which scans of a file are looked at
    flipped: bool = False  #: the sensor is upside down
    mount: Pose2D | None = None  #: pose of the sensor on the robot
    #: there may be several files: a topic is for those that have any
    many: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mount is not None:
            check_mount(self.mount, "`sensor`")

    @property
    def given(self) -> Given:
        """Settings of the scans that a diagnosis needs."""
        return Given(self.flipped, self.scale, fov=self.fov)

    def mounted(self, scan: LaserScan) -> LaserScan:
        """The scan in metres, of an upright sensor with this reach that is mounted so."""
        scan = scan if self.scale == 1 else scan.scaled(self.scale)
        scan = scan.flipped if self.flipped else scan
        reach = scan.range_max if self.range_max is None else min(self.range_max, scan.range_max)
        if reach <= scan.range_min:
            raise ConfigError(
                f"`range_max`: got {reach:g}, expected more than range_min, {scan.range_min:g} m"
            )
        if reach == scan.range_max and self.mount is None:
            return scan
        return replace(scan, range_max=reach, T_base_laser=self.mount or scan.T_base_laser)


@dataclass(frozen=True)
class Taken:
    """Selected scans of a file, in metres, with mount and reach applied."""

    name: str  #: of the file
    scans: ScanSet
    indices: list[int]  #: in the file
    total: int  #: scans that it has
    tried: ScanSet  #: a few of the whole file, which tell whether its poses are true
    recorded: ScanSet  #: the selected ones as the file has them, without scale, mount and reach

    def __iter__(self) -> Iterator[tuple[int, LaserScan, Pose2D | None]]:
        """Index, scan, and pose of the sensor in the map frame if that is known, of each."""
        for n, (k, scan) in enumerate(zip(self.indices, self.scans.scans, strict=True)):
            yield k, scan, None if self.scans.poses is None else Pose2D(*self.scans.poses[n])

    def some(self, which: Sequence[int]) -> "Taken":
        """The same with some of the scans that are looked at."""
        indices = [self.indices[k] for k in which]
        recorded = self.recorded.take(which)
        return replace(self, scans=self.scans.take(which), indices=indices, recorded=recorded)


@dataclass
class Desk:
    """The desk of a process: threads, memory, and the maps that it has prepared already.

    No answer depends on it.
    """

    threads: int = 1
    memory_budget: int | None = None  #: bytes; None is half of what is available when it is asked
    cache: Path | None = None  #: folder where prepared maps are kept
    kept: float = 0.0  #: share of the memory that maps may take beside the one that is used
    held: int = 0  #: bytes of what is kept beside: other maps, other scans
    #: shows how far something is that has a title and so many steps
    progress: Callable[..., AbstractContextManager[Callable[..., None]]] = lambda *_, **__: (
        contextlib.nullcontext(lambda *_: None)
    )
    _maps: "OrderedDict[tuple[Hashable, float], MapFeatures]" = field(default_factory=OrderedDict)
    _last: dict[str, tuple[Hashable, Any]] = field(default_factory=dict)

    def once(self, kind: str, key: Hashable, make: Callable[[], T]) -> T:
        """The last thing that was made of a kind, if it was by the same key; else make it."""
        if kind not in self._last or self._last[kind][0] != key:
            self._last.pop(kind, None)  # two of them need not fit into the memory
            self._last[kind] = key, make()
        found: T = self._last[kind][1]
        return found

    @property
    def budget(self) -> int:
        """Bytes that may be taken."""
        return default_budget() if self.memory_budget is None else self.memory_budget

    def check(self, need: int, what: str, hint: str) -> None:
        """Refuse to take more bytes than the memory has; `hint` is about what needs less."""
        LOG.info("%s: at most %d MiB, the budget is %d MiB", what, -(-need // MIB),
                 self.budget // MIB)  # fmt: skip
        check_budget(need, self.budget, what, f"{hint}, or raise `memory_budget`")

    def grid(self, path: Path, maps: MapFiles, *, usable: bool = False) -> OccupancyGrid:
        """A map, which is read once; `usable`: with walls and free cells."""
        key = _key(path, maps)
        grid = next((f.grid for k, f in self._maps.items() if k[0] == key), None)
        if grid is None:
            grid = self.once("grid", key, lambda: self._load(path, maps))
        if usable:
            require_usable(grid, display(path))
        return grid

    def _load(self, path: Path, maps: MapFiles) -> OccupancyGrid:
        if path.suffix.lower() in BAG_ENDINGS:
            return read_bag_map(path)
        reading = reading_of(path, maps.reading) if maps.many else maps.reading
        size, what = image_of(path, reading)
        what += f" beside {-(-self.held // MIB)} MiB of other maps" if self.held else ""
        self.check(self.held + load_bytes(size), what, "crop the map")
        with quiet_libraries():
            grid = load_map(path, **reading, allow_lossy=maps.allow_lossy)
        if looks_swapped(grid):
            LOG.warning("%s: %s", display(path), SWAPPED)
        return grid

    def features(
        self, path: Path, maps: MapFiles, options: Options, *, cell: float = 0.1,
        scans: Sequence[LaserScan] = (), hint: str = COARSER, fresh: bool = False,
    ) -> MapFeatures:  # fmt: skip
        """A map, prepared: already, from the cache, or anew, and nothing yet if it is `fresh`.

        ConfigError if it takes more memory than there is, beside an answer and the scans.
        """
        key, name = (_key(path, maps), cell), display(path)
        if not fresh and key in self._maps:
            self._maps.move_to_end(key)
            self.check_answer(self._maps[key], options, name, scans=scans, hint=hint)
            return self._maps[key]
        grid = self.grid(path, maps)
        parameters = {"cell": cell, "threads": self.threads, "memory_budget": self.memory_budget}
        features = prepare(grid, name, ready=False, **parameters)
        self.check_answer(features, options, name, scans=scans, hint=hint)
        if fresh:
            return features
        if self.cache is not None:
            features = load_features(grid, self.cache, parameters)
        self._maps[key] = features
        sizes = {k: f.bytes_for(options.method) for k, f in self._maps.items()}
        while len(self._maps) > 1 and sum(sizes[k] for k in self._maps) > self.kept * self.budget:
            self._maps.popitem(last=False)
        return features

    def keep(self, features: MapFeatures) -> None:
        """Keep in the cache what has been computed of a map and is not there yet."""
        if self.cache is not None and save_features(features, self.cache):
            LOG.info("kept the prepared map in %s", self.cache)

    def check_answer(
        self, features: MapFeatures, options: Options, name: str,
        *, scans: Sequence[LaserScan] = (), hint: str = COARSER, workers: int = 1,
    ) -> None:  # fmt: skip
        """Check the memory of an answer, its features, scans, in each of several processes."""
        (rows, columns), lattice = features.grid.occupied.shape, features.lattice
        own, answer = features.bytes_for(options.method), answer_bytes(features, options)
        need = own + answer
        what = (
            f"{name}: {options.method} on {lattice.height} x {lattice.width} cells of "
            f"{lattice.resolution:g} m ({-(-answer // MIB)} MiB) with features of "
            f"{rows} x {columns} cells ({-(-own // MIB)} MiB)"
        )
        if workers > 1:
            need = workers * (need + PROCESS + 2 * rows * columns)
            what, hint = f"{what} in each of {workers} processes", f"use fewer `workers`, {hint}"
        if (held := held_bytes(scans)) >= MIB:
            what = f"{what} and scans ({-(-held // MIB)} MiB)"
        self.check(need + held + self.held, what, hint)

    def check_simulation(
        self, grid: OccupancyGrid, name: str, count: int, rays: int,
        *, world: bool = False, at_once: int | None = None, sets: int = 1,
        hint: str = "simulate fewer scans, crop the map",
    ) -> None:  # fmt: skip
        """Check the memory of simulating scans `at_once`, by default all, and keeping `sets`."""
        height, width = grid.occupied.shape
        factor = round(grid.resolution / FINE) if world else fine_factor(grid)
        cells, beams = height * width, min(count, at_once or count) * rays
        need = simulate_bytes(cells, cells * factor**2, beams, kept=sets * count * rays)
        on = f"on {factor * height} x {factor * width} cells"
        self.check(need, f"{name}: simulating {count:,} scans of {rays:,} rays {on}", hint)

    def scans(self, path: Path | None, files: ScanFiles) -> Taken:
        """The scans of a file that are chosen; ``-`` is standard input."""
        if path is None:
            raise ConfigError("expected scans")
        if str(path) != "-":
            return self._scans(path, files)
        return self.once("standard input", files, lambda: self._streamed(path, files))

    def _streamed(self, path: Path, files: ScanFiles) -> Taken:
        with TemporaryDirectory(prefix="imgloc-") as folder, held(folder + os.sep, ""):
            spooled = Path(folder, "standard input")  # its content tells what it is
            try:
                _spool(sys.stdin.buffer, spooled)
                return replace(self._scans(spooled, files), name=name_of(path))
            except (ConfigError, ScanError) as e:
                raise type(e)(str(e).replace(str(spooled), name_of(path))) from None

    def _scans(self, path: Path, files: ScanFiles) -> Taken:
        topic, name = files.topic, display(path)
        if files.many and topic is not None and not has_topics(path):
            topic = None
        size = scans_size(path, topic=topic, height=files.height)
        self.check(
            scans_bytes(size.scans, size.numbers, size.file_bytes, text=size.text),
            f"{name}: a file of up to {size.scans:,} scans and {size.numbers:,} numbers",
            "take fewer scans, in several files",
        )
        recorded = load_scans(
            path, topic=topic, fov=files.fov, max_bad=files.max_bad, height=files.height,
            odom=files.odom, range_max=files.range_max and files.range_max / files.scale,
            sensor=files.mount,
        )  # fmt: skip
        if files.mount is not None and len({s.laser for s in recorded.scans}) > 1:
            raise ConfigError("`sensor`: the log has several lasers, each with a place of its own")
        if files.odom not in (None, SCANS) and not (recorded.recording.taken or files.many):
            hint = "a topic or frame is of a ROS bag; leave it out, or pass scans"
            raise ScanError(f"{name}: `odom`: got {files.odom}, expected none: {hint}")
        if files.odom == SCANS:
            recorded = replace(recorded, odom=None)
        indices = files.chosen.of(len(recorded), name)
        some, tried = (
            replace(part, scans=tuple(map(files.mounted, part.scans)))
            for part in (recorded.take(indices), tried_of(recorded))
        )
        if files.straighten != "no":
            speeds, backward = recorded.velocities[indices], files.straighten == "backward"
            pairs = zip(some.scans, speeds, strict=True)
            still = sum(not scan.time_increment for scan in some.scans)
            straight = (scan.straightened(speed, backward=backward) for scan, speed in pairs)
            some = replace(some, scans=tuple(straight))
            if left := sum(bool(scan.time_increment) for scan in some.scans) + still:
                LOG.warning(
                    "%s: %d of %d scans are not straightened: that takes time_increment, and "
                    "odometry with stamps at most a second before",
                    name, left, len(some),
                )  # fmt: skip
        return Taken(name, some, indices, len(recorded), tried, recorded.take(indices))


#: Draws a picture of what an answer has for it: PNGs by what they show.
Drawing = Callable[..., Mapping[str, bytes]]


@dataclass(frozen=True)
class Means:
    """Means of workers; no answer depends on them."""

    memory_budget: int | None = None  #: bytes; by default half of what is available
    cache: Path | None = None  #: folder where prepared maps are kept, nowhere by default
    drawings: Mapping[str, Drawing] = field(default_factory=dict)  #: by the kind of what is drawn

    def desk(self) -> Desk:
        """That of this process, which keeps its maps from one item to the next."""
        return _desk_of(self.memory_budget, self.cache)


@lru_cache(maxsize=1)
def _desk_of(memory_budget: int | None, cache: Path | None) -> Desk:
    return Desk(memory_budget=memory_budget, cache=cache, kept=_KEPT)


def _key(path: Path, maps: MapFiles) -> Hashable:
    """The key of a map: the contents of its files, and how they are read."""
    return path, content_hash(files_of(path)), repr(sorted(maps.reading.items())), maps.allow_lossy


def image_of(path: Path, reading: Reading) -> tuple[ImageSize, str]:
    """Size of the image of a map, and what an error calls it."""
    image = resolve_settings(path, **reading).image
    size = image_size(image)
    return size, f"{display(image)}: an image of {size.width} x {size.height} pixels"


def held_bytes(scans: Sequence[LaserScan]) -> int:
    """Bytes of scans that are held in memory; a few out of many hold the array of all."""
    arrays = [a if a.base is None else a.base for s in scans for a in (s.ranges, s.angles)]
    return scans_bytes(len(scans), 0) + sum({id(a): a.nbytes for a in arrays}.values())


def name_of(path: Path) -> str:
    """The name of scans in messages: their file, or standard input."""
    return "standard input" if str(path) == "-" else display(path)


def _spool(stream: IO[bytes], path: Path) -> None:
    """Copy a stream, which may be endless, into a file: no more than a file may have."""
    copied = 0
    try:
        with path.open("wb", buffering=0) as file:
            while block := stream.read(MIB):
                file.write(block)
                if not copied:
                    has_topics(path)  # a ScanError of what is no scan file at all
                copied += len(block)
                if copied > _STREAM:
                    raise ScanError(f"{path}: expected at most {_STREAM >> 20} MiB; use a file")
    except OSError as e:
        raise OutputError(f"standard input: cannot be kept in {path}: {e.strerror}") from None


@contextlib.contextmanager
def quiet_libraries() -> Iterator[None]:
    """Keep what C libraries write to standard error from it.

    libpng has a line of its own about a damaged file; imgloc's error is enough.
    """
    if sys.stderr is not None:
        sys.stderr.flush()
    with STDERR, held(), contextlib.ExitStack() as undo:
        with contextlib.suppress(OSError):  # without a standard error nothing is to be done
            kept = os.dup(2)
            undo.callback(os.close, kept)
            sink = os.open(os.devnull, os.O_WRONLY)
            undo.callback(os.close, sink)
            os.dup2(sink, 2)
            undo.callback(os.dup2, kept, 2)
        yield
