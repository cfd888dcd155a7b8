"""Files that want to harm: each is refused by the real command, soon, in little memory, in a line.

The line names the file and the cause, and holds nothing that a terminal would obey.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from badfiles import YAML, encode, npz, room
from command import MAPS, Run, weighed

MAP = MAPS / "double_wall.yaml"
SECONDS, MIB = 6.0, 80 + 300  # a machine that is busy with other tests; a plain run, and 300
ECHO = "angle_min: -1.0\nangle_increment: 0.1\nrange_max: 9.0\n"


class Case(NamedTuple):
    name: str  # of the file
    content: Callable[[], str | bytes]
    cause: str
    code: int = 4


def judged(run: Run, name: str, cause: str, code: int) -> None:
    assert run.code == code, run
    assert cause in run.err
    assert name in run.err
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
    Case("keys.yaml", lambda: YAML + "".join(f"k{i}: 1\n" for i in range(5000)), "more than 256"),
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


@pytest.mark.parametrize("what", ["a.npz", "map.png", "longer"])
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
