"""The map cache: keys that tell things apart, whole entries, and no trust in what is read."""

import logging
import os
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import imgloc
from imgloc.errors import OutputError
from imgloc.io.cache import (
    cache_key,
    default_folder,
    entry_names,
    entry_path,
    load_entry,
    store_entry,
)
from imgloc.model import OccupancyGrid, Pose2D

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
            grid(occupied=base.occupied.reshape(6, 4), free=base.free.reshape(6, 4)),
            {"sigma": 0.1},
        ),
        cache_key(grid(resolution=np.nextafter(0.1, 1)), {"sigma": 0.1}),
        cache_key(base, {"sigma": 0.1000001}),
        cache_key(base, {"sigma": 0.1, "n_psi": 72}),
    ]
    monkeypatch.setattr(imgloc, "__version__", "0.0.0+another")
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
    assert back is not None
    assert back.keys() == ARRAYS.keys() == entry_names(folder, KEY)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(back[name], array)
        assert back[name].dtype == array.dtype
        assert not back[name].flags.writeable
    assert [p.name for p in folder.iterdir()] == [f"{KEY}.npz"]


def test_transposed_arrays_come_back_equal(tmp_path: Path) -> None:
    array = np.arange(12).reshape(3, 4).T
    store_entry(tmp_path, KEY, {"a": array})
    back = load_entry(tmp_path, KEY)
    assert back is not None
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
def test_a_bad_entry_is_none_with_a_warning_and_can_be_replaced(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: str
) -> None:
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


def test_a_folder_that_cannot_be_made_is_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
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


def test_default_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "imgloc"
    monkeypatch.setenv("HOME", str(tmp_path / "me"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "me"))
    for value in ("", "relative"):
        monkeypatch.setenv("XDG_CACHE_HOME", value)
        assert default_folder() == tmp_path / "me" / ".cache" / "imgloc"


def test_default_folder_without_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", lost)
    with pytest.raises(OutputError, match="--cache"):
        default_folder()
