"""Protection levels held against true poses: the share that they hold, and whom they mislead.

The spread of the truth around a pose is fitted to the ``unique`` answers of recorded sets whose
place is right; each building counts as much as any other, and is left out once. Then come scans
and maps as :mod:`tools.trust.disturb` changes them, and scans that are from elsewhere. An answer
may be used where its level is below the alarm limit. It misleads if its error is above the level,
and hazardously if the error is above the limit, too.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.stats import norm

from imgloc import (
    LaserScan,
    Localization,
    MapFeatures,
    OccupancyGrid,
    Options,
    Pose2D,
    ScanSet,
    localize,
    prepare,
)
from imgloc.geometry import pose_errors, poses_of
from imgloc.model import FloatArray
from imgloc.numbers import Origin, write
from imgloc.output.plots import blank
from imgloc.search.priors import prior_of
from imgloc.search.protection import HEADING, POSITION, SHARES, Spread
from tools.script import table_lines
from tools.trust.disturb import MAPS, SCANS
from tools.trust.foreign import UNDISTURBED, WITHOUT, Asked, disturbed, elsewhere
from tools.trust.reliability import RIGHT, WRONG

LIMITS = (0.25, 0.5, 1.0)
"""Alarm limits, metres."""
MASSES = (0.5, 0.8, 0.85, 0.9, 0.95, 0.98, 0.99, 0.999)
"""Masses that a robot may ask for, at which risk and coverage are counted."""


@dataclass(frozen=True)
class Answered:
    """One answer beside the truth."""

    building: str
    condition: str
    verdict: str
    mass: float  #: of the best pose
    error: FloatArray  #: (2,) of the best pose, metres and radians; infinite if from elsewhere
    deviation: FloatArray  #: (2,) standard deviations of the best pose, metres and radians
    level: FloatArray  #: (S, 2) metres and radians at :data:`SHARES`

    @property
    def right(self) -> bool:
        """Whether the answer is ``unique`` and its place is right."""
        return self.verdict == "unique" and bool(np.all(self.error <= RIGHT))

    @property
    def wrong(self) -> bool:
        """Whether the best pose is of another place."""
        return bool(np.any(self.error > WRONG))


@dataclass(frozen=True)
class SpreadFit:
    """The spreads that were fitted, to how many answers of which buildings."""

    position: Spread
    heading: Spread
    buildings: Mapping[str, int]

    def scaled(self, answer: Answered) -> FloatArray:
        """Error (2,) of an answer over its radii (S, 2), as one mode that holds all mass."""
        radii = [
            radius(spread, np.asarray(sd))
            for spread, sd in zip((self.position, self.heading), answer.deviation, strict=True)
        ]
        return np.asarray(answer.error / np.stack(radii, axis=1))


def radius(spread: Spread, deviation: FloatArray) -> FloatArray:
    """The distances (S,) that hold :data:`SHARES` of a spread."""
    share, nu = np.array(SHARES), spread.tail
    far = norm.isf((1 - share) / 2)
    if nu is not None:
        far = np.sqrt(nu * ((1 - share) ** (-2 / nu) - 1))
    return np.asarray(far * spread.units(deviation))


def answered_at(features: MapFeatures, asked: Asked) -> Answered:
    """Ask where a scan is, and compare."""
    answer = localize(features, asked.scan, Options(prior=prior_of(asked.known, features.grid)))
    error, deviation = np.full((2, 2), np.inf)
    if answer.hypotheses:
        covariance = answer.hypotheses[0].covariance
        variance = np.linalg.eigvalsh(covariance[:2, :2])[-1], covariance[2, 2]
        deviation = np.sqrt(variance)
        if asked.pose is not None:
            error = pose_errors(poses_of(answer.hypotheses[:1]), Pose2D(*asked.pose))[0]
    return Answered(
        asked.building, asked.row, answer.verdict, mass_of(answer), error, deviation,
        np.array([(level.metres, level.radians) for level in answer.protection]).reshape(-1, 2),
    )  # fmt: skip


def mass_of(answer: Localization) -> float:
    """Mass of the best pose; 0 without one."""
    return answer.hypotheses[0].mass if answer.hypotheses else 0.0


def answers_at_home(
    building: str, grid: OccupancyGrid, scans: ScanSet, few: int, seed: int
) -> Iterator[Answered]:
    """Every scan of a set as it is; the first `few` disturbed, on disturbed maps, with priors."""
    for changed, some in disturbed(building, grid, scans, few, seed):
        features = prepare(changed, building)
        yield from (answered_at(features, asked) for asked in some)


def answers_away(
    building: str, grid: OccupancyGrid, foreign: Sequence[LaserScan], few: int, seed: int
) -> Iterator[Answered]:
    """Scans of other buildings, and `few` of each simple room that is on no map."""
    features, rng = prepare(grid, building), np.random.default_rng(seed)
    for asked in elsewhere(building, grid, foreign, few, (seed,), rng):
        if asked.prior == WITHOUT:
            yield answered_at(features, asked)


def fit_spreads(answers: Sequence[Answered]) -> SpreadFit:
    """Fit the spreads to the answers that are ``unique`` and right; buildings count alike.

    They are fitted by likelihood. The scale is then the one whose 95 % hold 95 % of the
    answers, with one more that no level holds (a conformal factor), so that it does not lean on
    the form of the spread.
    """
    used = [a for a in answers if a.right]
    count = Counter(a.building for a in used)
    weight = np.array([1 / count[a.building] for a in used])
    error, deviation = (np.array([getattr(a, of) for a in used]).T for of in ("error", "deviation"))
    found = [
        _fit(e, sd, weight / weight.sum(), spread)
        for e, sd, spread in zip(error, deviation, (POSITION, HEADING), strict=True)
    ]
    return SpreadFit(found[0], found[1], dict(count))


def _fit(error: FloatArray, deviation: FloatArray, weight: FloatArray, begin: Spread) -> Spread:
    def made(p: FloatArray) -> Spread:
        scale, shared, *tail = np.exp(p).tolist()
        return Spread(scale, shared, *(tail or (None,)))

    def loss(p: FloatArray) -> float:
        now = made(p)
        unit = now.units(deviation)
        if now.tail is None:
            return float(-weight @ (norm.logpdf(error / unit) - np.log(unit)))
        far = np.square(error / unit)
        log = np.log(np.maximum(error, 1e-9) / unit**2)
        return float(-weight @ (log - (now.tail / 2 + 1) * np.log1p(far / now.tail)))

    start = np.log([value for value in vars(begin).values() if value is not None])
    spread = made(minimize(loss, start, method="Nelder-Mead").x)
    far = error / np.array([radius(spread, np.asarray(sd))[0] for sd in deviation])
    order = np.argsort(far)
    # The next answer may lie beyond all of these: it has the weight of one of them.
    held = np.cumsum(weight[order]) / (1 + weight.max())
    at = min(int(np.searchsorted(held, SHARES[0])), len(far) - 1)
    return replace(spread, scale=spread.scale * float(far[order][at]))


def held_table(answers: Sequence[Answered], fit: SpreadFit) -> str:
    """What levels hold in each building, as Markdown, of answers that are ``unique`` and right.

    With the spreads fitted to the other buildings, and as answers have them now.
    """
    rows = []
    for name in fit.buildings:
        some = [a for a in answers if a.right and a.building == name]
        others = [a for a in answers if a.building != name]
        cells: list[str] = []
        if len(fit.buildings) > 1:
            ratio = np.array([fit_spreads(others).scaled(a) for a in some])
            inside = (ratio <= 1).mean(axis=0)
            cells += [", ".join(f"{share:.3f}" for share in inside[:, k]) for k in (0, 1)]
        level = np.array([a.level for a in some])
        error = np.array([a.error for a in some])
        inside = (error[:, None] <= level).mean(axis=0)
        cells.append(", ".join(f"{share:.3f}" for share in inside[:, 0]))
        cells.append(", ".join(f"{m:.2f}" for m in np.median(level[:, :, 0], axis=0)))
        cells.append(", ".join(f"{d:.1f}" for d in np.rad2deg(np.median(level[:, :, 1], axis=0))))
        rows.append((name, len(some), *cells))
    left = "left out: position | left out: heading | " if len(fit.buildings) > 1 else ""
    head = f"building | answers | {left}now: position | median m | median deg"
    return "\n".join(table_lines(head, rows))


def stanford_table(answers: Sequence[Answered], at: int = 0) -> str:
    """Counts of Stanford's diagram for each condition, as Markdown, by the level `at` of SHARES.

    Of all answers: the share that is available at each alarm limit, and the number that misleads,
    hazardously or not.
    """
    rows = []
    for condition in dict.fromkeys(a.condition for a in answers):
        some = [a for a in answers if a.condition == condition]
        error = np.array([a.error[0] for a in some])
        level = np.array([a.level[at, 0] if len(a.level) else np.inf for a in some])
        cells = []
        for limit in LIMITS:
            used = level <= limit
            hazard = used & (error > limit)
            misled = used & (error > level) & ~hazard
            cells.append(f"{used.mean():.2f}, {misled.sum()}, {hazard.sum()}")
        rows.append((condition, len(some), *cells))
    limits = " | ".join(f"limit {limit:g} m" for limit in LIMITS)
    return "\n".join(table_lines(f"condition | answers | {limits}", rows))


def risk_table(answers: Sequence[Answered]) -> str:
    """Risk against coverage, as Markdown: answers whose mass is at least so much, and the wrong."""
    groups = {
        UNDISTURBED: [a for a in answers if a.condition == UNDISTURBED],
        "disturbed": [a for a in answers if a.condition in {*SCANS, *MAPS} - {UNDISTURBED}],
        "from elsewhere": [a for a in answers if not np.isfinite(a.error).any()],
    }
    rows = []
    for mass in MASSES:
        cells = []
        for some in groups.values():
            sure = [a for a in some if a.mass >= mass]
            wrong = sum(a.wrong for a in sure)
            cells.append(f"{len(sure) / max(1, len(some)):.3f}, {wrong} of {len(sure)}")
        rows.append((f"{mass:g}", *cells))
    return "\n".join(table_lines(f"mass | {' | '.join(groups)}", rows))


def numbers_of_levels(fit: SpreadFit, text: str, by: str, date: str) -> str:
    """The text of ``numbers.json`` with the spreads that were fitted, by a command on a date."""
    count = sum(fit.buildings.values())
    on = f"{count} unique and right answers of {len(fit.buildings)} buildings"
    metres, turned = fit.position, fit.heading
    now: dict[str, list[float | None]] = {
        "protection.position": [metres.scale, metres.shared, metres.tail],
        "protection.heading": [turned.scale, float(np.rad2deg(turned.shared))],
    }
    rounded = {name: [float(f"{v or 0:.3g}") for v in values] for name, values in now.items()}
    return write(text, rounded, "protection", Origin(by, on, date))


def draw_stanford(answers: Sequence[Answered], at: int = 0) -> npt.NDArray[np.uint8]:
    """Stanford's diagrams, (H, W, 3) BGR: error against level for each condition, in metres.

    An answer above the diagonal is safe; below it, it misleads: hazardously if the error is above
    an alarm limit (a vertical line) and the level below it. Scans from elsewhere have no error:
    they are drawn at its right edge.
    """
    names = list(dict.fromkeys(a.condition for a in answers))
    columns, span = 6, (1e-2, 1e2)
    lines = -(-len(names) // columns)
    figure, pixels = blank(2.4 * columns, 2.4 * lines, dpi=75, layout="constrained")
    panels = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for axes, name in zip(panels.flat, names, strict=False):
        some = [a for a in answers if a.condition == name and len(a.level)]
        error = np.clip([a.error[0] for a in some], *span)
        level = np.clip([a.level[at, 0] for a in some], *span)
        bad = error > level
        axes.loglog(span, span, color="#282f38", linewidth=1)
        axes.vlines(LIMITS, *span, "#999999", linewidth=0.5)
        axes.hlines(LIMITS, *span, "#999999", linewidth=0.5)
        axes.scatter(error[~bad], level[~bad], 6, "#0072b2", linewidths=0, clip_on=False)
        axes.scatter(error[bad], level[bad], 14, "#d55e00", marker="x", linewidths=1, clip_on=False)
        axes.set(xlim=span, ylim=span, title=f"{name}: {len(some)}")
        axes.title.set_fontsize(8)
    for axes in panels.flat[len(names) :]:
        axes.set_visible(False)
    figure.supxlabel("error of the position / m")
    figure.supylabel(f"level that holds {SHARES[at]:.1%} / m")
    return pixels()
