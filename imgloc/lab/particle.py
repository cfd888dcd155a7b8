"""The particle filter: Monte Carlo localization that starts, and starts again, from p(x | z).

* The first particles are drawn from p(x | z) of the first scan (Sec. I: fewer are needed).
* **Sensor resetting** (Lenser and Veloso 2000; the averages are those of augmented MCL): while the
  short-time mean of the likelihood is below the long-time one, that share of the particles is
  drawn from p(x | z) again.
* As many particles as Fox's KLD bound asks for, by the bins of pose space that they fill;
  resampling with low variance, only once the weights have become uneven.
"""

from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Annotated

import numpy as np

from imgloc.answers.sample import sample_poses
from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import NOWHERE, Belief
from imgloc.filters.evidence import sight, view_of
from imgloc.filters.motion import sample_motion
from imgloc.filters.tracker import TrackerOptions
from imgloc.geometry import theta_bin, transform_poses, wrap
from imgloc.lab.scanned import MASS, ScannedFilter, ScannedOptions
from imgloc.model import FloatArray, IntArray, LaserScan, inverse
from imgloc.numbers import number
from imgloc.options import ALL_METHODS, Count, Factor, Metres, Options, Radians, Share, Shared
from imgloc.ranges import OneOf, Within
from imgloc.search.hypotheses import first_in_cell


@dataclass(frozen=True)
class ParticleOptions(ScannedOptions):
    """Settings of the particle filter."""

    least: Count = number("ParticleOptions.least")  #: least number of particles
    most: Count = number("ParticleOptions.most")
    #: KLD-sampling: largest distance of the distributions, nats
    error: Annotated[float, Within(1e-6, 1e6, "nats")] = number("ParticleOptions.error")
    #: method whose p(x | z) new particles are drawn from
    reset_by: Annotated[str, OneOf(*ALL_METHODS)] = "ght-v"
    #: rates of the long and the short mean of the likelihood
    alphas: tuple[Share, Share] = number("ParticleOptions.alphas")
    #: factor by which the short mean may lie below the long one without a reset
    slack: Factor = number("ParticleOptions.slack")
    #: standard deviations of particles that are drawn again, metres and radians
    jitter: tuple[Metres, Radians] = TrackerOptions.error


def kld_bound(bins: int, error: float, quantile: float) -> int:
    """Number of particles that keep the KL distance to their distribution below `error` (Fox 2003).

    The particles fill `bins` bins. `error` is in nats. `quantile` is that of the normal
    distribution.

    Examples
    --------
    >>> kld_bound(1, 0.05, 2.33), kld_bound(100, 0.05, 2.33)
    (1, 1348)
    """
    if bins < 2:
        return 1
    a = 2 / (9 * (bins - 1))
    return int(np.ceil((bins - 1) / (2 * error) * (1 - a + np.sqrt(a) * quantile) ** 3))


def low_variance(weights: FloatArray, n: int, rng: np.random.Generator) -> IntArray:
    """Draw `n` indices by weights (M,) with one random number: each is drawn as often as expected.

    Examples
    --------
    >>> low_variance(np.array([0.5, 0.0, 0.5]), 4, np.random.default_rng(0)).tolist()
    [0, 0, 2, 2]
    """
    sums = np.cumsum(weights)
    marks = (np.arange(n) + rng.random()) * (sums[-1] / n)
    return np.asarray(np.minimum(np.searchsorted(sums, marks, side="right"), len(weights) - 1))


class ParticleFilter(ScannedFilter):
    """Weighted poses of the robot, grid frame; see :class:`~imgloc.filters.belief.Filter`.

    Parameters
    ----------
    features : MapFeatures
        The map.
    options : Options, optional
        Options of the search.
    how : ParticleOptions, optional
        Settings of the filter.
    seed : int
        Seed of all random draws.
    """

    def __init__(
        self, features: MapFeatures, options: Options | None = None,
        how: ParticleOptions | None = None, *, seed: int = 0,
    ) -> None:  # fmt: skip
        self.how = how or ParticleOptions()
        if self.how.least > self.how.most:
            raise ConfigError(f"particles: got {self.how.least} to {self.how.most}")
        super().__init__(features, replace(options or Options(), top=20), self.how)
        self._rng = np.random.default_rng(seed)
        self.poses, self.weights = np.empty((0, 3)), np.empty(0)
        self._means: dict[str, tuple[float, float]] = {}  # of each laser, long and short

    def place(self, pose: FloatArray, deviation: tuple[float, float]) -> None:
        """Start at a pose (3,), grid frame, with standard deviations in metres and radians."""
        spread = (deviation[0], deviation[0], deviation[1])
        self.poses = pose + self._rng.standard_normal((self.how.least * 2, 3)) * spread
        self.weights = np.full(len(self.poses), 1 / len(self.poses))
        self._lasers.place()

    def _move(self, increment: FloatArray) -> None:
        if len(self.poses):
            self.poses = sample_motion(self.poses, increment, self.how.noise, self._rng)

    def _see(self, scan: LaserScan, new: float) -> None:
        how, first = self.how, not len(self.poses)
        if first:
            self.poses = self._new(scan, how.most)
            self.weights = np.full(len(self.poses), 1 / len(self.poses))
        seen = sight(self.features, view_of(scan, self._few), self.poses, self._few)
        log = seen.log_likelihood * new
        weights = self.weights * np.exp(log - log.max())
        self.weights = weights / weights.sum()
        # The mean has the present weights, so particles from the last reset count little.
        mean = float(self.weights @ np.exp(-seen.misfit))
        # Lenser and Veloso: the share that is drawn anew follows the running likelihood.
        slow, fast = how.alphas
        long, short = (mean, mean) if first else self._means.get(scan.laser, (mean, mean))
        long, short = long + slow * (mean - long), short + fast * (mean - short)
        self._means[scan.laser] = long, short
        share = max(0.0, 1 - how.slack * short / max(1e-300, long))
        neff = 1 / float(np.square(self.weights).sum())
        if first or share > 0 or neff < len(self.weights) / 2:
            self._resample(scan, share)

    def _resample(self, scan: LaserScan, share: float) -> None:
        how, rng = self.how, self._rng
        kept = self.poses[low_variance(self.weights, how.most, rng)]
        bins = len(first_in_cell(kept, *self.options.fused.separation))
        n = int(
            np.clip(kld_bound(bins, how.error, NormalDist().inv_cdf(MASS[0])), how.least, how.most)
        )
        anew = round(share * n)
        spread = np.array([how.jitter[0], how.jitter[0], how.jitter[1]])
        old = self.poses[low_variance(self.weights, n - anew, rng)]
        old = old + rng.standard_normal(old.shape) * spread
        if anew:
            self._resets += 1
            old = np.concatenate((old, self._new(scan, anew)))
        old[:, 2] = wrap(old[:, 2])
        self.poses, self.weights = old, np.full(len(old), 1 / len(old))

    def _new(self, scan: LaserScan, n: int) -> FloatArray:
        # The scan and these features already allow for the shared error.
        how = replace(self.options, method=self.how.reset_by, shared=Shared())
        drawn = sample_poses(self.features, scan, n, self._rng, how)
        poses = transform_poses(inverse(self.features.grid.origin), drawn)
        return view_of(scan, self.options).robot(poses)

    @property
    def _best(self) -> FloatArray:
        return self.belief.poses[:1]

    @property
    def belief(self) -> Belief:
        """The belief now: the places of the particles."""
        if not len(self.poses):
            return NOWHERE
        # Places with many particles come first, because the order of equal weights is arbitrary.
        metres, radians = self.options.fused.separation
        turn = max(1, round(2 * np.pi / radians))
        cells = np.column_stack(
            (np.floor(self.poses[:, :2] / metres), theta_bin(self.poses[:, 2], turn))
        )
        _, which = np.unique(cells, axis=0, return_inverse=True)
        crowd = np.bincount(which, self.weights)[which]
        order = np.lexsort((-self.weights, -crowd))
        poses, weights = self.poses[order], self.weights[order]
        return self._belief_of(poses, weights, 1 / float(np.square(weights).sum()))
