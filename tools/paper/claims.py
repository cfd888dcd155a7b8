"""What the paper says of its table, held against ours."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from tools.paper.complexity import AXES, PAPER, Complexity
from tools.paper.table import Ratio, TableRow

ORDER = ("cbml", "cbml-o", "ght", "ght-v")
"""From the worst to the best, says the paper."""
MAXIMUM = 0.7
"""The paper's share of trials in which GHT-V is greatest at the true pose, Sec. VII."""
GROWTH = {"ght": tuple(AXES), "ght-v": tuple(AXES), "cbml": ("rho_m", "rho_theta")}
"""With which of :data:`AXES` the work of a scan has to grow as the appendix says."""
WITHIN = 0.15
"""How near a fitted exponent has to be."""


@dataclass(frozen=True)
class Claim:
    """Something that is said of the table, whether it is so in ours, and what was found.

    One that is not `firm` may fail by chance where the trials are few.
    """

    text: str
    holds: bool
    found: str
    firm: bool = True


def claims(rows: Sequence[TableRow]) -> tuple[Claim, ...]:
    """Hold the paper's order, its intervals and its share of maxima against a table.

    Of the table there are all of :data:`ORDER` in each world.
    """
    by, out = {(r.world, r.method): r for r in rows}, []
    worlds = list(dict.fromkeys(r.world for r in rows))
    for world in worlds:
        s = [by[world, m].index.value for m in ORDER]
        found = ", ".join(f"{v:.2f}" for v in s)
        rising = all(a < b for a, b in pairwise(s))
        out.append(Claim(f"{world}: S of CBML < CBML-O < GHT < GHT-V", rising, found))
        for low, high in (("cbml", "cbml-o"), ("cbml-o", "ght-v")):
            a, b = by[world, low].interval, by[world, high].interval
            said = f"the intervals of {low.upper()} and {high.upper()} do not overlap"
            found = f"up to {a[1]:.2f}, from {b[0]:.2f}"
            out.append(Claim(f"{world}: {said}", a[1] < b[0], found))
    best = max((by[w, "ght-v"] for w in worlds), key=lambda r: r.exact.value)
    said = "GHT-V is greatest at the true pose in 70 % of the trials or more in some world"
    found = (
        f"{best.world}: {100 * best.exact.value:.0f} % in its cell, "
        f"{100 * best.near.value:.0f} % in its cell or one next to it"
    )
    return (*out, Claim(said, best.exact.value >= MAXIMUM, found, firm=False))


def time_claims(ratios: Sequence[Ratio]) -> tuple[Claim, ...]:
    """Hold the run times that the appendix calls nearly equal against those measured."""
    out = []
    for r in ratios:
        said = f"takes at most {r.most:g} x the time of {r.rival.upper()}"
        found = f"{r.value:.2f} x"
        out.append(
            Claim(f"{r.world}: {r.method.upper()} {said}", r.value <= r.most, found, firm=False)
        )
    return tuple(out)


def growth_claims(grown: Complexity) -> tuple[Claim, ...]:
    """Hold the exponents of the appendix against those fitted to the work counted."""
    out = []
    for method, axes in GROWTH.items():
        powers = {axis: PAPER[method]["run_s"][axis] for axis in axes}
        found = {axis: grown.exponent(method, axis, "work") for axis in powers}
        said = ", ".join(f"{axis}^{power:g}" for axis, power in powers.items())
        told = ", ".join(f"{axis}^{round(power, 2) + 0.0:.2f}" for axis, power in found.items())
        near = all(abs(found[axis] - power) <= WITHIN for axis, power in powers.items())
        out.append(Claim(f"{method.upper()}: the work of a scan grows with {said}", near, told))
    return (*out, *_beyond(grown))


def _beyond(grown: Complexity) -> tuple[Claim, ...]:
    """Where less work is done here than in the appendix."""
    stack, traced, blur = (
        grown.exponent(method, "rho_m", quantity)
        for method, quantity in (("beam", "init_work"), ("beam", "traced"), ("cbml", "init_work"))
    )
    work = {(s.method, s.axis, s.value): s.work for s in grown.samples}
    ght = [(axis, value) for method, axis, value in work if method == "ght"]
    shares = [work["ght-v", axis, value] / work["ght", axis, value] for axis, value in ght]
    return (
        Claim(
            "beyond the paper: the ray-distance stack's init grows with rho_m^2, a cell and "
            "direction each costing the same, where a table of traced rays has rho_m^3",
            abs(stack - 2) <= WITHIN,
            f"rho_m^{stack:.2f}; traced rays rho_m^{traced:.2f}",
        ),
        Claim(
            "beyond the paper: the blur of CBML's map grows with rho_m^3, one axis after the "
            "other, where the appendix has rho_m^4",
            abs(blur - 3) <= WITHIN,
            f"rho_m^{blur:.2f}",
        ),
        Claim(
            "beyond the paper: GHT-V is no dearer than GHT, its test comes before the vote",
            max(shares) <= 1,
            f"{100 * min(shares):.0f} to {100 * max(shares):.0f} % of its votes",
        ),
    )
