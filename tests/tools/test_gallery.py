"""Each script of the gallery leaves its picture; the docs have every public name."""

import re
from importlib import import_module

import numpy as np
import pytest
from command import ROOT

import imgloc
from tools.drive import drive
from tools.gallery import own_score

EVERY = sorted(p.stem for p in (ROOT / "tools" / "gallery").glob("[a-z]*.py"))
assert len(EVERY) > 5


@pytest.mark.parametrize("name", EVERY)
def test_a_script_leaves_its_picture(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module = import_module(f"tools.gallery.{name}")
    if name == "kinds":  # other scripts, and tools.pictures, draw all of these
        monkeypatch.setattr(module, "drive", lambda: drive().take(range(20)))
        monkeypatch.setattr(module.atlas, "picture", own_score.picture)
    image = module.picture().image
    assert image.dtype == np.uint8
    assert min(image.shape[:2]) > 300
    assert len(np.unique(image @ np.array([1, 1 << 8, 1 << 16]))) > 20  # colours
    title, line, *_ = str(module.__doc__).splitlines()
    assert line == "=" * len(title)


def test_the_docs_have_every_public_name() -> None:
    page = (ROOT / "tools" / "docs" / "api.md").read_text("utf-8")
    named = re.findall(r"^   ([A-Za-z]\w+)$", page, re.MULTILINE)
    assert sorted([*named, "ALL_METHODS", "METHODS", "__version__"]) == sorted(imgloc.__all__)
