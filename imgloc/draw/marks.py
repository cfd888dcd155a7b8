"""Marks for what rays say: a shape for each kind, so that colour is not all that tells them."""

from imgloc.draw.svg import number
from imgloc.explain import KINDS, RayFit
from imgloc.model import FloatArray

#: Shapes of the ends of rays, drawn around the point.
SHAPES = {
    "agrees": "h0",
    "orientation": "m0-4.2l4.2 4.2l-4.2 4.2l-4.2-4.2z",
    "visibility": "m-3.4-3.4l6.8 6.8m0-6.8l-6.8 6.8",
    "unexplained": "m-3 0a3 3 0 1 0 6 0a3 3 0 1 0-6 0",
}


def marks(kind: str, at: FloatArray) -> str:
    """The ``d`` of a path with a shape at each of the points (N, 2), pixels."""
    return "".join(f"M{number(x)} {number(y)}{SHAPES[kind]}" for x, y in at.tolist())


def swatch(kind: str) -> str:
    """The mark of a kind of ray, for a legend; a box for rays that are only counted."""
    mark = f'<rect class="{kind}" x="-5" y="-5" width="10" height="10"/>'
    if kind in SHAPES:
        mark = f'<path class="end {kind}" d="M0 0{SHAPES[kind]}"/>'
    return f'<svg class="swatch" viewBox="-8 -8 16 16" aria-hidden="true">{mark}</svg>'


def share_bar(fit: RayFit) -> str:
    """How the rays of a scan divide, as one bar."""
    counts, x, parts = fit.counts, 0.0, []
    total = max(1, sum(counts.values()))
    for kind in KINDS:
        width = 100 * counts[kind] / total
        parts.append(
            f'<rect class="{kind}" x="{x:.3f}" width="{width:.3f}" height="10"><title>'
            f"{counts[kind]} {kind.replace('_', ' ')}</title></rect>"
        )
        x += width
    return (
        f'<svg class="share" viewBox="0 0 100 10" preserveAspectRatio="none">{"".join(parts)}</svg>'
    )
