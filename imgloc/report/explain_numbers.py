"""The numbers of an explanation: tables, how each number comes about, and covariances."""

import math
from collections.abc import Iterator

import numpy as np

from imgloc.draw.explain import draw_covariance
from imgloc.explain import Explanation
from imgloc.geometry import rotate_covariance
from imgloc.model import Pose2D
from imgloc.options import FUSED
from imgloc.report.verdicts import likely, percent, question


def numbers(e: Explanation) -> Iterator[str]:
    """The questions of the verdict, and what they are computed from."""
    evidence = e.answer.evidence
    yield "<h2>The numbers behind the verdict</h2>"
    lines = []
    for k, check in enumerate(evidence.checks, start=1):
        ask, found, needed = question(check)
        decided = k == len(evidence.checks)
        mark = "<td class=ok>✓" if check.holds else "<td class=ko>✗"
        lines.append(
            f"<tr{' class=decided' if decided else ''}>{mark}<td>{ask}<td>{found}<td>{needed}"
            f"<td>{'this decides' if decided else ''}</tr>"
        )
    head = "<tr><th><th>asked<th>found<th>needed<th></tr>"
    yield f"<table class=checks>{head}{''.join(lines)}</table>"
    if not e.fits:
        return
    first = e.fits[0].hypothesis.log_likelihood
    rows = "".join(
        f"<tr><th>{k}<td>{percent(f.before)}<td>{percent(f.hypothesis.mass)}"
        f"<td>{minus(f.hypothesis.log_likelihood, 1)}<td>{minus(f.per_reading, 3)}"
        f"<td>{minus(first - f.hypothesis.log_likelihood, 1)}</tr>"
        for k, f in enumerate(e.fits, start=1)
    )
    yield (
        "<table><tr><th><th>probability,<br>if it is one of these<th>probability<br>in the end"
        "<th>log-likelihood,<br>nats<th>score per reading,<br>nats<th>behind the first,<br>nats"
        f"</tr>{rows}</table>"
    )
    rest = 1 - e.answer.elsewhere - sum(f.hypothesis.mass for f in e.fits)
    if rest >= 0.0005:
        yield f"<p class=note>Poses that are not listed hold {percent(rest)} together.</p>"
    yield f"<ul>{''.join(f'<li>{line}</li>' for line in _reasons(e))}</ul>"


def _reasons(e: Explanation) -> Iterator[str]:
    """How the numbers come about, as sentences of HTML."""
    evidence = e.answer.evidence
    trust, model = e.options.trust, e.options.fused.model
    yield (
        f"<b>Misfit {evidence.misfit:.3f} nats per reading.</b> A reading that ends exactly on "
        f"a wall scores {model.best:.3f}; those of the best pose score "
        f"{minus(e.fits[0].per_reading, 3)} on average, of {evidence.readings} readings."
    )
    if e.options.method == FUSED:
        yield (
            f"<b>Temperature {evidence.temperature.value:.2f}</b> = {trust.temperature:g} + "
            f"{trust.strain:g} × misfit. Errors of neighbouring readings are not independent, so "
            "differences of log-likelihood are divided by this before they become probabilities"
            + _margin(e)
        )
    elif e.options.exact:
        yield (
            f"<b>Temperature {evidence.temperature.value:.2f}.</b> Logarithms of scores are "
            "divided by it; probabilities are shares of the separated poses that score best."
        )
    else:
        yield (
            f"<b>Temperature {evidence.temperature.value:.2f}.</b> The stack's (log-)values are "
            "divided by it; its log-likelihoods are relative to all poses being equally probable."
        )
    constant, per_nat, per_share = trust.elsewhere
    share = 1 - e.fits[0].before if e.options.method == FUSED else 0.0
    odds = constant + per_nat * max(0.0, evidence.misfit) + per_share * share
    yield (
        f"<b>Elsewhere {percent(e.answer.elsewhere)}.</b> Log-odds {minus(constant, 1)} "
        f"+ {per_nat:g} × misfit + {per_share:g} × {share:.3f} (what the best does not hold) "
        f"= {minus(odds, 2)}. A scan of another place fits badly, and several poses equally badly."
    )


def _margin(e: Explanation) -> str:
    if len(e.fits) < 2:
        return ". There is no second pose."
    margin = e.fits[0].hypothesis.log_likelihood - e.fits[1].hypothesis.log_likelihood
    worth = margin / e.answer.evidence.temperature.value
    return (
        f": the second is {margin:.1f} nats behind, worth {worth:.2f}: it is "
        f"{likely(math.exp(min(worth, 99)))}."
    )


def spread(e: Explanation) -> Iterator[str]:
    """Covariances as ellipses and as standard deviations."""
    if not e.fits:
        return
    yield "<h2>How precisely</h2>"
    yield (
        "<p>If a pose is the right one, how far it may be off. Blue: one and two standard "
        "deviations of the position, each picture at its own scale; orange: two of the heading; "
        "the line points along it.</p>"
    )
    figures = []
    for k, fit in enumerate(e.fits, start=1):
        pose, covariance = fit.hypothesis.pose, fit.hypothesis.covariance
        along, across, turn = np.sqrt(np.diag(rotate_covariance(covariance, -pose.theta)))
        figures.append(
            f"<figure>{draw_covariance(fit.hypothesis)}<figcaption><b>{k}.</b> ± "
            f"{length(along)} along, ± {length(across)} across its heading, ± "
            f"{math.degrees(turn):.2f}°</figcaption></figure>"
        )
    yield f"<div class=spread>{''.join(figures)}</div>"


def describe(pose: Pose2D) -> str:
    """A pose in words."""
    return (
        f"x {minus(pose.x, 3)} m, y {minus(pose.y, 3)} m, "
        f"heading {minus(math.degrees(pose.theta), 1)}°"
    )


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
