"""Can this answer be trusted? Temperature, the chance of being elsewhere, and the verdict.

A scan from the best pose should score about as well as its readings can: close to
:attr:`~imgloc.options.EvidenceModel.best` nats each. What is missing, the **misfit**,
says how far map and scan disagree. Where they do, differences of evidence mean less than they
claim: the errors are not independent. Whether the true pose is one of those found is judged by
what the map explains beyond an empty room, see :mod:`imgloc.search.background`.
"""

from imgloc.model import Check, FloatArray
from imgloc.numbers import number
from imgloc.options import Trust

DOUBT = number("trust.doubt")  #: with more probability elsewhere than this there is no match


def judge(
    directions: int, mass: FloatArray, elsewhere: float, trust: Trust, complete: bool = True
) -> tuple[str, tuple[Check, ...]]:
    """Return one of ``unique``, ``ambiguous``, ``no-match`` and ``invalid``, and why.

    The questions are returned up to the first that is answered with no: that one decided.

    Parameters
    ----------
    directions : int
        Of the valid readings, see :attr:`~imgloc.model.LaserScan.directions`.
    mass, elsewhere : (M,) float array, float
        Of the hypotheses, best first, and of :meth:`~imgloc.options.Trust.mass_elsewhere`.
    complete : bool
        Whether the search came to its end: what was not looked at may fit as well.

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
    if not complete:
        questions.append(("ambiguous", Check("complete", 0.0, 1.0, True)))
    asked = tuple(check for _, check in questions)
    for k, (verdict, check) in enumerate(questions, start=1):
        if not check.holds:
            return verdict, asked[:k]
    return "unique", asked
