"""The grid filter: eq. 1 as image processing.

The belief is a stack of images ``(theta, y, x)`` on the lattice of poses. The integral of eq. 1 is
computed image by image. Each image is shifted by the motion, turned into its heading
(``warpAffine``), blurred by the errors of the motion, and mixed with the images of neighbouring
headings around the circle. Walls and unknown space hold no mass. A scan multiplies the belief by
the calibrated likelihood of any method. Once nearly all of the mass lies in a small box, only the
cells of that box are computed and scored. That makes the filter fast enough for real time.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import cv2
import numpy as np

from imgloc.features.budget import check_budget
from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import NOWHERE, Belief
from imgloc.filters.evidence import sight, view_of
from imgloc.filters.motion import MotionNoise, deviations
from imgloc.geometry import centre_of, rotation, wrap
from imgloc.lab.scanned import MASS, SUDDENLY, ScannedFilter, ScannedOptions
from imgloc.likelihoods.stacks import likelihood
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray, LaserScan, inverse
from imgloc.numbers import number
from imgloc.options import METHODS, Count, Nats, Options, Share
from imgloc.ranges import OneOf
from imgloc.search.stacked import posterior_of

_ROOT = float(np.sqrt(2 * np.pi))
_FINE = 32  # warpAffine interpolates between so many places of a pixel
_COPIES = 4  # stacks that are held at a time
_WIDE = 16.0  # cells: a wider blur costs less as a product of matrices
_EXACT = MotionNoise(0.0, 0.0, 0.0, 0.0, (0.0, 0.0))


@dataclass(frozen=True)
class GridOptions(ScannedOptions):
    """Settings of the grid filter."""

    #: method whose likelihood multiplies the belief on the whole map
    method: Annotated[str, OneOf(*METHODS)] = "ght-v"
    #: largest number of cells of the box, over all headings, that are scored one by one
    box_cells: Count = number("GridOptions.box_cells")
    #: nats per reading by which the misfit may exceed the usual one before p(x | z) is mixed in
    surprise: Nats = SUDDENLY
    #: share of p(x | z) that is then mixed in: sensor resetting
    share: Share = number("GridOptions.share")


def predict(
    belief: Float32Array, thetas: FloatArray, resolution: float, free: BoolArray,
    increment: FloatArray, noise: MotionNoise,
) -> Float32Array:  # fmt: skip
    """Move a belief (K, H, W) by an increment (3,), metres, metres, radians, and blur it: eq. 1.

    Parameters
    ----------
    thetas : (K,) float array
        Headings, radians, equally spaced over the circle.
    free : (H, W) bool array
        Cells that can hold mass. Mass that would leave them is spread over the others.

    Returns
    -------
    (K, H, W) float32 array
        Its sum is that of `belief`. It is all 0 if nearly no mass would stay on free cells, because
        the belief was wrong.

    Examples
    --------
    >>> belief = np.zeros((4, 5, 5), np.float32)
    >>> belief[0, 2, 1] = 1
    >>> still = MotionNoise(0, 0, 0, 0, (0, 0))
    >>> moved = predict(belief, np.arange(4) * np.pi / 2, 1.0, np.ones((5, 5), bool),
    ...                 np.array([2.0, 0, np.pi / 2]), still)
    >>> np.argwhere(moved > 0.5).tolist()
    [[1, 2, 3]]
    """
    first, along, second = deviations(increment, noise).tolist()
    go = float(np.hypot(*increment[:2]))
    # An error of the first turn moves poses sideways. The blur is round and has the larger width.
    sigma, out = max(along, first * go) / resolution, np.empty_like(belief)
    shift = _shift_far if sigma > _WIDE else _shift_near
    for k, theta in enumerate(thetas):
        out[k] = shift(belief[k], rotation(theta) @ increment[:2] / resolution, sigma)
    out = turn(out, float(increment[2]), float(np.hypot(first, second)))
    out *= free
    before, whole = belief.sum(dtype=np.float64), out.sum(dtype=np.float64)
    out *= np.float32(before / whole if whole > (1 - MASS[1]) * before else 0.0)
    return out


def _shift_near(image: Float32Array, shift: FloatArray, sigma: float) -> Float32Array:
    """Shift an image (H, W) by x and y (2,), pixels, and blur it by `sigma` pixels."""
    kernel, (height, width) = gaussian(sigma), image.shape
    # The image has a rim, because mass that is shifted off the map may be blurred back onto it.
    rim = len(kernel) // 2 + 1
    x, y = np.rint(shift * _FINE) / _FINE
    M = np.array([[1.0, 0.0, x + rim], [0.0, 1.0, y + rim]])
    size = width + 2 * rim, height + 2 * rim
    moved = cv2.warpAffine(image, M, size, flags=cv2.INTER_LINEAR)
    blurred = cv2.sepFilter2D(moved, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred[rim : rim + height, rim : rim + width])


def _shift_far(image: Float32Array, shift: FloatArray, sigma: float) -> Float32Array:
    """Shift and blur like :func:`_shift_near`, as matrix products: any width costs the same."""
    x, y = (
        np.exp(-0.5 * np.square((np.subtract.outer(i, i) - by) / sigma)) / (sigma * _ROOT)
        for by, i in zip(shift, map(np.arange, image.shape[::-1]), strict=True)
    )
    return np.asarray(y.astype(np.float32) @ image @ x.astype(np.float32).T)


def turn(stack: Float32Array, angle: float, sigma: float) -> Float32Array:
    """Move a stack (K, H, W) around the circle by an angle, and blur it by `sigma`, radians."""
    step = 2 * np.pi / len(stack)
    whole, part = divmod(angle / step, 1.0)
    # A blur wider than the circle is uniform around it.
    taps = np.convolve(gaussian(min(sigma, 2 * np.pi) / step).ravel(), [1 - part, part])
    by = np.arange(len(taps)) + int(whole) - (len(taps) - 2) // 2
    out = np.zeros_like(stack)
    for j, weight in enumerate(np.bincount(by % len(stack), taps, len(stack))):
        if weight > 0:
            out += np.float32(weight) * np.roll(stack, j, axis=0)
    return out


def gaussian(sigma: float) -> Float32Array:
    """A Gaussian kernel (2 r + 1, 1) of `sigma` pixels out to three of them; sums to 1."""
    return np.asarray(cv2.getGaussianKernel(2 * int(np.ceil(3 * sigma)) + 1, max(sigma, 1e-3)))


class GridFilter(ScannedFilter):
    """A belief over the cells of a map's lattice and some headings.

    Parameters
    ----------
    features : MapFeatures
        The map, with the cells of the belief: 0.1 m by default. Larger cells are faster.
    options : Options, optional
        Headings of the method, threads and memory budget.
    how : GridOptions, optional
        Settings of the filter.

    Raises
    ------
    ConfigError
        If the stacks take more than the memory budget.
    """

    knows_bent = False

    def __init__(
        self, features: MapFeatures, options: Options | None = None, how: GridOptions | None = None
    ) -> None:
        self.how = how or GridOptions()
        options = replace(options or Options(), method=self.how.method)
        super().__init__(features, options, self.how)
        self.thetas, self.lattice = options.thetas, self.features.lattice
        shape = (len(self.thetas), *self.lattice.shape)
        what = f"a grid filter of {shape[0]} headings x {shape[1]} x {shape[2]} cells"
        need = _COPIES * 4 * int(np.prod(shape))
        check_budget(need, self.options.memory_budget, what, "use larger cells")
        self._free = self.features.free
        self._box = (slice(0, shape[1]), slice(0, shape[2]))
        self._belief = np.zeros(shape, np.float32)
        self._belief[:] = self._free / max(1, shape[0] * int(np.count_nonzero(self._free)))
        self._seen = False
        self._room = np.inf  #: metres that the mass can still move within the box

    @property
    def stack(self) -> Float32Array:
        """The whole belief (K, H, W), also while only a box of it is computed."""
        if self._belief.shape[1:] == self.lattice.shape:
            return self._belief
        out = np.zeros((len(self.thetas), *self.lattice.shape), np.float32)
        out[:, self._box[0], self._box[1]] = self._belief
        return out

    def place(self, pose: FloatArray, deviation: tuple[float, float]) -> None:
        """Start at a pose (3,), grid frame, with standard deviations in metres and radians."""
        self._dense()
        metres, radians = deviation
        rows, columns = (
            centre_of(np.stack((np.arange(n),) * 2, axis=1), self.lattice.resolution)[:, 0]
            for n in self.lattice.shape
        )
        x = np.exp(-0.5 * np.square((columns - pose[0]) / metres))
        y = np.exp(-0.5 * np.square((rows - pose[1]) / metres))
        turned = np.exp(-0.5 * np.square(wrap(self.thetas - pose[2]) / radians))
        stack = turned[:, None, None] * (y[:, None] * x * self._free)
        self._belief, self._seen = (stack / max(1e-300, stack.sum())).astype(np.float32), True
        self._sparse()
        self._lasers.place()

    def _move(self, increment: FloatArray) -> None:
        if not self._seen:
            return  # a uniform belief stays uniform
        first, along, _ = deviations(increment, self.how.noise).tolist()
        go = float(np.hypot(*increment[:2]))
        reach = go + 3 * max(along, first * go)
        if reach > self._room:
            self._sparse(reach)
        self._room -= reach
        self._belief = predict(
            self._belief, self.thetas, self.lattice.resolution,
            self._free[self._box], increment, self.how.noise,
        )  # fmt: skip
        if not self._belief.any():  # the robot is not where it was believed to be
            self._dense()
            self._seen = False
            self._normalise()

    def _see(self, scan: LaserScan, new: float) -> None:
        new = new if self._seen else 1.0
        most = self._lasers.of(scan).usual + self.how.surprise
        surprised = self._seen and self._misfit_at_best(scan) > most
        if surprised:
            self._dense()
        if self._belief.shape[1:] == self.lattice.shape:
            self._multiply_all(scan, new, mix=surprised)
        else:
            self._multiply_box(scan, new)
        self._seen = True
        self._sparse()

    def _multiply_all(self, scan: LaserScan, new: float, *, mix: bool) -> None:
        stack = likelihood(self.features, scan, self.options)
        posterior = posterior_of(self.features, scan, stack, self.options)
        uniform = 1 / max(1, posterior.shape[0] * int(np.count_nonzero(self._free)))
        if scan.T_base_laser is not None:  # where the robot is if its sensor is there
            back = inverse(scan.T_base_laser)
            move = np.array([back.x, back.y, back.theta])
            posterior = predict(
                posterior, self.thetas, self.lattice.resolution, self._free, move, _EXACT
            )
        if not posterior.any():
            return
        if mix:
            self._resets += 1
            self._belief = (1 - self.how.share) * self._belief + self.how.share * posterior
        # What is left, as a share of a uniform likelihood, is the least one of a cell: none is out.
        self._belief *= (posterior / np.float32(uniform) + np.float32(1 - MASS[1])) ** new
        self._normalise()

    def _multiply_box(self, scan: LaserScan, new: float) -> None:
        """Score the cells that hold mass, by the score of the default method."""
        flat = self._belief.ravel()
        some = np.argsort(-flat, kind="stable")[: self.how.box_cells]
        some = some[flat[some] > 1e-9]
        view = view_of(scan, self._few)
        seen = sight(self.features, view, self._poses(some), self._few)
        out = np.zeros_like(flat)
        gain = (seen.log_likelihood - seen.log_likelihood.max()) * new
        out[some] = flat[some] * np.exp(gain).astype(np.float32)
        self._belief = out.reshape(self._belief.shape)
        self._normalise()

    def _poses(self, flat: IntArray) -> FloatArray:
        """Poses (N, 3) of cells of the box."""
        k, row, column = np.unravel_index(flat, self._belief.shape)
        cells = np.column_stack((row + self._box[0].start, column + self._box[1].start))
        return np.column_stack((centre_of(cells, self.lattice.resolution), self.thetas[k]))

    @property
    def _best(self) -> FloatArray:
        at = [int(np.argmax(self._belief))] if self._seen else []
        return self._poses(np.array(at, np.int64))

    def _normalise(self) -> None:
        whole = float(self._belief.sum(dtype=np.float64))
        if whole > 0:
            self._belief /= np.float32(whole)
        else:
            self._belief[:] = self._free[self._box]
            self._belief /= np.float32(self._belief.sum(dtype=np.float64))

    def _dense(self) -> None:
        self._belief = self.stack
        self._box = (slice(0, self.lattice.height), slice(0, self.lattice.width))
        self._room = np.inf

    def _sparse(self, reach: float = 0.0) -> None:
        """Keep only the box around nearly all of the mass, and `reach` metres more, if small."""
        stack, ends = self._belief, []
        image = stack.sum(axis=0, dtype=np.float64)
        # Only a box is computed that holds this mass.
        tail, room = (1 - MASS[1]) / 4, self.options.fused.separation[0] + reach
        around = int(min(np.ceil(room / self.lattice.resolution), max(self.lattice.shape)))
        for axis, old in ((1, self._box[0]), (0, self._box[1])):
            sums = np.cumsum(image.sum(axis=axis))
            low, high = np.searchsorted(sums, [tail * sums[-1], (1 - tail) * sums[-1]])
            ends.append((old.start + int(low) - around, old.start + int(high) + around + 1))
        limits = self.lattice.shape
        box = tuple(slice(max(0, a), min(n, b)) for (a, b), n in zip(ends, limits, strict=True))
        if np.prod([s.stop - s.start for s in box]) > self.how.box_cells:
            self._dense()
            return
        whole = self.stack
        self._box, self._room = (box[0], box[1]), room
        self._belief = np.ascontiguousarray(whole[:, box[0], box[1]])
        self._normalise()

    @property
    def belief(self) -> Belief:
        """The belief now: the places of the heaviest cells."""
        if not self._seen:
            return NOWHERE
        flat = self._belief.ravel().astype(np.float64)
        n = min(2000, flat.size)
        some = np.argpartition(-flat, n - 1)[:n]
        some = some[np.lexsort((some, -flat[some]))]
        poses, mass = self._poses(some), flat[some]
        return self._belief_of(poses, mass, 1 / float(np.square(flat).sum()))
