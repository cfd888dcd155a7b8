"""Files that want to harm: each is refused by the real command, soon, in little memory, in a line.

The line names the file and the cause, and holds nothing that a terminal would obey.
"""

import bz2
import contextlib
import os
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from badfiles import YAML, encode, npz, room
from command import MAPS, Run, call, rows, weighed

from imgloc.errors import ScanError
from imgloc.io.bagbounds import bounded

MAP = MAPS / "double_wall.yaml"
SECONDS, MIB = 6.0, 80 + 300  # of the processor; a plain run, and 300
ECHO = "angle_min: -1.0\nangle_increment: 0.1\nrange_max: 9.0\n"


class Case(NamedTuple):
    name: str  # of the file
    content: Callable[[], str | bytes]
    cause: str
    code: int = 4


def judged(run: Run, name: str, cause: str, code: int) -> None:
    run.ends(code, cause, name)
    assert run.err.startswith("imgloc: error: ")
    assert run.err.count("\n") == 1
    assert run.err.strip().isprintable()
    assert len(run.err) < 800
    assert not run.out


def check(name: str, cause: str, code: int, *arguments: object, **how: Any) -> None:
    run, seconds, mib = weighed(*arguments, **how)
    judged(run, name, cause, code)
    assert seconds < SECONDS
    assert mib < MIB


MAPS_THAT_HARM = [
    Case(
        "keys.yaml",
        lambda: YAML + "".join(f"k{i}: 1\n" for i in range(5000)),
        "expected at most 256",
    ),
    Case("hex.yaml", lambda: YAML.replace("0.1", "0x" + "f" * 3600), "3,602 digits"),
    Case("mode.yaml", lambda: YAML + "mode: 0x" + "f" * 3600, "3,602 digits"),
    Case("title.yaml", lambda: YAML + 2 * '"\\e]0;x\\a": 1\n', "\\x1b]0;x\\x07: given more"),
    Case("colour.yaml", lambda: YAML + "x: !%1b%5b31mred 5\n", "tag !\\x1b[31mred"),
    Case("long.yaml", lambda: YAML.replace("good", "a" * 300), "File name too long"),
    Case("bombs.yaml", lambda: YAML + "a: &- [1]\nb: [*-, *-]\n", "YAML anchor"),
]
SCANS_THAT_HARM = [
    Case("deep.yaml", lambda: "ranges: " + "[" * 25_000, "nested too deeply"),
    Case("deep.txt", lambda: "ranges: " + "[" * 25_000, "nested too deeply"),
    Case("hex.yaml", lambda: f"{ECHO}ranges: [1]\nrange_min: 0x" + "f" * 3600, "3,602 digits"),
    Case(
        "aliases.yaml",
        lambda: "a0: &-a [1,1,1,1,1,1,1,1,1,1]\n"
        + "".join(f"a{i}: &-{'a' * i}a [{10 * f'*-{chr(97) * i},'}]\n" for i in range(1, 8))
        + "ranges: *-aaaaaaaa\n",
        "YAML anchor",
    ),
]  # fmt: skip


@pytest.mark.parametrize("case", MAPS_THAT_HARM, ids=lambda case: case.name)
def test_a_map_that_wants_to_harm_is_one_line(case: Case, tmp_path: Path) -> None:
    path = tmp_path / case.name
    path.write_text(str(case.content()))
    check(case.name, case.cause, 3, "map", "check", path)


@pytest.mark.parametrize("case", SCANS_THAT_HARM, ids=lambda case: case.name)
def test_scans_that_want_to_harm_are_one_line(case: Case, tmp_path: Path) -> None:
    path, content = tmp_path / case.name, case.content()
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    check(case.name, case.cause, 4, "localize", MAP, path)


def test_brackets_from_standard_input_do_not_end_the_interpreter() -> None:
    deep = "(printf 'ranges: '; head -c 30000 /dev/zero | tr '\\0' '[')"
    check("standard input", "nested too deeply", 4, "localize", MAP, "-", stdin=deep)


def test_no_key_of_a_map_reaches_the_terminal(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(YAML + '"\\e[31mX": 1\n')
    (tmp_path / "good.png").write_bytes(encode(".png", room()))
    run = weighed("map", "check", tmp_path / "map.yaml").run
    assert run.code == 0
    assert "\\x1b[31mX: not a key" in run.out
    assert "\x1b" not in run.out + run.err


def locked(folder: Path) -> Path:
    """A folder with a map and scans that nobody may look into."""
    inside = folder / "locked"
    inside.mkdir()
    (inside / "map.png").write_bytes(b"")
    (inside / "a.npz").write_bytes(npz(ranges=np.ones((1, 9)), angles=np.arange(9.0)))
    inside.chmod(0)
    return inside


@pytest.mark.parametrize("what", ["a.npz", "map.png", "a.bag", "longer"])
def test_what_may_not_be_looked_at_is_no_defect(what: str, tmp_path: Path) -> None:
    inside = locked(tmp_path)
    try:
        if what == "map.png":
            path = tmp_path / "map.yaml"
            path.write_text(YAML.replace("good.png", "locked/map.png"))
            check("map.png", "Permission denied; ", 3, "map", "check", path)
        elif what == "longer":
            check("bbb", "File name too long", 4, "localize", MAP, tmp_path / ("b" * 300))
            check("bbb", "File name too long", 3, "localize", "b" * 300, MAP)
            run = call("batch", MAP, "--job", "check", "--out", tmp_path / ("b" * 300), "--dry-run")
            assert run.code == 0
        else:
            check(what, "Permission denied", 4, "localize", MAP, inside / what)
    finally:
        inside.chmod(0o755)


def test_a_map_that_cannot_be_reached_spoils_no_folder(tmp_path: Path) -> None:
    (tmp_path / "long.yaml").write_text(YAML.replace("good", "a" * 300))
    (tmp_path / "loop.yaml").write_text(YAML.replace("good", "loop"))
    (tmp_path / "loop.png").symlink_to("loop.png")
    (tmp_path / "good.yaml").write_text(YAML)
    (tmp_path / "good.png").write_bytes(encode(".png", room()))
    (tmp_path / "a.npz").write_bytes(
        npz(ranges=np.full((1, 90), 1.0), angles=np.linspace(-3, 3, 90), range_max=np.array(5.0))
    )
    run = weighed("which", tmp_path, tmp_path / "a.npz").run
    assert run.code == 5  # some maps are of no use
    assert "File name too long" in run.err
    assert "internal error" not in run.err


def fields(**values: bytes) -> bytes:
    """Header of a record of a ROS 1 bag."""
    each = (key.encode() + b"=" + value for key, value in values.items())
    return sized(b"".join(sized(field) for field in each))


def sized(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def bag_of(chunk: bytes, compression: bytes) -> bytes:
    """A ROS 1 bag with one message of one topic, in one chunk of these bytes."""
    from rosbags.typesys import Stores, get_typestore

    kind, (zero, one) = "sensor_msgs/msg/LaserScan", (struct.pack("<I", n) for n in (0, 1))
    definition, md5 = get_typestore(Stores.ROS1_NOETIC).generate_msgdef(kind)
    packed = fields(op=b"\5", compression=compression, size=zero) + sized(chunk)
    index = fields(op=b"\4", ver=one, conn=zero, count=one) + sized(bytes(12))
    about = {"topic": b"/scan", "type": b"sensor_msgs/LaserScan", "md5sum": md5.encode()}
    about["message_definition"] = definition.encode()
    connection = fields(op=b"\7", conn=zero, topic=b"/scan") + fields(**about)
    times = {"start_time": bytes(8), "end_time": bytes(8), "count": one}

    def start(index_pos: int) -> bytes:
        at = struct.pack("<Q", index_pos)
        counts = fields(op=b"\3", index_pos=at, conn_count=one, chunk_count=one)
        return b"#ROSBAG V2.0\n" + counts + sized(b"")

    at = len(start(0))
    info = fields(op=b"\6", ver=one, chunk_pos=struct.pack("<Q", at), **times) + sized(zero + one)
    return start(at + len(packed + index)) + packed + index + connection + info


def mcap_of(*records: tuple[int, bytes]) -> bytes:
    """An MCAP file of these records, operation and content, without an index."""
    magic = b"\x89MCAP0\r\n"
    every = [(1, sized(b"ros2") + sized(b"")), *records, (2, bytes(20))]
    return magic + b"".join(struct.pack("<BQ", op, len(d)) + d for op, d in every) + magic


def mcap_chunk(packed: bytes, size: int, compression: bytes) -> tuple[int, bytes]:
    head = struct.pack("<QQQI", 0, 1, size, 0) + sized(compression)
    return 6, head + struct.pack("<Q", len(packed)) + packed


def zstd_of(size: int) -> bytes:
    from rosbags.rosbag2 import reader

    return reader.zstd.compress(bytes(size))


def lz4_of(size: int) -> bytes:
    import lz4.frame

    return lz4.frame.compress(bytes(size))


def db3_of(*topics: tuple[str, str], data: str = "data") -> bytes:
    """A recording of one empty message of each topic, a name and a type."""
    with contextlib.closing(sqlite3.connect(":memory:")) as base:
        base.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format, "
            "offered_qos_profiles); CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, "
            f"timestamp, {data});"
        )
        for i, (name, kind) in enumerate(topics):
            base.execute(
                "INSERT INTO topics VALUES(?, ?, ?, 'cdr', ?)", (i, name, kind, "[" * 9999)
            )
            base.execute("INSERT INTO messages(topic_id, timestamp) VALUES(?, 1)", (i,))
        base.commit()
        return base.serialize()


_LASER, _KIND, _MANY = "sensor_msgs/msg/LaserScan", b"x/msg/Y", 512 << 20
BAGS_THAT_HARM = [
    Case("bz2.bag", lambda: bag_of(bz2.compress(bytes(99 << 20)), b"bz2"), "unpacks to too much"),
    Case("streams.bag", lambda: bag_of(400 * bz2.compress(bytes(9 << 20)), b"bz2"), "damaged"),
    Case("lz4.bag", lambda: bag_of(lz4_of(_MANY), b"lz4"), "unpacks to too much"),
    Case("cut.bag", lambda: bag_of(lz4_of(99)[:-9], b"lz4"), "a chunk ends early"),
    Case("long.bag", lambda: b"#ROSBAG V2.0\n\xf0\xff\xff\xff" + bytes(91), "damaged or not a bag"),
    Case(
        "a.mcap", lambda: mcap_of(mcap_chunk(zstd_of(_MANY), _MANY, b"zstd")), "unpacks to too much"
    ),
    Case(
        "b.mcap", lambda: mcap_of(mcap_chunk(lz4_of(_MANY), _MANY, b"lz4")), "unpacks to too much"
    ),
    Case(
        "huge.mcap",
        lambda: mcap_of((3, b"")).replace(b"\3" + bytes(8), b"\3" + struct.pack("<Q", 1 << 62)),
        "damaged or not a bag (a length beyond any memory)",
    ),
    Case(
        "made.db3",
        lambda: db3_of(("/a", _LASER), data="data AS (zeroblob(900000000))"),
        "string or blob too big",
    ),
    Case(
        "definition.mcap",
        lambda: mcap_of(
            (
                3,
                struct.pack("<H", 1)
                + b"".join(map(sized, (_KIND, b"ros2msg", b"int8 a\n" * 10**6))),
            ),
            (4, struct.pack("<HH", 1, 1) + b"".join(map(sized, (b"/a", b"cdr", b"")))),
        ),
        "definitions of messages too long",
    ),
    Case("other?.db3", lambda: db3_of(("/a", _LASER)), "SQLite takes names with ?"),
    Case("kind.db3", lambda: db3_of(("/a", "x/msg/\x1b[31mY")), "but x/msg/\\x1b[31mY"),
    Case("topic.db3", lambda: db3_of(("/a", _LASER), ("/\x1b[31mb", _LASER)), "/\\x1b[31mb (1)"),
]


@pytest.mark.parametrize("case", BAGS_THAT_HARM, ids=lambda case: case.name)
def test_bags_that_want_to_harm_are_one_line(case: Case, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="reads bags: the extra ros")
    path, content = tmp_path / case.name, case.content()
    assert isinstance(content, bytes)
    path.write_bytes(content)
    check(case.name, case.cause, 4, "localize", MAP, path)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3", "a"])
@pytest.mark.parametrize("kind", ["pipe", "endless"])
def test_what_never_ends_is_not_read(name: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / name
    os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")
    run = call("localize", MAP, path)
    judged(run, name, "is a pipe or device", 4)


METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  relative_file_paths: [a.db3{ending}]
  duration: {{nanoseconds: 1}}
  starting_time: {{nanoseconds_since_epoch: 1}}
  message_count: 1
  topics_with_message_count:
  - topic_metadata: {{name: /scan, type: x/msg/Y, serialization_format: cdr}}
    message_count: 1
  compression_format: '{format}'
  compression_mode: '{mode}'
"""


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("metadata.yaml", "nested too deeply"),
        ("metadata.yaml", "is a pipe or device"),
        ("a.db3", "is a pipe or device"),
        ("a.db3", "no such file"),
        ("recording", "unpacks to too much"),
    ],
)
def test_recordings_that_want_to_harm_are_one_line(name: str, cause: str, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="reads bags: the extra ros")
    folder = tmp_path / "recording"
    folder.mkdir()
    about, packed = folder / "metadata.yaml", name == "recording"
    ending, form, mode = (".zstd", "zstd", "FILE") if packed else ("", "", "")
    about.write_text(METADATA.format(ending=ending, format=form, mode=mode))
    if cause == "nested too deeply":
        about.write_text("[" * 50_000)
    elif packed:
        (folder / "a.db3.zstd").write_bytes(zstd_of(_MANY))
    elif cause == "is a pipe or device":
        (folder / name).unlink(missing_ok=True)
        os.mkfifo(folder / name)
    check(name, cause, 4, "localize", MAP, folder)


def test_all_that_a_bag_unpacks_to_is_counted() -> None:
    pytest.importorskip("rosbags", reason="reads bags: the extra ros")
    from rosbags.rosbag2 import storage_mcap

    data, size = zstd_of(9 << 20), 9 << 20
    with bounded("a.mcap", len(data)):
        assert len(storage_mcap.DECOMPRESSORS["zstd"](data, size)) == size
        with pytest.raises(ScanError, match="unpacks to too much, expected at most 100"):
            storage_mcap.DECOMPRESSORS["zstd"](data, size)
    for _ in range(2):  # as others use it
        assert len(storage_mcap.DECOMPRESSORS["zstd"](data, size)) == size


@pytest.mark.parametrize("ending", ["npz", "csv", "jsonl", "log", "yaml"])
def test_a_scan_of_ten_million_readings_is_none(ending: str, tmp_path: Path) -> None:
    many = 10**7
    content = {
        "csv": b"# angle_min=-1, angle_max=1\n" + b"1," * many + b"1\n",
        "jsonl": b'{"angle_min":-1,"angle_max":1,"ranges":[' + b"1," * many + b"1]}\n",
        "log": b"FLASER 10000000 " + b"1 " * many + b"0 0 0 0 0 0 1 host 1\n",
        "yaml": ECHO.encode() + b"ranges: [" + b"1," * many + b"1]\n",
    }
    path = tmp_path / f"a.{ending}"
    if ending == "npz":
        path.write_bytes(npz(ranges=np.ones((many // 2, 1)), angles=np.zeros(1)))
    else:
        path.write_bytes(content[ending])
    check(path.name, "expected at most", 4, "localize", MAP, path, "--memory-budget", "8G")


@pytest.mark.parametrize(
    ("stream", "cause"),
    [("cat /dev/zero", "no known scan format"), ("yes 1,2,3", "expected at most 256 MiB")],
)
def test_standard_input_that_never_ends_is_left(stream: str, cause: str) -> None:
    check("standard input", cause, 4, "localize", MAP, "-", stdin=stream)


def test_a_batch_waits_for_nothing_that_never_ends(tmp_path: Path) -> None:
    scans = tmp_path / "scans"
    scans.mkdir()
    os.mkfifo(scans / "a.bag")
    (scans / "b.mcap").symlink_to("/dev/zero")
    (scans / "c.json").write_text("[" * 100_000)
    run, seconds, _ = weighed("batch", MAP, scans, "--out", tmp_path / "out", "--workers", 1)
    assert run.code == 5
    said = [row["message"] for row in rows((tmp_path / "out" / "results.jsonl").read_text())]
    assert [s.partition(": ")[2].partition(", expected")[0] for s in said[:2]] == [
        "is a pipe or device"
    ] * 2
    assert "not valid JSON" in said[2]
    assert seconds < SECONDS
