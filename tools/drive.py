"""A log of a drive through a bundled world, its track, and the README's moving picture of it.

The robot goes from place to place where there is most room, is carried off once, and goes on::

    python -m tools.drive --out tools/track.png --log drive.npz --movie tools/drive.webp
"""

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import PIL.Image
from skimage.graph import route_through_array

from imgloc import Options, Picture, ScanSet, follow, make_filter, prepare, save_scans
from imgloc.filters.motion import noisy_odometry
from imgloc.geometry import centre_of, transform_poses
from imgloc.model import FloatArray, LaserScan, OccupancyGrid
from imgloc.output.canvas import Image
from imgloc.output.tracks import Video, draw_track
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render
from tools.filters import piece
from tools.script import parser_of

_ANGLES = np.deg2rad(np.arange(-90, 90.5, 1.0))
WORLD = "corridor"  #: whose doors repeat
STOPS = (
    ((25.0, 5.0), (31.5, 5.2), (31.5, 6.5), (34.5, 8.2)),
    ((12.0, 5.0), (3.5, 5.0), (3.5, 3.5), (2.5, 1.6)),
)
"""Two drives, in the grid frame, metres; between them the robot is carried."""
_MS, _HELD = 160, 12  # milliseconds of a frame, and frames that the last one stays
_ROOM = 1.0  # metres from a wall beyond which more room is no better


def path_between(grid: OccupancyGrid, stops: FloatArray, step: float) -> FloatArray:
    """Poses (N, 3), map frame, on a way with room through free places (M, 2), `step` metres apart.

    Raises
    ------
    ValueError
        If a place is not free.
    """
    room = cv2.distanceTransform(grid.free.astype(np.uint8), cv2.DIST_L2, 5) * grid.resolution
    cost = np.where(grid.free, 1 + 20 * np.maximum(0, _ROOM - room), 1e6)
    cells = np.floor(stops[:, ::-1] / grid.resolution).astype(int)
    if not grid.free[tuple(cells.T)].all():
        raise ValueError("every stop must be in free space")
    way = [cells[:1].astype(float)]
    for a, b in itertools.pairwise(cells):
        route, _ = route_through_array(cost, a, b, fully_connected=True, geometric=True)
        way.append(np.array(route[1:], dtype=float))
    xy = centre_of(np.concatenate(way).astype(np.int64), grid.resolution)
    kernel = np.hanning(2 * round(0.6 / grid.resolution) + 3)
    pad = len(kernel) // 2
    smooth = [
        np.convolve(np.pad(v, pad, mode="edge"), kernel / kernel.sum(), "valid") for v in xy.T
    ]
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(smooth, axis=1)))))
    at = np.arange(0, along[-1], step)
    x, y = (np.interp(at, along, v) for v in smooth)
    theta = np.arctan2(np.gradient(y), np.gradient(x))
    return transform_poses(grid.origin, np.column_stack((x, y, theta)))


def log_of(poses: FloatArray, seed: int) -> ScanSet:
    """The scans at the poses, a tenth of their readings stopped by people, and odometry."""
    fine = render(WORLDS[WORLD](), 0.02)
    ranges = simulate_ranges(fine, poses, _ANGLES, seed=seed, range_max=8.0, outliers=0.1)
    scans = tuple(LaserScan(r, _ANGLES, range_max=8.0) for r in ranges)
    odom = noisy_odometry(poses, np.random.default_rng(seed))
    return ScanSet(scans, poses, np.arange(0, len(poses) / 2, 0.5, dtype=np.float64), odom)


def drive(seed: int = 1) -> ScanSet:
    """The log of both drives, one after the other."""
    grid = render(WORLDS[WORLD](), 0.1)
    parts = [path_between(grid, np.array(stops), 0.25) for stops in STOPS]
    ends, whole = np.cumsum([0, *map(len, parts)]), log_of(np.concatenate(parts), seed)
    return piece(whole, *(range(a, b) for a, b in itertools.pairwise(ends.tolist())))


def draw_drive(log: ScanSet) -> Picture:
    """The track that the tracker makes of the log."""
    features = prepare(render(WORLDS[WORLD](), 0.1))
    moments = list(follow(features, log, make_filter("tracker", features, Options())))
    return draw_track(features.grid, moments, log.poses)


def frames_of(log: ScanSet) -> list[Image]:
    """The frames of `imgloc track --video`, BGR, as the tracker follows the log."""
    features, frames = prepare(render(WORLDS[WORLD](), 0.1)), list[Image]()
    video = Video(features, title="lost, found, carried off, found again")
    video.close()
    video._writer = cast("Any", SimpleNamespace(write=frames.append, release=lambda: None))
    for moment in follow(features, log, make_filter("tracker", features, Options())):
        video.add(moment, log[moment.index])
    return frames


def write_movie(path: Path, frames: list[Image]) -> None:
    """Write frames as an animated WebP that begins anew."""
    shown = [*frames, *_HELD * frames[-1:]]
    first, *more = (PIL.Image.fromarray(np.ascontiguousarray(f[..., ::-1])) for f in shown)
    first.save(path, save_all=True, append_images=more, duration=_MS, loop=0, quality=60, method=6)


def main() -> None:
    """Make the log, follow it, draw it."""
    parser = parser_of("tools.drive", __doc__, seed=1)
    parser.add_argument("--out", type=Path, required=True, help="PNG to write")
    parser.add_argument("--log", type=Path, help="NPZ to write: for imgloc track")
    parser.add_argument("--movie", type=Path, help="WebP to write: each second scan")
    given = parser.parse_args()
    log = drive(given.seed)
    if given.log is not None:
        save_scans(given.log, log, force=True)
    draw_drive(log).save(given.out, force=True)
    if given.movie is not None:
        write_movie(given.movie, frames_of(log)[::2])


if __name__ == "__main__":
    main()
