"""What the tests of batches share: a small site, a quick job, a run of it in this process."""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from places import room_with_a_post

from imgloc import Options, ScanSet, Sensor, make_job, run_batch, save_map, save_scans, simulate
from imgloc.runs.results import RESULTS, read_rows

QUICK = make_job(options=Options(method="cbml", top=2), cell=0.2)


def site_in(folder: Path) -> Path:
    """The folder, with a small map, and six files with a scan each."""
    (folder / "floors").mkdir()
    (folder / "scans").mkdir()
    grid = room_with_a_post()
    save_map(folder / "floors" / "post.yaml", grid)
    scans = simulate(grid, 40, 1, Sensor(rays=60, fov=6.0, range_max=9.0))
    save_scans(folder / "all.npz", scans)
    for k in range(6):
        one = ScanSet(scans.scans[k : k + 1], poses=scans.poses[k : k + 1])
        save_scans(folder / "scans" / f"s{k}.npz", one)
    return folder


def timeless(folder: Path) -> list[str]:
    """Rows in order, without what two runs do not share."""
    found = [json.dumps({**row, "cost": None}) for row in read_rows(folder)]
    assert len(found) == len((folder / RESULTS).read_bytes().splitlines())
    return sorted(found)


def in_threads(site: Path, out: Path, **more):
    """A run in this process: quick, and through the same seam."""
    with ThreadPoolExecutor(1) as pool:
        return run_batch(site / "floors", site / "scans", out, QUICK, executor=pool, **more)
