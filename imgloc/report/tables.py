"""Tables and a chart of the report, as HTML: from the plain values of ``results.json``."""

import html
import math
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
        index = row["index"]
        floored = f"<sup>†{index['floored']}</sup>" if index["floored"] else ""
        said = _number(row["paper"])
        if row["bare"]:
            said = f"bare {_number(row['bare']['value'])}<sup>†{row['bare']['floored']}</sup>"
        return (
            f"<b>{_number(index['value'])}</b> ± {_number(index['standard_error'])}{floored}"
            f"<br><span class=paper>{said}</span>"
        )

    ceiling = {(r["world"], r["step_deg"]): r["log_poses"] for r in rows}
    note = "; ".join(f"{w}, {s:g}°: {v:.1f}" for (w, s), v in ceiling.items())
    return (
        _by_world(rows, cell)
        + f"<p class=note>The greatest S that there can be: {escape(note)}.</p>"
    )


def maximum_table(rows: Sequence[Row]) -> str:
    """Shares of trials in which the maximum is at the true pose, and next to it."""

    def cell(row: Row) -> str:
        return f"{_share(row['exact'])}<br>{_share(row['near'])}"

    return _by_world(rows, cell)


def time_table(rows: Sequence[Row]) -> str:
    """Median times of a stack, milliseconds."""
    return _by_world(rows, lambda row: f"{row['cost']['ms']:.1f}")


def _by_world(rows: Sequence[Row], cell: Callable[[Row], str]) -> str:
    """A table with a line for each method and a column for each world."""
    by = {(r["world"], r["method"]): r for r in rows}
    worlds, methods = (list(dict.fromkeys(r[key] for r in rows)) for key in ("world", "method"))
    places = {r["world"]: r["place"] for r in rows}
    head = "".join(
        f"<th>{escape(w)}<br><span class=paper>{escape(places[w])}</span>" for w in worlds
    )
    lines = []
    for method in methods:
        cells = "".join(f"<td>{cell(by[w, method])}" for w in worlds)
        lines.append(f"<tr><th>{escape(_NAMES.get(method, method))}{cells}</tr>")
    return f"<table><tr><th>{head}</tr>{''.join(lines)}</table>"


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
        f'<figure><svg viewBox="0 0 700 {bottom + 22}" role="img" aria-label="{caption}">'
        f"{''.join(out)}</svg><figcaption>{caption}</figcaption></figure>"
    )


def claim_list(claims: Sequence[Row]) -> str:
    """What is said and whether it holds, as a list."""
    lines = [
        f"<li class={'yes' if c['holds'] else 'no'}>{escape(c['text'])} "
        f"<span class=paper>({escape(c['found'])})</span></li>"
        for c in claims
    ]
    return f"<ul class=claims>{''.join(lines)}</ul>"


def exponent_table(complexity: Mapping[str, Any]) -> str:
    """Exponents, each beside the paper's."""
    fits = {(f["method"], f["quantity"], f["axis"]): f for f in complexity["fits"]}
    axes = [a for a in _AXES if any(key[2] == a for key in fits)]
    lines = []
    for quantity, label in _QUANTITIES.items():
        for method in dict.fromkeys(key[0] for key in fits if key[1] == quantity):
            cells = []
            for axis in axes:
                fit = fits.get((method, quantity, axis))
                said = "" if fit is None or fit["paper"] is None else f" ({fit['paper']:g})"
                cells.append(f"<td>{'–' if fit is None else _number(fit['exponent'])}"
                             f"<span class=paper>{said}</span>")  # fmt: skip
            lines.append(
                f"<tr><th>{label}: {escape(_NAMES.get(method, method))}{''.join(cells)}</tr>"
            )
    head = "".join(f"<th>{_AXES[a]}" for a in axes)
    world = f"<p class=note>World: {escape(complexity['world'])}.</p>"
    return f"<table><tr><th>{head}</tr>{''.join(lines)}</table>{world}"


def _share(share: Mapping[str, Any]) -> str:
    low, high = 100 * share["low"], 100 * share["high"]
    return f"{100 * share['value']:.0f} % <span class=paper>[{low:.0f}, {high:.0f}]</span>"


def _number(value: float | None) -> str:
    """Two digits, with a minus sign that is one; a dash for what is not known."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.2f}".replace("-", "−")


def escape(text: object) -> str:
    """Text as HTML."""
    return html.escape(str(text), quote=True)
