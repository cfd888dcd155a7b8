"""Why an answer is what it is: every number behind a verdict, and what each ray says.

>>> from imgloc.model import LaserScan, OccupancyGrid
>>> from imgloc.pipeline import localize, prepare
>>> wall = np.pad(np.zeros((30, 40), bool), 2, constant_values=True)
>>> features = prepare(OccupancyGrid(wall, ~wall, 0.1))
>>> blind = LaserScan(np.full(20, np.inf), np.linspace(0, 3, 20), range_max=9.0)
>>> why = explain(features, blind, localize(features, blind))
>>> [(check.name, check.value, check.holds) for check in why.checks]
[('readings', 0.0, False)]
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_xy, thin
from imgloc.geometry import inverse
from imgloc.layers import Layer, layers_of
from imgloc.likelihood.calibration import DEFAULTS
from imgloc.methods import FUSED, Options
from imgloc.model import (
    Hypothesis,
    LaserScan,
    Localization,
    OccupancyGrid,
    Pose2D,
)
from imgloc.pipeline import in_map_frame
from imgloc.search.explain import RayFit, explain_rays
from imgloc.search.rescore import rescore
from imgloc.search.trust import DOUBT, crowding
from imgloc.searches import misfit_of, settle


@dataclass(frozen=True)
class Fit:
    """One hypothesis and the scan laid on the map there.

    Parameters
    ----------
    pose : Pose2D
        Map frame.
    hypothesis : Hypothesis
        The same in the grid frame.
    rays : RayFit
    per_reading : float
        Score of the readings at the pose, nats each; of a stack's pose, after it has settled.
    before : float
        Its mass if the true pose is one of those found.
    """

    pose: Pose2D
    hypothesis: Hypothesis
    rays: RayFit
    per_reading: float
    before: float


@dataclass(frozen=True)
class Check:
    """One question of the verdict: `value` must be at least, or at most, `limit`."""

    name: str
    value: float
    limit: float
    at_least: bool

    @property
    def holds(self) -> bool:
        """Whether it is answered with yes."""
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True)
class Explanation:
    """Everything that there is to say about one answer.

    Parameters
    ----------
    grid : OccupancyGrid
    scan : LaserScan
    answer : Localization
    options : Options
    fits : tuple of Fit
        The hypotheses, best first.
    readings : int
        How many were scored.
    misfit : float
        Nats per reading that the best pose lacks, NaN without one.
    temperature : float
        What evidence was divided by, NaN without a pose.
    checks : tuple of Check
        The questions of the verdict, up to the first that is answered with no: that one
        decided. All answered with yes is ``unique``.
    layers : tuple of Layer
    """

    grid: OccupancyGrid
    scan: LaserScan
    answer: Localization
    options: Options
    fits: tuple[Fit, ...]
    readings: int
    misfit: float
    temperature: float
    checks: tuple[Check, ...]
    layers: tuple[Layer, ...]


def explain(
    features: MapFeatures, scan: LaserScan, answer: Localization, options: Options | None = None
) -> Explanation:
    """Say why a scan was answered as it was.

    Parameters
    ----------
    features : MapFeatures
    scan : LaserScan
    answer : Localization
        Of :func:`imgloc.pipeline.localize` with the same features, scan and options.
    options : Options, optional

    Returns
    -------
    Explanation
    """
    options = options or Options()
    grid = features.grid
    there = replace(grid.info, origin=inverse(grid.origin))
    local = [in_map_frame(h, there) for h in answer.hypotheses]
    fits: tuple[Fit, ...] = ()
    misfit, readings = float("nan"), 0
    if local:
        poses = np.array([(h.pose.x, h.pose.y, h.pose.theta) for h in local])
        rays = thin(scan.valid, options.fused.rays)
        seen = scan.ranges[rays], scan.angles[rays]
        if options.method == FUSED:
            score = rescore(poses, *seen, features.field, features.walls, options.fused.model)
        else:
            score, _ = settle(features, scan, poses, options)
        misfit, readings = misfit_of(score, options), len(rays)
        found = max(1 - answer.elsewhere, 1e-12)
        fits = tuple(
            Fit(
                given.pose,
                h,
                explain_rays(
                    h.pose,
                    scan,
                    features.surface,
                    features.field,
                    features.walls,
                    options.fused.model,
                ),
                float(total) / readings,
                min(1.0, h.mass / found),
            )
            for given, h, total in zip(answer.hypotheses, local, score.log_likelihood, strict=True)
        )
    layers = tuple(layers_of(features, scan, options)) if answer.verdict != "invalid" else ()
    return Explanation(
        grid=grid,
        scan=scan,
        answer=answer,
        options=options,
        fits=fits,
        readings=readings,
        misfit=misfit,
        temperature=_temperature(scan, options, misfit, features.grid.resolution),
        checks=tuple(_checks(scan, answer, options)),
        layers=layers,
    )


def _temperature(scan: LaserScan, options: Options, misfit: float, cell: float) -> float:
    """What made masses of the scores."""
    if options.method == FUSED:
        if not np.isfinite(misfit):
            return float("nan")
        rays = thin(scan.valid, options.fused.rays)
        return options.trust.temperature_at(misfit, crowding(scan_xy(scan)[rays]), cell)
    how = options.calibration or DEFAULTS[options.method]
    return how.temperature_at(options.method, max(1, int(scan.valid.sum())))


def _checks(scan: LaserScan, answer: Localization, options: Options) -> Iterator[Check]:
    """The questions of :func:`~imgloc.search.trust.judge`, in its order."""
    best = answer.hypotheses[0].mass if answer.hypotheses else 0.0
    for check in (
        Check("readings", float(scan.directions), options.trust.readings, True),
        Check("elsewhere", answer.elsewhere, DOUBT, False),
        Check("mass", best, options.trust.mass, True),
        *([] if answer.complete else [Check("complete", 0.0, 1.0, True)]),
    ):
        yield check
        if not check.holds:
            return
