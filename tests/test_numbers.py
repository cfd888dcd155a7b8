"""Numbers that were fitted or chosen are in numbers.json, checked, used, and nowhere else."""

import ast
import json
import math
from collections.abc import Iterator
from functools import cache

import pytest
from command import ROOT, parsed

from imgloc.numbers import FILE, NUMBERS, SOURCES, Origin, read, write

TEXT = FILE.read_text("utf-8")
PACKAGE = ROOT / "imgloc"
ROOMS = ("search", "likelihoods", "filters", "answers", "choice")
#: Constants that stay in the code, by why no measurement governs an answer through them.
LEFT = {
    "how much is done at a time": (
        "_CHUNK _TOGETHER _LOOKUPS _FEW _LOOKS _CHUNK_CELLS _FIRST_CELLS"
        " _BLOCK BLOCK_PAIRS BLOCK_COLUMNS TILE_CELLS TILE_WIDTH CELLS MOST"
    ),
    "which engine is the faster one": (
        "FLAT_CELLS FLAT_PIECE SHIFT_SECONDS_PER_BYTE SHIFT_SECONDS_PER_CALL FLAT_SECONDS_PER_CALL"
        " DFT_SECONDS_PER_STEP DFT_SECONDS_PER_HEADING DFT_CACHE DFT_BEYOND_CACHE _ALIKE"
    ),
    "what a type of numbers holds": (
        "_OFF_EVERY_MAP _REACH VMAP_LEVELS OFF_CELLS _NOTHING MAX_POWER MAX_OFFSET EPSILON"
        " ALLOWED_ERROR _STEPS _MINUTE _FAR _erfc"
    ),
    "a unit, a pattern, nothing": "_CM _FACTORS NOWHERE NO_PLACES METHODS WAYS UNITS",
    "a promise": "SCALES SHARES DEEPEST TOLERANCES",
    "what evo has, whose figures ours are compared with": "_APART",
    "bounds of files, pictures, clocks": (
        "_SIDE _BARS _WORK _ALL _YOUNG _LIMIT _BESIDE _BUFFERS _LATEST _FASTEST _FARTHEST"
    ),
}
FITTED = (
    "EvidenceModel", "FusedOptions", "Trust", "TrackerOptions", "MotionNoise", "GridOptions",
    "ParticleOptions", "ScannedOptions",
)  # fmt: skip


@cache
def trees() -> list[tuple[str, ast.Module]]:
    paths = sorted(PACKAGE.rglob("*.py"))
    return [(p.relative_to(PACKAGE).as_posix(), parsed(p)) for p in paths]


def literals(node: ast.AST) -> Iterator[float]:
    """Numbers that are written in an expression."""
    for part in ast.walk(node):
        if isinstance(part, ast.Constant) and type(part.value) in (int, float):
            yield part.value


def asked() -> Iterator[str]:
    """Names that the code asks for, those that it makes ending in a star."""
    for _, tree in trees():
        for call in ast.walk(tree):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "number":
                name = call.args[0]
                if isinstance(name, ast.JoinedStr):
                    name = name.values[0]
                    yield f"{ast.literal_eval(name)}*"
                elif isinstance(name, ast.Constant):
                    yield name.value


def test_every_number_is_used_once() -> None:
    names = list(asked())
    made = tuple(name[:-1] for name in names if name.endswith("*"))
    plain = [name for name in names if not name.endswith("*")]
    alphas = ["MotionNoise.alpha"] * 3
    assert sorted([*plain, *(n for n in NUMBERS if n.startswith(made))]) == sorted(
        [*NUMBERS, *alphas]
    )


def test_no_default_of_what_was_fitted_is_written_in_the_code() -> None:
    found = {}
    for _, tree in trees():
        for kind in ast.walk(tree):
            if isinstance(kind, ast.ClassDef) and kind.name in FITTED:
                fields = [f for f in kind.body if isinstance(f, ast.AnnAssign) and f.value]
                found[kind.name] = [  # a displacement of 0 and an exponent of 1 change nothing
                    ast.unparse(f) for f in fields if f.value and {*literals(f.value)} - {0, 1}
                    and "number(" not in ast.unparse(f.value)
                ]  # fmt: skip
    assert found == {name: [] for name in FITTED}


def test_each_constant_that_is_left_in_the_code_has_a_reason() -> None:
    left = []
    for path, tree in trees():
        if path.split("/")[0] not in (*ROOMS, "pipeline.py", "options.py"):
            continue
        for node in tree.body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                if ast.unparse(node.value).startswith("Annotated["):
                    continue  # a type, and the range of its values
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                left += [ast.unparse(t) for t in targets if list(literals(node.value))]
    assert sorted(set(left)) == sorted(" ".join(LEFT.values()).split())


def test_numbers_are_in_si_units() -> None:
    assert NUMBERS["refine.step"].value == (0.1, 0.1, pytest.approx(0.0349066), 0.02)
    assert isinstance(NUMBERS["Trust.readings"].value, int)
    assert SOURCES[NUMBERS["Trust.temperature"].source].by.startswith("chosen by a random search")


WHOLE = (
    "blocks", "cells", "components", "directions", "headings", "hypotheses", "grey levels",
    "maps", "nodes", "places", "poses", "readings", "scans", "searches",
)  # fmt: skip
SHARES, SIZES = ("share", "probability"), (
    "metres", "seconds", "metres and seconds", "square metres", "variance", "deviations",
    "square deviations", "odds", "logarithm", "per reading", "temperature per nat",
)  # fmt: skip
UNITS = (
    dict.fromkeys(WHOLE, (1, 1e9)) | dict.fromkeys(SHARES, (0, 1)) | dict.fromkeys(SIZES, (0, 1e6))
    | dict.fromkeys(("nats", "nats per reading"), (0, math.inf)) | {"log-odds": (-1e6, 1e6)}
    | dict.fromkeys(("factor", "exponent", "temperature"), (1e-6, 1e6))
    | {"radians": (0, math.tau), "degrees": (0, 360)}
)  # fmt: skip


@pytest.mark.parametrize("name", NUMBERS)
def test_each_number_has_a_source_a_reason_and_a_value_that_its_unit_may_have(name: str) -> None:
    entry, one = json.loads(TEXT)["numbers"][name], NUMBERS[name]
    several = isinstance(entry["value"], list)
    values = entry["value"] if several else [entry["value"]]
    units = one.unit if isinstance(one.unit, list) else [one.unit] * len(values)
    assert several or isinstance(one.unit, str)
    for value, unit in zip(values, units, strict=True):
        low, high = UNITS[unit]
        assert type(value) is (int if unit in WHOLE else float)
        assert low <= value <= high
    source = SOURCES[one.source]
    assert all(isinstance(text, str) and text for text in (one.costs, *vars(source).values()))


def test_a_fit_writes_its_numbers_and_where_they_are_from() -> None:
    made = Origin("python -m tools.trust fit", "one map", "2030-01-01")
    out = write(TEXT, {"Trust.elsewhere": [-3.0, -0.5, 2.0]}, "trust-fit", made)
    sources, numbers = read(out)
    assert numbers["Trust.elsewhere"].value == (-3.0, -0.5, 2.0)
    assert sources[numbers["Trust.elsewhere"].source] == made
    changed = [a for a, b in zip(out.split("\n"), TEXT.split("\n"), strict=True) if a != b]
    assert len(changed) == 2
    assert write(TEXT, {}, "trust-fit", read(TEXT)[0]["trust-fit"]) == TEXT


def test_a_fit_writes_no_number_that_is_none() -> None:
    with pytest.raises(ValueError, match="not JSON"):
        write(TEXT, {"Trust.elsewhere": [float("nan")] * 3}, "trust-fit", Origin("a", "b", "c"))
