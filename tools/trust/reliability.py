"""Is the trust deserved? Masses, verdicts and covariances held against true poses."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from imgloc import Localization, MapFeatures, Options, Pose2D, ScanSet, localize
from imgloc.geometry import pose_errors, poses_of
from imgloc.lab.evaluation import Share, share
from imgloc.model import BoolArray, FloatArray
from imgloc.output.plots import blank
from tools.trust.precision import difference, squared

RIGHT = (0.5, float(np.deg2rad(15.0)))
"""A hypothesis this near the true pose is right: the separation of hypotheses."""
WRONG = (1.0, float(np.deg2rad(20.0)))
"""A ``unique`` pose farther than this, in metres or radians, is a confident wrong answer."""
LEAST = 0.01
"""Hypotheses of less mass say nothing: they would fill the first bin with easy successes."""


@dataclass(frozen=True)
class Judged:
    """One answer, compared with the true pose."""

    mass: FloatArray  #: (M,) of the hypotheses with :data:`LEAST` or more
    right: BoolArray  #: (M,)
    verdict: str
    wrong: bool  #: ``unique``, and elsewhere
    nees: float  #: normalised squared error of the best pose if ``unique`` and right; else NaN


@dataclass(frozen=True)
class Bin:
    """Hypotheses of a mass from `low` to `high`: number, mean mass, share that is right."""

    low: float
    high: float
    count: int
    mass: float
    right: Share


def judged(
    features: MapFeatures,
    scans: ScanSet,
    options: Options | None = None,
    advance: Callable[[], None] = lambda: None,
) -> Iterator[Judged]:
    """Locate scans whose poses (map frame) are known; `advance` is called after each."""
    for scan, pose in scans.with_poses():
        yield judge_answer(localize(features, scan, options), Pose2D(*pose))
        advance()


def judge_answer(answer: Localization, truth: Pose2D) -> Judged:
    """Compare one answer with the true pose, both in the map frame."""
    told = [h for h in answer.hypotheses if h.mass >= LEAST]
    poses = poses_of(told)
    errors = pose_errors(poses, truth)
    right = np.all(errors <= RIGHT, axis=1)
    unique = answer.verdict == "unique"
    nees = float("nan")
    if unique and right[0]:
        nees = squared(difference(poses[0], np.array([*truth])), told[0].covariance)
    return Judged(
        np.array([h.mass for h in told]),
        np.asarray(right),
        answer.verdict,
        unique and bool(np.any(errors[0] > WRONG)),
        nees,
    )


def reliability(answers: Sequence[Judged], bins: int = 10) -> tuple[tuple[Bin, ...], float]:
    """Sort hypotheses by their mass and count how many are right.

    Also the expected calibration error: the mean distance of mass and share, weighted by counts.

    Examples
    --------
    >>> one = Judged(np.array([0.8, 0.2]), np.array([True, False]), "ambiguous", False, np.nan)
    >>> rows, ece = reliability([one], bins=2)
    >>> [row.count for row in rows], round(ece, 3)
    ([1, 1], 0.2)
    """
    mass = np.concatenate([a.mass for a in answers]) if answers else np.empty(0)
    right = np.concatenate([a.right for a in answers]) if answers else np.empty(0, bool)
    index = np.minimum((mass * bins).astype(int), bins - 1)
    rows = []
    for k in range(bins):
        inside = index == k
        count = int(inside.sum())
        mean = float(mass[inside].mean()) if count else float("nan")
        rows.append(Bin(k / bins, (k + 1) / bins, count, mean, share(right[inside])))
    gaps = [row.count * abs(row.mass - row.right.value) for row in rows if row.count]
    return tuple(rows), float(sum(gaps) / max(1, len(mass)))


def mean_nees(answers: Sequence[Judged]) -> dict[str, object]:
    """Mean normalised squared error of unique right answers, and the band where it should be."""
    values = np.array([a.nees for a in answers if np.isfinite(a.nees)])
    mean = float(values.mean()) if len(values) else None
    return {"mean": mean, "trials": len(values), "band": nees_band(max(1, len(values)))}


def count_verdicts(answers: Sequence[Judged]) -> dict[str, int]:
    """How often each verdict was given."""
    told = [a.verdict for a in answers]
    return {verdict: told.count(verdict) for verdict in sorted(set(told))}


def summary(
    simulated: Mapping[str, Sequence[Judged]],
    recorded: Mapping[str, Sequence[Judged]],
    away: Sequence[Judged],
) -> tuple[tuple[Bin, ...], dict[str, object]]:
    """What there is to say of the trust, for JSON; and the bins of the simulated scans.

    Parameters
    ----------
    simulated, recorded : mapping of str to sequence of Judged
        By the names of worlds and sets.
    away : sequence of Judged
        Scans that were asked of another map than theirs.
    """
    all_simulated = [a for some in simulated.values() for a in some]
    all_recorded = [a for some in recorded.values() for a in some]
    rows, ece = reliability(all_simulated)
    sure = [yes for a in all_simulated for yes in a.right[a.mass >= 0.8].tolist()]
    return rows, {
        "ece": ece,
        "bins": [asdict(row) for row in rows],
        "right of mass 0.8 and more": asdict(share(sure)),
        "unique but wrong, simulated": asdict(share(a.wrong for a in all_simulated)),
        "unique but wrong, recorded": asdict(share(a.wrong for a in all_recorded)),
        "not unique in another map": asdict(share(a.verdict != "unique" for a in away)),
        "nees": {name: mean_nees(some) for name, some in simulated.items()},
        "nees of all": mean_nees(all_simulated),
        "recorded": {
            name: {
                "ece": reliability(some)[1],
                "verdicts": count_verdicts(some),
                "nees": mean_nees(some),
            }
            for name, some in recorded.items()
        },
    }


def nees_band(count: int) -> tuple[float, float]:
    """The 95 % band of the mean of `count` values of chi-square with 3 degrees of freedom.

    Wilson and Hilferty's cube-root approximation, which is good to 0.01 from ten trials on.

    Examples
    --------
    >>> low, high = nees_band(100)
    >>> round(low, 2), round(high, 2)
    (2.54, 3.5)
    """
    k = 3 * count
    z = np.array([-1.959964, 1.959964])
    low, high = 3 * (1 - 2 / (9 * k) + z * np.sqrt(2 / (9 * k))) ** 3
    return float(low), float(high)


def draw_reliability(groups: Mapping[str, Sequence[Bin]]) -> npt.NDArray[np.uint8]:
    """Draw the share of right hypotheses over their mass, with 95 % intervals, (H, W, 3) BGR.

    Parameters
    ----------
    groups : mapping of str to bins
        Of :func:`reliability`, by name.
    """
    figure, pixels = blank(6.2, 6.2, dpi=100)
    axes = figure.add_axes((70 / 620, 60 / 620, 520 / 620, 520 / 620))
    axes.set(
        xlim=(0, 1), ylim=(0, 1), xlabel="mass of the hypothesis", ylabel="share that is right"
    )
    axes.grid(alpha=0.3)
    axes.plot((0, 1), (0, 1), color="#282f38", linewidth=1)
    for (name, bins), colour in zip(groups.items(), ("#0072b2", "#d55e00"), strict=False):
        known = [b for b in bins if b.count]
        mass, right = [b.mass for b in known], [b.right for b in known]
        value = [r.value for r in right]
        axes.vlines(mass, [r.low for r in right], [r.high for r in right], colour, linewidth=2)
        size = [(8 + 3 * np.log10(b.count)) ** 2 / 2 for b in known]
        said = f"{name}: {sum(b.count for b in bins)} hypotheses"
        axes.scatter(mass, value, size, colour, label=said, zorder=3, clip_on=False)
    axes.legend(loc="upper left")
    return pixels()
