"""What the commands read, the same way in each: maps, scans, priors, within the memory.

This loads all of imgloc: a command imports it when it runs.
"""

import contextlib
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

import numpy as np

from imgloc.choice.choose import names_of
from imgloc.cli.console import LOG, quiet_libraries
from imgloc.cli.options import RADIUS, TOLERANCE, Known, Logs
from imgloc.errors import ConfigError, MapError, OutputError, ScanError
from imgloc.features.budget import MIB, PROCESS, check_budget, scans_bytes, simulate_bytes
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.store import load_features, save_features
from imgloc.io.cache import cache_folder, cache_limit
from imgloc.io.calibration import calibration_path, load_calibrations
from imgloc.io.files import display, is_folder, refuse_existing
from imgloc.io.folders import find_maps
from imgloc.io.images import ImageSize, image_size, read_image
from imgloc.io.maps import (
    SWAPPED,
    YAML_ENDINGS,
    Reading,
    load_bytes,
    load_map,
    looks_swapped,
    reading_of,
    require_usable,
    resolve_settings,
)
from imgloc.io.mapyaml import load_map_yaml
from imgloc.io.scans import has_topics, load_scans, scans_size
from imgloc.io.scanset import ScanSet
from imgloc.live.sites import Site
from imgloc.model import BoolArray, LaserScan, OccupancyGrid
from imgloc.options import Options, Prior
from imgloc.pipeline import prepare
from imgloc.search import priors
from imgloc.search.asked import answer_bytes
from imgloc.simulation.scans import FINE, fine_factor

_STREAM = 1 << 28  # bytes of standard input
COARSER = "crop the map, use a larger --cell or --theta-step-deg"


def files_of(map_path: Path) -> list[Path]:
    """The files that a map is read from: its YAML and the image that this names, or an image."""
    files = [map_path]
    if map_path.suffix.lower() in YAML_ENDINGS:
        with contextlib.suppress(MapError):  # said when the map is loaded
            files.append(load_map_yaml(map_path).image)
    return files


def check_target(
    path: Path | None, ending: str, *, force: bool, inputs: Iterable[Path] = ()
) -> None:
    """Refuse an output file before the work that it is to hold: one without the `ending`, or there.

    With `force` one that is there may be replaced, but for `inputs`, which the command reads. None,
    an option that was not given, passes.
    """
    if path is None:
        return
    if path.suffix.lower() != ending:
        raise ConfigError(f"{display(path)}: expected a name that ends in {ending}")
    if not is_folder(path.parent):
        raise OutputError(f"{display(path)}: there is no folder {display(path.parent)}")
    if not force:
        refuse_existing(path)
    for source in inputs:
        with contextlib.suppress(OSError):
            if path.samefile(source):
                raise OutputError(
                    f"{display(path)}: is read by this command and will not be overwritten, not "
                    "even with --force; expected another name"
                )


def numbered(path: Path | None, indices: Sequence[int]) -> dict[int, Path]:
    """Names of the files of some scans: the name itself for one, NAME-0003 and so on for several.

    Examples
    --------
    >>> [p.name for p in numbered(Path("a.png"), [0, 12]).values()]
    ['a-0000.png', 'a-0012.png']
    """
    if path is None or len(indices) == 1:
        return {} if path is None else {indices[0]: path}
    return {k: path.with_name(f"{path.stem}-{k:04d}{path.suffix}") for k in indices}


def cut_scan(scan: LaserScan, range_max: float | None, *, flipped: bool = False) -> LaserScan:
    """The scan that a sensor with a shorter reach, or one upright, would have recorded."""
    scan = scan.flipped if flipped else scan
    if range_max is None or range_max >= scan.range_max:
        return scan
    if range_max <= scan.range_min:
        raise ConfigError(
            f"--range-max: got {range_max:g}, expected more than range_min, {scan.range_min:g} m"
        )
    return replace(scan, range_max=range_max)


def check_memory(need: int, budget: int, what: str, hint: str) -> None:
    """Say how much `what` takes at most; refuse it if it is more than the budget, bytes."""
    LOG.info("%s: at most %d MiB, the budget is %d MiB", what, -(-need // MIB), budget // MIB)
    check_budget(need, budget, what, f"{hint}, or raise --memory-budget")


def check_image(
    path: Path, reading: Mapping[str, Any], budget: int, need: Callable[[ImageSize], int],
    *, held: int = 0,
) -> None:  # fmt: skip
    """Check the memory for the image of a map, `need` of its size beside what is `held`, bytes."""
    image = resolve_settings(path, **reading).image
    size = image_size(image)
    beside = f" beside {-(-held // MIB)} MiB of other maps" if held else ""
    check_memory(
        held + need(size),
        budget,
        f"{display(image)}: an image of {size.width} x {size.height} pixels{beside}",
        "crop the map",
    )


def load_grid(
    path: Path, budget: int, *, allow_lossy: bool, held: int = 0, usable: bool = True,
    **reading: Any,
) -> OccupancyGrid:  # fmt: skip
    """Load a map, within the budget beside what is `held`; `usable`: with walls and free cells."""
    check_image(path, reading, budget, load_bytes, held=held)
    with quiet_libraries():
        grid = load_map(path, **reading, allow_lossy=allow_lossy)
    if looks_swapped(grid):
        LOG.warning("%s: %s", display(path), SWAPPED)
    if usable:
        require_usable(grid, display(path))
    return grid


def name_of(path: Path) -> str:
    """What scans are called in messages: their file, or standard input."""
    return "standard input" if str(path) == "-" else display(path)


def load_set(path: Path, budget: int, logs: Logs = Logs()) -> ScanSet:
    """Load scans, which are read only if they take no more than the budget; ``-`` is stdin."""
    if str(path) != "-":
        return _load_set(path, budget, logs)
    with TemporaryDirectory(prefix="imgloc-") as folder:
        spooled = Path(folder, "standard input")  # its content tells what it is
        try:
            _spool(sys.stdin.buffer, spooled)
            return _load_set(spooled, budget, logs)
        except (ConfigError, ScanError) as e:
            raise type(e)(str(e).replace(str(spooled), "standard input")) from None


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


def _load_set(path: Path, budget: int, logs: Logs) -> ScanSet:
    size = scans_size(path, topic=logs.topic)
    check_memory(
        scans_bytes(size.scans, size.numbers, size.file_bytes, text=size.text),
        budget,
        f"{display(path)}: a file of up to {size.scans:,} scans and {size.numbers:,} numbers",
        "take fewer scans, in several files",
    )
    scans = load_scans(path, topic=logs.topic, fov=logs.fov)
    if logs.scale == 1:
        return scans
    return replace(scans, scans=tuple(scan.scaled(logs.scale) for scan in scans.scans))


def held_bytes(scans: Sequence[LaserScan]) -> int:
    """Bytes of scans that are held in memory; a few out of many hold the array of all."""
    arrays = [a if a.base is None else a.base for s in scans for a in (s.ranges, s.angles)]
    return scans_bytes(len(scans), 0) + sum({id(a): a.nbytes for a in arrays}.values())


def check_simulation(
    grid: OccupancyGrid, name: str, count: int, rays: int, budget: int,
    *, world: bool = False, at_once: int | None = None, sets: int = 1,
    hint: str = "simulate fewer scans, crop the map",
) -> None:  # fmt: skip
    """Check the memory of simulating scans `at_once`, by default all, and keeping `sets` of it."""
    height, width = grid.occupied.shape
    factor = round(grid.resolution / FINE) if world else fine_factor(grid)
    cells, beams = height * width, min(count, at_once or count) * rays
    need = simulate_bytes(cells, cells * factor**2, beams, kept=sets * count * rays)
    what = (
        f"{name}: simulating {count:,} scans of {rays:,} rays "
        f"on {factor * height} x {factor * width} cells"
    )
    check_memory(need, budget, what, hint)


def check_answer(
    features: MapFeatures, options: Options, name: str,
    *, hint: str = COARSER, workers: int = 1, scans: Sequence[LaserScan] = (),
) -> None:  # fmt: skip
    """Check the memory of an answer, its features and the scans, in each of several processes."""
    (rows, columns), lattice = features.grid.occupied.shape, features.lattice
    held = features.bytes_for(options.method)
    answer = answer_bytes(features, options)
    what = (
        f"{name}: {options.method} on {lattice.height} x {lattice.width} cells of "
        f"{lattice.resolution:g} m ({-(-answer // MIB)} MiB) with features of "
        f"{rows} x {columns} cells ({-(-held // MIB)} MiB)"
    )
    need = held + answer
    if workers > 1:
        need = workers * (need + PROCESS + 2 * rows * columns)
        what, hint = f"{what} in each of {workers} processes", f"use fewer --workers, {hint}"
    if (kept := held_bytes(scans)) >= MIB:
        what = f"{what} and {len(scans):,} scans ({-(-kept // MIB)} MiB)"
    check_memory(need + kept, options.memory_budget or 0, what, hint)


def kept_in(given: Path | None, *, wanted: bool) -> Path | None:
    """Where prepared maps are kept: the folder given, else the user's; None for nowhere."""
    if not wanted:
        if given is not None:
            raise ConfigError("--cache and --no-cache: expected one of them")
        return None
    cache_limit()  # nonsense is refused before the work
    try:
        return given or cache_folder()
    except OutputError as error:  # nothing but time is lost
        LOG.warning("%s", error)
        return None


def open_features(
    grid: OccupancyGrid, name: str, folder: Path | None, options: Options,
    *, hint: str = COARSER, scans: Sequence[LaserScan] = (), **parameters: Any,
) -> MapFeatures:  # fmt: skip
    """Prepare a map, with what the cache in `folder` has of it, if :func:`check_answer` lets it."""
    parameters["memory_budget"] = options.memory_budget
    features = prepare(grid, name, **parameters)
    check_answer(features, options, name, hint=hint, scans=scans)
    return features if folder is None else load_features(grid, folder, parameters)


def site_makers(
    path: Path, options: Options, folder: Path | None, reading: Reading, *, allow_lossy: bool
) -> dict[str, Callable[[], Site]]:
    """What makes each map of a folder, or the one at `path`, by its name.

    One map is loaded here, so that what is wrong with it is said at once; those of a folder when
    they are made.
    """
    many = is_folder(path)
    paths = find_maps(path, images=reading.get("resolution") is not None) if many else [path]
    names = names_of(paths, path) if many else [path.stem]

    def grid_at(at: Path) -> OccupancyGrid:
        how = reading_of(at, reading) if many else reading
        return load_grid(at, options.memory_budget or 0, allow_lossy=allow_lossy, **how)

    def made(at: Path, grid: OccupancyGrid | None) -> Site:
        grid = grid_at(at) if grid is None else grid
        features = open_features(grid, display(at), folder, options, threads=options.threads)
        return Site(features, *load_calibrations(calibration_path(at), grid))

    grids = [None if many else grid_at(at) for at in paths]
    return {
        name: partial(made, at, grid) for name, at, grid in zip(names, paths, grids, strict=True)
    }


def keep_features(features: MapFeatures, folder: Path | None) -> None:
    """Keep in the cache what has been computed of a map and is not there yet."""
    if folder is not None and save_features(features, folder):
        LOG.info("kept the prepared map in %s", folder)


def prior_of(known: Known, grid: OccupancyGrid, *, allow_lossy: bool = False) -> Prior:
    """Make the prior of a map; its region may be a JPEG if the map may."""
    prior = priors.Known(known.near, known.heading, known.clearance).prior(grid)
    if known.region is not None:
        cells = _region(known.region, grid, allow_lossy)
        prior &= Prior(cells, None, {"region": {"cells": int(cells.sum())}})
    return prior


def check_prior(known: Known, features: MapFeatures, options: Options) -> None:
    """Refuse a prior without a cell in which a sensor can be, by the option that leaves none."""
    if not priors.leaves_none(options.prior, features):
        return
    near: tuple[float, ...] = known.near or ()
    near = near[:3] if near[3:] == (RADIUS, TOLERANCE) else near
    said = {
        "--near": ",".join(f"{value:g}" for value in near),
        "--region": known.region and display(known.region),
        "--clearance": known.clearance and f"{known.clearance:g}",
    }
    given = " with ".join(f"{option} {value}" for option, value in said.items() if value)
    grid = features.grid
    height, width = grid.occupied.shape
    about = f"{width * grid.resolution:.1f} x {height * grid.resolution:.1f} m"
    corner = f"lower-left corner at {grid.origin.x:g},{grid.origin.y:g}"
    raise ConfigError(
        f"{given}: the prior leaves no cell in which a sensor can be; the map has {about}, its "
        f"{corner}; imgloc map show draws it"
    )


def _region(path: Path, grid: OccupancyGrid, allow_lossy: bool) -> BoolArray:
    """The white pixels of an image that are not transparent, row 0 lowest."""
    size = image_size(path)[:2]  # of which there is memory enough if it is that of the map
    if size[::-1] != grid.occupied.shape:
        height, width = grid.occupied.shape
        raise ConfigError(
            f"{display(path)}: {size[0]} x {size[1]} pixels, expected {width} x {height} as the map"
        )
    read = read_image(path, allow_lossy=allow_lossy)
    # The darkest channel decides, alpha being one of them: neither colour nor nothing is white.
    cells: BoolArray = np.atleast_3d(read.pixels).min(axis=2)[::-1] > read.white // 2
    if not cells.any():
        raise ConfigError(f"{display(path)}: no white pixel, expected white where the robot may be")
    return cells
