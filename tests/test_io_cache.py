"""The map cache: keys that tell things apart, whole entries, and no trust in what is read."""

import logging
import mmap
import os
import subprocess
import sys
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import imgloc
from imgloc import ConfigError, OccupancyGrid, OutputError, Pose2D
from imgloc.io.cache import (
    cache_folder,
    cache_info,
    cache_key,
    clear_cache,
    entry_names,
    entry_path,
    load_entry,
    store_entry,
)

KEY = "0123456789abcdef0123456789abcdef01234567"
ARRAYS = {
    "walls": np.arange(6, dtype=np.float32).reshape(2, 3),
    "surface.valid": np.array([True, False]),
    "nothing": np.empty((0, 2)),
}


def grid(**changes: object) -> OccupancyGrid:
    walls = np.zeros((3, 8), dtype=bool)
    walls[1, 2] = True
    return OccupancyGrid(**{"occupied": walls, "free": ~walls, "resolution": 0.1, **changes})


def test_key_depends_on_everything_that_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    other = np.zeros((3, 8), dtype=bool)
    other[1, 3] = True
    base = grid()
    keys = [
        cache_key(base, {"sigma": 0.1}),
        cache_key(grid(occupied=other, free=base.free & ~other), {"sigma": 0.1}),
        cache_key(grid(free=base.free & ~other), {"sigma": 0.1}),
        # the same bits in another shape
        cache_key(
            grid(occupied=base.occupied.reshape(6, 4), free=base.free.reshape(6, 4)), {"sigma": 0.1}
        ),
        cache_key(grid(resolution=np.nextafter(0.1, 1)), {"sigma": 0.1}),
        cache_key(base, {"sigma": 0.1000001}),
        cache_key(base, {"sigma": 0.1, "n_psi": 72}),
    ]
    monkeypatch.setattr("imgloc.io.cache.__version__", "0.0.0+another")
    keys.append(cache_key(base, {"sigma": 0.1}))
    assert len(set(keys)) == len(keys)


def test_key_does_not_depend_on_where_the_map_lies() -> None:
    here, there = grid(), grid(origin=Pose2D(3.0, 4.0, 1.0))
    assert cache_key(here, {"a": 1, "b": 2}) == cache_key(there, {"b": 2, "a": 1})


def test_what_is_stored_comes_back_read_only(tmp_path: Path) -> None:
    folder = tmp_path / "made" / "on the way"
    assert load_entry(folder, KEY) is None
    assert entry_names(folder, KEY) == frozenset()
    assert store_entry(folder, KEY, ARRAYS)
    back = load_entry(folder, KEY)
    assert back.keys() == ARRAYS.keys() == entry_names(folder, KEY)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(back[name], array)
        assert back[name].dtype == array.dtype
        assert not back[name].flags.writeable
    assert [p.name for p in folder.iterdir()] == [f"{KEY}.npz"]


def test_arrays_are_mapped_and_aligned(tmp_path: Path) -> None:
    arrays = {"a": np.arange(7, dtype=np.uint8), "b.c": np.ones((300, 50), np.int16), **ARRAYS}
    store_entry(tmp_path, KEY, arrays)
    back = load_entry(tmp_path, KEY)
    for name in arrays:
        assert back[name].ctypes.data % 64 == 0
        base = back[name]
        while isinstance(base, np.ndarray):
            base = base.base
        assert os.name == "nt" or isinstance(memoryview(base).obj, mmap.mmap)
    with np.load(entry_path(tmp_path, KEY)) as archive:  # it is an archive of arrays still
        np.testing.assert_array_equal(archive["b.c"], arrays["b.c"])
    entry_path(tmp_path, KEY).unlink()  # by another process, while this one uses them
    assert back["b.c"].sum() == 15_000


@pytest.mark.parametrize("swap", [8, 4096, 5000])
def test_every_damage_to_an_array_is_noticed(tmp_path: Path, swap: int) -> None:
    store_entry(tmp_path, KEY, {"a": np.arange(30_000, dtype=np.uint32)})
    path = entry_path(tmp_path, KEY)
    data = path.read_bytes()
    at = len(data) // 2
    torn = data[:at] + data[at + swap : at + 2 * swap] + data[at : at + swap]
    path.write_bytes(torn + data[len(torn) :])
    assert load_entry(tmp_path, KEY) is None


def test_transposed_arrays_come_back_equal(tmp_path: Path) -> None:
    array = np.arange(12).reshape(3, 4).T
    store_entry(tmp_path, KEY, {"a": array})
    back = load_entry(tmp_path, KEY)
    np.testing.assert_array_equal(back["a"], array)


def test_equal_arrays_are_equal_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        store_entry(tmp_path / name, KEY, ARRAYS)
    assert (
        entry_path(tmp_path / "a", KEY).read_bytes() == entry_path(tmp_path / "b", KEY).read_bytes()
    )


def test_a_new_entry_replaces_the_old_one(tmp_path: Path) -> None:
    store_entry(tmp_path, KEY, ARRAYS)
    store_entry(tmp_path, KEY, {"walls": np.zeros(3)})
    assert entry_names(tmp_path, KEY) == {"walls"}


def damage(path: Path, kind: str) -> None:
    data = bytearray(path.read_bytes())
    if kind == "bit":
        data[data.index(np.float32(5).tobytes())] ^= 1
    elif kind == "half":
        del data[len(data) // 2 :]
    elif kind == "empty":
        data.clear()
    elif kind == "text":
        data[:] = b"not an archive"
    elif kind == "pickle":
        np.savez(path, key=np.array(KEY), walls=np.array([{"a": 1}], dtype=object))
        return
    elif kind == "compressed":
        np.savez_compressed(path, key=np.array(KEY), **ARRAYS)
        return
    elif kind == "nameless":
        np.savez(path, **ARRAYS)
        return
    elif kind == "no member":
        np.savez(path)
        return
    elif kind == "another's":
        path.unlink()
        other = KEY[::-1]
        store_entry(path.parent, other, ARRAYS)
        entry_path(path.parent, other).rename(path)
        return
    elif kind == "huge":
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000000000,), }"
        header = header.ljust(117) + b"\n"
        with zipfile.ZipFile(path, "w") as archive:
            key = path.with_suffix(".npy")
            np.save(key, np.array(KEY))
            archive.write(key, "key.npy")
            archive.writestr("walls.npy", b"\x93NUMPY\x01\x00\x76\x00" + header + b"\0" * 64)
        return
    path.write_bytes(data)


@pytest.mark.parametrize(
    "kind",
    [
        "bit",
        "half",
        "empty",
        "text",
        "pickle",
        "compressed",
        "nameless",
        "no member",
        "another's",
        "huge",
    ],
)
def test_a_bad_entry_is_none_with_a_warning_and_can_be_replaced(tmp_path, caplog, kind):
    store_entry(tmp_path, KEY, ARRAYS)
    damage(entry_path(tmp_path, KEY), kind)
    with caplog.at_level(logging.WARNING):
        assert load_entry(tmp_path, KEY) is None
    assert "bad cache entry, built anew" in caplog.text
    assert KEY in caplog.text
    assert not entry_names(tmp_path, KEY)
    assert store_entry(tmp_path, KEY, ARRAYS)
    assert load_entry(tmp_path, KEY) is not None


def test_every_truncation_is_noticed(tmp_path: Path) -> None:
    store_entry(tmp_path, KEY, ARRAYS)
    path = entry_path(tmp_path, KEY)
    data = path.read_bytes()
    for length in range(0, len(data) - 1, 13):
        path.write_bytes(data[:length])
        assert load_entry(tmp_path, KEY) is None


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_is_not_waited_for(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    os.mkfifo(entry_path(tmp_path, KEY))
    assert load_entry(tmp_path, KEY) is None
    assert "pipe" in caplog.text
    assert entry_path(tmp_path, KEY).is_fifo()  # not ours to remove


def test_a_folder_that_cannot_be_made_is_a_warning(tmp_path, caplog):
    (tmp_path / "file").write_text("in the way")
    assert not store_entry(tmp_path / "file", KEY, ARRAYS)
    assert "cannot be written" in caplog.text
    assert (tmp_path / "file").read_text() == "in the way"
    assert not entry_names(tmp_path / "file", KEY)


def test_objects_are_not_stored_and_nothing_is_left_behind(tmp_path: Path) -> None:
    store_entry(tmp_path, KEY, ARRAYS)
    assert not store_entry(tmp_path, KEY, {"bad": np.array([{}], dtype=object)})
    assert [p.name for p in tmp_path.iterdir()] == [f"{KEY}.npz"]
    assert load_entry(tmp_path, KEY) is not None


def test_readers_see_whole_entries_while_others_write(tmp_path: Path) -> None:
    big = {f"a{i}": np.full(20_000, i) for i in range(5)}
    store_entry(tmp_path, KEY, big)

    def work(i: int) -> bool:
        if i % 2:
            return store_entry(tmp_path, KEY, big)
        back = load_entry(tmp_path, KEY)
        return back is not None and all((back[f"a{j}"] == j).all() for j in range(5))

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(60)))
    assert [p.name for p in tmp_path.iterdir()] == [f"{KEY}.npz"]


@pytest.mark.parametrize("key", ["", "../../etc/passwd", KEY[:-1], KEY.upper(), KEY + "\n"])
def test_only_keys_are_file_names(tmp_path: Path, key: str) -> None:
    with pytest.raises(ValueError, match="not a key"):
        entry_path(tmp_path, key)


def test_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "imgloc"
    monkeypatch.setenv("HOME", str(tmp_path / "me"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "me"))
    for value in ("", "relative"):
        monkeypatch.setenv("XDG_CACHE_HOME", value)
        assert cache_folder() == tmp_path / "me" / ".cache" / "imgloc"


def test_cache_folder_without_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    with pytest.raises(OutputError, match="pass `cache`"):
        cache_folder()


# ---- limit, orphans, clearing --------------------------------------------------------------

ONE = {"a": np.zeros(10_000, np.uint8)}
SIZE = 10_800  # bytes of its entry, at most


def keys(count: int) -> list[str]:
    return [cache_key(grid(), {"number": i}) for i in range(count)]


def used(path: Path, seconds_ago: float) -> None:
    os.utime(path, (time.time() - seconds_ago,) * 2)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_what_was_used_longest_ago_makes_room(tmp_path: Path) -> None:
    *old, new = keys(4)
    for age, key in enumerate(old):
        store_entry(tmp_path, key, ONE)
        used(entry_path(tmp_path, key), 30 - 10 * age)
    assert load_entry(tmp_path, old[0]) is not None  # is now the one that was used last
    assert store_entry(tmp_path, new, ONE, limit=3 * SIZE)
    assert names(tmp_path) == {f"{key}.npz" for key in (old[0], old[2], new)}
    assert load_entry(tmp_path, old[1]) is None


def test_an_entry_over_the_limit_is_not_stored_and_costs_no_other(tmp_path: Path) -> None:
    small, large = keys(2)
    store_entry(tmp_path, small, ONE)
    assert not store_entry(tmp_path, large, {"a": np.zeros(40_000, np.uint8)}, limit=3 * SIZE)
    assert names(tmp_path) == {f"{small}.npz"}
    assert not store_entry(tmp_path, small, ONE, limit=0)


def test_the_limit_is_an_option_of_the_environment(tmp_path, monkeypatch):
    monkeypatch.delenv("IMGLOC_CACHE_MIB", raising=False)
    assert cache_info(tmp_path).limit == 2048 << 20
    monkeypatch.setenv("IMGLOC_CACHE_MIB", "1")
    a, b = keys(2)
    for key in (a, b):
        assert store_entry(tmp_path, key, {"a": np.zeros(600 << 10, np.uint8)})
    assert names(tmp_path) == {f"{b}.npz"}
    monkeypatch.setenv("IMGLOC_CACHE_MIB", "a lot")
    with pytest.raises(ConfigError, match="IMGLOC_CACHE_MIB: got 'a lot', expected a whole numbe"):
        cache_info(tmp_path)


@pytest.mark.parametrize(("ago", "kept"), [(3700, False), (3500, True)])
def test_orphans_are_removed_when_nobody_can_be_at_them(tmp_path, monkeypatch, ago, kept):
    monkeypatch.setattr("imgloc.io.cache.__version__", "0.0.0+old")
    old = entry_path(tmp_path, cache_key(grid(), {}))
    store_entry(tmp_path, old.stem, ONE)
    monkeypatch.undo()
    other_code = entry_path(tmp_path, cache_key(grid(), {}, code="yesterday"))
    store_entry(tmp_path, other_code.stem, ONE)
    torn = tmp_path / ".imgloc-cache-0123456789abcdef.tmp"  # of a writer that was killed
    torn.write_bytes(b"PK")
    mine = entry_path(tmp_path, cache_key(grid(), {}))
    store_entry(tmp_path, mine.stem, ONE)
    orphans = (old, other_code, torn)
    for path in (*orphans, mine):
        used(path, ago)
    new = entry_path(tmp_path, cache_key(grid(), {"number": 1}))
    assert store_entry(tmp_path, new.stem, ONE)
    assert names(tmp_path) == {p.name for p in (mine, new, *(orphans if kept else ()))}


def test_only_what_this_program_wrote_is_counted_and_removed(tmp_path: Path) -> None:
    key, other = keys(2)
    np.savez(tmp_path / f"{'0' * 40}.npz", ranges=np.zeros(9))  # named by a digest, as ours
    (tmp_path / f"{'1' * 40}.npz").write_text("PK")
    (tmp_path / f"{'2' * 40}.npz").mkdir()
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / ".imgloc-0123456789abcdef.tmp").write_text("a result that is being written")
    elsewhere = tmp_path / "elsewhere"
    store_entry(elsewhere, other, ONE)
    (tmp_path / f"{other}.npz").symlink_to(elsewhere / f"{other}.npz")
    theirs = names(tmp_path)
    for path in tmp_path.iterdir():
        if path.is_file():
            used(path, 10_000)
    store_entry(tmp_path, key, ONE, limit=SIZE)
    (tmp_path / ".imgloc-cache-0123456789abcdef.tmp").write_bytes(bytes(500))
    info = cache_info(tmp_path)
    size = entry_path(tmp_path, key).stat().st_size
    assert info == (1, size + 500, info.limit, tmp_path)
    assert clear_cache(tmp_path) == 2
    assert names(tmp_path) == theirs
    assert (elsewhere / f"{other}.npz").exists()
    assert cache_info(tmp_path)[:2] == (0, 0)
    assert clear_cache(tmp_path) == 0


def test_the_folder_of_the_user_by_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_info() == (0, 0, cache_info().limit, tmp_path / "imgloc")
    assert clear_cache() == 0
    assert not names(tmp_path)
    store_entry(cache_folder(), KEY, ONE)
    assert cache_info().entries == 1
    assert clear_cache() == 1


BUSY = """
import sys, logging
import numpy as np
from imgloc.io.cache import cache_info, load_entry, store_entry
folder, which = sys.argv[1], int(sys.argv[2])
complaints = []
handler = logging.Handler()
handler.emit = lambda record: complaints.append(record.getMessage())
logging.getLogger("imgloc").addHandler(handler)
keys = [f"{i:040x}" for i in range(6)]
for i in range(150):
    key = keys[(i * (which + 1)) % 6]
    arrays = load_entry(folder, key)
    if arrays is None:
        stored = store_entry(folder, key, {"a": np.full(20_000, int(key, 16))}, limit=500_000)
        assert stored, complaints
    else:
        assert (arrays["a"] == int(key, 16)).all()
    cache_info(folder)
assert not complaints, complaints[:3]
"""


def test_processes_that_evict_one_another_only_miss(tmp_path: Path) -> None:
    # Six entries of 160 kB where three have room: each process removes what others read.
    root = str(Path(imgloc.__file__).parents[1])
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", BUSY, tmp_path, str(which)],
            env={**os.environ, "PYTHONPATH": root}, stderr=subprocess.PIPE, text=True,
        )
        for which in range(3)
    ]  # fmt: skip
    ends = [(run.communicate(timeout=120)[1], run.returncode) for run in runs]
    assert ends == [("", 0)] * 3
    assert 1 <= cache_info(tmp_path).entries <= 4
    assert not [name for name in names(tmp_path) if name.endswith(".tmp")]


def test_an_entry_that_goes_while_it_is_looked_for_is_a_miss(tmp_path, monkeypatch, caplog):
    store_entry(tmp_path, KEY, ONE)
    real = os.path.lexists

    def evicted(path: Path) -> bool:
        was_there = real(path)
        Path(path).unlink(missing_ok=True)
        return was_there

    monkeypatch.setattr(os.path, "lexists", evicted)
    assert load_entry(tmp_path, KEY) is None
    assert not caplog.records
