"""Tables of plain text, and those of `imgloc evaluate`."""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any


def as_plain(columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 0) -> str:
    """Format a table; no cell is ever cut.

    Parameters
    ----------
    columns : sequence of str
        Headings.
    rows : sequence of sequence of str
        As many cells as there are headings.
    left : int
        So many columns are flush left, the others right.

    Examples
    --------
    >>> print(as_plain(("a", "b"), [("x", "1")], left=1))
    +---+---+
    | a | b |
    +---+---+
    | x | 1 |
    +---+---+
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.ASCII2, pad_edge=True)
    for k, name in enumerate(columns):
        table.add_column(Text(name), justify="left" if k < left else "right", no_wrap=True)
    for row in rows:
        table.add_row(*map(Text, row))  # Text: what is in brackets is not markup
    console = Console(file=io.StringIO(), width=1000, color_system=None)
    with console.capture() as captured:
        console.print(table)
    return "\n".join(line.rstrip() for line in captured.get().splitlines())


def evaluation(rows: Sequence[Mapping[str, Any]]) -> str:
    """Format the results of `imgloc evaluate`, one a map and method, as three tables."""
    parts = (
        ("Index S (eq. 12, nats) and global maximum, over free cells [95 % interval]", _index),
        ("Right answers, % [95 % interval]", _success),
        ("Errors of the first hypothesis, and cost", _cost),
    )
    return "\n\n".join(
        f"{title}\n{as_plain(list(cells[0]), [list(c.values()) for c in cells], left=2)}"
        for title, cells in ((t, [_head(row) | make(row) for row in rows]) for t, make in parts)
    )


def _head(row: Mapping[str, Any]) -> dict[str, str]:
    return {"map": row["map"], "method": row["method"], "n": str(row["trials"])}


def _index(row: Mapping[str, Any]) -> dict[str, str]:
    step = row["lattice"]["theta_step"]
    return {
        "cell": f"{row['lattice']['cell']:g} m {math.degrees(step):.3g} deg",
        "S +- s.e.": _estimate(row["index"]),
        "S calibrated": _estimate(row["index_calibrated"]),
        "S max": f"{row['lattice']['log_poses']:.2f}",
        "S box +- s.e.": _estimate(row["index_box"]),
        "floored": str(row["index"]["floored"]),
        "outside": str(row["outside"]),
        "maximum %": _share(row["exact"]),
        "within 1 cell %": _share(row["near"]),
    }


def _success(row: Mapping[str, Any]) -> dict[str, str]:
    out: dict[str, str] = {}
    for s in row["success"]:
        near = f"{s['tolerance']['position']:g} m {math.degrees(s['tolerance']['heading']):.3g} deg"
        out |= {f"{near} @1": _share(s["at_1"]), f"{near} @5": _share(s["at_5"])}
    wrong = row["success"][-1]["unique_wrong"]
    out["unique"] = _share(row["verdicts"]["unique"])
    out["unique, wrong"] = _share(wrong)
    return out


def _cost(row: Mapping[str, Any]) -> dict[str, str]:
    cost = row["cost"]
    unit = {None: "", "pair of points": " pair", "pose and reading": " pose,ray"}[row["unit"]]
    names = tuple(row["position"])
    return {
        "m " + " ".join(names): " ".join(_number(row["position"][q], 2) for q in names),
        "deg " + " ".join(names): " ".join(
            _number(math.degrees(row["heading"][q]), 1) for q in names
        ),
        "ms p50 p99": " ".join(_number(cost["ms"][q], 0) for q in ("median", "p99")),
        "stack ms": _number(cost["stack_ms"]["median"], 1),
        "ns per": _number(cost["ns_per_unit"], 3) + unit,
        "first ms": _number(cost["first_ms"], 0),
        "stack MiB": f"{row['stack_bytes'] / 2**20:.1f}",
        "features MiB": f"{row['features_bytes'] / 2**20:.1f}",
    }


def _estimate(index: Mapping[str, Any]) -> str:
    return f"{_number(index['value'], 2)} +- {_number(index['standard_error'], 2)}"


def _share(share: Mapping[str, Any]) -> str:
    low, high = 100 * share["low"], 100 * share["high"]
    return f"{100 * share['value']:.1f} [{low:2.0f}, {high:3.0f}]"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
