"""What a batch does with each map and scan file: the work of a command, its answers as plain rows.

Everything here runs in a worker, which keeps the maps that it has prepared, up to a limit.
"""

import contextlib
import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from imgloc.answers.diagnose import Doubt, Said, doubts
from imgloc.choice.choose import OPTIONS as WHICH
from imgloc.choice.choose import Opened, bounds_of, choose, search
from imgloc.choice.folder_index import MapIndex, open_index
from imgloc.doors import behind
from imgloc.errors import ConfigError, MapError, ScanError
from imgloc.features.budget import check_budget, default_budget, scans_bytes
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.store import load_features, save_features
from imgloc.geometry import pose_errors, poses_of
from imgloc.io.calibration import calibrated
from imgloc.io.contents import content_hash, files_of
from imgloc.io.files import display
from imgloc.io.images import image_size
from imgloc.io.mapcheck import check_bytes, check_map
from imgloc.io.maps import Reading, load_bytes, load_map, reading_of, resolve_settings
from imgloc.io.scans import has_topics, load_scans, scans_size
from imgloc.io.scanset import Chosen, ScanSet
from imgloc.model import LaserScan, OccupancyGrid, Pose2D, check_mount, plain
from imgloc.options import FUSED, TOLERANCES, Count, Factor, Length, Options, Prior, Tolerance
from imgloc.pipeline import localize, prepare
from imgloc.ranges import Checked, OneOf, Within
from imgloc.search.asked import answer_bytes
from imgloc.search.priors import Known, leaves_none
from imgloc.simulation.scans import Sensor

JOBS = ("localize", "evaluate", "check", "which", "atlas")
WITHOUT_SCANS = frozenset({"check", "atlas"})  #: jobs that look at maps alone
PICTURES = ("none", "doubtful", "all")
#: Draws a picture of an answer, or of a map: PNGs by what they show.
Drawing = Callable[..., Mapping[str, bytes]]
_KEPT = 0.5  # share of a worker's memory that prepared maps may take


@dataclass(frozen=True)
class Job(Checked):
    """What is done with each item, and everything that decides its rows.

    The options of methods are those of the command whose name the job has.
    """

    name: Annotated[str, OneOf(*JOBS)] = "localize"  #: one of :data:`JOBS`
    options: Options = field(default_factory=Options)
    #: how images are read, as of :func:`imgloc.load_map`; resolution and origin are of images
    #: without a YAML alone
    reading: Reading = field(default_factory=lambda: Reading())
    allow_lossy: bool = False
    cell: Length = 0.1  #: of the poses, metres
    topic: str | None = None  #: which laser of a log with several, as of :func:`imgloc.load_scans`
    range_scale: Factor = 1.0  #: metres of a range
    range_max: Length | None = None  #: readings are cut here, metres
    chosen: Chosen = field(default_factory=Chosen)  #: which scans of a file are looked at
    flipped: bool = False  #: the sensor is upside down
    mount: Pose2D | None = None  #: pose of the sensor on the robot
    #: what is known of all poses, of ``localize``; but for a place also of ``which``
    known: Known = field(default_factory=Known)
    #: how near a known pose an answer is a hit
    tolerance: Tolerance = TOLERANCES[-1]
    sure: Annotated[float, Within(0.5, 1, "a probability")] = (
        0.5  #: probability that a map needs to be named, of ``which``
    )
    #: of what is simulated: by ``evaluate`` without scans and by ``atlas``
    sensor: Sensor = field(default_factory=Sensor)
    count: Count = 100
    seed: int = 0
    step: Length = 0.5  #: between the places of an atlas, metres
    headings: Count = 4
    pictures: Annotated[str, OneOf(*PICTURES)] = (
        "none"  #: of which answers there are some, one of :data:`PICTURES`
    )
    drawings: Mapping[str, Drawing] = field(default_factory=dict)
    #: bytes that a worker may take, by default half of what is available; no answer depends on it
    memory_budget: int | None = None
    cache: Path | None = None  #: where prepared maps are kept, nowhere by default

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mount is not None:
            check_mount(self.mount, "mount")
        if self.name == "which" and self.options.method != FUSED:
            raise ConfigError(f"maps are compared by the method {FUSED}")
        if self.name == "which" and self.known.near is not None:
            raise ConfigError("a place is known of one map, not of several to choose from")

    @cached_property
    def digest(self) -> str:
        """Hash of what decides the rows, apart from the files and the version."""
        text = json.dumps(self.parameters, sort_keys=True)
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    @property
    def parameters(self) -> dict[str, Any]:
        """Everything that decides a row, as plain values."""
        aside = {"drawings", "memory_budget", "cache", "options"}
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in aside}
        own["reading"] = dict(self.reading)
        for name in ("tolerance", "sensor", "known", "chosen"):
            own[name] = asdict(own[name])
        options = asdict(replace(self.options, prior=Prior(), threads=1, memory_budget=None))
        return dict(plain(own | {"options": options}))


@dataclass(frozen=True)
class Item:
    """A map with a file of scans; several maps for ``which``, no scans for jobs without."""

    map: str  #: names, as the rows have them
    scans: str | None
    maps: tuple[tuple[str, Path], ...]  #: name and file of each map
    scans_path: Path | None = None

    @property
    def id(self) -> tuple[str, str | None]:
        """What tells it from all others of a batch."""
        return self.map, self.scans

    @property
    def group(self) -> str:
        """Items of one group use the same maps: a worker is to have as many of one as it can."""
        return self.map


@dataclass
class Done:
    """What a job has made of an item."""

    answers: list[dict[str, Any]] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)  #: time of each answer
    cost: dict[str, Any] = field(default_factory=dict)  #: what else two runs do not share
    pictures: dict[str, bytes] = field(default_factory=dict)  #: by the ends of their names

    def draw(self, job: Job, kind: str, doubtful: bool, k: int, *what: Any) -> None:
        """Add the pictures of the last answer, if they are wanted."""
        if job.pictures == "none" or (job.pictures == "doubtful" and not doubtful):
            return
        if (drawing := job.drawings.get(kind)) is not None:
            made = drawing(*what)
            self.pictures |= {f"{k:04d}-{name}.png": png for name, png in made.items()}
            self.answers[-1]["pictures"] = [f"{k:04d}-{name}.png" for name in made]


def perform(item: Item, job: Job) -> Done:
    """Do a job with an item.

    Raises
    ------
    ImglocError
        If a file, or what is to be done with it, is at fault.
    """
    work: Callable[[Item, Job], Done] = _WORK.get(job.name) or behind(_BEHIND[job.name])
    return work(item, job)


_MAPS: "OrderedDict[tuple[object, ...], MapFeatures]" = OrderedDict()


def open_map(path: Path, job: Job, options: Options, *, fresh: bool = False) -> MapFeatures:
    """A map as a worker has it: prepared already, from the cache, or anew.

    ConfigError if it takes more memory than a worker may.
    """
    # By what is in its files, and the way it is read: a worker of a cluster has many a job.
    way = (repr(sorted(job.reading.items())), job.allow_lossy, job.cell, job.memory_budget)
    key = (path, content_hash(files_of(path)), *way)
    if fresh or key not in _MAPS:
        budget = job.memory_budget or default_budget()
        reading = reading_of(path, job.reading)
        name, size = display(path), image_size(resolve_settings(path, **reading).image)
        what = f"{name}: an image of {size.width} x {size.height} pixels"
        check_budget(load_bytes(size), budget, what, "crop the map")
        grid = load_map(path, allow_lossy=job.allow_lossy, **reading)
        parameters = {"cell": job.cell, "memory_budget": job.memory_budget}
        features = prepare(grid, name, **parameters)
        height, width = grid.occupied.shape
        need = features.bytes_for(options.method) + answer_bytes(features, options)
        what = f"{name}: {options.method} on {height} x {width} cells"
        check_budget(need, budget, what, "crop the map, use larger cells")
        if fresh:
            return features
        if job.cache is not None:
            features = load_features(grid, job.cache, parameters)
        _MAPS[key] = features
        sizes = {k: f.bytes_for(options.method) for k, f in _MAPS.items()}
        while len(_MAPS) > 1 and sum(sizes[k] for k in _MAPS) > _KEPT * budget:
            _MAPS.popitem(last=False)
    _MAPS.move_to_end(key)
    return _MAPS[key]


def open_scans(item: Item, job: Job) -> tuple[ScanSet, list[int]]:
    """The scans of an item as the sensor, mounted as the job says, has recorded them.

    Those that the job has chosen, and their indices in the file.
    """
    path = item.scans_path
    if path is None:
        raise ConfigError(f"{job.name}: expected scans")
    topic = job.topic if has_topics(path) else None  # of a folder's logs
    size, name = scans_size(path, topic=topic), display(path)
    need = scans_bytes(size.scans, size.numbers, size.file_bytes, text=size.text)
    what = f"{name}: a file of up to {size.scans:,} scans"
    check_budget(need, job.memory_budget, what, "take fewer scans, in several files")
    recorded = load_scans(path, topic=topic)
    indices = job.chosen.of(len(recorded), name)
    recorded = recorded.take(indices)
    scans = tuple(_as_mounted(scan, job, name) for scan in recorded.scans)
    return replace(recorded, scans=scans), indices


def _as_mounted(scan: LaserScan, job: Job, name: str) -> LaserScan:
    scan = scan.flipped if job.flipped else scan
    scan = scan if job.range_scale == 1 else scan.scaled(job.range_scale)
    reach = scan.range_max if job.range_max is None else min(scan.range_max, job.range_max)
    if reach <= scan.range_min:
        raise ScanError(f"{name}: range_min is {scan.range_min:g} m, cut at {reach:g} m")
    return replace(scan, range_max=reach, T_base_laser=job.mount or scan.T_base_laser)


def job_options(job: Job, path: Path, grid: OccupancyGrid | None = None) -> Options:
    """The options of a job, on one thread, with what was calibrated for a map."""
    options = replace(job.options, threads=1, memory_budget=job.memory_budget)
    if grid is None or options.calibration is not None:
        return options
    return calibrated(options, path, grid)


def _locate(item: Item, job: Job) -> Done:
    ((_, path),) = item.maps
    scans, indices = open_scans(item, job)
    (features, options), done = _opened(path, job), Done()
    for n, (k, scan) in enumerate(zip(indices, scans.scans, strict=True)):
        answer = localize(features, scan, options)
        row = answer.as_row(k)
        done.ms.append(row.pop("timings_ms")["localize"])
        del row["parameters"]  # the same for all
        truth = None if scans.poses is None else Pose2D(*scans.poses[n])
        if truth is not None:
            row |= _compare(poses_of(answer.hypotheses[:1]), truth, job.tolerance)
        done.answers.append(row)
        doubtful = answer.verdict != "unique" or row.get("hit") is False
        done.draw(job, "answer", doubtful, k, features, answer, scan, truth, options)
    if job.cache is not None:
        save_features(features, job.cache)
    return done


def _opened(path: Path, job: Job) -> Opened:
    """A map, and the options with what is known of it."""
    features = open_map(path, job, job_options(job, path))
    options = job_options(job, path, features.grid)
    return features, replace(options, prior=job.known.prior(features.grid))


def look_again(item: Item, job: Job, said: Said) -> list[Doubt]:
    """What may be wrong with an item of ``localize``: tried on a few of its scans."""
    ((_, path),) = item.maps
    scans, _ = open_scans(item, job)
    features, options = _opened(path, job)
    return doubts(
        features, scans.scans, said, options, flipped=job.flipped, range_scale=job.range_scale
    )


def _compare(poses: Any, truth: Pose2D, tolerance: Tolerance) -> dict[str, Any]:
    """What is said of an answer when the true pose is known."""
    errors = pose_errors(poses, truth)
    hit = bool(len(errors) and np.all(errors[0] <= (tolerance.position, tolerance.heading)))
    position, heading = errors[0].tolist() if len(errors) else (None, None)
    return {"truth": plain(truth), "hit": hit, "error": {"position": position, "heading": heading}}


def _check(item: Item, job: Job) -> Done:
    ((_, path),) = item.maps
    reading = reading_of(path, job.reading)
    size = image_size(resolve_settings(path, **reading).image)
    what = f"{display(path)}: an image of {size.width} x {size.height} pixels"
    check_budget(check_bytes(size), job.memory_budget, what, "crop the map")
    report = check_map(path, **reading)
    done = Done([report.as_row()])
    if job.pictures == "all" or (job.pictures == "doubtful" and report.warnings):
        grid = load_map(path, allow_lossy=True, **reading)
        done.draw(job, "map", True, 0, grid)
    return done


def _choose(item: Item, job: Job) -> Done:
    (scans, indices), done = open_scans(item, job), Done()
    options = replace(WHICH, memory_budget=job.memory_budget)
    coarse = replace(options, prior=Prior(None, job.known.heading))
    index, errors = _index_of(item, job, options)
    left_out = [{"map": name, "message": str(error)} for name, error in errors.items()]
    if not index.names:
        raise MapError(f"none of the {len(left_out)} maps can be used: {left_out[0]['message']}")
    files = dict(item.maps)

    @contextlib.contextmanager
    def opened(name: str) -> Iterator[Opened | None]:
        features = open_map(files[name], job, options)
        prior = job.known.prior(features.grid)
        here = calibrated(replace(options, prior=prior), files[name], features.grid)
        yield None if leaves_none(prior, features) else (features, here)
        if job.cache is not None:
            save_features(features, job.cache)

    bounds = [bounds_of(index, files, scan, coarse) for scan in scans.scans]
    looked_at = zip(indices, scans.scans, search(scans.scans, bounds, opened), strict=True)
    for k, scan, found in looked_at:
        if not found:
            raise ConfigError("no map has a place in which the robot can be")
        choice = choose(found, sure=job.sure, ruled_out=len(index.names) - len(found))
        done.ms.append(sum(answer.timings_ms["localize"] for answer in found.values()))
        done.answers.append(choice.as_row(found, k) | ({"left_out": left_out} if left_out else {}))
        best = next(iter(choice.probability))
        features = open_map(files[best], job, options)
        doubtful = choice.verdict != best
        done.draw(job, "answer", doubtful, k, features, found[best], scan, None, options)
    return done


_INDEX: dict[tuple[object, ...], tuple[MapIndex, dict[str, MapError | ConfigError]]] = {}


def _index_of(
    item: Item, job: Job, options: Options
) -> tuple[MapIndex, dict[str, MapError | ConfigError]]:
    """The index of the maps of an item, as a worker has it already, or anew."""
    contents = tuple(content_hash(files_of(path)) for _, path in item.maps)
    key = (item.maps, contents, job.digest, job.memory_budget)
    if key not in _INDEX:
        _INDEX.clear()
        _INDEX[key] = open_index(
            dict(item.maps), lambda path: open_map(path, job, options),
            about="", memory_budget=job.memory_budget or default_budget(),
        )  # fmt: skip
    return _INDEX[key]


_WORK: Mapping[str, Callable[[Item, Job], Done]] = {
    "localize": _locate, "check": _check, "which": _choose,
}  # fmt: skip
_BEHIND = {"evaluate": "evaluate_item", "atlas": "survey_item"}  # what doors.py knows them by
