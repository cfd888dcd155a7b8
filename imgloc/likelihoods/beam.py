"""The beam model, eq. 2, for every pose of a lattice: the paper's "Table" as image operations."""

from collections.abc import Iterable

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.geometry import theta_bin, wrap
from imgloc.model import BoolArray, Float32Array, FloatArray
from imgloc.numbers import number
from imgloc.options import EvidenceModel
from imgloc.threads import over_slices

_CM = 100.0
_REACH = 127  # steps that the table of log densities reaches in front of the reading
_BLOCK = 1 << 17  # pixels worked on at a time, so that they stay in the second-level cache


def beam(
    distances: npt.NDArray[np.uint16],
    ranges: FloatArray,
    angles: FloatArray,
    valid: BoolArray,
    thetas: FloatArray,
    *,
    sigma: float = EvidenceModel().sigmas[0],
    sigma_theta: float = 0.0,
    hit: float = EvidenceModel.hit,
    short: float = number("beam.short"),
    span: float = EvidenceModel.span,
    threads: int = 1,
) -> Float32Array:
    """Compute the log-likelihood of a scan for the poses at all cell centres and headings.

    Parameters
    ----------
    distances : (n_psi, H, W) uint16 array
        Distance to the wall from each cell in n_psi directions, from
        :func:`imgloc.features.raydistance.ray_distances`. n_psi is a multiple of K.
    ranges, angles : (N,) float arrays
        Metres, and radians in the sensor frame.
    valid : (N,) bool array
        The mask of a :class:`imgloc.model.LaserScan`. Other readings, also those without return,
        are no evidence: real sensors lose readings on dark and slanted surfaces.
    thetas : (K,) float array
        Headings, radians, uniform over the circle and starting at 0.
    sigma, sigma_theta : float
        The standard deviation of a hit at range rho is hypot(sigma, rho sigma_theta), metres.
        `sigma` covers the sensor and half a cell (of 10 cm by default). `sigma_theta`, radians,
        covers the rounding of headings, see :func:`heading_sigma`.
    hit, short, span : float
        `hit` is the share of readings of the mapped wall, `short` that of something unmapped before
        it. The rest, > 0, may also come from *behind* the wall. Both `short` and the rest are
        spread over `span` metres.
    threads : int
        Number of threads, each for some headings. The result does not depend on it.

    Returns
    -------
    (K, H, W) float32 array
        Nats, up to a constant of the scan. 0 everywhere for a scan without evidence.

    Raises
    ------
    ConfigError
        If an array has a wrong shape or a parameter is out of its range.

    Notes
    -----
    The robust form of eq. 2, ``sum_i log p(rho_i | r_m(x, y, theta + phi_i))`` with
    ``p(rho | r) = hit N(rho - r; sigma^2) + (short [rho < r] + 1 - hit - short) / span``, the
    direction rounded to one of the stack. The readings count as independent, which they are not.
    The temperatures in :mod:`imgloc.options` make up for that.

    Examples
    --------
    Two walls, 0.4 m apart; a reading of 0.25 m forward fits best in one cell:

    >>> from imgloc.features.raydistance import ray_distances
    >>> d = ray_distances(np.array([[1, 0, 0, 0, 0, 1]], bool), 0.1, 4, 5.0)
    >>> one = np.array([True])
    >>> L = beam(d, np.array([0.25]), np.zeros(1), one, np.array([0, np.pi]), sigma=0.05)
    >>> L.argmax(axis=2)[:, 0].tolist()
    [2, 3]
    """
    distances = np.asarray(distances)
    rho, phi = np.asarray(ranges, np.float64), np.asarray(angles, np.float64)
    _check(distances, thetas, {"ranges": rho, "angles": phi, "valid": valid})
    n_psi, k = len(distances), len(thetas)
    if threads < 1:
        raise ConfigError(f"threads must be at least 1, got {threads}")
    if not (sigma > 0 and sigma_theta >= 0 and span > 0):
        raise ConfigError(
            f"sigma {sigma} and span {span} must be positive, "
            f"sigma_theta {sigma_theta} not negative"
        )
    if not (hit >= 0 and short >= 0 and hit + short < 1):
        raise ConfigError(f"hit {hit} and short {short} must be shares with a sum below 1")

    floors = (1 - hit - short) / span, (1 - hit) / span
    beams = []
    for r, a in zip(rho[valid], phi[valid], strict=True):
        deviation = float(np.hypot(sigma, r * sigma_theta))
        beams.append((int(theta_bin(a, n_psi)), *_hit_table(r, deviation, hit, floors)))

    out = np.zeros((k, *distances.shape[1:]), np.float32)
    rows = max(1, _BLOCK // max(1, distances.shape[2]))

    def work(share: Iterable[tuple[int, int]]) -> None:
        for index, top in share:
            total = out[index, top : top + rows]
            ahead, offset = np.empty((2, *total.shape), np.uint16)
            entry, value = np.empty(total.shape, np.uint8), np.empty(total.shape, np.float32)
            for psi, start, step, table in beams:
                r_m = distances[(psi + index * (n_psi // k)) % n_psi, top : top + rows]
                # r_m - start in steps, cut to the length of the table. `offset` is an image of
                # `start`, because OpenCV takes a scalar for an image of four rows.
                offset.fill(start)
                cv2.subtract(r_m, offset, dst=ahead)  # saturates at 0
                cv2.convertScaleAbs(ahead, dst=entry, alpha=1 / step)  # saturates at 255
                cv2.LUT(entry, table, dst=value)
                cv2.add(total, value, dst=total)  # eq. 2, its logarithm

    tops = range(0, distances.shape[1], rows)
    over_slices(work, [(index, top) for index in range(k) for top in tops], threads)
    return out


def _check(
    distances: npt.NDArray[np.uint16],
    thetas: FloatArray,
    readings: dict[str, FloatArray | BoolArray],
) -> None:
    """Refuse distances, headings and readings whose shapes do not go together."""
    if distances.ndim != 3 or distances.dtype != np.uint16:
        found = f"{distances.shape} {distances.dtype}"
        raise ConfigError(f"distances must be a (n_psi, H, W) uint16 stack, got {found}")
    n_psi, k = len(distances), len(thetas)
    if k < 1 or n_psi % k:
        raise ConfigError(f"n_psi = {n_psi} must be a multiple of the number of headings, {k}")
    if not np.allclose(wrap(thetas - np.arange(k) * (2 * np.pi / k)), 0, atol=1e-9):
        raise ConfigError("thetas must be 2 pi k / K for k = 0 .. K - 1")
    shapes = {name: np.shape(values) for name, values in readings.items()}
    if len({*shapes.values()}) > 1 or len(shapes["ranges"]) != 1:
        found = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ConfigError(f"{found} must be vectors of one length")


def heading_sigma(n_thetas: int) -> float:
    """A good `sigma_theta` for a number of headings, radians.

    It is the deviation of the sum of two uniform draws within a step: headings are rounded, and
    rays, too.

    Examples
    --------
    >>> round(float(np.rad2deg(heading_sigma(120))), 3)
    1.732
    """
    return float(2 * np.pi / n_thetas / np.sqrt(3))


def _hit_table(
    rho: float, sigma: float, hit: float, floors: tuple[float, float]
) -> tuple[int, float, Float32Array]:
    """Log density of a reading `rho` over the expected distance: first entry, step, table.

    Entry j is for an expected distance of ``start + j * step`` centimetres. The first entry serves
    all nearer distances, the last one all farther ones.
    """
    step = max(1.0, 8 * sigma * _CM / _REACH)  # so that the table reaches 8 sigma
    start = int(np.clip(round(rho * _CM - _REACH * step), 0, np.iinfo(np.uint16).max))
    error = rho - (start + step * np.arange(256)) / _CM
    normal = np.exp(-0.5 * (error / sigma) ** 2) / (np.sqrt(2 * np.pi) * sigma)
    density = hit * normal + np.where(error < 0, floors[1], floors[0])
    return start, step, np.log(density).astype(np.float32)
