"""One self-contained HTML page that explains one answer: no script, no network, no other file.

What it says is here, how it is laid out in ``templates/explain.html``.
"""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from imgloc import __version__
from imgloc.explain import Explanation, Layer
from imgloc.geometry import base_of, rotate_covariance
from imgloc.model import Check, Hypothesis, Pose2D
from imgloc.output.pictures import draw_likelihood
from imgloc.output.svg import (
    ENVIRONMENT,
    data_of,
    draw_covariance,
    draw_overview,
    draw_rays,
    draw_scan,
    window,
)
from imgloc.output.tables import difference

HEADLINES = {
    "unique": "One pose explains this scan.",
    "ambiguous": "Several poses explain this scan.",
    "no-match": "No pose on this map explains this scan.",
    "invalid": "Too few readings to say anything.",
}


def render_explanation(
    e: Explanation,
    title: str,
    *,
    truth: Pose2D | None = None,
    mount: Pose2D | None = None,
    version: str = __version__,
) -> str:
    """Write the page.

    Parameters
    ----------
    e : Explanation
    title : str
        What was localized where.
    truth : Pose2D, optional
        True pose of the sensor in the map frame, to state the error.
    mount : Pose2D, optional
        Pose of the sensor on the robot, to state the robot's.
    version : str
        Of imgloc.

    Returns
    -------
    str
        HTML.
    """
    answer, poses = e.answer, [f.hypothesis.pose for f in e.fits]
    views = window(poses, [f.rays for f in e.fits], 400.0) if e.fits else []
    return ENVIRONMENT.get_template("explain.html").render(
        e=e,
        title=title,
        version=version,
        headline=HEADLINES[answer.verdict],
        why=why(e),
        facts=_facts(e, truth, mount),
        overview=draw_overview(e.grid, poses, e.fits[0].rays if e.fits else None),
        cards=list(zip(e.fits, views, strict=True)),
        layers=[_layer(e, layer) for layer in e.layers],
        checks=[(check.holds, *question(check)) for check in answer.evidence.checks],
        margin=_margin(e),
        times=", ".join(f"{key} {ms:.0f} ms" for key, ms in answer.timings_ms.items()),
        parameters=flat(answer.parameters),
    )


def _facts(e: Explanation, truth: Pose2D | None, mount: Pose2D | None) -> list[tuple[str, str]]:
    """The pose, how sure, and the scan as it came."""
    rows: list[tuple[str, str]] = []
    pose = e.answer.pose
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
    if pose is not None and mount is not None:
        rows.append(("Pose of the robot", describe(base_of(pose, mount))))
    if truth is not None:
        rows.append(("True pose of the sensor", describe(truth)))
    if pose is not None and truth is not None:
        away, turned = difference(pose, truth)
        rows.append(("Error", f"{away:.3f} m, {math.degrees(turned):.2f}°"))
    used = ", ".join(f"{n} {key.replace('_', ' ')}" for key, n in e.scan.counts.items() if n)
    rows.append(("Readings", used or "none"))
    prior = e.answer.parameters.get("prior")
    if isinstance(prior, Mapping) and prior:
        known = ", ".join(f"{key} {value}" for key, value in flat(prior))
        rows.append(("Known beforehand", known))
    return rows


def _layer(e: Explanation, layer: Layer) -> tuple[str, str, str]:
    """Name, text and PNG of a likelihood."""
    png = ""
    if layer.likelihood is not None:
        png = data_of(draw_likelihood(layer.likelihood, grid=e.grid))
    return layer.name, layer.about, png


def why(e: Explanation) -> str:
    """One or two sentences: the reason for a verdict, with its numbers."""
    answer, evidence, trust = e.answer, e.answer.evidence, e.options.trust
    if answer.verdict == "invalid":
        left = [
            f"{n} {key.replace('_', ' ')}" for key, n in e.scan.counts.items() if key != "valid"
        ]
        valid, directions = e.scan.counts["valid"], e.scan.directions
        repeated = f", in {directions} different directions" if directions < valid else ""
        return (
            f"{valid} of its {len(e.scan.ranges)} readings are distances to "
            f"something{repeated}; {trust.readings} are needed. The others: {', '.join(left)}."
        )
    if not e.fits:
        within = " that the prior allows" if answer.parameters.get("prior") else ""
        return f"The search found no pose{within} in which a sensor can be and that fits at all."
    best = e.fits[0]
    if answer.verdict == "no-match":
        return (
            f"Even at the best pose found the readings fall {evidence.misfit:.2f} nats each short "
            "of a perfect fit. The chance that the scan was taken at none of the poses found is "
            f"{percent(answer.elsewhere)}; more than {percent(evidence.checks[-1].limit)} is no "
            "match. The poses below are best guesses, not to be trusted."
        )
    share = percent(best.hypothesis.mass)
    needed = percent(trust.mass)
    if answer.verdict == "unique":
        return (
            f"It holds {share} of the probability, where {needed} are needed, and "
            f"{percent(answer.explained)} of the readings end on a wall of the map there."
        )
    if not e.answer.complete and best.hypothesis.mass >= trust.mass:
        return f"Of those looked at, the best one holds {share} of the probability."
    rival = e.fits[1] if len(e.fits) > 1 else None
    text = f"The best one holds {share} of the probability; {needed} are needed to be unique."
    if rival is not None:
        times = best.hypothesis.mass / max(rival.hypothesis.mass, 1e-12)
        text += f" The second, {apart(e)} away, is {likely(times)}."
    return text


def likely(times: float) -> str:
    """How a second hypothesis compares with the first.

    Examples
    --------
    >>> likely(1.03), likely(3.2), likely(5e6)
    ('as likely', '3.2 times less likely', 'more than 1000 times less likely')
    """
    if times < 1.05:
        return "as likely"
    return f"{times:.2g} times less likely" if times <= 1000 else "more than 1000 times less likely"


def apart(e: Explanation) -> str:
    """How far the second hypothesis is from the first, in words."""
    a, b = e.fits[0].pose, e.fits[1].pose
    turn = abs(math.degrees(math.remainder(a.theta - b.theta, math.tau)))
    return f"{math.hypot(a.x - b.x, a.y - b.y):.1f} m and {turn:.0f}°"


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


def question(check: Check) -> tuple[str, str, str]:
    """What a check asks, what was found and what is needed, as text."""
    if check.name == "readings":
        found = f"valid in {check.value:.0f} directions"
        return "Are there enough readings?", found, f"≥ {check.limit:.0f}"
    if check.name == "complete":
        return "Did the search come to its end?", "out of time", "complete"
    ask = {
        "elsewhere": "Is the true pose among those found?",
        "mass": "Does one pose hold nearly all of the probability?",
    }[check.name]
    found = {"elsewhere": "elsewhere with", "mass": "the best holds"}[check.name]
    sign = "≥" if check.at_least else "≤"
    return ask, f"{found} {percent(check.value)}", f"{sign} {percent(check.limit)}"


def _margin(e: Explanation) -> str:
    """What the second pose is behind, as the end of a sentence."""
    if len(e.fits) < 2:
        return ". There is no second pose."
    margin = e.fits[0].hypothesis.log_likelihood - e.fits[1].hypothesis.log_likelihood
    worth = margin / e.answer.evidence.temperature.value
    return (
        f": the second is {margin:.1f} nats behind, worth {worth:.2f}: it is "
        f"{likely(math.exp(min(worth, 99)))}."
    )


def deviations(hypothesis: Hypothesis) -> str:
    """Standard deviations along and across the heading, and of it, as text."""
    turned = rotate_covariance(hypothesis.covariance, -hypothesis.pose.theta)
    along, across, turn = np.sqrt(np.diag(turned))
    return (
        f"± {length(along)} along, ± {length(across)} across its heading, ± "
        f"{math.degrees(turn):.2f}°"
    )


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


ENVIRONMENT.filters |= {
    "percent": percent,
    "short": short,
    "digits": minus,
    "deviations": deviations,
}
ENVIRONMENT.globals |= {
    "draw_scan": draw_scan,
    "draw_rays": draw_rays,
    "draw_covariance": draw_covariance,
}
