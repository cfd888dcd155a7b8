"""What simulating and drawing take is known beforehand: bounds, and not by far."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from command import MAPS, call
from test_features_budget import office, peak

from imgloc.cli.atlas import _scans
from imgloc.cli.maps import Subject, draw_subject
from imgloc.draw.atlas import draw_atlas
from imgloc.draw.canvas import default_scale
from imgloc.experiments.atlas import atlas_poses
from imgloc.experiments.calibrate import disturbed_set
from imgloc.experiments.finegrid import fine_factor, refine_grid
from imgloc.experiments.scansets import Sensor, simulate_set
from imgloc.features.budget import surface_count
from imgloc.features.estimates import POSE_TEXT, check_bytes, picture_bytes, simulate_bytes
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.images import image_size
from imgloc.io.mapcheck import check_map
from imgloc.model import Pose2D

SLACK = 40  # MiB of buffers of a fixed size


@pytest.mark.parametrize(("rooms", "count"), [(2, 2000), (8, 2), (20, 2)])
def test_simulating_takes_no_more_than_estimated(rooms: int, count: int) -> None:
    grid = office(rooms)
    taken = peak(lambda: simulate_set(grid, count, 0, Sensor(rays=91)))
    cells, factor = grid.occupied.size, fine_factor(grid)
    need = simulate_bytes(cells, factor**2 * cells, count * 91)
    assert taken <= need <= 3 * taken


def test_the_fine_image_is_as_large_as_said() -> None:
    grid = office(1)
    factor = fine_factor(grid, 0.02)
    height, width = grid.occupied.shape
    assert factor == 2
    assert refine_grid(grid, 0.02).occupied.shape == (factor * height, factor * width)


@pytest.mark.parametrize("what", list(Subject))
@pytest.mark.parametrize("rooms", [1, 8])
def test_drawing_takes_no_more_than_estimated(what: Subject, rooms: int) -> None:
    grid = office(rooms)
    features = MapFeatures(grid, cell=grid.resolution)
    shape, scale = grid.occupied.shape, default_scale(grid.info)
    taken = peak(lambda: draw_subject(features, what, None))
    need = picture_bytes(
        what.value, shape, scale**2 * grid.occupied.size, points=surface_count(grid)
    )
    assert taken <= need
    assert need <= 3 * taken + (SLACK << 20)


@pytest.mark.parametrize(("step", "rays"), [(0.5, 181), (1.0, 720)])
def test_the_scans_of_an_atlas_take_no_more_than_estimated(step: float, rays: int) -> None:
    grid = office(4, 0.1)
    poses = atlas_poses(grid, step, 4, 0.2)
    taken = peak(lambda: _scans(Path("x"), grid, poses, Sensor(rays=rays), 0))
    cells, factor = grid.occupied.size, fine_factor(grid)
    some = min(len(poses), 1000)
    need = simulate_bytes(cells, factor**2 * cells, some * rays, kept=len(poses) * rays)
    assert taken <= need <= 3 * taken


def test_three_sets_take_no_more_than_estimated() -> None:
    grid = office(4, 0.1)
    taken = peak(lambda: disturbed_set(grid, 100, 0, Sensor(rays=3000)))
    cells, factor = grid.occupied.size, fine_factor(grid)
    need = simulate_bytes(cells, factor**2 * cells, 300_000, kept=3 * 300_000)
    assert taken <= need <= 3 * taken


@pytest.mark.parametrize(("rooms", "step"), [(4, 0.5), (12, 3.0)])
def test_drawing_an_atlas_takes_no_more_than_estimated(rooms: int, step: float) -> None:
    grid = office(rooms, 0.1)
    poses = [Pose2D(*pose) for pose in atlas_poses(grid, step, 4, 0.2)]
    kinds, twins = ["ambiguous"] * len(poses), [Pose2D(1.0, 1.0)] * len(poses)
    taken = peak(lambda: draw_atlas(grid, poses, kinds, twins, step=step, headings=4))
    shape, scale = grid.occupied.shape, default_scale(grid.info)
    need = picture_bytes("map", shape, scale**2 * grid.occupied.size, marks=len(poses))
    assert taken <= need <= 3 * taken


@pytest.mark.parametrize("name", ["a.png", "b.png", "c.png", "d.pgm", "e.ppm", "f.ppm"])
def test_checking_a_map_takes_no_more_than_estimated(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    grey = np.where(office(6).occupied, 0, 254).astype(np.uint8)
    wide = grey.astype(np.uint16) * 257
    if name == "f.ppm":  # samples as text
        text = " ".join(["65535 0 65535"] * 40_000)
        path.write_text(f"P3 200 200 65535 {text}")
    else:
        images = {"b.png": np.dstack([grey] * 3), "c.png": np.dstack([wide] * 4)}
        image = images.get(name, np.dstack([grey] * 3) if "ppm" in name else grey)
        path.write_bytes(cv2.imencode(path.suffix, image)[1])
    width, height, length = image_size(path)
    taken = peak(lambda: check_map(path, resolution=0.05))
    need = check_bytes(width * height, length)
    assert length == path.stat().st_size
    assert taken <= need <= 3 * taken + check_bytes(0, 0)


def test_a_table_of_poses_takes_no_more_than_estimated(tmp_path: Path) -> None:
    scans, out = tmp_path / "s.npz", tmp_path / "p.csv"
    assert call("simulate", MAPS / "curved.yaml", "-n", 1, "--out", scans).code == 0
    words = ("sample", MAPS / "curved.yaml", scans, "--out", out, "--threads", 1, "--force", "-n")
    few, many = (peak(lambda n=n: call(*words, n)) for n in (1, 40_000))
    assert many <= POSE_TEXT * 40_000 + few
    assert many >= POSE_TEXT * 40_000 / 3
