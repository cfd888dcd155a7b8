"""Your own score
==============

A score of your own: rank the hypotheses anew by the share of readings within 10 cm of a wall."""

import math
from dataclasses import replace

import numpy as np

from imgloc import MapFeatures, Picture, Pose2D, draw, load_map, localize, prepare, simulate
from imgloc.features.scanpoints import scan_xy
from imgloc.geometry import cell_of, in_grid_frame, inside, transform_points
from imgloc.io.maps import bundled_maps
from imgloc.model import FloatArray


def near_walls(features: MapFeatures, points: FloatArray, pose: Pose2D) -> float:
    """Share of the points (N, 2), sensor frame, that fall within 10 cm of a wall from `pose`."""
    grid = features.grid
    cells = cell_of(transform_points(in_grid_frame(pose, grid), points), grid.resolution)
    there = cells[inside(cells, grid.info)]
    distance = features.walls[there[:, 0], there[:, 1]] * grid.resolution
    return float(np.count_nonzero(distance <= 0.1)) / len(points)


def picture() -> Picture:
    """The answer with masses in proportion to the score."""
    grid = load_map(bundled_maps() / "curved.yaml")
    features, scan = prepare(grid), simulate(grid, 1, seed=9)[0]
    answer = localize(features, scan)
    points = scan_xy(scan)[scan.valid]
    weights = [math.exp(40 * near_walls(features, points, h.pose)) for h in answer.hypotheses]
    ranked = sorted(zip(weights, answer.hypotheses, strict=True), key=lambda pair: -pair[0])
    own = tuple(replace(h, mass=weight / sum(weights)) for weight, h in ranked)
    return draw(features, replace(answer, hypotheses=own), scan)
