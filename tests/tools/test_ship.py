"""What people install: the check of wheels, the container's rules, the unit."""

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from command import ROOT
from serving import served

from tools import ship

DOCKERFILE = ship.DOCKERFILE.read_text("utf-8").replace("\\\n", " ")


def test_what_a_wheel_lacks_or_has_besides_is_named(tmp_path: Path) -> None:
    wheel = tmp_path / "imgloc-1-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as file:
        for name in ("imgloc/a.py", "imgloc/maps/a.png", "imgloc/own.py", "imgloc-1.dist-info/R"):
            file.writestr(name, "")
    tracked = ["imgloc/a.py", "imgloc/py.typed", "maps/a.png", "maps/a.yaml", "tools/ship.py"]
    assert ship.differences(wheel, tracked) == [
        "imgloc/maps/a.yaml is missing",
        "imgloc/py.typed is missing",
        "imgloc/own.py is not under version control",
    ]


def test_a_command_that_fails_is_wrong_with_what_it_printed() -> None:
    assert ship.run(sys.executable, "-c", "print(3)") == "3\n"
    with pytest.raises(ship.Wrong, match=r"exit code 4\nlast words"):
        ship.run(sys.executable, "-c", "print('last words'); raise SystemExit(4)")


def test_the_container_is_pinned_and_not_root() -> None:
    bases = re.findall(r"(?m)^FROM (\S+)", DOCKERFILE)
    assert bases
    assert all(re.fullmatch(r"python:3\.\d+-slim-\w+", base) for base in bases)
    last = DOCKERFILE.rpartition("\nFROM ")[2]
    (user,) = re.findall(r"(?m)^USER (\d+):\d+$", last)
    assert int(user) > 0
    assert re.search(rf"useradd --uid {user} ", last)


def test_the_container_copies_what_the_build_may_see() -> None:
    """Each source of a COPY exists and is among the files that .dockerignore lets through."""
    ignore = ship.DOCKERFILE.with_name("Dockerfile.dockerignore").read_text("utf-8").split()
    copied = re.findall(r"(?m)^COPY (?!--from)(.+) \S+$", DOCKERFILE)
    sources = [word for line in copied for word in line.split()]
    assert "imgloc/__about__.py" in sources
    for word in sources:
        assert (ROOT / word).exists(), word
        assert f"!{word.split('/')[0]}" in ignore, word


def test_the_health_check_fails_unless_the_service_answers() -> None:
    """The command of the Dockerfile, but for the port."""
    (words,) = re.findall(r'HEALTHCHECK .*?CMD \["python", "-c", "(.*)"\]', DOCKERFILE)
    with served() as one:
        script = words.replace(":8080/", f":{one.port}/")
        assert script != words
        assert subprocess.run([sys.executable, "-c", script]).returncode == 0
        one.end()
    after = subprocess.run([sys.executable, "-c", script], capture_output=True)
    assert after.returncode == 1


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_a_unit_with_a_wrong_line_is_noticed(tmp_path, monkeypatch):
    assert "verified" in ship.verify_unit()
    text = ship.UNIT.read_text("utf-8")
    monkeypatch.setattr(ship, "UNIT", tmp_path / "imgloc.service")
    for wrong in (
        text.replace("DynamicUser=yes", "DynamicUser=perhaps"),
        text.replace("ExecStart=", "ExecBegin="),
        re.sub(r"(?m)^(Protect|Private|Restrict|Capab|System).*$", "", text),
    ):
        ship.UNIT.write_text(wrong)
        with pytest.raises(ship.Wrong, match="systemd-analyze"):
            ship.verify_unit()
