"""The verdict on an answer: whether its pose can be trusted.

A scan from the best pose should score about as well as its readings can: close to
:attr:`~imgloc.options.EvidenceModel.best` nats each. The **misfit** is what is missing to that, in
nats per reading. It measures how far map and scan disagree. If they disagree, their errors are not
independent, and a higher temperature makes differences of evidence count less. The probability that
the true pose is elsewhere depends on what the map explains beyond an empty room, see
:mod:`imgloc.search.background`.
"""

from imgloc.model import Check, FloatArray
from imgloc.numbers import number
from imgloc.options import Trust

DOUBT = number("trust.doubt")  #: probability *elsewhere* above which the verdict is ``no-match``


def judge(
    directions: int, mass: FloatArray, elsewhere: float, trust: Trust, complete: bool = True,
    *, alone: float | None = None,
) -> tuple[str, tuple[Check, ...]]:  # fmt: skip
    """Return the verdict on an answer, and the checks that led to it.

    Parameters
    ----------
    directions : int
        Number of different directions of the valid readings, see
        :attr:`~imgloc.model.LaserScan.directions`.
    mass : (M,) float array
        Mass of each hypothesis, best first.
    elsewhere : float
        Probability that the true pose is none of them, from
        :meth:`~imgloc.options.Trust.mass_elsewhere`.
    trust : Trust
        Limits of the checks.
    complete : bool
        Whether the search came to its end. Poses that it did not reach may fit as well.
    alone : float, optional
        Mass of the best by the scan alone, if `mass` is that with the weights of a prior.

    Returns
    -------
    verdict : str
        One of ``unique``, ``ambiguous``, ``no-match`` and ``invalid``.
    checks : tuple of Check
        The checks in their order, up to the first that does not hold. That one decided.

    Examples
    --------
    >>> import numpy as np
    >>> verdict, checks = judge(181, np.array([0.6, 0.4]), 0.0, Trust())
    >>> verdict, [check.name for check in checks], checks[-1].holds
    ('ambiguous', ['readings', 'elsewhere', 'mass'], False)
    """
    best, elsewhere = (float(mass[0]), elsewhere) if len(mass) else (0.0, 1.0)
    questions = [
        ("invalid", Check("readings", float(directions), trust.readings, True)),
        ("no-match", Check("elsewhere", elsewhere, DOUBT, False)),
        ("ambiguous", Check("mass", best, trust.mass, True)),
    ]
    if alone is not None:
        questions.append(("ambiguous", Check("alone", alone, trust.mass, True)))
    if not complete:
        questions.append(("ambiguous", Check("complete", 0.0, 1.0, True)))
    asked = tuple(check for _, check in questions)
    for k, (verdict, check) in enumerate(questions, start=1):
        if not check.holds:
            return verdict, asked[:k]
    return "unique", asked
