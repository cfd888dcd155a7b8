"""Every kind of picture
=====================

A contact sheet: one picture of each kind that the commands and the library draw."""

import cv2
import numpy as np

from imgloc import OccupancyGrid, Picture, draw, likelihood, load_map, localize, prepare, simulate
from imgloc.answers.logcheck import check_log
from imgloc.io.maps import bundled_maps
from imgloc.lab.align import align_maps
from imgloc.lab.aligned import draw_alignment
from imgloc.lab.changes import map_changes
from imgloc.lab.picture import draw_changes
from imgloc.output.features import SUBJECTS
from imgloc.output.inspection import draw_log
from imgloc.output.pictures import mosaic
from tools.drive import draw_drive, drive
from tools.gallery import atlas


def picture() -> Picture:
    """A map, what is computed from it, answers, a log, a track, and what was measured."""
    grid = load_map(bundled_maps() / "visibility.yaml")
    features, scans = prepare(grid), simulate(grid, 40, 5)
    assert scans.poses is not None
    walls = grid.occupied.copy()
    walls[40:44, 40:60] = True
    older = OccupancyGrid(walls, grid.free & ~walls, grid.resolution, grid.origin)
    kinds = [draw(features, what=what) for what in SUBJECTS]
    kinds += [draw(grid, likelihood(features, scans[1], name)) for name in ("ght-v", "cbml")]
    kinds += [draw(grid, localize(features, scans[1]), scans[1]), atlas.picture()]
    kinds.append(draw_alignment(grid, older, align_maps(grid, older)))
    kinds.append(draw_changes(map_changes(older, scans.scans, scans.poses)))
    rows = mosaic([_wide(kind, 600) for kind in kinds], columns=3)
    long = (draw_log("a log", check_log(scans), scans[1]), draw_drive(drive()))
    return mosaic([rows, *(_wide(kind, 1800) for kind in long)], columns=1)


def _wide(picture: Picture, width: int) -> Picture:
    scale = width / picture.image.shape[1]
    return Picture(np.asarray(cv2.resize(picture.image, None, None, scale, scale, cv2.INTER_AREA)))
