"""Scans of a finished batch, at the poses that it found: nothing is located again."""

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from imgloc.errors import ConfigError, ImglocError, OutputError, ScanError
from imgloc.features.floor import as_located
from imgloc.features.scanpoints import evenly
from imgloc.io.contents import content_hash, files_of
from imgloc.io.files import display, is_folder, reason
from imgloc.io.maps import reading_of
from imgloc.io.scans import has_topics
from imgloc.lab.located import Once, Placed
from imgloc.model import Pose2D
from imgloc.options import Chosen, Reading
from imgloc.runs.batch import find_items
from imgloc.runs.hints import evidence_of
from imgloc.runs.localize import Localize
from imgloc.runs.opening import Desk, MapFiles, ScanFiles
from imgloc.runs.results import RUN, Id, Row, id_of, read_rows, read_run

_AGAIN = "run imgloc batch again with `resume=True`"
_NAMED = 3  # maps of a batch that an error names


def is_batch(path: Path) -> bool:
    """Whether a path is a folder, but not that of a recording: only a batch may have made it."""
    try:
        return is_folder(path) and not has_topics(path)
    except ScanError:
        return True


def read_batch(
    folder: Path,
    map_path: Path,
    job: Localize,
    desk: Desk,
    most: int,
    once: Once,
) -> list[Placed]:
    """Read the scans that a batch has located in one map, file by file, with their poses.

    Parameters
    ----------
    folder : path
        Folder of results of a batch with the job ``localize``.
    map_path : path
        The map. It must be as it was for the batch: its YAML, image and calibration.
    job : Localize
        How its image is read, and which scans of each file are taken, if the batch has located
        them.
    desk : Desk
        What reads the scans. It reads them as the batch has read them.
    most : int
        At most so many scans of each file are taken, evenly spread, unless they are chosen.
    once : Once
        Leaves out the scans that a file before had.

    Returns
    -------
    list of Placed
        One for each file of scans, in the order of the rows.

    Raises
    ------
    ConfigError
        If the folder is of another job, has no results of this map, or of this map read in another
        way, or is no folder of a batch; if a file of scans has changed since, or is not there.
    OutputError
        If it is damaged.
    """
    name, run = display(folder), read_run(folder)
    if run["job"] != Localize.name:
        raise ConfigError(f"{name}: a batch of the job {run['job']}, expected {Localize.name}")
    here, rows, others = content_hash(files_of(map_path)), list[Row](), dict[str, None]()
    for row in read_rows(folder):
        if row.get("hashes", {}).get("map") == here:
            rows.append(row)
        else:
            others[row["map"]] = None
    if not rows:
        there = ", ".join([*others][:_NAMED]) + (" ..." if len(others) > _NAMED else "")
        raise ConfigError(
            f"{name}: a batch of {there or 'no map'}, expected one of {display(map_path)}; if "
            f"this map or its calibration has changed since, {_AGAIN}"
        )
    paths, found = _paths_of(folder, run, job.maps), list[Placed]()
    wanted = reading_of(map_path, job.parameters["maps"]["reading"])
    for row in rows:
        reading, files = _as_read(folder, run, row)
        if (used := reading_of(map_path, reading)) != wanted:
            raise ConfigError(
                f"{name}: the batch has read {display(map_path)} with {_words(used)}, expected "
                f"the same here, got {_words(wanted)}"
            )
        path = paths.get(id_of(row))
        if path is None or content_hash([path]) != row["hashes"]["scans"]:
            raise ConfigError(
                f"{name}: {row['scans']}: the file is not there, or not as the batch has read it; "
                f"{_AGAIN}"
            )
        found.append(_batched(desk, path, replace(files, chosen=job.scans.chosen), row, most, once))
    return found


def _batched(desk: Desk, path: Path, files: ScanFiles, row: Row, most: int, once: Once) -> Placed:
    """The scans of a row's file, with the poses of that row."""
    taken = desk.scans(path, files)
    by = {answer["index"]: answer for answer in row["answers"]}
    pairs = zip(taken.indices, taken.scans.scans, strict=True)
    some = [(scan, by[k]) for k, scan in pairs if k in by]
    if files.chosen == Chosen():
        some = [some[k] for k in evenly(len(some), most).tolist()]
    some = [some[k] for k in once.new([scan for scan, _ in some], taken.name)]
    sure = [
        (scan, answer)
        for scan, answer in some
        if answer["verdict"] == "unique" and answer["complete"] and answer["hypotheses"]
    ]
    best = [answer["hypotheses"][0] for _, answer in sure]
    return Placed(
        len(some),
        tuple(as_located(scan, evidence_of(answer["evidence"])) for scan, answer in sure),
        np.array([(p["x"], p["y"], p["theta"]) for p in best], np.float64).reshape(-1, 3),
    )


def _paths_of(folder: Path, run: Row, maps: MapFiles) -> dict[Id, Path | None]:
    """The files of scans of a batch, by what its rows call map and file."""
    try:
        items = find_items(run["maps"], run["scans"], Localize(maps=maps), out=folder)
    except ImglocError as e:
        raise ConfigError(
            f"{display(folder)}: its maps and scans are not found: {reason(e)}; expected the "
            "working folder in which imgloc batch ran"
        ) from None
    return {item.id: item.scans_path for item in items}


def _as_read(folder: Path, run: Row, row: Row) -> tuple[Reading, ScanFiles]:
    """How a batch has read the map and the scans of a row."""
    try:
        used = run["parameters"][row["hashes"]["parameters"]]
        said = {**used["scans"], "chosen": Chosen()}
        if said["height"] is not None:
            said["height"] = tuple(said["height"])
        if said["mount"] is not None:
            said["mount"] = Pose2D(**said["mount"])
        return cast(Reading, dict(used["maps"]["reading"])), ScanFiles(**said)
    except (KeyError, TypeError, ValueError, ConfigError):
        raise OutputError(
            f"{display(folder)}: {RUN} does not state how the scans of {row['scans']} were read; "
            "restore the file"
        ) from None


def _words(reading: Reading) -> str:
    return ", ".join(f"{key} {value}" for key, value in reading.items()) or "no option"
