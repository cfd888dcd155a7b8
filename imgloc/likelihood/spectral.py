"""The DFT engine: the correlation of one heading as a product of spectra.

The cost does not depend on the number of readings, so it wins for dense scans.
"""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.likelihood.slices import Finish, over_slices
from imgloc.model import Float32Array, FloatArray, IntArray

# Largest error of a correlation in float32, in norms of image and kernel multiplied: measured
# on both OpenCV majors, and reached when all readings share a cell. Integers are recovered from
# an error below 0.5; a tenth is allowed, as other builds have other transforms.
EPSILON = 6e-8
ALLOWED_ERROR = 0.1


class Spectrum:
    """The cached spectra of an image of one or two components, and the scratch to use them.

    Parameters
    ----------
    image : (C, H, W) array
        The components: bmap for CBML, the two of vmap for CBML-O.
    reach : (int, int)
        Largest row and column offset; they pad the plane, so that nothing wraps around.
    weight : float
        Largest Euclidean norm of the kernels to come. It decides between single and double
        precision, where integers must survive the transforms.
    exact : bool
        Whether sums are integers, to be recovered by rounding.
    """

    def __init__(
        self, image: npt.NDArray[np.generic], reach: tuple[int, int], weight: float, exact: bool
    ) -> None:
        self.components, self.height, self.width = image.shape
        self.exact = exact
        values = np.asarray(image, dtype=np.float64)
        doubtful = exact and _doubtful(values, weight)
        self.dtype: type[np.floating] = np.float64 if doubtful else np.float32
        self.shape = (
            cv2.getOptimalDFTSize(self.height + reach[0]),
            cv2.getOptimalDFTSize(self.width + reach[1]),
        )
        self.spectra: list[npt.NDArray[np.floating]] = []
        for component in values:
            plane = np.zeros(self.shape, dtype=self.dtype)
            # The scale of the inverse transform goes in here, once for all headings.
            plane[: self.height, : self.width] = component / (self.shape[0] * self.shape[1])
            cv2.dft(plane, plane)
            self.spectra.append(plane)

    def scratch(self) -> list[npt.NDArray[np.floating]]:
        """Buffers for :meth:`correlate`, one set per thread."""
        return [np.zeros(self.shape, dtype=self.dtype) for _ in range(2 + self.components)]

    def transform(
        self,
        offsets: IntArray,
        weights: Float32Array,
        scratch: list[npt.NDArray[np.floating]],
    ) -> None:
        """Draw the scan, (n, 2) offsets of weights (C, n), and transform it into `scratch`."""
        h, w = self.shape
        flat = (offsets[:, 0] % h) * w + offsets[:, 1] % w
        for component, plane in zip(weights, scratch[2:], strict=True):
            plane.fill(0)
            np.add.at(plane.reshape(-1), flat, component)
            cv2.dft(plane, plane)  # in place: what is in the cache is half of the work

    def correlate(
        self,
        scratch: list[npt.NDArray[np.floating]],
        out: Float32Array,
        *,
        half_turn: int = 0,
    ) -> None:
        """Write the correlation with the scan last transformed into `out` (H, W).

        A `half_turn` of +1 or -1 takes the scan turned by 180 degrees instead, its weights times
        that number: the spectrum of a mirrored kernel is the conjugate.
        """
        product, spare = scratch[:2]
        for k, (image, scan) in enumerate(zip(self.spectra, scratch[2:], strict=True)):
            multiply_packed(image, scan, product if k == 0 else spare, conjugate=half_turn == 0)
            if k > 0:
                cv2.add(product, spare, product)
        # No nonzeroRows: with it OpenCV leaves its fast path for float32 (3 times slower).
        cv2.dft(product, product, cv2.DFT_INVERSE | cv2.DFT_REAL_OUTPUT)
        result = product[: self.height, : self.width]
        if self.exact:
            np.rint(result, out=out, casting="unsafe")
            result = out
        if half_turn < 0:
            np.negative(result, out=out, casting="unsafe")
        elif result is not out:
            np.copyto(out, result, casting="unsafe")


def multiply_packed(
    a: npt.NDArray[np.floating],
    b: npt.NDArray[np.floating],
    out: npt.NDArray[np.floating],
    *,
    conjugate: bool,
) -> None:
    """Multiply two packed spectra of real images, the second one conjugated if so wanted.

    What ``cv2.mulSpectrums`` does, at a third of its cost. Real and imaginary parts lie side by
    side, but for the first column, and the last of an even number: those are packed downwards.
    """
    width = a.shape[1]
    paired = slice(1, width - 1 + width % 2)
    kind = np.result_type(a.dtype, np.complex64)
    x, y, z = (plane[:, paired].view(kind) for plane in (a, b, out))
    if conjugate:
        np.conjugate(y, out=z)
        y = z
    np.multiply(x, y, out=z)
    for column in {0, width - 1} if width % 2 == 0 else {0}:
        first, second = (np.ascontiguousarray(plane[:, column])[None] for plane in (a, b))
        product = cv2.mulSpectrums(first, second, cv2.DFT_ROWS, conjB=conjugate)
        out[:, column] = product[0]


def spectral_stack(
    image: npt.NDArray[np.generic],
    offsets: IntArray,
    weights: Float32Array,
    threads: int,
    out: Float32Array,
    *,
    half_turn: int,
    exact: bool,
    finish: Finish,
) -> None:
    """Write the correlation of each heading's scan with the image, summed over components.

    Parameters
    ----------
    image : (C, H, W) array
        One image, or the two components of a vector field.
    offsets : (K, N, 2) int array
        (rows, columns) from a pose to each point.
    weights : (K, C, N) float32 array
        What each point counts in each component.
    threads : int
        Number of threads, over pairs of opposite headings.
    out : (K, H, W) float32 array
        Overwritten.
    half_turn : {1, -1}
        What half a turn does to the weights: nothing, or a change of sign (normals).
    exact : bool
        Whether the sums are integers, to be recovered by rounding.
    finish : callable
        Called with each slice.
    """
    _, height, width = image.shape
    near = np.all(np.abs(offsets) < (height, width), axis=2)  # the others miss from every pose
    reach = np.where(near[..., None], np.abs(offsets), 0).max(axis=(0, 1), initial=0)
    norm = _kernel_norm(offsets) if exact else 0.0
    spectrum = Spectrum(image, (int(reach[0]), int(reach[1])), norm, exact)
    units = _opposite_headings(offsets)

    def work(share: Sequence[tuple[int, int | None]]) -> None:
        scratch = spectrum.scratch()
        for k, opposite in share:
            spectrum.transform(offsets[k][near[k]], weights[k][:, near[k]], scratch)
            spectrum.correlate(scratch, out[k])
            finish(out[k])
            if opposite is not None:
                spectrum.correlate(scratch, out[opposite], half_turn=half_turn)
                finish(out[opposite])

    over_slices(work, units, threads)


def needs_double(image: npt.NDArray[np.generic], offsets: IntArray) -> bool:
    """Tell whether exact sums of these scans (K, N, 2) over the image need double precision."""
    return _doubtful(np.asarray(image, dtype=np.float64), _kernel_norm(offsets))


def _doubtful(values: FloatArray, weight: float) -> bool:
    # Not np.linalg.norm, which wakes the threads of a BLAS.
    return EPSILON * weight * float(np.sqrt(np.square(values).sum())) > ALLOWED_ERROR


def _kernel_norm(offsets: IntArray) -> float:
    """Return the largest norm of a scan drawn with weight 1: readings may share cells."""
    keys = (offsets[..., 0] << 32) + offsets[..., 1]
    norms = (float(np.linalg.norm(np.unique(key, return_counts=True)[1])) for key in keys)
    return max(norms, default=0.0)


def _opposite_headings(offsets: IntArray) -> list[tuple[int, int | None]]:
    """Pair each heading with the one half a turn on, where rounding kept the offsets opposite."""
    half, odd = divmod(len(offsets), 2)
    if odd or half == 0:
        return [(k, None) for k in range(len(offsets))]
    units: list[tuple[int, int | None]] = []
    for k in range(half):
        if np.array_equal(offsets[k], -offsets[k + half]):
            units.append((k, k + half))
        else:
            units += [(k, None), (k + half, None)]
    return units
