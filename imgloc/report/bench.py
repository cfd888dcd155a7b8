"""The benchmark's figures as Markdown."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from imgloc.likelihood.correlate import ENGINES

Row = Mapping[str, Any]


def bench_tables(results: Mapping[str, Any]) -> str:
    """A table of each part that was measured by :func:`imgloc.experiments.bench_run.run_bench`.

    Examples
    --------
    >>> row = {"side": 4000, "cell": 0.05, "seconds": 5.31, "rss_mib": 565.2}
    >>> print(bench_tables({"machine": {"cores": 2}, "memory": [row]}))
    cores 2
    <BLANKLINE>
    | cells a side | of m | imgloc localize, s | peak MiB |
    |---:|---:|---:|---:|
    | 4000 | 0.05 | 5.3 | 565 |
    """
    parts = [", ".join(f"{key} {value}" for key, value in results["machine"].items())]
    parts += [table(results[key]) for key, table in _TABLES.items() if key in results]
    for key in ("auto_over_best", "floors", "exponents"):
        if key in results:
            said = ", ".join(f"{name} {_number(v)}" for name, v in results[key].items())
            parts.append(f"{_TITLES[key]}: {said or 'not measured'}")
    return "\n\n".join(parts)


_TITLES = {
    "auto_over_best": "auto / best",
    "floors": "the same in C, ns",
    "exponents": "exponents of growth in the area",
}


def _costs(rows: Sequence[Row]) -> str:
    return _table(
        "case | ns per | ms | spread",
        (
            (
                r["case"],
                f"{r['ns']:.4f} {r['unit']}",
                f"{r['ms']:.2f}",
                f"{100 * r['spread']:.0f} %",
            )
            for r in rows
        ),
    )


def _engines(rows: Sequence[Row]) -> str:
    names = (*ENGINES, "auto")
    head = " | ".join(f"{name}, ms" for name in names)
    return _table(
        f"cells | reach | rays | {head} | best | auto / best",
        (
            (r["size"], r["reach"], r["rays"], *(f"{r['ms'][name]:.2f}" for name in names),
             r["best"], f"{r['ratio']:.2f}")
            for r in rows
        ),
    )  # fmt: skip


def _answers(rows: Mapping[str, Row]) -> str:
    return _table(
        "localize on | ms | p99 / median | prepare, s",
        (
            (name, f"{r['median_ms']:.0f}", f"{r['p99_over_median']:.2f}", f"{r['prepare_s']:.2f}")
            for name, r in rows.items()
        ),
    )


def _growth(rows: Sequence[Row]) -> str:
    return _table(
        "area, m² | ms | prepare, s | peak MiB",
        (
            (f"{r['area']:.0f}", f"{r['ms']:.0f}", f"{r['prepare_s']:.2f}", f"{r['rss_mib']:.0f}")
            for r in rows
        ),
    )


def _memory(rows: Sequence[Row]) -> str:
    return _table(
        "cells a side | of m | imgloc localize, s | peak MiB",
        ((r["side"], f"{r['cell']:g}", f"{r['seconds']:.1f}", f"{r['rss_mib']:.0f}") for r in rows),
    )


_TABLES: Mapping[str, Callable[[Any], str]] = {
    "costs": _costs,
    "engines": _engines,
    "localize": _answers,
    "growth": _growth,
    "memory": _memory,
}


def _table(head: str, rows: Iterable[Sequence[object]]) -> str:
    lines = [f"| {head} |", "|" + "---:|" * (head.count("|") + 1)]
    return "\n".join(lines + [f"| {' | '.join(map(str, row))} |" for row in rows])


def _number(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
