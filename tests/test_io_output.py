"""Outputs: whole or not at all, never over a file that is not ours."""

import os
import stat
from pathlib import Path

import cv2
import numpy as np
import pytest

from imgloc.errors import OutputError
from imgloc.io.files import write_bytes_atomic, write_text_atomic
from imgloc.io.images import encode_png

resource = pytest.importorskip("resource", reason="limits on file size are a Unix matter")


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_writes_and_leaves_nothing_else(tmp_path: Path) -> None:
    write_bytes_atomic(tmp_path / "a.bin", b"\0\xff")
    assert (tmp_path / "a.bin").read_bytes() == b"\0\xff"
    write_text_atomic(str(tmp_path / "b.txt"), "größe\n")
    assert (tmp_path / "b.txt").read_text("utf-8") == "größe\n"
    assert names(tmp_path) == ["a.bin", "b.txt"]


def test_existing_files_need_force(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("mine")
    with pytest.raises(OutputError, match=r"a\.txt: exists already; pass `force=True`"):
        write_text_atomic(path, "yours")
    assert path.read_text() == "mine"
    write_text_atomic(path, "yours", force=True)
    assert path.read_text() == "yours"
    assert names(tmp_path) == ["a.txt"]


def test_dangling_link_counts_as_existing(tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "nowhere")
    with pytest.raises(OutputError, match="exists already"):
        write_bytes_atomic(link, b"x")


@pytest.mark.parametrize("make", [lambda p: p.mkdir(), lambda p: os.mkfifo(p)])
def test_force_does_not_replace_what_is_no_file(tmp_path: Path, make) -> None:
    make(tmp_path / "thing")
    with pytest.raises(OutputError, match="not a regular file"):
        write_bytes_atomic(tmp_path / "thing", b"x", force=True)
    assert names(tmp_path) == ["thing"]


def test_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        OutputError, match=r"out\.txt: cannot be written: there is no folder .*gone"
    ):
        write_bytes_atomic(tmp_path / "gone" / "out.txt", b"x")
    assert names(tmp_path) == []


def test_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="Not a directory"):
        write_bytes_atomic(tmp_path / "file" / "out.txt", b"x")


@pytest.mark.parametrize("force", [False, True])
def test_full_disk_leaves_the_old_file_and_no_rubbish(tmp_path: Path, force: bool) -> None:
    path = tmp_path / "result.json"
    if force:
        path.write_text("old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(OutputError, match=r"result\.json: cannot be written: File too large"):
            write_bytes_atomic(path, bytes(1_000_000), force=force)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert names(tmp_path) == (["result.json"] if force else [])
    assert not force or path.read_text() == "old"


def test_mode_follows_the_umask(tmp_path: Path) -> None:
    old = os.umask(0o027)
    try:
        write_bytes_atomic(tmp_path / "a", b"")
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


def test_undecodable_names(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"caf\xe9.txt")
    write_text_atomic(path, "x")
    with pytest.raises(OutputError, match=r"caf\\xe9\.txt: exists"):
        write_text_atomic(path, "x")
    with pytest.raises(OutputError, match="cannot be written"):
        write_text_atomic("a\0b", "x")


@pytest.mark.parametrize("shape", [(3, 5), (3, 5, 3)])
def test_png_round_trip(shape: tuple[int, ...]) -> None:
    image = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    data = encode_png(image[::-1])  # not contiguous
    again = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(again, image[::-1])


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((2, 2)),
        np.zeros((2, 2, 4), np.uint8),
        np.zeros((0, 2), np.uint8),
        np.zeros(3, np.uint8),
    ],
)
def test_png_of_something_else_is_a_defect(image) -> None:
    with pytest.raises(ValueError, match="must be uint8, grey or BGR"):
        encode_png(image)
