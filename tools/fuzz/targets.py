"""What reads foreign files, by name: valid samples of each, and a call that reads one like them.

A target is one function. It takes an input and a folder, in which its samples were made; it may
return, or raise imgloc's own error::

    @target(lambda folder: [b'{"do": "localize"}'])
    def request(data: bytes, folder: Path) -> None:
        answer_to(data)
"""

import contextlib
import gzip
import io
import json
import shutil
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet  # noqa: F401  (its memory is not that of the first export)
import skimage.measure  # noqa: F401  (nor its time)
from ezdxf.filemanagement import new
from PIL import Image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import imgloc
from imgloc.choice.folder_index import open_index
from imgloc.features.budget import MIB
from imgloc.features.store import features_key, load_features, save_features
from imgloc.io.cache import entry_path
from imgloc.io.calibration import load_calibrations, save_calibrations
from imgloc.io.scans import scans_size
from imgloc.options import FILTERS
from imgloc.output.export import as_bytes
from imgloc.output.report import render_report
from imgloc.output.ros import filled
from imgloc.plans.drawn import drawing_to_maps
from imgloc.plans.vectors import read_drawing
from imgloc.runs.batch import BatchSummary, find_items, work
from imgloc.runs.jobs import make_job
from imgloc.runs.results import RESULTS, RUN, SUMMARY, Results

BUDGET = 256 * MIB
"""Bytes that are given to whatever takes a budget of memory."""
_PIXELS = 8_000_000  # of an image: a command would find more too much for the budget
OPTIONS = imgloc.Options(threads=1, memory_budget=BUDGET)

Run = Callable[[bytes, Path], object]
Make = Callable[[Path], list[bytes]]


@dataclass(frozen=True)
class Target:
    """A reader: what makes samples in a folder, and what reads an input there."""

    name: str
    make: Make
    run: Run


TARGETS: dict[str, Target] = {}


def target(make: Make, name: str | None = None) -> Callable[[Run], Run]:
    """Put a function among the targets, by default under its own name."""

    def put(run: Run) -> Run:
        called = name or run.__name__.replace("_", "-")
        TARGETS[called] = Target(called, make, run)
        return run

    return put


def _each(*calls: Callable[[], object]) -> None:
    """Call all of them, also after imgloc's own error; the first one is raised at the end."""
    refused = []
    for call in calls:
        try:
            call()
        except imgloc.ImglocError as error:
            refused.append(error)
    if refused:
        raise refused[0]


def _written(data: bytes, path: Path) -> Path:
    path.write_bytes(data)
    return path


def _made(name: str, save: Callable[[Path], object]) -> Make:
    """Samples that are one file, written by imgloc."""

    def make(folder: Path) -> list[bytes]:
        save(folder / name)
        return [(folder / name).read_bytes()]

    return make


# What all samples are of: a room of 4 x 3 m with a post, and a short drive through it.
_WALLS = np.pad(np.zeros((30, 40), bool), 2, constant_values=True)
_WALLS[10:16, 20:23] = True
ROOM = imgloc.OccupancyGrid(_WALLS, ~_WALLS, 0.1)
_ANGLES = np.linspace(-3.1, 3.1, 24)
_POSES = np.array([(1.0 + 0.3 * k, 2.6, 0.1 * k) for k in range(4)])
_RANGES = np.round(3.6 - 2 * np.abs(np.cos(_ANGLES + _POSES[:, 2:])), 2)
_RANGES[1, 3], _RANGES[2, 5] = np.inf, np.nan
_SCANS = [imgloc.LaserScan(ranges, _ANGLES, range_max=10.0) for ranges in _RANGES]
DRIVE = imgloc.ScanSet(tuple(_SCANS), _POSES, np.arange(4.0), _POSES)


@cache
def _features() -> imgloc.MapFeatures:
    return imgloc.prepare(ROOM, memory_budget=BUDGET)


def _yaml(folder: Path) -> list[bytes]:
    imgloc.save_map(folder / "map.yaml", ROOM, force=True)
    plain = (folder / "map.yaml").read_bytes()
    return [plain, plain.replace(b"trinary", b"scale"), plain + b'note: "a"\nlist: [1, {a: b}]\n']


@target(_yaml)
def map_yaml(data: bytes, folder: Path) -> None:
    """The YAML of a map whose image is well."""
    path = _written(data, folder / "input.yaml")
    _each(lambda: imgloc.load_map(path), lambda: imgloc.check_map(path))


def _images(_: Path) -> list[bytes]:
    grey = Image.fromarray(np.where(_WALLS, 0, 254).astype(np.uint8))
    ways: list[dict[str, Any]] = [
        {"format": "PNG"}, {"format": "TIFF"}, {"format": "TIFF", "compression": "tiff_lzw"},
        {"format": "TIFF", "compression": "tiff_deflate"}, {"format": "BMP"}, {"format": "JPEG"},
        {"format": "WEBP", "lossless": True}, {"format": "WEBP"}, {"format": "PPM"},
    ]  # fmt: skip
    words = b" ".join(str(v).encode() for v in np.asarray(grey).ravel())
    out = [b"P2\n%d %d\n# a comment\n255\n%s\n" % (*grey.size, words)]
    for picture in (grey, *map(grey.convert, ("RGBA", "1", "P"))):
        for way in ways:
            buffer = io.BytesIO()
            with contextlib.suppress(OSError):  # not every format has every mode
                picture.save(buffer, **way)
                out.append(buffer.getvalue())
    return [data for data in out if data[:2] != b"P4"]


@target(_images)
def image(data: bytes, folder: Path) -> None:
    """An image of any format, whatever its name says."""
    path = _written(data, folder / "input.png")
    _each(
        lambda: imgloc.load_map(path, resolution=0.1, allow_lossy=True, max_pixels=_PIXELS),
        lambda: imgloc.check_map(path, resolution=0.1, max_pixels=_PIXELS),
    )


_FITTED = {"cbml": imgloc.Calibration(0.1, 0.1, 0.5)}


def _drawings(_: Path) -> list[bytes]:
    """A room with a door: as a DXF with a block, an SVG with a copy, and a PDF."""
    document = new(units=6)
    block = document.blocks.new("door")
    block.add_arc((0, 0), 0.9, 0, 90)
    block.add_line((0, 0), (0.9, 0))
    model = document.modelspace()
    model.add_lwpolyline([(0, 0), (5, 0), (5, 4), (0, 4)], close=True, dxfattribs={"layer": "wall"})
    model.add_blockref("door", (1, 0), dxfattribs={"rotation": 90})
    text = io.StringIO()
    document.write(text)
    svg = (
        '<svg width="60mm" height="50mm" viewBox="0 0 60 50"><g id="wall" fill="none" stroke="red">'
        '<rect id="a" x="5" y="5" width="50" height="40"/><use href="#a" transform="scale(1.02)"/>'
        '<path d="M10 45 A 9 9 0 0 1 19 36 L 10 36 Z"/></g><text>1:100</text></svg>'
    )
    lines = (
        b"6 w 50 50 m 200 50 l 200 150 l 50 150 l h S 1 w 90 50 m 90 65 78 75 65 75 c 65 50 l S "
    )
    lines += b"BT /F1 9 Tf 9 9 Td (1:100) Tj ET"
    pdf = (
        b"%%PDF-1.4\n1 0 obj<</Pages 2 0 R>>endobj 2 0 obj<</Kids[3 0 R]/Count 1>>endobj 3 0 obj"
        b"<</Type/Page/Parent 2 0 R/MediaBox[0 0 300 200]/Contents 4 0 R/Resources<</Font<</F1"
        b"<</Type/Font/Subtype/Type1/BaseFont/Helvetica>>>>>>>>endobj 4 0 obj<</Length "
        b"%d>>stream\n%s\nendstream endobj trailer<</Root 1 0 R>>" % (len(lines), lines)
    )
    return [text.getvalue().encode(), svg.encode(), pdf]


@target(_drawings)
def drawing(data: bytes, folder: Path) -> None:
    """A drawing of an architect."""
    ending = ".svg" if data[:1] == b"<" else ".pdf" if data[:2] == b"%P" else ".dxf"
    drawing_to_maps(read_drawing(_written(data, folder / f"input{ending}")))


@target(_made("a", lambda path: save_calibrations(path, ROOM, _FITTED, {"cbml": {"seed": 1}})))
def calibration(data: bytes, folder: Path) -> None:
    """What was fitted on a map."""
    load_calibrations(_written(data, folder / "input.calibration.json"), ROOM)


def _entry(folder: Path) -> list[bytes]:
    assert _features().walls is not None
    save_features(_features(), folder)
    return [entry_path(folder, features_key(_features())).read_bytes()]


@target(_entry)
def cache_entry(data: bytes, folder: Path) -> None:
    """Prepared features of a map."""
    _written(data, entry_path(folder, features_key(_features())))
    again = load_features(ROOM, folder, {"memory_budget": BUDGET})
    assert again.walls.shape == _features().walls.shape
    save_features(again, folder)


def _open(file: Path) -> None:
    """An index of a map that is not there: no times, and no names of folders, are in it."""
    maps = {"map": Path("/map.yaml")}
    index, _ = open_index(maps, lambda _: _features(), about="", memory_budget=BUDGET, file=file)
    index.bounds(DRIVE[0], OPTIONS)


def _index(folder: Path) -> list[bytes]:
    _open(folder / "a.npz")
    with np.load(folder / "a.npz") as archive:
        about = json.loads(archive["about"].tobytes()) | {"written": 1 << 60}
        arrays = dict(archive) | {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return [buffer.getvalue()]


@target(_index)
def map_index(data: bytes, folder: Path) -> None:
    """The coarse levels of maps."""
    _open(_written(data, folder / "input.npz"))


def _csv(_: Path) -> list[bytes]:
    rows = "\n".join(",".join(map(str, ranges)) for ranges in _RANGES)
    named = "stamp,x,y,theta,r0,r1,r2\n1.5,1,2,0.5,1.0,2.0,inf\n2.5,1,2,0.5,1,2,nan\n"
    head = "# angle_min=-1.5, angle_max=1.5, range_max=30\n"
    texts = (head + rows, head + named, "angle,range\n-1.0,2.0\n0.0,2.5\n1.0,3\n")
    return [text.encode() for text in texts]


def _jsonl(_: Path) -> list[bytes]:
    lines = (
        '{"angle_min": -1.5, "angle_increment": 1.0, "range_max": 30, "stamp": 1.5,'
        ' "ranges": [2.3, 2, null, "inf"], "odom": [0, 1, 0.5], "pose": [1, 2, 0.5]}\n',
        '{"angles": [-1, 0, 1], "range_min": 0.1, "ranges": [1, 2, 3], "mount": [0, 0, 0]}\n',
    )
    return [2 * line.encode() for line in lines]


def _carmen(_: Path) -> list[bytes]:
    ranges = " ".join(f"{1 + i / 100:.2f}" for i in range(181))
    head, tail = "1 0 -1.0 2.0 0.5 30.0 0.01 0 5 1 2 3 4 5 0", "12.5 host 1.5\n"
    flaser = f"FLASER 181 {ranges} 1.2 2 0.5 1 2 0.5 1211.5 host 3.5\n"
    laser = f"ROBOTLASER{head} 0.3 0 0 0 0 0 0 0 0 0 0 {tail}"
    rest = f"PARAM robot_front_laser_max 30.0\nODOM 0 0 0 0 0 0 1 h 1\nRAWLASER{head} {tail}"
    return [text.encode() for text in (f"# log\n{flaser}{flaser}", 2 * laser, rest + laser)]


def _packed(folder: Path) -> list[bytes]:
    return [gzip.compress(text, mtime=0) for text in (*_carmen(folder), *_csv(folder))]


def _pcd(_: Path) -> list[bytes]:
    points = np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES), 0 * _ANGLES, _ANGLES))
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z i\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        "WIDTH 24\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 24\nDATA "
    )
    words = "\n".join(" ".join(f"{v:.3f}" for v in point) for point in points)
    return [f"{head}ascii\n{words}\n".encode(),
            f"{head}binary\n".encode() + points.astype("<f4").tobytes()]  # fmt: skip


def _echo(_: Path) -> list[bytes]:
    text = (
        b"header:\n  stamp:\n    sec: 12\n    nanosec: 500000000\n  frame_id: laser\n"
        b"angle_min: -1.0\nangle_max: 1.0\nangle_increment: 1.0\ntime_increment: 0.0\n"
        b"range_min: 5e-2\nrange_max: 30.0\nranges:\n- 1.0\n- .inf\n- .nan\nintensities: []\n---\n"
    )
    return [2 * text, text.replace(b"\n- 1.0\n- .inf\n- .nan", b" [1.0, inf, nan]")]


_TF = "tf2_msgs/msg/TFMessage"
_HEAD = {"stamp": {"sec": 1, "nanosec": 5}, "frame_id": "laser"}
_MESSAGES: dict[str, dict[str, Any]] = {
    _TF: {"transforms": [{
        "header": {"frame_id": "base_link"}, "child_frame_id": "laser",
        "transform": {"rotation": {"w": 1.0}}}]},
    "nav_msgs/msg/Odometry": {
        "header": _HEAD, "child_frame_id": "base_link",
        "pose": {"pose": {"orientation": {"w": 1.0}}}},
    "sensor_msgs/msg/LaserScan": {
        "header": _HEAD, "angle_min": -1.0, "angle_max": 1.0, "angle_increment": 1.0,
        "range_max": 30.0, "ranges": [1.0, np.inf, np.nan]},
}  # fmt: skip
_CLOUDS: dict[str, dict[str, Any]] = {
    "sensor_msgs/msg/PointCloud2": {
        "header": _HEAD, "height": 1, "width": 2, "point_step": 12, "row_step": 24,
        "fields": [{"name": axis, "offset": 4 * k, "datatype": 7, "count": 1}
                   for k, axis in enumerate("xyz")],
        "data": list(np.array([1, 2, 0, -1, 2, 0], "<f4").tobytes())},
}  # fmt: skip


def _bags(kind: str, folder: Path, messages: dict[str, dict[str, Any]] = _MESSAGES) -> list[bytes]:
    """A log with what is looked at in one."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))
    pack = store.serialize_ros1 if kind == "bag" else store.serialize_cdr
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    path = folder / ("a.bag" if kind == "bag" else "log")
    with Writer1(path) if kind == "bag" else Writer(path, version=9, storage_plugin=plugin) as bag:
        for topic, values in messages.items():
            name = {_TF: "/tf_static"}.get(topic, f"/{topic[-4:]}")
            connection = bag.add_connection(name, topic, typestore=store)
            for k in range(2):
                message = bytes(pack(filled(store, topic, values), topic))
                bag.write(connection, (k + 1) * 10**9, message)
    return [(path if kind == "bag" else next(path.glob(f"*.{kind}"))).read_bytes()]


def _read(name: str, data: bytes, folder: Path) -> None:
    path = _written(data, folder / name)
    cut = (-0.5, 0.5)
    _each(lambda: scans_size(path, height=cut), lambda: imgloc.load_scans(path, height=cut))


_npz = _made("a.npz", lambda path: imgloc.save_scans(path, DRIVE))
_FILES: tuple[tuple[str, str, Make], ...] = (
    ("csv", ".csv", _csv), ("jsonl", ".jsonl", _jsonl), ("carmen", ".log", _carmen),
    ("echo", ".yaml", _echo), ("npz", ".npz", _npz), ("packed", "", _packed), ("pcd", ".pcd", _pcd),
    ("cloud", ".mcap", partial(_bags, "mcap", messages=_CLOUDS)),
)  # fmt: skip
for _name, _ending, _make in _FILES:
    target(_make, _name)(partial(_read, f"input{_ending}"))
for _name in ("bag", "mcap", "db3"):
    target(partial(_bags, _name), _name)(partial(_read, f"input.{_name}"))


@target(_made("log/metadata.yaml", lambda path: _bags("db3", path.parents[1])))
def bag_metadata(data: bytes, folder: Path) -> None:
    """What is said beside a recording of ROS 2."""
    log = _written(data, folder / "log/metadata.yaml").parent
    _each(lambda: scans_size(log), lambda: imgloc.load_scans(log))


def _timeless(value: Any, key: str = "") -> Any:
    """A value of JSON without what two runs do not share."""
    late = key in ("seconds", "timings_ms", "ms")
    if isinstance(value, dict):
        return {k: _timeless(v, key if late else k) for k, v in value.items()}
    if isinstance(value, list):
        return [_timeless(part, key) for part in value]
    return 1.0 if late and isinstance(value, float) else value


def _batch(name: str, file: str, folder: Path) -> list[bytes]:
    """One of the files of a small batch, which stays in the folder."""
    _yaml(folder)
    imgloc.save_scans(folder / "scans.npz", DRIVE.take([0, 1]))
    job, scans = (
        make_job(name, **({"options": OPTIONS} if name == "localize" else {})),
        None if name == "check" else folder / "scans.npz",
    )
    about = {"job": name, "maps": "maps", "scans": None, "imgloc": "0",
             "parameters": {job.digest: job.parameters}}  # fmt: skip
    summary = BatchSummary()
    with Results(folder / "batch", about) as results:
        for item in find_items(folder / "map.yaml", scans, job):
            row = _timeless(work(item, job)[0]) | {"map": "map.yaml"}
            row = json.loads(json.dumps(row).replace(str(folder), "folder"))  # also in warnings
            results.add(row, {})
            summary.add(row)
        results.summarise(summary.as_row())
    return [(folder / "batch" / file).read_bytes()]


def _look(name: str, file: str, data: bytes, folder: Path) -> None:
    """Everything that reads a folder of results."""
    out, job = folder / "out", make_job(name)
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(folder / "batch", out)
    _written(data, out / file)
    _each(
        lambda: render_report(out),
        lambda: as_bytes(out, ".csv"),
        lambda: as_bytes(out, ".parquet"),
        lambda: imgloc.run_batch(folder / "map.yaml", None, out, job, resume=True, items=[]),
    )


for _job in ("check", "localize", "which"):
    target(partial(_batch, _job, RESULTS), f"rows-{_job}")(partial(_look, _job, RESULTS))
for _name in (RUN, SUMMARY):
    target(partial(_batch, "localize", _name), _name)(partial(_look, "localize", _name))


@target(
    lambda _: [b"map,scans\na.yaml,a.npz\nb/b.yaml,b.csv\n", b'scans,"map"\r\n"a b",c.yaml\r\n']
)
def pairs(data: bytes, folder: Path) -> None:
    """A CSV of maps and scans for a batch."""
    find_items(_written(data, folder / "input.csv"), None, make_job())


_FOLLOWED = 40  # scans of a log


def _log(folder: Path) -> list[bytes]:
    entry = {"angle_min": -3.1, "angle_max": 3.1, "range_max": 10.0}
    lines = [
        json.dumps({"stamp": k, "odom": pose.tolist(), "ranges": [*map(str, ranges)]} | entry)
        for k, (pose, ranges) in enumerate(zip(_POSES, _RANGES, strict=True))
    ]
    return ["\n".join(lines).encode(), *_npz(folder)]


@target(_log)
def log(data: bytes, folder: Path) -> None:
    """Odd odometry and stamps, along one of the filters; the first scans, because each has work."""
    ending = ".npz" if data.startswith(b"PK") else ".jsonl"
    scans = imgloc.load_scans(_written(data, folder / f"input{ending}"))
    scans = scans.take(range(min(len(scans), _FOLLOWED)))
    name = FILTERS[zlib.crc32(data) % len(FILTERS)]
    for _ in imgloc.follow(_features(), scans, imgloc.make_filter(name, _features(), OPTIONS)):
        pass
