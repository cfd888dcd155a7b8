"""An atlas
========

Where is one scan enough? Simulated from a raster of places, answered, drawn by verdict."""

from imgloc import Options, Picture, Sensor, load_map
from imgloc.io.maps import bundled_maps
from imgloc.lab.atlas import TOP, atlas_poses, simulate_at, survey
from imgloc.lab.picture import draw_atlas


def picture() -> Picture:
    """Places three metres apart, two headings each, of a sensor that reaches 6 metres."""
    grid = load_map(bundled_maps() / "visibility.yaml")
    poses = atlas_poses(grid, 3.0, 2, 0.3)
    scans = simulate_at(grid, poses, Sensor(rays=91, range_max=6.0), 0, None)
    spots = list(survey(grid, scans, Options(top=TOP, threads=1), workers=1))
    return draw_atlas(grid, spots, step=3.0, headings=2)
