"""The tool that puts errors into the code: what it changes, and whether it says who noticed."""

import ast

import pytest

from tools import mutants
from tools.mutants import main, mutants_of

SOURCE = b'''"""Doc 1 + 1."""

LIMIT = 3


def area(width: "1 | 2", height: float = 2.0, *, closed: bool = True) -> float:
    """Area, 1 < 2."""
    if width < 0 or not closed:
        raise ValueError("1 + 1" + str(1 + 1))
    return -(width  # a * b
            * height) % LIMIT
'''


def changes(source):
    return [m.change for m in mutants_of("a.py", source)]


def test_one_thing_is_changed_and_it_still_compiles():
    found = [m for m in mutants_of("a.py", SOURCE) if mutants.compiles(SOURCE, m)]
    for mutant in found:
        changed = mutants.mutated(SOURCE, mutant)
        ast.parse(changed)
        assert changed != SOURCE
    told = [m.change for m in found]
    assert len(set(told)) == len(told)
    assert {"True -> False", "2.0 -> 3.0", "2.0 -> 4.0", "3 -> 4", "width < 0 -> width > 0"} <= set(
        told
    )
    assert "width < 0 or not closed -> width < 0 and not closed" in told
    assert "not closed -> closed" in told
    assert any(t.endswith("-> -(width # a * b / height) % LIMIT") for t in told) is False
    assert "width # a * b * height -> width # a * b / height" in told  # not the comment's


def test_a_wrap_is_left_out_whole():
    assert changes(b"k = (a + 1) % (2 * n)")[0] == "(a + 1) % (2 * n) -> (a + 1) "


def test_messages_annotations_and_documentation_are_left_alone():
    lines = {m.line for m in mutants_of("a.py", SOURCE)}
    assert lines == {3, 6, 8, 10}
    assert not [c for c in changes(SOURCE) if "Doc" in c or "1 + 1" in c or "1 | 2" in c]


def test_names_are_swapped_whatever_their_module():
    assert changes(b"y = np.minimum(a.max(), b)") == [
        "np.minimum(a.max(), b) -> np.maximum(a.max(), b)", "a.max() -> a.min()",
    ]  # fmt: skip


@pytest.fixture
def checkout(tmp_path, tmp_path_factory, monkeypatch):
    """A package with one test, which sees one of two functions; its results are kept elsewhere."""
    root = tmp_path / "root"
    for folder in ("imgloc/search", "tests", "tools"):
        (root / folder).mkdir(parents=True)
    (root / "imgloc" / "__init__.py").touch()
    for name in "ab":
        (root / "imgloc" / "search" / f"{name}.py").write_text("def f(x):\n    return not x\n")
    (root / "tests" / "test_search_a.py").write_text(
        "from imgloc.search.a import f\n\ndef test_f():\n    assert f(0)\n"
    )
    monkeypatch.setattr(mutants, "ROOT", root)
    # The path of a socket may be no longer than some 100 letters.
    monkeypatch.setattr(mutants.tempfile, "tempdir", str(tmp_path_factory.mktemp("k")))
    return root


def test_it_says_which_test_notices_and_what_survives(checkout, capsys):
    words = ["-n", "9", "--workers", "2", "--paths"]
    assert main([*words, "imgloc/search"]) == 1
    said = capsys.readouterr().out
    killed = "| imgloc/search/a.py:2 | `not x -> x` | tests/test_search_a.py::test_f |"
    assert killed in said
    assert "| imgloc/search/b.py:2 | `not x -> x` | **SURVIVED** |" in said
    assert said.endswith("\n1 of 2 killed\n")
    assert (checkout / "imgloc" / "search" / "a.py").read_text().endswith("not x\n")


def test_what_has_been_killed_is_not_asked_again(checkout, capsys, monkeypatch):
    answers = iter(["tests/test_search_a.py::test_f", ""])  # with the mutant, and without it
    monkeypatch.setattr(mutants, "killer", lambda folder, some: next(answers))
    for _ in range(2):  # a third call would be one too many
        assert main(["--paths", "imgloc/search/a.py"]) == 0
        assert capsys.readouterr().out.endswith("\n1 of 1 killed\n")


def test_a_test_that_always_fails_kills_nothing(checkout):
    (checkout / "tests" / "test_search_a.py").write_text("def test_f():\n    assert False\n")
    with pytest.raises(RuntimeError, match=r"test_search_a\.py::test_f fails without a mutant"):
        main(["--paths", "imgloc/search/a.py", "--workers", "1"])


@pytest.mark.parametrize("forever", ["pass", "time.sleep(1)"])
def test_what_does_not_end_has_failed(checkout, monkeypatch, forever):
    monkeypatch.setattr(mutants, "PATIENCE", 0.5)
    (checkout / "tests" / "test_search_a.py").write_text(
        f"import time\n\ndef test_f():\n    while True:\n        {forever}\n"
    )
    said = mutants.killer(checkout, ["tests/test_search_a.py"])
    assert said == "tests/test_search_a.py::test_f did not end"
