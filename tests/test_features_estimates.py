"""What loading and simulating take is known beforehand: bounds, and not by far."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import ROOT
from test_features_budget import office, peak

from imgloc.features.budget import scans_bytes
from imgloc.io.images import ImageSize, image_size
from imgloc.io.mapcheck import check_bytes, check_map
from imgloc.io.maps import load_bytes
from imgloc.io.scans import scans_size
from imgloc.simulation.scans import fine_factor, refine_grid

TABLES = load_bytes(ImageSize(0, 0, 0, grey=True))
LOADS = """
import json, os, sys
sys.path.insert(0, sys.argv[1])
from imgloc.io.maps import load_map
from imgloc.io.scans import load_scans
def status(key):
    with open("/proc/self/status") as lines:
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith(key))
for line in sys.stdin:
    if os.fork():  # a process for each: it begins with a peak of its own
        os.wait()
        continue
    load, small, large, options = json.loads(line)
    try:
        vars()[load](small, **options)
        before = status("VmRSS")
        vars()[load](large, **options)
        print(status("VmHWM") - before, flush=True)
    except Exception as e:
        print(repr(e), flush=True)
    os._exit(0)
"""


@pytest.fixture(scope="module")
def resident() -> Iterator[Callable[..., int]]:
    """Bytes that a process of its own takes at most while it loads, after a small file."""
    if not Path("/proc/self/status").exists():
        pytest.skip("peak resident memory is read from /proc")
    command = [sys.executable, "-c", LOADS, ROOT]
    with subprocess.Popen(command, stdin=-1, stdout=-1, text=True) as server:

        def taken(load: str, small: Path, large: Path, **options: object) -> int:
            print(
                json.dumps([load, str(small), str(large), options]), file=server.stdin, flush=True
            )
            return int(server.stdout.readline())

        yield taken
        server.stdin.close()


def test_the_fine_image_is_as_large_as_said() -> None:
    grid = office(1)
    factor = fine_factor(grid)
    height, width = grid.occupied.shape
    assert factor > 1
    assert refine_grid(grid).occupied.shape == (factor * height, factor * width)


@pytest.mark.parametrize("name", ["a.png", "c.png", "e.ppm", "f.ppm"])
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
    size = image_size(path)
    check_map(path, resolution=0.05)  # what is imported at the first call stays
    taken = peak(lambda: check_map(path, resolution=0.05))
    assert size.file_bytes == path.stat().st_size
    assert taken <= check_bytes(size) <= 3 * taken + TABLES


def image_of(grey: np.ndarray, name: str) -> bytes:
    """A file of a grey image, as the name says."""
    kind, ending = name.split(".")
    if kind.startswith("P"):
        samples = np.repeat(grey % 10, 3, axis=1) if ending == "ppm" else grey
        text = " ".join(map(str, samples.ravel()))
        return f"{kind} {grey.shape[1]} {grey.shape[0]} {samples.max()} {text}".encode()
    samples = grey.astype(np.uint16) * 257 if "16" in kind else grey
    channels = {"rgb": 3, "rgba": 4}.get(kind.removesuffix("16"), 1)
    image = samples if channels == 1 else np.dstack([samples] * channels)
    return cv2.imencode(f".{ending}", image)[1].tobytes()


@pytest.mark.parametrize("name", ["flat.png", "rgba16.png", "grey.pgm", "P3.ppm", "rgb.bmp"])
def test_loading_a_map_takes_no_more_than_estimated(name, resident, tmp_path):
    side = 600
    grey = np.random.default_rng(0).integers(0, 256, (side, side), dtype=np.uint8)
    grey[:, :: 1 if "flat" in name else side] = 254
    paths = [tmp_path / f"{which}{name}" for which in ("small", "large")]
    for path, image in zip(paths, (grey[:9, :9], grey), strict=True):
        path.write_bytes(image_of(image, name))
    size = image_size(paths[1])
    grey_only = not any(sign in name for sign in ("rgb", "P3"))
    assert size == (side, side, paths[1].stat().st_size, grey_only)
    taken = resident("load_map", *paths, resolution=0.05)
    assert taken <= load_bytes(size) <= 4.5 * taken + TABLES


def write_scans(path: Path, count: int, rays: int, kind: str) -> None:
    ranges = np.random.default_rng(count).uniform(1, 9, (count, rays)).round(3)
    angles = np.linspace(-1, 1, rays)
    if path.suffix == ".npz":
        np.savez_compressed(path, ranges=ranges.astype("f4"), angles=angles.astype("f4"))
    elif path.suffix == ".csv":
        lines = [",".join(map(str, row)) for row in ranges.tolist()]
        path.write_text(f"# angle_min=-1, angle_max=1 {kind}\n" + "\n".join(lines), "utf-8")
    else:
        entry = {"angle_min": -1, "angle_max": 1, "note": kind}
        lines = [json.dumps({**entry, "ranges": row}) for row in ranges.tolist()]
        whole = "[" + ",".join(lines) + "]" if path.suffix == ".json" else "\n".join(lines)
        path.write_text(whole, "utf-8")


@pytest.mark.parametrize(
    ("name", "count", "rays", "kind"),
    [
        ("s.npz", 2000, 360, ""),
        ("s.npz", 9000, 1, ""),
        ("s.csv", 1, 100_000, ""),
        ("s.csv", 600, 360, "\N{COMPASS}\N{ROBOT FACE}"),
        ("s.jsonl", 600, 360, ""),
        ("s.json", 600, 360, ""),
    ],
)
def test_loading_scans_takes_no_more_than_estimated(name, count, rays, kind, resident, tmp_path):
    small, large = tmp_path / f"small_{name}", tmp_path / name
    write_scans(small, 2, 2, kind)
    write_scans(large, count, rays, kind)
    size = scans_size(large)
    assert count <= size.scans <= count + 1
    assert size.file_bytes == large.stat().st_size
    taken = resident("load_scans", small, large)
    need = scans_bytes(size.scans, size.numbers, size.file_bytes, text=size.text)
    assert taken <= need <= 4 * taken


def test_how_much_an_archive_holds_is_in_its_headers(tmp_path: Path) -> None:
    arrays = {"ranges": np.ones((4, 7)), "angles": np.zeros(7), "poses": np.zeros((4, 3))}
    np.savez_compressed(tmp_path / "s.npz", **arrays, other=np.zeros(999))
    size = scans_size(tmp_path / "s.npz")
    assert (size.scans, size.numbers, size.text) == (4, 28 + 7 + 12, False)
    np.savez(tmp_path / "one.npz", ranges=np.ones(7), angle_min=0.0, angle_increment=0.1)
    assert (scans_size(tmp_path / "one.npz").scans, scans_size(tmp_path / "one.npz").numbers) == (
        1,
        9,
    )
