"""Each script of the gallery leaves its picture; the page shows all of them."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from tools.gallery import __main__ as gallery

EVERY = gallery.NAMES


@pytest.mark.parametrize("name", EVERY)
def test_a_script_leaves_its_picture(name: str) -> None:
    image = import_module(f"tools.gallery.{name}").picture().image
    assert image.dtype == np.uint8
    assert min(image.shape[:2]) > 300
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 20


def test_the_page_has_every_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "NAMES", ("from_a_png", "stack"))
    gallery.main(["--out", str(tmp_path / "g")])
    page = (tmp_path / "g" / "index.html").read_text("utf-8")
    for name in gallery.NAMES:
        assert f'<img src="{name}.png"' in page
        assert (tmp_path / "g" / f"{name}.png").stat().st_size > 1000
    there = {p.stem for p in Path(gallery.__file__).parent.glob("[a-z]*.py")}
    assert there == {
        "from_a_png",
        "folder",
        "prior",
        "stack",
        "atlas",
        "which_map",
        "own_score",
        "own_map",
    }
