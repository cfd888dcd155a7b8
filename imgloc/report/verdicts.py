"""A verdict in words: what it is, why, and what each of its questions means."""

import math

from imgloc.explain import Explanation
from imgloc.model import Check

HEADLINES = {
    "unique": "One pose explains this scan.",
    "ambiguous": "Several poses explain this scan.",
    "no-match": "No pose on this map explains this scan.",
    "invalid": "Too few readings to say anything.",
}
MARKS = {"unique": "✓", "ambiguous": "?", "no-match": "✗", "invalid": "–"}

KIND_NAMES = {
    "agrees": "agrees",
    "orientation": "vetoed by orientation",
    "visibility": "vetoed by visibility",
    "unexplained": "unexplained",
    "no_return": "no return",
    "invalid": "invalid",
}
KIND_NOTES = {
    "agrees": "ends on a mapped surface that faces the sensor",
    "orientation": "ends on a surface, but the scan and the map say that it faces elsewhere",
    "visibility": "passes through a mapped wall (dashed beyond it)",
    "unexplained": "ends where the map has no surface: somebody is there, or it is the wrong pose",
    "no_return": "met nothing within reach; counted, not drawn",
    "invalid": "not a distance: too close, or NaN; counted, not drawn",
}


def why(e: Explanation) -> str:
    """One or two sentences: the reason for a verdict, with its numbers."""
    evidence = e.answer.evidence
    answer, trust = e.answer, e.options.trust
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
            f"of a perfect fit. The chance that the scan was taken at none of the poses found is "
            f"{percent(answer.elsewhere)}; "
            f"more than {percent(evidence.checks[-1].limit)} is no match. "
            "The poses below are best guesses, not to be trusted."
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
