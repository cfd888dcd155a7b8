"""README's pictures show what the code draws."""

import re

import cv2
import pytest
from command import ROOT

from tools import pictures


@pytest.mark.parametrize("name", ["demo", "fig2"])  # that of the track takes longer: .ci/run
def test_a_picture_is_what_the_code_draws(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert pictures.main(["--check", name]) == 0, capsys.readouterr().out


def test_a_stale_picture_is_noticed(monkeypatch, capsys):
    there, made_by = pictures.load(pictures.FOLDER / "track.png")
    assert re.fullmatch(r"matplotlib \d+\.\d+", made_by)
    now = cv2.circle(there.copy(), (600, 140), 12, (60, 20, 220), -1)  # a robot that was not there
    monkeypatch.setattr(pictures, "LETTERS", made_by)
    monkeypatch.setattr(pictures, "PICTURES", {"track": lambda: now})
    assert pictures.main(["--check"]) == 1
    assert "python -m tools.pictures track" in capsys.readouterr().out


def test_every_picture_of_the_readme_and_the_paper_is_made_by_the_command() -> None:
    pages = (ROOT / name for name in ("README.md", "tools/docs/start.md", "tools/docs/paper.md"))
    text = "".join(page.read_text("utf-8") for page in pages)
    shown = re.findall(r"!\[[^]]*\]\((?:tools|\.\.)/(\w+)\.png\)", text)
    assert sorted(shown) == sorted(pictures.PICTURES)
