"""One self-contained HTML page that reads like the paper's Sec. VI, with today's numbers.

The page needs no other file and no network: style and pictures are inside, scripts there are
none. It is made of the same plain values that ``results.json`` holds, by the templates beside
this file: ``page.html`` has the text, ``tables.html`` the tables, ``page.css`` what style it has
beside that of imgloc's own pages.
"""

import base64
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import jinja2
from markupsafe import Markup, escape

NAMES = {
    "cbml": "CBML", "cbml-o": "CBML-O", "ght": "GHT", "ght-v": "GHT-V", "beam": "beam, eq. 2",
    "ght-v once": "GHT-V, one vote per point",
}  # fmt: skip
AXES = {
    "A": Markup("A"), "rho_m": Markup("ρ<sub>m</sub>"), "rho_theta": Markup("ρ<sub>θ</sub>"),
    "n": Markup("n"),
}  # fmt: skip

QUANTITIES = {
    "init_s": "init time", "init_work": "init, counted", "storage": "storage",
    "run_s": "run time", "work": "run, counted",
}  # fmt: skip

Row = Mapping[str, Any]


def render_report(results: Row, pictures: Mapping[str, bytes]) -> str:
    """The page as HTML, of what is in ``results.json`` and of PNG files by name."""
    encoded = {name: base64.b64encode(png).decode("ascii") for name, png in pictures.items()}
    return templates().get_template("page.html").render(results=results, pictures=encoded)


def templates() -> jinja2.Environment:
    """The templates, with what they call: everything is escaped unless it is marked up."""
    env = jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [jinja2.PackageLoader("tools.paper", "."), jinja2.PackageLoader("imgloc.output")]
        ),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    env.globals |= {
        "axes": AXES,
        "by_key": lambda fits: {(f["quantity"], f["method"], f["axis"]): f for f in fits},
        "ceilings": lambda rows: {(r["world"], r["step_deg"]): r["log_poses"] for r in rows},
        "chart": chart,
        "costs": costs,
        "quantities": QUANTITIES,
    }
    env.filters |= {
        "formula": formula,
        "name": lambda method: NAMES.get(method, method),
        "number": number,
        "share": share,
    }
    return env


def chart(rows: Sequence[Row]) -> dict[str, Any]:
    """Where everything is on a picture of S, pixels: a line for each row, worlds one by one."""
    worlds = list(dict.fromkeys(r["world"] for r in rows))
    values = [v for r in rows for v in (*r["interval"], r["paper"]) if v is not None]
    finite = [v for v in values if math.isfinite(v)]
    low, high = math.floor(min([*finite, 0])), math.ceil(max([*finite, 1]))

    def x(v: float | None) -> float | None:
        known = v is not None and math.isfinite(v)
        return round(190 + 500 * (v - low) / (high - low), 1) if known and v is not None else None

    heads, lines, y = [], [], 8
    for world in worlds:
        y += 18
        heads.append((world, y))
        for r in (r for r in rows if r["world"] == world):
            y += 19
            ends = tuple(map(x, r["interval"]))
            lines.append((r["method"], y, x(r["index"]["value"]), ends, x(r["paper"])))
        y += 12
    ticks = [(v, x(v)) for v in range(low, high + 1)]
    return {"heads": heads, "lines": lines, "ticks": ticks, "bottom": y + 8}


def costs(counted: Sequence[Row], timed: Sequence[Row]) -> list[tuple[Row, Row]]:
    """Counts and times of each method where the area begins to grow: one copy of the world."""
    least = min((s["value"] for s in counted if s["axis"] == "A"), default=0)
    pairs = zip(counted, timed, strict=True)
    return [(s, t) for s, t in pairs if (s["axis"], s["value"]) == ("A", least)]


def number(value: float | None, sign: str = "") -> str:
    """Two digits, with a minus sign that is one; a dash for what is not known.

    Examples
    --------
    >>> number(-0.001), number(-1.5), number(0.25, "+"), number(None)
    ('0.00', '−1.50', '+0.25', '–')
    """
    if value is None or not math.isfinite(value):
        return "–"
    return f"{round(value, 2) + 0.0:{sign}.2f}".replace("-", "−")


def share(value: Row) -> Markup:
    """A share with its interval."""
    low, high = 100 * value["low"], 100 * value["high"]
    said = '{:.0f} % <span class="paper">[{:.0f}, {:.0f}]</span>'
    return Markup(said.format(100 * value["value"], low, high))  # noqa: S704  (numbers)


def formula(text: str) -> Markup:
    """Text with its powers raised and the paper's Greek letters.

    Examples
    --------
    >>> print(formula("A^1, rho_m^2.98 < 3"))
    A<sup>1</sup>, ρ<sub>m</sub><sup>2.98</sup> &lt; 3
    """
    raised = re.sub(r"\^(-?[\d.]*\d)", r"<sup>\1</sup>", str(escape(text)))
    for name in ("rho_m", "rho_theta"):
        raised = raised.replace(name, AXES[name])
    return Markup(raised)  # noqa: S704  (escaped above)
