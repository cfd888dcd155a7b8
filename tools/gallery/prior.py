"""What is known beforehand
========================

A corridor repeats itself: one scan fits many places, until it is known roughly where it was."""

import math

from imgloc import Options, Pose2D, Prior, Sensor, draw, load_map, localize, prepare, simulate
from imgloc.geometry import in_grid_frame
from imgloc.io.maps import bundled_maps
from imgloc.output.canvas import Picture
from imgloc.output.pictures import mosaic
from imgloc.search.priors import near


def picture() -> Picture:
    """The same scan with nothing known, and known to be within 2 m and 45 degrees of a place."""
    grid = load_map(bundled_maps() / "corridor.yaml")
    features, scans = prepare(grid), simulate(grid, 8, 4, Sensor(range_max=4.0))
    assert scans.poses is not None
    scan, at = scans[2], in_grid_frame(Pose2D(*scans.poses[2]), grid)
    place = Prior(near(grid.info, at.x, at.y, 2.0), (at.theta, math.radians(45)))
    sheets = []
    for title, prior in (("nothing known", Prior()), ("roughly where", place)):
        answer = localize(features, scan, Options(prior=prior))
        sheets.append(draw(features, answer, scan, title=title))
    return mosaic(sheets, columns=1)
