"""Files of scans: those that were recorded in a map, with the true pose of each; one a scan."""

from dataclasses import replace
from pathlib import Path

from imgloc.errors import ConfigError
from imgloc.io.files import display
from imgloc.io.scans import load_scans, save_scans
from imgloc.io.scanset import ScanSet
from imgloc.simulation import sample_set


def scans_beside(path: Path, n: int, seed: int, range_max: float) -> ScanSet:
    """Pick `n` scans of the file ``scans.npz`` beside a map, as a shorter reach would have them.

    See :func:`imgloc.simulation.sample_set`; all if there are fewer.

    Raises
    ------
    ScanError
        If there is no such file, it is no set of scans, or they have no poses.
    ConfigError
        If `n` is less than 1 or the reach not positive.
    """
    if n < 1:
        raise ConfigError(f"n must be at least 1, got {n}")
    file = path.with_name("scans.npz")
    return cut_set(sample_set(load_scans(file), n, seed, display(file)), range_max)


def save_each(folder: Path, scans: ScanSet) -> None:
    """Make a folder with a file of each scan, and of its pose if that is known."""
    folder.mkdir()
    for k, scan in enumerate(scans.scans):
        poses = None if scans.poses is None else scans.poses[k : k + 1]
        save_scans(folder / f"{k:04d}.npz", ScanSet((scan,), poses=poses))


def cut_set(scans: ScanSet, range_max: float) -> ScanSet:
    """The scans as a sensor of a shorter reach, metres, would have recorded them."""
    if not range_max > 0:
        raise ConfigError(f"the reach must be positive, got {range_max:g} m")
    cut = (replace(s, range_max=min(s.range_max, range_max)) for s in scans.scans)
    return replace(scans, scans=tuple(cut))
