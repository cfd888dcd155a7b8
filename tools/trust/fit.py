"""What trust is made of: temperature and the chance of being elsewhere, fitted to disturbed scans.

Scans are simulated in the bundled worlds and taken from recorded sets, each as it is and after
every disturbance of :mod:`tools.trust.disturb`; others are laid on maps that they are not from, and
on other floors of drawn buildings. The temperature makes the mass of the true mode as large as it
may be; a logistic regression tells scans whose place is found from those whose place is not. Each
building is left out once.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy.optimize import minimize

from imgloc import LaserScan, MapFeatures, OccupancyGrid, Options, Pose2D, ScanSet, Trust, prepare
from imgloc.geometry import cell_of, pose_errors, transform_points, transform_poses
from imgloc.lab.evaluation import share
from imgloc.model import BoolArray, FloatArray, inverse
from imgloc.numbers import Origin, write
from imgloc.options import LOG_VOLUME
from imgloc.pipeline import find_adapted_modes
from imgloc.search.answer import log_volume
from imgloc.search.hypotheses import masses
from imgloc.search.priors import prior_of
from imgloc.search.trust import judge
from imgloc.search.weigh import evidence_with
from tools.script import table_lines
from tools.trust.disturb import ROOMS
from tools.trust.foreign import (
    WITHOUT,
    Asked,
    Questions,
    disturbed,
    elsewhere,
    floors_of,
    on_other_floors,
)
from tools.trust.reliability import LEAST, RIGHT, Judged, reliability

MARGIN = 1.25
"""By how much the strain is larger than the one that fits best: for maps worse than these."""
PRIOR = -0.5
"""Added to the log-odds of being elsewhere: more scans are of their map than in this mixture."""
MODES = 20  # of an answer, that are compared
_NEAR = 4  # cells


@dataclass(frozen=True)
class Case:
    """One scan laid on one map."""

    building: str
    condition: str
    score: FloatArray  #: (M,) of the modes, nats, best first
    right: BoolArray  #: (M,) which are the true place; none if the scan is of another one
    readings: int
    misfit: float  #: of the best mode by things, nats per reading
    gap: float  #: nats per reading by which the best mode beats a building on no map
    cell: float  #: of the map, metres
    against: float = 0.0  #: nats against the best mode, but for `gap`
    log_volume: float = LOG_VOLUME  #: as :attr:`imgloc.model.Evidence.log_volume`

    def net(self, temperature: float) -> float:
        """Nats for the best mode, as :attr:`imgloc.model.Evidence.net`."""
        return self.gap * self.readings / temperature - self.against


@dataclass(frozen=True)
class TrustFit:
    """What was fitted, and on what; losses are in nats a case."""

    temperature: float
    strain: float
    elsewhere: tuple[float, float, float]
    cases: Mapping[str, int]  #: how many, by condition
    buildings: Mapping[str, int]  #: and by building
    loss: tuple[float, float]  #: of the temperature and of being elsewhere, on what was fitted to
    left_out: tuple[float, float]  #: the same of buildings that were left out
    now: tuple[float, float]  #: the same of the trust that is the default


def case_of(features: MapFeatures, asked: Asked) -> Case | None:
    """Lay a scan on a map; None if nothing is found."""
    options, scan = Options(prior=prior_of(asked.known, features.grid)), asked.scan
    if scan.directions < options.trust.readings:
        return None
    found = find_adapted_modes(features, scan, options)
    if len(found.poses) == 0:
        return None
    score, n = found.scores.things[:MODES], len(found.readings)
    right = np.zeros(len(score), bool)
    if asked.pose is not None and mapped(features.grid, asked.pose):
        there = transform_poses(features.grid.origin, found.poses[:MODES])
        right = np.all(pose_errors(there, Pose2D(*asked.pose)) <= RIGHT, axis=1)
    fit = evidence_with(features, found, options)
    gap, cell = float(score[0]) / n - fit.unmapped, features.grid.resolution
    against = gap * n / fit.temperature.value - fit.net
    misfit = fit.best - float(score[0]) / n
    condition = asked.row if asked.prior == WITHOUT else f"{asked.row}, {asked.prior}"
    volume = log_volume(features, options)
    return Case(asked.building, condition, score, right, n, misfit, gap, cell, against, volume)


def cases_of(questions: Questions) -> Iterator[Case]:
    """Lay scans on the maps that are asked for them."""
    for grid, some in questions:
        features = prepare(grid)
        yield from filter(None, (case_of(features, asked) for asked in some))


def cases_at_home(building: str, grid: OccupancyGrid, scans: ScanSet, seed: int) -> Iterator[Case]:
    """Every scan of a set with poses: as it is, disturbed, and on disturbed maps."""
    return cases_of(disturbed(building, grid, scans, None, seed))


def cases_away(
    building: str, grid: OccupancyGrid, foreign: Sequence[LaserScan], n: int, seed: int
) -> Iterator[Case]:
    """Scans that are not of a map: those of other buildings, and `n` of each simple room."""
    rng = np.random.default_rng((seed, len(ROOMS)))
    return cases_of(iter([(grid, elsewhere(building, grid, foreign, n, (seed,), rng))]))


def cases_on_floors(seed: int, n: int) -> Iterator[Case]:
    """Scans on their own floor, on another one of the same drawn building, on a mirrored plan."""
    return cases_of(on_other_floors(floors_of(seed, n)))


def listed(make: Callable[..., Iterator[Case]], given: Sequence[Any]) -> list[Case]:
    """The cases that a function of these arguments makes, on one thread, for a process."""
    cv2.setNumThreads(1)
    return list(make(*given))


def mapped(grid: OccupancyGrid, pose: FloatArray) -> bool:
    """Whether a pose, map frame, is in free space or within a few cells of it."""
    local = transform_points(inverse(grid.origin), np.asarray(pose)[None, :2])
    row, column = cell_of(local, grid.resolution)[0]
    near = (slice(max(0, k - _NEAR), max(0, k + _NEAR + 1)) for k in (row, column))
    return bool(grid.free[tuple(near)].any())


def fit_trust(cases: Sequence[Case], held: tuple[float, float] | None = None) -> TrustFit:
    """Fit temperature and log-odds to all cases, and to those of all buildings but one, each once.

    A temperature and strain that are `held` are not fitted.

    Cases count so that every building and condition has the root of its number of cases.
    """
    fixed = None if held is None else np.array(held) / (1, MARGIN)
    scale, odds = _fit(cases, fixed)
    out = np.zeros(2)
    weights = _weights(cases)
    for name in sorted({c.building for c in cases}):
        home = np.array([c.building == name for c in cases])
        rest, some = ([c for c, h in zip(cases, home, strict=True) if h == x] for x in (0, 1))
        if rest:
            out += weights[home].sum() / weights.sum() * np.array(_losses(some, *_fit(rest, fixed)))
    trust = Trust()
    now = np.array([trust.temperature, trust.strain / MARGIN])
    odds_now = np.array(trust.elsewhere) - (PRIOR, 0, 0)
    return TrustFit(
        temperature=float(scale[0]),
        strain=float(scale[1] * MARGIN),
        elsewhere=(float(odds[0] + PRIOR), float(odds[1]), float(odds[2])),
        cases=dict(Counter(c.condition for c in cases)),
        buildings=dict(Counter(c.building for c in cases)),
        loss=_losses(cases, scale, odds),
        left_out=(float(out[0]), float(out[1])),
        now=_losses(cases, now, odds_now),
    )


def numbers_of(fit: TrustFit, text: str, by: str, date: str, *, held: bool) -> str:
    """The text of ``numbers.json`` with what was fitted, by a command on a date.

    A temperature that was `held` stays as it is.
    """
    count, kinds = sum(fit.cases.values()), len(fit.cases)
    on = f"{len(fit.buildings)} buildings: {count} cases, {kinds} conditions"
    now = {"Trust.elsewhere": [round(odds, 2) for odds in fit.elsewhere]}
    out = write(text, now, "trust-fit", Origin(by, on, date))
    if held:
        return out
    scale = {"Trust.temperature": round(fit.temperature, 2), "Trust.strain": round(fit.strain, 2)}
    return write(out, scale, "temperature-fit", Origin(by, on, date))


def _fit(cases: Sequence[Case], fixed: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Temperature and strain (2,), then log-odds (3,), by what they lose."""
    scale = fixed
    if scale is None:
        start = np.log([Trust().temperature, Trust().strain])
        # Both are positive; Nelder and Mead's way needs no slope: a clipped share has none.
        found = minimize(lambda p: _temperature_loss(cases, np.exp(p)), start, method="Nelder-Mead")
        scale = np.exp(found.x)
    lose = _elsewhere_loss(cases, scale)
    return scale, np.asarray(minimize(lambda b: lose(b) + 1e-4 * b @ b, np.zeros(3)).x)


def _losses(cases: Sequence[Case], scale: FloatArray, odds: FloatArray) -> tuple[float, float]:
    return _temperature_loss(cases, scale), _elsewhere_loss(cases, scale)(odds)


def _elsewhere_loss(cases: Sequence[Case], scale: FloatArray) -> Callable[[FloatArray], float]:
    """Of log-odds (3,): the mean of minus the logarithm of what was the case."""
    X, w = _regressors(cases, scale), _weights(cases)
    sign = np.where(_lost(cases), -1, 1)
    return lambda odds: float(w @ np.logaddexp(0, sign * (X @ odds)) / w.sum())


def _temperature(case: Case, scale: FloatArray) -> float:
    trust = Trust(temperature=float(scale[0]), strain=float(scale[1]))
    return trust.temperature_at(case.misfit, case.readings, case.cell).value


def _temperature_loss(cases: Sequence[Case], scale: FloatArray) -> float:
    """Mean of minus the logarithm of the true mode's mass, where it was found."""
    mine = [not lost for lost in _lost(cases)]
    weights, home = _weights(cases)[mine], [c for c, m in zip(cases, mine, strict=True) if m]
    mass = [masses(c.score, _temperature(c, scale))[c.right].sum() for c in home]
    return float(-weights @ np.log(np.maximum(mass, 1e-9)) / max(weights.sum(), 1e-9))


def _regressors(cases: Sequence[Case], scale: FloatArray) -> FloatArray:
    """(N, 3): one, nats for the best mode, logarithm of the number of possible poses."""
    most = Trust().most
    rows = []
    for c in cases:
        T = _temperature(c, scale * (1, MARGIN))
        net, few = np.clip(c.net(T), -most, most), min(0.0, LOG_VOLUME - c.log_volume)
        rows.append((1.0, net, few * max(0.0, net)))
    return np.array(rows)


def _lost(cases: Sequence[Case]) -> BoolArray:
    return np.array([not c.right.any() for c in cases])


def _weights(cases: Sequence[Case]) -> FloatArray:
    count = Counter((c.building, c.condition) for c in cases)
    return np.array([count[c.building, c.condition] ** -0.5 for c in cases])


def trust_of(fit: TrustFit) -> Trust:
    """The default trust with what was fitted."""
    return replace(Trust(), temperature=fit.temperature, strain=fit.strain, elsewhere=fit.elsewhere)


def conditions_table(cases: Sequence[Case], trust: Trust) -> str:
    """What a trust makes of each condition, as Markdown.

    Right is the first mode; of the ``unique`` it is said how many are wrong; the error of the
    calibration is of all modes of 1 % and more.
    """
    rows = []
    for condition in dict.fromkeys(c.condition for c in cases):
        some = [c for c in cases if c.condition == condition]
        told = [_judged(c, trust) for c in some]
        first = share(c.right[0] for c in some).value
        unique, none = (share(j.verdict == v for j in told).value for v in ("unique", "no-match"))
        wrong, error = sum(j.wrong for j in told), reliability(told)[1]
        shares = (f"{first:.2f}", f"{unique:.2f}", wrong, f"{none:.2f}", f"{error:.3f}")
        rows.append((condition, len(some), *shares))
    head = "condition | scans | first right | unique | wrong | no-match | calibration"
    return "\n".join(table_lines(head, rows))


def _judged(case: Case, trust: Trust) -> Judged:
    T = trust.temperature_at(case.misfit, case.readings, case.cell).value
    mass = masses(case.score, T)
    elsewhere = trust.mass_elsewhere(case.net(T), case.log_volume)
    mass = mass * (1 - elsewhere)
    verdict = judge(trust.readings, mass, elsewhere, trust)[0]
    told = mass >= LEAST
    wrong = verdict == "unique" and not case.right[0]
    return Judged(mass[told], case.right[told], verdict, wrong, float("nan"))
