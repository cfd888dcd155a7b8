"""Do covariances keep what they claim? By true poses, by halves of a scan, by readings left out.

The mean error along the middle of the view shows whether poses lean toward what the sensor sees.

The halves are every other pair of readings. Even and odd ones would do where a scan is of one
moment; but a scanner that reads every half degree in two turns of its mirror, as that of
``belgioioso``, has its odd readings from 0.03 s later: on a robot that turns these are of another
pose, by 0.028 s times the rate of the turn.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imgloc import LaserScan, Localization, MapFeatures, Options, Pose2D, ScanSet, Shared, localize
from imgloc.geometry import in_grid_frame, wrap
from imgloc.lab.bound import least_covariances
from imgloc.lab.calibrate import fit_depth
from imgloc.model import FloatArray
from tools.script import table_lines

REGION = 7.815
"""The 95 % point of chi-square with three degrees of freedom."""
TRUTH = (0.03, 0.03, float(np.deg2rad(0.4)))
"""Standard deviations of recorded poses: metres, metres, radians."""
NEAR = 0.5
"""Metres from the true place; farther off an answer is wrong, not imprecise."""
_ROUND = 0.05  # length of the mean ray, of rays of length 1, below which a view is a full circle


@dataclass(frozen=True)
class Precision:
    """Of the answers that are ``unique`` and right: shares, and medians of standard deviations."""

    name: str
    answers: int
    inside: float  #: true poses within the 95 % region
    agree: float  #: halves of a scan within their joint 95 % region
    moved: float  #: scans that one reading less moves by more than two standard deviations
    claimed: tuple[float, float]  #: metres along one axis, radians
    error: tuple[float, float]  #: root mean square, metres along one axis, radians
    #: mean error, metres: along the middle of the view, and to its left
    bias: tuple[float, float]
    bound: float  #: least root mean square that any method could have, metres along one axis

    @property
    def ratio(self) -> float:
        """Standard deviation that is claimed over the error, of positions."""
        return self.claimed[0] / self.error[0]


def precision(
    name: str,
    features: MapFeatures,
    scans: ScanSet,
    truth: Sequence[float] = TRUTH,
    options: Options | None = None,
    sigma: float = float("nan"),
) -> Precision:
    """Measure one set of scans with poses; `truth` are the standard deviations of those.

    The noise `sigma` of simulated ranges, metres, gives the bound.
    """
    rows, claimed, errors, biases, bounds = [], [], [], [], []
    for k, (scan, pose) in enumerate(scans.with_poses()):
        answer = localize(features, scan, options)
        found, covariance = best_of(answer)
        error = difference(found, pose)
        if answer.verdict != "unique" or np.hypot(*error[:2]) > NEAR:
            continue
        inside = squared(error, covariance + np.diag(np.square(truth))) < REGION
        (a, A), (b, B) = (
            best_of(localize(features, replace(scan, ranges=r, angles=phi), options))
            for r, phi in _halves(scan)
        )
        ranges = scan.ranges.copy()
        ranges[np.random.default_rng((0, k)).choice(np.flatnonzero(scan.valid))] = np.nan
        less = localize(features, replace(scan, ranges=ranges), options)
        step = difference(best_of(less)[0], found)
        moved = bool(np.any(np.abs(step) > 2 * np.sqrt(np.diag(covariance))))
        rows.append((inside, squared(difference(a, b), A + B) < REGION, moved))
        x, y, turn = np.diag(covariance)
        claimed.append(np.sqrt([(x + y) / 2, turn]))
        errors.append([np.hypot(*error[:2]) / np.sqrt(2), error[2]])
        biases.append(_seen_from(error, pose[2] + middle_of_view(scan)))
        at = in_grid_frame(Pose2D(*pose), features.grid.info)
        (least,) = least_covariances(
            features, np.array([[at.x, at.y, at.theta]]), scan.angles, scan.range_max, sigma
        )
        bounds.append(np.trace(least[:2, :2]) / 2)
    if not rows:
        nan = float("nan")
        return Precision(name, 0, nan, nan, nan, (nan, nan), (nan, nan), (nan, nan), nan)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    within, agree, moves = np.mean(rows, axis=0).tolist()
    means = np.median(claimed, axis=0), rms, np.mean(biases, axis=0)
    claims, off, bias = (tuple(v.tolist()) for v in means)
    least = float(np.sqrt(np.mean(bounds)))
    return Precision(name, len(rows), within, agree, moves, claims, off, bias, least)


def knowing(features: MapFeatures, scans: ScanSet) -> tuple[str, Options]:
    """Options with the depth of a map's faces, fitted to other scans of it; and what to call it."""
    depth, _ = fit_depth(features, scans.scans)
    return f"face {100 * depth:.1f} cm deep", Options(shared=Shared(depth=depth))


def precision_table(rows: Sequence[Precision]) -> str:
    """The rows as Markdown."""
    head = "scans | `unique` and right | truth inside | halves agree | moved"
    head += " | claimed m, deg | error m, deg | claimed / error | error / bound"
    head += " | along, across the view cm"
    cells = (
        (r.name, r.answers, *(f"{share:.2f}" for share in (r.inside, r.agree, r.moved)),
         *(f"{m:.4f}, {np.rad2deg(t):.3f}" for m, t in (r.claimed, r.error)),
         f"{r.ratio:.1f}", f"{r.error[0] / r.bound:.1f}".replace("nan", ""),
         ", ".join(f"{100 * m:+.1f}" for m in r.bias))
        for r in rows
    )  # fmt: skip
    return "\n".join(table_lines(head, cells))


def middle_of_view(scan: LaserScan) -> float:
    """Angle of the middle of the view, radians; 0 for a full circle, which has none."""
    ahead = np.exp(1j * scan.angles).mean()
    return float(np.angle(ahead)) if np.abs(ahead) > _ROUND else 0.0


def _seen_from(error: FloatArray, heading: float) -> FloatArray:
    """An error (3,) in x and y as one along a heading, radians, and to its left: (2,) metres."""
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, s], [-s, c]]) @ error[:2]


def _halves(scan: LaserScan) -> list[tuple[FloatArray, FloatArray]]:
    """Ranges and angles of every other pair of readings, and of the pairs between."""
    second = np.arange(len(scan.ranges)) // 2 % 2
    return [(scan.ranges[second == i], scan.angles[second == i]) for i in (0, 1)]


def best_of(answer: Localization) -> tuple[FloatArray, FloatArray]:
    """Pose (3,) and covariance of the first hypothesis; far off if there is none."""
    if not answer.hypotheses:
        return np.full(3, np.inf), np.eye(3)
    best = answer.hypotheses[0]
    return np.array([best.pose.x, best.pose.y, best.pose.theta]), best.covariance


def difference(a: FloatArray, b: FloatArray) -> FloatArray:
    """One pose (3,) less another, its turn within half a circle."""
    with np.errstate(invalid="ignore"):  # where nothing was found
        out = np.asarray(a - b)
    out[2] = wrap(out[2]) if np.isfinite(out[2]) else np.inf
    return out


def squared(error: FloatArray, covariance: FloatArray) -> float:
    """Squared Mahalanobis distance of an error; infinite where nothing was found."""
    if not np.isfinite(error).all():
        return math.inf
    return float(error @ np.linalg.solve(covariance, error))
