"""Results of a batch as one flat table, a row for each scan, for pandas, Polars and DuckDB.

Of an item without an answer there is one row, too: its status names the cause. Columns of
`localize` have the best pose, map frame, metres and radians, with its covariance; of other jobs the
names of nested values are joined by an underscore, and lists are JSON texts.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from imgloc.errors import ConfigError, OutputError
from imgloc.io.files import PathLike, display
from imgloc.io.text import csv_text
from imgloc.runs.results import Row, read_rows, read_run

_COVARIANCE = {"xx": (0, 0), "xy": (0, 1), "xt": (0, 2), "yy": (1, 1), "yt": (1, 2), "tt": (2, 2)}
_ITEM = ("map", "scans", "status", "code", "message", "version", "key")
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
_LONGEST = 4096  # characters of a text of an item
_MOST = 1000  # columns; answers have about a hundred
Columns = dict[str, list[Any]]


def as_bytes(folder: PathLike, ending: str) -> bytes:
    """Return the table of a folder of results, as CSV, or as Parquet if the `ending` is that.

    Raises
    ------
    OutputError
        If it is not the folder of a batch, or cannot be read.
    ConfigError
        If Parquet is asked for without pyarrow.
    """
    return (_parquet if ending == ".parquet" else _csv)(columns_of(folder))


def columns_of(folder: PathLike) -> Columns:
    """The table, column by column; what a row does not have is None."""
    describe = _located if read_run(folder)["job"] == "localize" else _flat
    columns: Columns = {}
    count = 0
    for row in read_rows(folder):
        # A message is in each line of its item: what an edited row has of it could be megabytes.
        about = {key: v[:_LONGEST] if isinstance(v := row[key], str) else v for key in _ITEM}
        # A signal, an exit code, or the kind of an error: text, so that the column has one type.
        about["code"] = None if row["code"] is None else str(row["code"])
        cost = {"item_seconds": row["cost"].get("seconds"), "attempts": row["cost"].get("attempts")}
        times = row["cost"].get("ms", ())
        for k, answer in enumerate(row["answers"] or [None]):
            said = about | ({} if answer is None else describe(answer)) | cost
            if k < len(times):
                said["ms"] = times[k]
            for key in said.keys() - columns.keys():
                columns[key] = [None] * count
            if len(columns) > _MOST:
                raise OutputError(f"{display(folder)}: expected at most {_MOST:,} columns")
            for key, values in columns.items():
                values.append(said.get(key))
            count += 1
    first = [key for key in (*_ITEM, *_BEST) if key in columns]
    return {key: columns[key] for key in [*first, *(k for k in sorted(columns) if k not in first)]}


def _located(answer: Row) -> Row:
    """An answer of `localize`: the best pose, and what it is worth."""
    kept = ("index", "verdict", "explained", "entropy", "elsewhere", "complete")
    out = {key: answer[key] for key in kept}
    evidence = answer["evidence"]
    out |= {key: evidence[key] for key in ("misfit", "temperature", "readings", "found")}
    # Rows of an earlier version may lack these.
    out |= {key: evidence[key] for key in ("scale", "thinner", "bent") if key in evidence}
    for best in answer["hypotheses"][:1]:
        out |= {key: best[key] for key in ("x", "y", "theta", "mass", "log_likelihood")}
        for level in answer.get("protection", []):
            out[f"within_{level['share']:g}"] = level["metres"]
        out |= {f"covariance_{n}": best["covariance"][i][j] for n, (i, j) in _COVARIANCE.items()}
    for second in answer["hypotheses"][1:2]:
        out["second_mass"] = second["mass"]
    out |= _flat({key: answer[key] for key in ("truth", "error", "hit") if key in answer})
    return out


def flat(
    values: Mapping[str, object], between: str = ".", above: str = ""
) -> Iterator[tuple[str, object]]:
    """Name and value of everything in nested mappings.

    Examples
    --------
    >>> list(flat({"a": 1, "b": {"c": 2}}))
    [('a', 1), ('b.c', 2)]
    """
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flat(value, between, f"{above}{key}{between}")
        else:
            yield above + key, value


def _flat(answer: Row) -> Row:
    """Nested values side by side; without the map, which the item has."""
    said = {key: value for key, value in flat(answer, "_") if key != "map"}
    return {key: json.dumps(v) if isinstance(v, list) else v for key, v in said.items()}


_BEST = (
    "index", "verdict", "x", "y", "theta", "mass", "second_mass", "elsewhere", "explained",
    "misfit", "hit", "error_position", "error_heading", "truth_x", "truth_y", "truth_theta", "ms",
)  # fmt: skip


def _csv(columns: Columns) -> bytes:
    lines = zip(*columns.values(), strict=True)
    text = csv_text(map(_inert, line) for line in (columns, *lines))
    return text.encode("utf-8", "backslashreplace")


def _inert(value: object) -> object:
    """A cell that no spreadsheet takes for a formula: a text that begins like one gets a quote.

    Examples
    --------
    >>> [_inert(value) for value in ("=1+1.npz", "a=1", -2.5)]
    ["'=1+1.npz", 'a=1', -2.5]
    """
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def _parquet(columns: Columns) -> bytes:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ConfigError(
            "Parquet: needs pyarrow; install it with: pip install 'imgloc[parquet]'"
        ) from None
    buffer = pyarrow.BufferOutputStream()
    try:
        table = pyarrow.table(columns)
    except (pyarrow.ArrowException, UnicodeEncodeError) as e:
        raise OutputError(f"Parquet: a column has values of two kinds: {e}") from None
    pyarrow.parquet.write_table(table, buffer, compression="zstd")
    return bytes(buffer.getvalue())
