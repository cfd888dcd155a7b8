"""Files of the commands: the desk that reads them, targets that they write, known poses.

This loads all of imgloc: a command imports it when it runs.
"""

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from imgloc.cli.console import LOG, progress
from imgloc.cli.options import Kept, MapImages
from imgloc.doors import behind
from imgloc.errors import ConfigError, OutputError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.cache import cache_folder, cache_limit
from imgloc.io.calibration import calibration_path, load_calibrations
from imgloc.io.contents import files_of as files_of
from imgloc.io.files import display, is_folder, refuse_existing
from imgloc.io.folders import find_maps
from imgloc.model import LaserScan, OccupancyGrid, Pose2D, compose
from imgloc.options import RADIUS, TOLERANCE, Chosen, Known, Logs, Mounting, Options, Shared
from imgloc.runs.jobs import Item
from imgloc.runs.opening import Desk, MapFiles, ScanFiles
from imgloc.runs.opening import held_bytes as held_bytes
from imgloc.runs.opening import name_of as name_of
from imgloc.runs.opening import quiet_libraries as quiet_libraries
from imgloc.search import priors

if TYPE_CHECKING:
    from imgloc.answers.causes import Cause
    from imgloc.filters.follow import Moment
    from imgloc.io.scanset import ScanSet
    from imgloc.live.sites import Site


def desk_of(threads: int, memory_budget: int, cache: Path | None = None) -> Desk:
    """The desk of a command."""
    return Desk(threads, memory_budget, cache, progress=progress)


def map_files(reading: MapImages = MapImages(), *, many: bool = False) -> MapFiles:
    """The way to read the maps of a command; the options of its only map override the YAML."""
    given: Any = dict(reading)
    lossy = given.pop("allow_lossy", False)
    return MapFiles(given, lossy, many)


def maps_in(folder: Path, reading: MapImages) -> dict[str, Path]:
    """The maps of a folder tree by their names; with a resolution images without a YAML, too."""
    from imgloc.choice.choose import names_of

    found = find_maps(folder, images=reading.get("resolution") is not None)
    return dict(zip(names_of(found, folder), found, strict=True))


def as_recorded(
    logs: Logs = Logs(), chosen: Chosen = Chosen(), mounting: Mounting = Mounting(),
    *, many: bool = False,
) -> ScanFiles:  # fmt: skip
    """The way in which the scans of a command are read."""
    flipped, mount = mounting.flipped, mounting.sensor
    return ScanFiles(**vars(logs), chosen=chosen, flipped=flipped, mount=mount, many=many)


def item_of(map_path: Path, scans: Path | None = None) -> Item:
    """One map, and a file of scans or none."""
    where = display(map_path)
    said = None if scans is None else name_of(scans)
    return Item(where, said, ((where, map_path),), scans)


def check_target(
    path: Path | None, ending: str | tuple[str, ...], *, force: bool, inputs: Iterable[Path] = ()
) -> None:
    """Refuse an output file before the work that it is to hold: one without the `ending`, or there.

    If several endings are given, one of them is expected.

    With `force` one that is there may be replaced, but for `inputs`, which the command reads. None,
    an option that was not given, passes.
    """
    if path is None:
        return
    endings = (ending,) if isinstance(ending, str) else ending
    if path.suffix.lower() not in endings:
        raise ConfigError(f"{display(path)}: expected a name that ends in {' or '.join(endings)}")
    if not is_folder(path.parent):
        raise OutputError(f"{display(path)}: there is no folder {display(path.parent)}")
    for source in inputs:  # first: no hint of --force where it does not help
        with contextlib.suppress(OSError):
            if path.samefile(source):
                raise OutputError(
                    f"{display(path)}: is read by this command and will not be overwritten, not "
                    "even with --force; expected another name"
                )
    if not force:
        refuse_existing(path)


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


def targets(
    path: Path | None, ending: str, numbers: Sequence[int], *, force: bool,
    inputs: Iterable[Path] = (),
) -> dict[int, Path]:  # fmt: skip
    """The files of some scans, see :func:`numbered`, each of which :func:`check_target` lets be."""
    files, read = numbered(path, numbers), list(inputs)
    for file in files.values():
        check_target(file, ending, force=force, inputs=read)
    return files


def kept_in(kept: Kept) -> Path | None:
    """Where prepared maps are kept: the folder given, else the user's; None for nowhere."""
    if kept.no_cache:
        if kept.cache is not None:
            raise ConfigError("--cache and --no-cache: expected one of them")
        return None
    cache_limit()  # nonsense is refused before the work
    try:
        return kept.cache or cache_folder()
    except OutputError as error:  # nothing but time is lost
        LOG.warning("%s", error)
        return None


def check_prior(known: Known, region: Path | None, features: MapFeatures, options: Options) -> None:
    """Refuse a prior without a cell in which a sensor can be, by the option that leaves none."""
    if not priors.leaves_none(options.prior, features):
        return
    near: tuple[float, ...] = known.near or ()
    near = near[:3] if near[3:] == (RADIUS, TOLERANCE) else near
    said = {
        "--near": ",".join(f"{value:g}" for value in near),
        "--region": region and display(region),
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


def aged(
    grid: OccupancyGrid, sure: Sequence[tuple[LaserScan, Pose2D]], shared: Shared
) -> "Cause | None":
    """The cause that a map is old or of another place, by scans of sensors at sure poses; or None.

    Rays also pass walls that others drew too thick, so nothing is said of such a map, and of walls
    that seem bent only that they are of another place.
    """
    if shared.thinner:
        return None
    scans = [scan for scan, _ in sure]
    poses = np.array([(p.x, p.y, p.theta) for _, p in sure]).reshape(-1, 3)
    found: Cause | None = behind("aging_hint")(grid, scans, poses)
    return found if found is None or found.serious or not shared.bent else None


def aged_along(
    grid: OccupancyGrid, scans: "ScanSet", moments: "Sequence[Moment]", shared: Shared
) -> "Cause | None":
    """The same, by the scans along a way whose poses were unique.

    Scans of a log that is still being written are not kept.
    """
    seen = ((scans[m.index], m.pose) for m in moments if m.pose is not None and len(scans))
    return aged(grid, [
        (scan.scaled(shared.scale), compose(pose, scan.mount))
        for scan, pose in seen
    ], shared)  # fmt: skip


def site_makers(
    paths: Mapping[str, Path], maps: MapFiles, options: Options, folder: Path | None
) -> tuple[dict[str, Callable[[], "Site"]], Callable[[str, "Site"], None]]:
    """Makers of the maps, by name, and what keeps a map in the cache once it is made."""
    from imgloc.live.sites import Site  # with the filters, which few commands use

    def made(path: Path) -> Site:
        # A desk keeps its maps, but who serves sites decides how many are kept: one for each.
        desk = desk_of(options.threads, options.memory_budget or 0, folder)
        features = desk.features(path, maps, options)
        return Site(features, *load_calibrations(calibration_path(path), features.grid))

    keep = desk_of(1, 0, folder).keep
    return (
        {name: partial(made, path) for name, path in paths.items()},
        lambda _, site: keep(site.features),
    )
