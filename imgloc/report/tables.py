"""Tables and a chart of the report, as HTML: from the plain values of ``results.json``."""

import html
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

_NAMES = {
    "cbml": "CBML", "cbml-o": "CBML-O", "ght": "GHT", "ght-v": "GHT-V", "beam": "beam, eq. 2",
    "ght-v once": "GHT-V, one vote per point", "ght-v eq. 8": "GHT-V, eq. 8 modelled",
}  # fmt: skip
_AXES = {"A": "A", "rho_m": "ρ<sub>m</sub>", "rho_theta": "ρ<sub>θ</sub>", "n": "n"}
_QUANTITIES = {
    "init_s": "init time", "init_work": "init, counted", "storage": "storage",
    "run_s": "run time", "work": "run, counted",
}  # fmt: skip


Row = Mapping[str, Any]


def index_table(rows: Sequence[Row]) -> str:
    """S of each method in each world, the paper's below it; the greatest S that there can be."""

    def cell(row: Row) -> str:
        index, bare = row["index"], row["bare"]
        said = _number(row["paper"])
        if bare:
            said = f"bare {_number(bare['value'])}{_floored(bare)}"
        if row["gain"]:
            gain = row["gain"]
            said = f"{_number(gain['value'], '+')} ± {_number(gain['standard_error'])}"
        error = _number(index["standard_error"]) + _floored(index)
        return f"<b>{_number(index['value'])}</b> ± {error}<br><span class=paper>{said}</span>"

    ceiling = {(r["world"], r["step_deg"]): r["log_poses"] for r in rows}
    note = "; ".join(f"{w}, {s:g}°: {v:.1f}" for (w, s), v in ceiling.items())
    return (
        _by_world(rows, cell)
        + f"<p class=note>The greatest S that there can be: {escape(note)}.</p>"
    )


def maximum_table(rows: Sequence[Row]) -> str:
    """Shares of trials in which the maximum is at the true pose, and next to it."""
    cells = ("exact", "its cell"), ("wide", "10 cm, 30°"), ("near", "± 1 cell")

    def cell(row: Row) -> str:
        return "<br>".join(_share(row[key]) for key, _ in cells)

    return _by_world(rows, cell, "<br>".join(label for _, label in cells))


def time_table(rows: Sequence[Row]) -> str:
    """Median times of a stack, milliseconds."""
    return _by_world(rows, lambda row: f"{row['cost']['ms']:.1f}")


def ratio_table(ratios: Sequence[Row]) -> str:
    """CPU times of two methods on the same scans, and their ratios."""
    lines = [
        f"<tr><th>{escape(r['world'])}<td>{_NAMES[r['method']]} / {_NAMES[r['rival']]}"
        f"<td>{r['ms']:.1f} / {r['rival_ms']:.1f} ms<td><b>{_number(r['value'])}</b>"
        for r in ratios
    ]
    return f"<table>{'</tr>'.join(lines)}</tr></table>"


def _by_world(rows: Sequence[Row], cell: Callable[[Row], str], label: str = "") -> str:
    """A table with a line for each method and a column for each world.

    `label`, of HTML, is a column of its own: what the lines of a cell are.
    """
    by = {(r["world"], r["method"]): r for r in rows}
    label = label and f"<td><span class=paper>{label}</span>"
    worlds, methods = (list(dict.fromkeys(r[key] for r in rows)) for key in ("world", "method"))
    places = {r["world"]: r["place"] for r in rows}
    head = "".join(
        f"<th>{escape(w)}<br><span class=paper>{escape(places[w])}</span>" for w in worlds
    )
    lines = []
    for method in methods:
        cells = "".join(f"<td>{cell(by[w, method])}" for w in worlds)
        lines.append(f"<tr><th>{escape(_NAMES.get(method, method))}{label}{cells}</tr>")
    return f"<table><tr><th>{label and '<th>'}{head}</tr>{''.join(lines)}</table>"


def chart(rows: Sequence[Row]) -> str:
    """The same as a picture: a dot with its interval for each, the paper's as a ring."""
    worlds = list(dict.fromkeys(r["world"] for r in rows))
    lines = [r for w in worlds for r in rows if r["world"] == w]
    values = [v for r in lines for v in (*r["interval"], r["paper"]) if v is not None]
    finite = [v for v in values if math.isfinite(v)]
    low, high = math.floor(min([*finite, 0])), math.ceil(max([*finite, 1]))
    left, right, step = 190, 690, 19

    def x(v: float) -> float:
        return float(left + (right - left) * (v - low) / (high - low))

    out, y = [], 8
    bottom = 30 * len(worlds) + step * len(lines) + 8
    for v in range(low, high + 1):
        out.append(f'<path class=grid d="M{x(v):.1f} 4V{bottom}"/>'
                   f'<text x="{x(v):.1f}" y="{bottom + 15}" class=mid>{v}</text>')  # fmt: skip
    for world in worlds:
        y += 18
        out.append(f'<text x="8" y="{y}" class=head>{escape(world)}</text>')
        for r in (r for r in lines if r["world"] == world):
            y += step
            s, (a, b) = r["index"]["value"], r["interval"]
            out.append(
                f'<text x="20" y="{y}">{escape(_NAMES.get(r["method"], r["method"]))}</text>'
            )
            if math.isfinite(a + b):
                out.append(f'<path class=bar d="M{x(a):.1f} {y - 4}H{x(b):.1f}"/>')
            out.append(f'<circle cx="{x(s):.1f}" cy="{y - 4}" r="4"/>')
            if r["paper"] is not None:
                out.append(f'<circle class=ring cx="{x(r["paper"]):.1f}" cy="{y - 4}" r="4"/>')
        y += 12
    caption = "S with its 95 % interval (dots) beside the paper's (rings), nats."
    return (
        f'<figure><div class=wide><svg viewBox="0 0 700 {bottom + 22}" role="img" '
        f'aria-label="{caption}">'
        f"{''.join(out)}</svg></div><figcaption>{caption}</figcaption></figure>"
    )


def claim_list(claims: Sequence[Row]) -> str:
    """What is said and whether it holds, as a list."""
    lines = [
        f"<li class={'yes' if c['holds'] else 'no'}>{formula(c['text'])} "
        f"<span class=paper>({formula(c['found'])})</span></li>"
        for c in claims
    ]
    return f"<ul class=claims>{''.join(lines)}</ul>"


def exponent_table(fits: Sequence[Row]) -> str:
    """Exponents, each beside the paper's."""
    at = {(f["method"], f["quantity"], f["axis"]): f for f in fits}
    axes = [a for a in _AXES if any(key[2] == a for key in at)]
    lines = []
    for quantity, label in _QUANTITIES.items():
        for method in dict.fromkeys(key[0] for key in at if key[1] == quantity):
            cells = []
            for axis in axes:
                fit = at.get((method, quantity, axis))
                said = "" if fit is None or fit["paper"] is None else f" ({fit['paper']:g})"
                cells.append(f"<td>{'–' if fit is None else _number(fit['exponent'])}"
                             f"<span class=paper>{said}</span>")  # fmt: skip
            lines.append(
                f"<tr><th>{label}: {escape(_NAMES.get(method, method))}{''.join(cells)}</tr>"
            )
    head = "".join(f"<th>{_AXES[a]}" for a in axes)
    return f"<table><tr><th>{head}</tr>{''.join(lines)}</table>"


def cost_table(samples: Sequence[Row], times: Sequence[Row]) -> str:
    """What each method takes where the measurement of the area begins: one copy of the world."""
    least = min(s["value"] for s in samples if s["axis"] == "A")
    lines = []
    for s, t in zip(samples, times, strict=True):
        if (s["axis"], s["value"]) != ("A", least):
            continue
        ms = [_number(None if t[k] is None else 1e3 * t[k]) for k in ("init_s", "run_s")]
        lines.append(
            f"<tr><th>{escape(_NAMES[s['method']])}<td>{ms[0]}<td>{s['storage'] / 1e3:,.0f}"
            f"<td>{ms[1]}<td>{s['work'] / 1e6:,.2f}</tr>"
        )
    head = "<th><th>init, ms<th>storage, kB<th>run, ms<th>votes or pixels, 10<sup>6</sup>"
    return f"<table><tr>{head}</tr>{''.join(lines)}</table>"


def _floored(index: Row) -> str:
    return f"<sup>†{index['floored']}</sup>" if index["floored"] else ""


def _share(share: Mapping[str, Any]) -> str:
    low, high = 100 * share["low"], 100 * share["high"]
    return f"{100 * share['value']:.0f} % <span class=paper>[{low:.0f}, {high:.0f}]</span>"


def _number(value: float | None, sign: str = "") -> str:
    """Two digits, with a minus sign that is one; a dash for what is not known."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{round(value, 2) + 0.0:{sign}.2f}".replace("-", "−")


def formula(text: str) -> str:
    """Text as HTML, with its powers raised and the paper's Greek letters.

    Examples
    --------
    >>> formula("A^1, rho_m^2.98 < 3")
    'A<sup>1</sup>, ρ<sub>m</sub><sup>2.98</sup> &lt; 3'
    """
    raised = re.sub(r"\^(-?[\d.]*\d)", r"<sup>\1</sup>", escape(text))
    for name, letter in _AXES.items():
        raised = raised.replace(name, letter) if len(name) > 1 else raised
    return raised


def escape(text: object) -> str:
    """Text as HTML."""
    return html.escape(str(text), quote=True)
