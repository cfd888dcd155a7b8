"""A likelihood as images
======================

A likelihood is a stack of images, (theta, y, x): any operation on images is one on it."""

import numpy as np

from imgloc import Picture, likelihood, load_map, prepare, simulate
from imgloc.io.maps import bundled_maps
from imgloc.output.canvas import sheet, wheel
from imgloc.output.plots import Bar, framed


def picture() -> Picture:
    """Colour is the best heading at each place, strength is how likely it is."""
    grid = load_map(bundled_maps() / "visibility.yaml")
    features, scan = prepare(grid, cell=0.2), simulate(grid, 1, seed=2)[0]
    stack = likelihood(features, scan, "ght-v")
    best = stack.values.max(axis=0)
    heading = stack.thetas[stack.values.argmax(axis=0)]
    strength = np.sqrt(best / max(float(best.max()), 1e-12))
    canvas = sheet(wheel(heading, strength), stack.grid)
    turns = wheel(np.linspace(-np.pi, np.pi, 73)[None], np.ones((1, 73)))
    bar = Bar(turns, -180, 180, 90, "heading, degrees")
    return framed(canvas, grid.origin, "The best heading of each place", bar=bar)
