"""Your own map maker
==================

A map maker of your own: rays of scans with known poses, counted, are a map to localize in."""

import cv2
import numpy as np

from imgloc import OccupancyGrid, Picture, Pose2D, draw, load_map, localize, prepare, simulate
from imgloc.features.scanpoints import scan_xy
from imgloc.geometry import transform_points
from imgloc.io.maps import bundled_maps


def picture() -> Picture:
    """Sixty scans make the map; a sixty-first is found in it."""
    world = load_map(bundled_maps() / "curved.yaml")
    scans = simulate(world, 61, seed=1)
    assert scans.poses is not None
    height, width = world.occupied.shape
    passed, hit = np.zeros((height, width), np.uint8), np.zeros((height, width), np.uint8)
    for scan, pose in zip(scans.scans[:60], scans.poses, strict=False):
        ends = transform_points(Pose2D(*pose), scan_xy(scan)[scan.valid])
        cells = np.floor(ends / world.resolution).astype(int)
        start = np.floor(pose[:2] / world.resolution).astype(int).tolist()
        for cell in cells.tolist():
            cv2.line(passed, start, cell, 1)
        x, y = np.clip(cells.T, 0, [[width - 1], [height - 1]])
        hit[y, x] = 1
    grid = OccupancyGrid(hit > 0, (passed > 0) & (hit == 0), world.resolution)
    features = prepare(grid)
    return draw(features, localize(features, scans[60]), scans[60], truth=Pose2D(*scans.poses[60]))
