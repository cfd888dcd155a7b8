"""Bounds that rosbags lacks for what it unpacks and parses of a bag.

A chunk of 6 kB may unpack to gigabytes, and YAML of 10,000 brackets takes rosbags a quarter of a
minute. Its functions that unpack and parse are replaced by such as do what they did, but inside
:func:`bounded`; a program's own use of rosbags is as it was.
"""

import bz2
import contextlib
import functools
import importlib
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from imgloc.errors import ScanError
from imgloc.io.plainyaml import plain_yaml

MAX_METADATA = 4 << 20
"""Bytes of a recording's metadata.yaml."""
_VALUES = 100_000  # of metadata.yaml
# Bytes that a chunk, or a message that is packed by itself, may unpack to; and all of a bag, which
# is a part of that and a multiple of its size. Scans shrink to a third, maps to a hundredth.
_CHUNK, _ROOM, _RATIO = 64 << 20, 16 << 20, 100


@dataclass
class _Bag:
    name: str
    left: int  # bytes that it may unpack to yet
    messages: int  # bytes that its messages may have yet
    largest: int = 0  # bytes of a chunk so far
    types: dict[tuple[Any, ...], Any] = field(default_factory=dict)  # of definitions
    definitions: int = 1 << 20  # characters that they may have yet; 7 s of parsing

    def take(self, count: int) -> None:
        """Count what was unpacked; ScanError if it is too much."""
        self.left -= count
        self.largest = max(self.largest, count)
        if self.left < 0:
            hint = f"expected at most {_RATIO} times its size; rosbag decompress, or record less"
            raise ScanError(f"{self.name}: unpacks to too much, {hint}")

    def types_of(self, parse: Callable[..., Any], *definition: str) -> Any:
        """The types that a definition declares, which many topics may share."""
        if definition not in self.types:
            self.definitions -= sum(map(len, definition))
            if self.definitions < 0:
                raise ScanError(f"{self.name}: definitions of messages too long, expected 1 MiB")
            self.types[definition] = parse(*definition)
        return self.types[definition]


_OPEN: ContextVar[_Bag | None] = ContextVar("bag that is open", default=None)


@contextlib.contextmanager
def bounded(name: str, size: int) -> Iterator[None]:
    """Bound what rosbags unpacks and parses of the bag called `name`, of `size` bytes.

    Inside, chunks and messages that unpack to more than 64 MiB are a ScanError, and so is all
    beyond 16 MiB and 100 times the size, metadata.yaml that is not plain, and more than a MiB of
    different definitions. Quality-of-service profiles are not parsed at all.
    """
    _replace()
    most = _ROOM + _RATIO * size
    token = _OPEN.set(_Bag(name, most, most))
    try:
        yield
    finally:
        _OPEN.reset(token)


def messages_of(bag: Any, connections: Sequence[Any]) -> Iterator[tuple[Any, int, bytes]]:
    """Connection, time and data of the messages of a bag, as long as they are not too many bytes.

    An index may name one message a thousand times, a database may make a column as it is read.
    """
    about = _bag()
    for connection, time, data in bag.messages(connections=connections):
        about.messages -= len(data)
        if about.messages < 0:
            hint = f"expected at most {_RATIO} times its size; record it again"
            raise ScanError(f"{about.name}: messages of too many bytes, {hint}")
        yield connection, time, data


def largest_chunk() -> int:
    """Bytes of the largest piece that was unpacked of the bag that is open."""
    return _bag().largest


def metadata(text: str, name: str) -> Any:
    """Parse the metadata.yaml of a recording."""
    return plain_yaml(text, name, ScanError, most=_VALUES)


@functools.cache
def _replace() -> None:
    """Patch rosbags with size limits, once."""
    names = (
        "rosbag1.reader", "highlevel.anyreader",
        "rosbag2.reader", "rosbag2.storage_mcap", "rosbag2.storage_sqlite3",
    )  # fmt: skip
    modules: list[Any] = [importlib.import_module(f"rosbags.{name}") for name in names]
    reader1, anyreader, reader, mcap, sqlite = modules
    zstd, lz4 = reader.zstd, importlib.import_module("lz4.frame").LZ4FrameDecompressor
    for table, key, unpacker in (
        (reader1.decompressors, "bz2", bz2.BZ2Decompressor),
        (reader1.decompressors, "lz4", lz4),
        (mcap.DECOMPRESSORS, "lz4", lz4),
        (mcap.DECOMPRESSORS, "zstd", zstd.ZstdDecompressor),
    ):
        table[key] = _inside(functools.partial(_unpack, unpacker), table[key])
    reader1.decompressors["none"] = _inside(_as_it_is, reader1.decompressors["none"])
    sqlite.apsw.connection_hooks.append(_limit)
    for parser in ("get_types_from_msg", "get_types_from_idl"):
        parse = getattr(anyreader, parser)
        types = functools.partial(lambda parse, *text: _bag().types_of(parse, *text), parse)
        setattr(anyreader, parser, _inside(types, parse))
    reader.zstd = SimpleNamespace(**vars(zstd))
    reader.zstd.decompress = _inside(
        functools.partial(_unpack, zstd.ZstdDecompressor), zstd.decompress
    )
    reader.zstd.open = _inside(lambda file, mode: _Counted(zstd.open(file, mode)), zstd.open)
    plain = SimpleNamespace(load=lambda text: metadata(text, "metadata.yaml"))
    reader.YAML = _inside(lambda **_: plain, reader.YAML)
    for module in (reader, mcap, sqlite):
        module.parse_qos = _inside(lambda _: [], module.parse_qos)


def _inside(ours: Callable[..., Any], theirs: Callable[..., Any]) -> Callable[..., Any]:
    """`ours` while a bag is open in :func:`bounded`, `theirs` otherwise."""
    return lambda *args, **named: (theirs if _OPEN.get() is None else ours)(*args, **named)


def _bag() -> _Bag:
    bag = _OPEN.get()
    assert bag is not None
    return bag


def _as_it_is(data: bytes) -> bytes:
    """A chunk that is not packed: an index may lead back and forth between two of them."""
    _bag().take(len(data))
    return data


def _limit(connection: Any) -> None:
    """Limit values of a database, which may make them as they are read."""
    if _OPEN.get() is not None:
        connection.limit(importlib.import_module("apsw").SQLITE_LIMIT_LENGTH, _CHUNK)


def _unpack(unpacker: Callable[[], Any], data: bytes, _size: int = 0) -> bytes:
    """Unpack the first stream of `data`, and no more of it than there may be."""
    bag, one = _bag(), unpacker()
    most = min(_CHUNK, bag.left)
    out: bytes = one.decompress(data, most + 1)
    if len(out) > _CHUNK:
        hint = f"expected at most {_CHUNK >> 20} MiB; rosbag decompress, or record smaller ones"
        raise ScanError(f"{bag.name}: a chunk unpacks to too much, {hint}")
    bag.take(len(out))
    if not one.eof:
        raise EOFError("a chunk ends early")
    return out


class _Counted:
    """A packed file that is open, of which all that is read counts."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def __enter__(self) -> "_Counted":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, size: int) -> bytes:
        data: bytes = self._file.read(size)
        _bag().take(len(data))
        return data
