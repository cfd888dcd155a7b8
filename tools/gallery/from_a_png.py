"""A map from a PNG
================

A map from a drawing program: black walls on white, no YAML, just a resolution."""

from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

import imgloc


def picture() -> imgloc.Picture:
    """Draw a flat, save it as PNG, and find a scan of it."""
    sheet = np.full((160, 240), 255, np.uint8)
    for x, y, x1, y1 in ((5, 5, 234, 154), (5, 60, 90, 62), (120, 5, 122, 90), (160, 90, 234, 92)):
        cv2.rectangle(sheet, (x, y), (x1, y1), 0, 2)
    with TemporaryDirectory() as folder:
        file = Path(folder, "flat.png")
        file.write_bytes(cv2.imencode(".png", sheet)[1].tobytes())
        grid = imgloc.load_map(file, resolution=0.05)
    scans = imgloc.simulate(grid, 1, seed=3)
    features = imgloc.prepare(grid)
    return imgloc.draw(features, imgloc.localize(features, scans[0]), scans[0])
