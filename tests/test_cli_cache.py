"""`imgloc cache`: what is kept of prepared maps is shown, and cleared, and nothing else is."""

from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call, rows

from imgloc import LaserScan, ScanSet, save_scans
from imgloc.io.cache import cache_info


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "imgloc"


def test_an_empty_cache_is_shown(folder: Path) -> None:
    code, out, err = call("cache")
    assert (code, err) == (0, "")
    assert out.splitlines()[0] == f"folder   {folder}"
    assert "entries  0" in out
    assert not folder.exists()  # looking makes nothing


def test_what_is_kept_is_shown_and_cleared(folder: Path, tmp_path: Path) -> None:
    blind = LaserScan(np.full(20, 1.0), np.linspace(-1, 1, 20), range_max=10.0)
    save_scans(tmp_path / "s.npz", ScanSet((blind,)))
    words = ("localize", MAPS / "curved.yaml", tmp_path / "s.npz", "-v")
    assert "kept the prepared map" in call(*words).err
    (shown,) = rows(call("cache", "--json").out)
    info = cache_info()
    assert shown == {**info._asdict(), "folder": str(folder)}
    assert (info.entries, info.bytes > 10_000) == (1, True)
    assert "entries  1" in call("cache").out
    (folder / "mine.txt").write_text("not imgloc's")
    code, out, err = call("cache", "clear")
    assert (code, out) == (0, "")
    assert err.startswith("imgloc: removed 1 files, ")
    assert (cache_info().entries, cache_info().bytes) == (0, 0)
    assert (folder / "mine.txt").read_text() == "not imgloc's"
    assert "kept the prepared map" in call(*words).err  # anew


def test_usage_errors_exit_with_2() -> None:
    assert call("cache", "empty").code == 2
    about = call("cache", "--help").out
    assert about.startswith("Usage: imgloc cache")
    assert about.index("--json ") < about.index("Commands:")
