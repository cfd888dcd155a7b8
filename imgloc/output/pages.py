"""One self-contained HTML page that explains one answer: no script, no network, no other file.

Its words are in ``templates/words.html``, its layout in ``templates/explain.html``; here numbers
become text.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from imgloc.__about__ import __version__
from imgloc.answers.explain import Explanation
from imgloc.features.scanpoints import scan_xy
from imgloc.geometry import in_grid_frame, rotate_covariance
from imgloc.model import Hypothesis, Pose2D, base_of
from imgloc.output import svg
from imgloc.output.export import flat
from imgloc.output.pictures import draw_hypotheses, draw_likelihood
from imgloc.pose import difference

HEADLINES = {
    "unique": "One pose explains this scan.",
    "ambiguous": "Several poses explain this scan.",
    "no-match": "No pose on this map explains this scan.",
    "invalid": "Too few readings to say anything.",
}

DRAWN = 12
"""Hypotheses that have pictures of their own; the table has all."""


def render_explanation(
    e: Explanation, title: str, *, truth: Pose2D | None = None, hints: Sequence[str] = (),
    version: str = __version__,
) -> str:  # fmt: skip
    """Write the page, HTML; its `title` names the scan and the map.

    With the `truth`, the pose of the sensor in the map frame, the error is stated. The `hints` name
    what to look at next.
    """
    poses, rays = [f.hypothesis.pose for f in e.fits], [f.rays for f in e.fits]
    local = None if truth is None else in_grid_frame(truth, e.grid)
    some, points = [f.hypothesis for f in e.fits[:DRAWN]], scan_xy(e.scan)[e.scan.valid]
    overview = draw_hypotheses(e.grid, points, some, truth=local, title=title)
    return svg.ENVIRONMENT.get_template("explain.html").render(
        e=e,
        title=title,
        truth=truth,
        hints=hints,
        version=version,
        drawn=DRAWN,
        headlines=HEADLINES,
        overview=svg.data_of(overview.image),
        views=svg.window(poses, rays, 400.0) if rays else [],
    )


def likely(times: float) -> str:
    """Compare a second hypothesis with the first.

    Examples
    --------
    >>> likely(1.03), likely(3.2), likely(151.2)
    ('as likely', '3.2 times less likely', '151 times less likely')
    """
    if times < 1.05:
        return "as likely"
    return f"{times:.3g} times less likely" if times < 999 else "more than 1000 times less likely"


def apart(a: Pose2D, b: Pose2D) -> str:
    """The distance of one pose from another, in words."""
    away, turn = difference(a, b)
    return f"{away:.1f} m and {math.degrees(turn):.0f}°"


def percent(share: float) -> str:
    """A probability as text, never rounded to certainty.

    Examples
    --------
    >>> percent(0.9), percent(0.99996), percent(1.0), percent(2e-5), percent(0.123)
    ('90 %', '> 99.9 %', '100 %', '< 0.1 %', '12.3 %')
    """
    if share in (0.0, 1.0):
        return f"{100 * share:.0f} %"
    if share < 0.001:
        return "< 0.1 %"
    return "> 99.9 %" if share > 0.999 else f"{round(100 * share, 1):g} %"


def deviations(hypothesis: Hypothesis) -> str:
    """Standard deviations along and across the heading, and of it, as text."""
    turned = rotate_covariance(hypothesis.covariance, -hypothesis.pose.theta)
    along, across, turn = np.sqrt(np.diag(turned))
    place = f"± {length(along)} along, ± {length(across)} across its heading"
    return f"{place}, ± {math.degrees(turn):.2f}°"


def describe(pose: Pose2D) -> str:
    """A pose in words."""
    heading = minus(math.degrees(pose.theta), 1)
    return f"x {minus(pose.x, 3)} m, y {minus(pose.y, 3)} m, heading {heading}°"


def short(pose: Pose2D) -> str:
    """A pose for a narrow place."""
    return f"{minus(pose.x, 2)}, {minus(pose.y, 2)} m, {minus(math.degrees(pose.theta), 1)}°"


def minus(value: float, digits: int) -> str:
    """A number with a minus sign that is one, and no minus zero.

    Examples
    --------
    >>> minus(-1.25, 1), minus(-0.04, 1)
    ('−1.2', '0.0')
    """
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")


def length(metres: float) -> str:
    """A standard deviation in a fitting unit.

    Examples
    --------
    >>> length(0.0042), length(0.031), length(1.5)
    ('4 mm', '3.1 cm', '1.50 m')
    """
    if metres < 0.01:
        return f"{1000 * metres:.0f} mm"
    return f"{100 * metres:.1f} cm" if metres < 1 else f"{metres:.2f} m"


def known_words(prior: Mapping[str, Any]) -> str:
    """The prior knowledge, in words, of the parameter ``prior`` of an answer.

    Examples
    --------
    >>> known_words({"heading": {"theta": 0.0, "tolerance": 0.5}, "clearance": 0.3})
    'heading 0.0° ± 28.6°, at least 0.3 m from what is not free'
    """
    said = []
    for key, value in prior.items():
        words = f"{key} {value}"
        if key == "clearance":
            words = f"at least {value:g} m from what is not free"
        elif key == "region":
            words = f"in a region of {value['cells']:,} cells"
        elif isinstance(value, Mapping) and "theta" in value:
            turn = f"{minus(math.degrees(value['theta']), 1)}°"
            words = f"heading {turn} ± {math.degrees(value['tolerance']):.1f}°"
            if "radius" in value:
                place = f"{minus(value['x'], 2)}, {minus(value['y'], 2)} m"
                words = f"within {value['radius']:g} m of {place}, {words}"
        elif isinstance(value, list) and isinstance(value[0], Mapping):
            words = "weighed by " + " or ".join(
                f"{minus(one['x'], 2)}, {minus(one['y'], 2)} m ± {one['metres']:g} m"
                for one in value
            )
        said.append(words)
    return ", ".join(said)


_FILTERS: tuple[Callable[..., object], ...] = (
    apart, base_of, describe, deviations, difference, flat, known_words, likely, math.degrees,
    math.exp, percent, short,
)  # fmt: skip
_DRAWINGS: tuple[Callable[..., object], ...] = (svg.draw_scan, svg.draw_rays, svg.draw_covariance)
svg.ENVIRONMENT.filters |= {f.__name__: f for f in _FILTERS} | {
    "digits": minus,
    "png": lambda likelihood, grid: svg.data_of(draw_likelihood(likelihood, grid).image),
}
svg.ENVIRONMENT.globals |= {f.__name__: f for f in _DRAWINGS}
