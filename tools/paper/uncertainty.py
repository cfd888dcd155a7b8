"""Votes that know how wrong they may be: the uncertainty of eq. 8 (Sec. VII).

By eq. 7 and 8 a pair votes for ``theta = alpha_j - alpha_i`` and ``t = p_j - R(theta) p_i``. With
errors of the two normals, of the range and of the place of the map point,

    d theta = d alpha_j - d alpha_i,    d t = d p_j - R(theta) d p_i - J (R(theta) p_i) d theta,

where J turns by 90 degrees: heading and place err **together**, along the arc around p_j. An
error of the heading is the same thing as an error of alpha_i, so a vote is spread along its
arc, exactly, by letting the scan point vote several times with its normal turned by ``e_m``,
weighted with ``exp(-e_m**2 / (2 (sigma_alpha_i**2 + sigma_alpha_j**2)))``: plain GHT-V of more
points, each vote with its own test of visibility. What is left (the range, the map point, and
arcs longer than the turned copies can fill) is a Gaussian blur of the images. Points that need
more of it vote first and are blurred more often (variances add), so that one stack and a few
blurs serve all.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from imgloc.errors import ConfigError
from imgloc.likelihoods.ght import vote
from imgloc.model import Float32Array, FloatArray, IntArray, OrientedPoints

REACH = 2.5  # standard deviations that a vote is spread to either side
# Weights in steps of 2**-8: sums are exact in float32, so that their order does not matter.
LEVELS = 256
# A surface point's sigma_alpha is rounded to a power of two within these.
LEAST_OCTAVE, GREATEST_OCTAVE = -8, -1


@dataclass(frozen=True)
class Uncertainty:
    """What the terms of eq. 8 are uncertain by; sigma_alpha comes with the points.

    Fewer `copies` are made up for by a wider blur in x and y, not in theta: let them be no further
    apart, 5 sigma_alpha / (copies - 1), than the headings of the stack.
    """

    sigma_range: float = 0.02  #: of a reading, metres
    #: of a surface point, metres: of one per cell the cell's side over the square root of 12
    sigma_surface: float = 0.03
    copies: int = 15  #: most headings that a pair votes for; odd. The time grows with it

    def __post_init__(self) -> None:
        for name in ("sigma_range", "sigma_surface"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ConfigError(f"{name} must be finite and not negative, got {value}")
        if self.copies < 1 or self.copies % 2 == 0:
            raise ConfigError(f"copies must be odd and positive, got {self.copies}")


@dataclass(frozen=True)
class Copies:
    """The scan points that vote in place of the scan's own."""

    index: IntArray  #: (N',) which scan point each is a copy of
    turn: FloatArray  #: (N',) what its normal is turned by, radians
    weight: Float32Array  #: (N',) what its votes count; about 1 over all copies of a point
    #: (N',) 0 for copies a cell apart; g for those ``2**g`` cells apart, which need a blur of half
    #: as much (all up to a factor of 1.4)
    blur: IntArray


def turned_copies(
    sigma: FloatArray, distance: FloatArray, step: float, resolution: float, most: int
) -> Copies:
    """Choose the headings that each scan point votes for.

    `sigma` (N,) is ``hypot(sigma_alpha_i, sigma_alpha_j)``, radians, and `distance` (N,) ``|p_i|``,
    metres; `step` and `resolution` are those of the stack; `most` copies of a point, odd. They come
    point after point, neighbours no more than about a heading and a cell apart as far as `most`
    allows.

    Examples
    --------
    >>> near_and_far = np.array([0.1, 4.0])
    >>> copies = turned_copies(np.full(2, 0.1), near_and_far, 0.5, 0.1, 5)
    >>> copies.index.tolist(), copies.turn.round(3).tolist()
    ([0, 0, 0, 1, 1, 1, 1, 1], [-0.25, 0.0, 0.25, -0.25, -0.125, 0.0, 0.125, 0.25])
    >>> copies.blur.tolist()
    [0, 0, 0, 2, 2, 2, 2, 2]
    """
    wanted = np.minimum(step, resolution / np.maximum(distance, 1e-9))
    half = np.minimum(np.floor(REACH * sigma / wanted + 0.5), most // 2).astype(np.int64)
    index = np.repeat(np.arange(len(sigma)), 2 * half + 1)
    rank = np.arange(len(index)) - np.repeat(np.cumsum(2 * half + 1) - half - 1, 2 * half + 1)
    spacing = REACH * sigma / np.maximum(half, 1)
    gap = spacing * distance / resolution
    blur = np.rint(np.log2(np.maximum(gap, 1.0))).astype(np.int64)
    # What the blur does is not left to the copies: their variances add.
    blurred = np.where(blur > 0, 2.0 ** (blur - 1), 0.0) * resolution / np.maximum(distance, 1e-9)
    left = np.maximum(sigma**2 - blurred**2, 1e-6 * sigma**2)
    turn = np.asarray(rank * spacing[index], dtype=np.float64)
    weight = np.exp(-0.5 * turn**2 / left[index])
    weight /= np.bincount(index, weight, len(sigma))[index]
    return Copies(
        index=index,
        turn=turn,
        weight=(np.rint(weight * LEVELS) / LEVELS).astype(np.float32),
        blur=blur[index],
    )


def octaves(sigma_alpha: FloatArray) -> IntArray:
    """Round standard deviations to powers of two: the exponents, within limits.

    Examples
    --------
    >>> octaves(np.array([0.0, 0.1, 0.3, np.inf])).tolist()
    [-8, -3, -2, -1]
    """
    with np.errstate(divide="ignore"):
        exponent = np.rint(np.log2(sigma_alpha))
    exponent = np.nan_to_num(exponent, nan=GREATEST_OCTAVE)
    return np.clip(exponent, LEAST_OCTAVE, GREATEST_OCTAVE).astype(np.int64)


def vote_spread(
    surface: OrientedPoints,
    visibility: Float32Array | None,
    points: OrientedPoints,
    n_theta: int,
    shape: tuple[int, int],
    resolution: float,
    uncertainty: Uncertainty,
    *,
    once: bool = False,
    threads: int = 1,
) -> Float32Array:
    """GHT-V, and GHT without a visibility, with each vote spread over the poses of eq. 8.

    The parameters are those of :func:`imgloc.likelihoods.ght.ght_v`. With `once`, a scan point
    adds no more than 1 to a cell, before the blur.
    """
    out = np.zeros((n_theta, *shape), np.float32)
    points = points.select(points.valid & np.isfinite(points.xy).all(axis=1))
    # NaN is as uncertain as allowed.
    limits = 2.0**LEAST_OCTAVE, 2.0**GREATEST_OCTAVE
    sigma_i = np.clip(np.nan_to_num(points.sigma_alpha, nan=limits[1]), *limits)
    octave = octaves(surface.sigma_alpha)
    distance = np.hypot(*points.xy.T)
    step = 2 * np.pi / len(out)
    classes: list[tuple[OrientedPoints, Float32Array | None, Copies]] = []
    for k in np.unique(octave[surface.valid]).tolist():
        some = (octave == k) & surface.valid
        sigma = np.hypot(sigma_i, 2.0**k)
        copies = turned_copies(sigma, distance, step, resolution, uncertainty.copies)
        classes.append(
            (surface.select(some), None if visibility is None else visibility[:, some], copies)
        )
    votes = np.empty_like(out)
    base = float(np.hypot(uncertainty.sigma_range, uncertainty.sigma_surface)) / resolution
    widest = max((int(c.blur.max(initial=0)) for _, _, c in classes), default=0)
    for group in range(widest, -1, -1):
        votes.fill(0)
        for surface_k, visibility_k, copies in classes:
            mine = (copies.blur == group) & (copies.weight > 0)
            i = copies.index[mine]
            turned = OrientedPoints(
                points.xy[i], points.alpha[i] + copies.turn[mine], points.sigma_alpha[i],
                points.valid[i],
            )  # fmt: skip
            vote(
                surface_k, visibility_k, turned, resolution, votes,
                weights=copies.weight[mine], once=once, threads=threads,
            )  # fmt: skip
        np.add(out, votes, out=out)
        blur(out, blur_of(group, base))
    return out


def blur_of(group: int, base: float) -> float:
    """Sigma, in cells, that takes votes from the blur of a group to that of the next lower one.

    Group g has a blur of ``2**(g - 1)`` cells, group 0 none, and then `base` on top.

    Examples
    --------
    >>> blur_of(0, 0.4), blur_of(1, 0.4), round(blur_of(3, 0.4) ** 2, 3)
    (0.4, 1.0, 12.0)
    """
    if group == 0:
        return base
    below = 2.0 ** (group - 2) if group > 1 else 0.0
    return float(np.sqrt(4.0 ** (group - 1) - below**2))


def blur(stack: Float32Array, sigma: float) -> None:
    """Blur each image of a stack (K, H, W) in place; beyond its border there is nothing."""
    if sigma <= 0:
        return
    for image in stack:
        cv2.GaussianBlur(image, (0, 0), sigma, dst=image, borderType=cv2.BORDER_CONSTANT)
