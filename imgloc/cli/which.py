"""`imgloc which`: which of the maps in a folder a scan is from."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imgloc.cli.console import LOG, emit, progress, say
from imgloc.cli.options import (
    AllowLossy,
    AsJson,
    Flipped,
    MemoryBudget,
    ScansPath,
    Threads,
    console,
    count_threads,
    cut_scan,
    with_options,
)
from imgloc.cli.values import check_range
from imgloc.errors import ConfigError, MapError

if TYPE_CHECKING:
    from imgloc.model import Localization
    from imgloc.which import Choice

FAILED_ROWS = 5
_LISTED = 3
_NO_MAP = ("none", "undecided", "invalid")  # verdicts
_HEADER = f"{'index':>6}  {'verdict':<24} {'probability':>11} {'none':>7}  pose or next best"


@with_options(console)
def which(
    maps_dir: Annotated[
        Path,
        typer.Argument(metavar="MAPS_DIR", help="Folder with map_server YAML files, at any depth."),
    ],
    scans_path: ScansPath,
    range_max: Annotated[
        float | None,
        typer.Option(metavar="M", help="Cut readings at M metres: there, no return."),
    ] = None,
    flipped: Flipped = False,
    sure: Annotated[
        float, typer.Option(metavar="P", help="Probability that a map needs to be named.")
    ] = 0.5,
    as_json: AsJson = False,
    threads: Threads = None,
    memory_budget: MemoryBudget = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Prepare the maps anew and keep nothing.")
    ] = False,
    allow_lossy: AllowLossy = False,
) -> None:
    """Say which of the maps in a folder each scan is from: one of them, none, or undecided.

    The scan is located in every map. Evidence is the likelihood averaged over all poses of a map,
    so that a large map does not win by having more places. It is from none if it fits badly, or,
    asked of three maps or more, if the best fits hardly better than the third best does by chance.
    Of fewer than five maps, one is named only if the scan has a unique place in it.
    A scan with too few readings is invalid. A map that cannot be used is reported and left out;
    the exit code is then 5.
    """
    check_range("--range-max", range_max, 1e-3, 1e6, "metres")
    check_range("--sure", sure, 0.5, 1, "a probability")

    import cv2

    from imgloc.cli.budgets import fixed_budget
    from imgloc.cli.loading import load_grid, load_set
    from imgloc.cli.prepared import cache_folder, keep_features, open_features
    from imgloc.io.files import display
    from imgloc.options import Options
    from imgloc.pipeline import check_options
    from imgloc.which import choose, fit

    workers = count_threads(threads)
    memory_budget = fixed_budget(memory_budget)
    cv2.setNumThreads(workers)
    paths = find_maps(maps_dir)
    recorded = load_set(scans_path, memory_budget).scans
    scans = [cut_scan(scan, range_max, flipped=flipped) for scan in recorded]
    options = Options(top=20, threads=workers, memory_budget=memory_budget)
    folder = cache_folder(None, wanted=not no_cache)
    fits: list[dict[str, Localization]] = [{} for _ in scans]
    names, failed = names_of(paths, maps_dir), list[MapError | ConfigError]()
    with progress("which", len(paths) * len(scans), lines=False) as advance:
        for path, name in zip(paths, names, strict=True):
            try:
                grid = load_grid(path, memory_budget, allow_lossy=allow_lossy)
                features = open_features(
                    grid, display(path), folder, options,
                    hint="crop the map", scans=scans, threads=workers,
                )  # fmt: skip
                check_options(features, options)
            except (MapError, ConfigError) as error:
                say(f"left out: {error}")
                failed.append(error)
                continue
            for scan, found in zip(scans, fits, strict=True):
                found[name] = fit(features, scan, options)
                advance()
            if folder is not None:
                keep_features(features, folder)
            del features  # before the next map's are loaded
            LOG.info("%s: %d scans located", display(path), len(scans))
    if len(failed) == len(paths):
        # Too little memory is no fault of the maps.
        kind = MapError if any(isinstance(e, MapError) for e in failed) else ConfigError
        raise kind(f"{display(maps_dir)}: none of its {len(failed)} maps can be used")
    if not as_json:
        emit(_HEADER)
    for k, found in enumerate(fits):
        choice = choose(found, options.trust, sure=sure)
        emit(_as_json(k, choice, found) if as_json else _as_line(k, choice, found))
    if failed:
        raise typer.Exit(FAILED_ROWS)


def find_maps(folder: Path) -> list[Path]:
    """YAML files of maps in a folder and below, in order of their names.

    Raises
    ------
    ConfigError
        If it is no folder, or holds none.
    """
    from imgloc.io.files import display

    if not folder.is_dir():
        raise ConfigError(f"{display(folder)}: expected a folder of maps")
    paths = sorted({*folder.rglob("*.yaml"), *folder.rglob("*.yml")})
    if not paths:
        raise ConfigError(f"{display(folder)}: no map, expected map_server YAML files (*.yaml)")
    return paths


def names_of(paths: Iterable[Path], folder: Path) -> list[str]:
    """Names of maps in a folder, each other than all others and than the verdicts without a map.

    Examples
    --------
    >>> names_of([Path("a/attic.yaml"), Path("a/cellar/map.yaml")], Path("a"))
    ['attic', 'cellar']
    >>> names_of([Path("a/b.yaml"), Path("a/b/map.yaml"), Path("a/none.yaml")], Path("a"))
    ['b.yaml', 'b/map.yaml', 'none.yaml']
    """
    full = [path.relative_to(folder) for path in paths]
    short = [
        path.parent if path.stem == "map" and path.parent != Path() else path.with_suffix("")
        for path in full
    ]
    taken = Counter([*(name.as_posix() for name in short), *_NO_MAP])
    names = [
        (path if taken[name.as_posix()] > 1 else name).as_posix()
        for path, name in zip(full, short, strict=True)
    ]
    return names if len(set(names)) == len(names) else [path.as_posix() for path in full]


def _as_json(index: int, choice: "Choice", fits: "dict[str, Localization]") -> str:
    """One line of JSON: the verdict, and each map with its pose in it."""
    from imgloc.cli.answers import as_pose, to_json

    return to_json(
        {
            "index": index,
            "verdict": choice.verdict,
            "none": choice.none,
            "temperature": choice.temperature,
            "maps": [
                {
                    "map": name,
                    "probability": share,
                    "log_evidence": choice.log_evidence.get(name),
                    "misfit": fits[name].evidence.misfit,
                    "verdict": fits[name].verdict,
                    "pose": as_pose(fits[name].pose),
                    "explained": fits[name].explained,
                }
                for name, share in choice.probability.items()
            ],
        }
    )


def _as_line(index: int, choice: "Choice", fits: "dict[str, Localization]") -> str:
    """One line of text: the pose in the map that is named, else the candidates."""
    from imgloc.cli.answers import describe

    if choice.verdict == "invalid":
        return f"{index:>6}  {choice.verdict:<24} {'-':>11} {'-':>7}  too few readings"
    name = next(iter(choice.probability))
    pose = fits[name].pose
    if choice.verdict == name and pose is not None:
        more = f"{describe(pose)} ({fits[name].verdict})"
    else:
        some = list(choice.probability.items())[:_LISTED]
        more = ", ".join(f"{other} {100 * share:.1f} %" for other, share in some)
    return (
        f"{index:>6}  {choice.verdict:<24} {100 * choice.probability[name]:9.1f} % "
        f"{100 * choice.none:5.1f} %  {more}"
    )
