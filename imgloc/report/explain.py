"""One self-contained HTML page that explains one answer: no script, no network, no other file."""

import base64
from collections.abc import Iterator, Mapping, Sequence

from imgloc.draw.answers import draw_likelihood
from imgloc.draw.explain import (
    draw_overview,
    draw_rays,
    draw_scan,
    window,
)
from imgloc.draw.marks import share_bar, swatch
from imgloc.explain import KINDS, Explanation, HypothesisFit, Layer
from imgloc.io.images import encode_png
from imgloc.options import FUSED
from imgloc.report.explain_numbers import describe, numbers, short, spread
from imgloc.report.explain_style import EXPLAIN_STYLE
from imgloc.report.style import STYLE
from imgloc.report.tables import escape
from imgloc.report.verdicts import (
    HEADLINES,
    KIND_NAMES,
    KIND_NOTES,
    MARKS,
    percent,
    why,
)

_LAYERS = {
    "cbml": "Where the ends of the readings fall on walls (CBML)",
    "cbml-o": "Where the ends and their normals fit (CBML-O)",
    "ght": "Where pairs of oriented points vote (GHT)",
    "ght-v": "Where pairs of oriented points vote, if the map lets the ray through (GHT-V)",
    "beam": "Where the ranges fit (the beam model, eq. 2)",
}


def render_explanation(
    e: Explanation, title: str, facts: Sequence[tuple[str, str]] = (), version: str = ""
) -> str:
    """Write the page.

    Parameters
    ----------
    e : Explanation
    title : str
        What was localized where.
    facts : sequence of (str, str)
        More to be listed beside the pose, names and values.
    version : str
        Of imgloc.

    Returns
    -------
    str
        HTML.
    """
    parts = [
        f"<h1>{escape(title)}</h1>",
        "<p class=meta>Where on this map was this laser scan taken? imgloc compares the scan with "
        "the map at every pose, without an initial guess.</p>",
        _headline(e),
        _facts(e, facts),
        *_places(e),
        *_likelihoods(e),
        *numbers(e),
        *spread(e),
        _details(e),
        f"<p class=meta>imgloc {escape(version)}</p>",
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}: {escape(e.answer.verdict)}</title>"
        f"<style>{STYLE}{EXPLAIN_STYLE}</style></head>\n<body><main>\n"
        + "\n".join(parts)
        + "\n</main></body></html>\n"
    )


def _headline(e: Explanation) -> str:
    verdict = e.answer.verdict
    late = " The search ran out of time; it may have missed better poses."
    return (
        f'<div class="verdict {verdict}"><span class=mark aria-hidden=true>{MARKS[verdict]}</span>'
        f"<div><span class=word>{verdict}</span><h2>{HEADLINES[verdict]}</h2>"
        f"<p>{escape(why(e))}{'' if e.answer.complete else late}</p></div></div>"
    )


def _facts(e: Explanation, more: Sequence[tuple[str, str]]) -> str:
    """The pose, how sure, and the scan as it came."""
    counts = e.scan.counts
    rows: list[tuple[str, str]] = []
    if e.fits:
        sure = e.answer.verdict in ("unique", "ambiguous")
        rows.append(("Pose of the sensor" if sure else "Best guess", describe(e.fits[0].pose)))
        rows.append(("Probability", percent(e.fits[0].hypothesis.mass)))
        rows.append(("Elsewhere", f"{percent(e.answer.elsewhere)}: at none of the poses found"))
        rows.append(
            (
                "Readings explained",
                f"{percent(e.answer.explained)} of {e.answer.evidence.readings} scored",
            )
        )
    rows += more
    used = ", ".join(f"{n} {key.replace('_', ' ')}" for key, n in counts.items() if n)
    rows.append(("Readings", used or "none"))
    prior = e.answer.parameters.get("prior")
    if isinstance(prior, Mapping) and prior:
        known = ", ".join(f"{key} {value}" for key, value in flat(prior))
        rows.append(("Known beforehand", known))
    cells = "".join(
        f"<dt>{escape(name)}</dt><dd{' class=big' if k == 0 and e.fits else ''}>{escape(text)}</dd>"
        for k, (name, text) in enumerate(rows)
    )
    return (
        f"<div class=facts><dl>{cells}</dl><figure class=scan>{draw_scan(e.scan)}"
        "<figcaption>The scan as the sensor sees it, forward up.</figcaption></figure></div>"
    )


def _places(e: Explanation) -> Iterator[str]:
    """The map with all hypotheses, and each of them ray by ray."""
    hypotheses, rays = [f.hypothesis for f in e.fits], [f.rays for f in e.fits]
    numbered = (
        " Each numbered disc is a pose that fits, its nose along the heading; the blue dots are "
        "the scan at the best one."
    )
    yield f"<h2>{'Where on the map' if e.fits else 'The map'}</h2>"
    yield (
        f"<figure><div class='wide over'>{draw_overview(e.grid, hypotheses, rays)}</div>"
        "<figcaption>Walls are dark, free space white, unknown space grey."
        f"{numbered if e.fits else ''}</figcaption></figure>"
    )
    if not e.fits:
        return
    yield "<h2>Ray by ray</h2>"
    yield (
        "<p>The scan laid on the map at each pose, best first. Each ray ends in a mark for what "
        "it says about the pose.</p>"
    )
    items = "".join(
        f"<li>{swatch(kind)}<span><b>{KIND_NAMES[kind]}</b>: {KIND_NOTES[kind]}</span></li>"
        for kind in KINDS
    )
    yield f"<ul class=legend>{items}</ul>"
    views = window([h.pose for h in hypotheses], rays, 400.0)
    cards = "".join(
        f"<figure class=card><h3><span>{k}. {percent(fit.hypothesis.mass)}</span>"
        f"<span class=paper>{short(fit.pose)}</span></h3>"
        f"{draw_rays(e.grid, fit.hypothesis, fit.rays, view, str(k))}{share_bar(fit.rays)}"
        f"{_counts(fit)}</figure>"
        for k, (fit, view) in enumerate(zip(e.fits, views, strict=True), start=1)
    )
    yield f"<div class=cards>{cards}</div>"
    if e.options.method == FUSED:
        yield (
            "<p class=note>The score that ranks the poses asks where a ray ends and whether a "
            "wall is in its way. Orientation is what GHT-V votes with when it proposes them.</p>"
        )
    else:
        yield (
            "<p class=note>Drawn at the poses as listed: no finer than the cells and headings of "
            f"{escape(e.options.method)}'s stack.</p>"
        )


def _counts(fit: HypothesisFit) -> str:
    total = max(1, len(fit.rays.kind))
    rows = "".join(
        f"<tr><td>{swatch(kind)} {KIND_NAMES[kind]}<td>{n}<td>{100 * n / total:.0f} %</tr>"
        for kind, n in fit.rays.counts.items()
        if n
    )
    return f"<table>{rows}</table>"


def _likelihoods(e: Explanation) -> Iterator[str]:
    if not e.layers:
        return
    yield "<h2>The likelihood of every place</h2>"
    yield (
        "<p>For each place the best over all headings: black is the highest, white low, turquoise "
        "exactly zero or not searched; walls are brown. "
        + (
            "These two propose where to look; a finer score decides.</p>"
            if e.options.method == FUSED
            else "</p>"
        )
    )
    yield f"<div class=pair>{''.join(_layer(e, layer) for layer in e.layers)}</div>"


def _layer(e: Explanation, layer: Layer) -> str:
    about = f"<b>{_LAYERS[layer.name]}.</b> {escape(layer.about)}"
    if layer.likelihood is None:
        return f"<figure><figcaption>{about}</figcaption></figure>"
    data = base64.b64encode(encode_png(draw_likelihood(layer.likelihood, grid=e.grid)))
    return (
        f'<figure><img alt="{_LAYERS[layer.name]}" src="data:image/png;base64,'
        f'{data.decode("ascii")}"><figcaption>{about}</figcaption></figure>'
    )


def _details(e: Explanation) -> str:
    times = ", ".join(f"{escape(key)} {ms:.0f} ms" for key, ms in e.answer.timings_ms.items())
    entropy = f" Entropy {e.answer.entropy:.3f} nats." if e.fits else ""
    rows = "".join(
        f"<tr><th>{escape(key)}<td>{escape(value)}</tr>" for key, value in flat(e.answer.parameters)
    )
    return (
        f"<h2>For the record</h2><p>Time: {times or 'not taken'}.{entropy}</p>"
        "<details><summary>All parameters that decided this answer</summary>"
        f"<table>{rows}</table></details>"
    )


def flat(values: Mapping[str, object], above: str = "") -> Iterator[tuple[str, object]]:
    """Name and value of everything in nested mappings.

    Examples
    --------
    >>> list(flat({"a": 1, "b": {"c": 2}}))
    [('a', 1), ('b.c', 2)]
    """
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value
