"""Several lasers on one robot: the scans of all in the order of time, each with its own name.

They are never joined to one scan: what a reading passed through depends on where it started.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from imgloc.errors import ScanError
from imgloc.io.scanset import ScanSet
from imgloc.model import FloatArray


def lasers_of(topic: str) -> list[str]:
    """The names in a list with commas.

    Examples
    --------
    >>> lasers_of("/front, /rear"), lasers_of("/scan")
    (['/front', '/rear'], ['/scan'])
    """
    return [word for word in map(str.strip, topic.split(",")) if word]


def scan_topics(lasers: Iterable[str]) -> dict[str, str]:
    """A topic of ROS for each of some lasers; the only one has /scan.

    Examples
    --------
    >>> scan_topics(["/front/scan", "/front/scan"])
    {'/front/scan': '/scan'}
    >>> scan_topics(["/front/scan", "1"])
    {'/front/scan': '/front/scan', '1': '/laser_1/scan'}
    """
    names = list(dict.fromkeys(lasers)) or [""]
    if len(names) == 1:
        return {names[0]: "/scan"}
    return {name: name if name[:1] == "/" else f"/laser_{name}/scan" for name in names}


def frame_of(topic: str) -> str:
    """The frame of the laser of a topic."""
    return topic.strip("/").replace("/", "_")


def together(sets: Mapping[str, ScanSet], name: str) -> ScanSet:
    """The scans of several lasers as one set, in the order of their stamps.

    Poses are kept if all have them. Odometry is NaN where a laser has none.

    Parameters
    ----------
    sets : mapping
        Scans by the name of their laser.
    name : str
        Name of the file, for messages.

    Raises
    ------
    ScanError
        If a laser has no stamps, or no known place on the robot, or is named twice.
    """
    for laser, scans in sets.items():
        if scans.stamps is None or not np.isfinite(scans.stamps).all():
            raise ScanError(
                f"{name}: {laser}: no stamps, expected a stamp for each scan of several lasers"
            )
        if any(scan.T_base_laser is None for scan in scans.scans):
            where = "expected a transform from the robot's base to each laser"
            raise ScanError(f"{name}: {laser}: no place on the robot, {where}")
    named = {laser: scans.recording.taken or laser for laser, scans in sets.items()}
    if len(set(named.values())) < len(named):
        raise ScanError(f"{name}: got {', '.join(named)}, expected each laser once")
    every = list(sets.values())
    robots = list(dict.fromkeys(s.recording.odometry for s in every if s.recording.odometry))
    if len(robots) > 1:
        what = f"are on several robots, by their odometry: {', '.join(robots)}"
        raise ScanError(f"{name}: {', '.join(sets)} {what}; expected lasers of one, or `odom`")
    stamps = np.concatenate([s.stamps for s in every if s.stamps is not None])
    order = np.argsort(stamps, kind="stable")
    joined = [replace(scan, laser=named[laser]) for laser, s in sets.items() for scan in s.scans]
    return ScanSet(
        tuple(joined[k] for k in order),
        None if any(s.poses is None for s in every) else _each(every, "poses")[order],
        stamps[order],
        None if all(s.odom is None for s in every) else _each(every, "odom")[order],
        every[0].recording,
    )


def _each(sets: Sequence[ScanSet], key: str) -> FloatArray:
    """Poses (N, 3) of all scans, NaN where those of a laser are not known."""
    parts = [(len(scans), getattr(scans, key)) for scans in sets]
    return np.concatenate([np.full((n, 3), np.nan) if at is None else at for n, at in parts])
