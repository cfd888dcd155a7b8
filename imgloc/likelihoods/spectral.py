"""The DFT engine: a heading's correlation as a product of spectra, however many the readings."""

from collections.abc import Iterable

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.likelihoods.slices import Finish, reach_of
from imgloc.model import Float32Array, IntArray
from imgloc.threads import over_slices

# Largest error of a correlation in float32, as a share of the norms of image and kernel multiplied,
# measured on both OpenCV majors. Rounding recovers integers up to an error of 0.5; the margin is
# for other builds, which have other transforms.
EPSILON = 6e-8
ALLOWED_ERROR = 0.1


class Spectrum:
    """The cached spectrum of an image (1, H, W), and correlations with it.

    `reach` is the largest row and column offset. It pads the plane, so that nothing wraps around.
    With `exact` the sums are integers, which rounding recovers. That may need double precision.
    """

    channels = 1

    def __init__(
        self, image: npt.NDArray[np.generic], reach: tuple[int, int], exact: bool, double: bool
    ) -> None:
        _, self.height, self.width = image.shape
        rows, columns = (
            cv2.getOptimalDFTSize(n + r) for n, r in zip(image.shape[1:], reach, strict=True)
        )
        self.shape, self.exact = (rows, columns), exact
        self.dtype: type[np.floating] = np.float64 if double else np.float32
        self.prepare(image)

    def prepare(self, image: npt.NDArray[np.generic]) -> None:
        """Transform the image."""
        values = np.asarray(image[0], dtype=np.float64)
        self.spectrum: npt.NDArray[np.floating] = np.zeros(self.shape, dtype=self.dtype)
        # The scale of the inverse transform is applied here, once for all headings.
        self.spectrum[: self.height, : self.width] = values / (self.shape[0] * self.shape[1])
        cv2.dft(self.spectrum, self.spectrum)

    def scratch(self) -> list[npt.NDArray[np.floating]]:
        """Buffers for :meth:`correlate`, one set per thread."""
        shape = (*self.shape, 2) if self.channels == 2 else self.shape
        return [np.zeros(shape, dtype=self.dtype) for _ in range(2)]

    def transform(
        self, offsets: IntArray, weights: Float32Array, scratch: list[npt.NDArray[np.floating]]
    ) -> None:
        """Draw the scan, (n, 2) offsets of weights (C, n), and transform it into `scratch`."""
        plane = scratch[1]
        plane.fill(0)
        rows, columns = self.shape
        cells = offsets[:, 0] % rows * columns + offsets[:, 1] % columns  # offsets wrap around
        for c, weight in enumerate(weights):
            np.add.at(plane.reshape(-1), self.channels * cells + c, weight)
        cv2.dft(plane, plane)  # in place, because the cache decides half of the time

    def correlate(
        self, scratch: list[npt.NDArray[np.floating]], out: Float32Array, *, half_turn: bool = False
    ) -> None:
        """Write the correlation with the last transformed scan into `out` (H, W).

        A `half_turn` turns that scan by 180 degrees: a mirrored kernel has the conjugate spectrum.
        """
        product, scan = scratch
        multiply_packed(self.spectrum, scan, product, conjugate=not half_turn)
        # No nonzeroRows: with it OpenCV leaves its fast path for float32 (3 times slower).
        cv2.dft(product, product, cv2.DFT_INVERSE | cv2.DFT_REAL_OUTPUT)
        result = product[: self.height, : self.width]
        if self.exact:
            np.rint(result, out=out, casting="unsafe")
        else:
            np.copyto(out, result, casting="unsafe")


class VectorSpectrum(Spectrum):
    """The cached spectrum of a vector field (2, H, W), whose vectors are complex numbers.

    ``sum_p Re(v(x + p) conj(s(p)))`` is the sum of scalar products. One complex transform takes
    less time than two real ones, so a scan with normals costs little more than one without.
    """

    channels = 2

    def prepare(self, image: npt.NDArray[np.generic]) -> None:
        """Transform the field and its conjugate."""
        self.spectra = []
        for sign in (1, -1):
            plane = np.zeros((*self.shape, 2), dtype=np.float32)
            plane[: self.height, : self.width] = np.moveaxis(image, 0, -1) * np.array((1, sign))
            plane /= self.shape[0] * self.shape[1]
            self.spectra.append(cv2.dft(plane).view(np.complex64)[..., 0])

    def correlate(
        self, scratch: list[npt.NDArray[np.floating]], out: Float32Array, *, half_turn: bool = False
    ) -> None:
        """Write the correlation with the last transformed scan into `out` (H, W).

        A `half_turn` turns that scan by 180 degrees, and negates its normals.
        """
        product, scan = (plane.view(np.complex64)[..., 0] for plane in scratch)
        if half_turn:  # the conjugate is then that of the field
            np.multiply(self.spectra[1], scan, out=product)
        else:
            np.conjugate(scan, out=product)
            np.multiply(self.spectra[0], product, out=product)
        cv2.dft(scratch[0], scratch[0], cv2.DFT_INVERSE)
        result = product.real[: self.height, : self.width]
        if half_turn:
            np.negative(result, out=out)
        else:
            np.copyto(out, result)


def multiply_packed(
    a: npt.NDArray[np.floating],
    b: npt.NDArray[np.floating],
    out: npt.NDArray[np.floating],
    *,
    conjugate: bool,
) -> None:
    """Multiply two packed spectra of real images, with the second one conjugated on request.

    It takes a third of the time of ``cv2.mulSpectrums``. Real and imaginary parts lie side by side,
    but for the first column, and the last of an even number of columns: those are packed downwards.
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
    exact: bool,
    finish: Finish,
) -> None:
    """Write the correlation of each heading's scan with the image, summed over components.

    `image` is (C, H, W) uint8 or float32: one image, or the two components of a vector field.
    `offsets` (K, N, 2) are rows and columns from a pose to each point, `weights` (K, C, N) its
    weights. `exact` sums are integers, which rounding recovers; those of a vector field cannot be.
    `finish` is called with each slice. A thread takes pairs of opposite headings.
    """
    near, reach = reach_of(offsets, image.shape)
    kind = VectorSpectrum if len(image) == 2 else Spectrum
    spectrum = kind(image, reach, exact, exact and needs_double(image[0], offsets))

    def work(share: Iterable[tuple[int, int | None]]) -> None:
        scratch = spectrum.scratch()
        for k, opposite in share:
            spectrum.transform(offsets[k][near[k]], weights[k][:, near[k]], scratch)
            spectrum.correlate(scratch, out[k])
            finish(out[k])
            if opposite is not None:
                spectrum.correlate(scratch, out[opposite], half_turn=True)
                finish(out[opposite])

    over_slices(work, _opposite_headings(offsets), threads)


def needs_double(image: npt.NDArray[np.generic], offsets: IntArray) -> bool:
    """True if exact sums of the scans' offsets (K, N, 2) over the image need double precision."""
    keys = (offsets[..., 0] << 32) + offsets[..., 1]  # readings may share cells
    norms = (float(np.linalg.norm(np.unique(key, return_counts=True)[1])) for key in keys)
    # np.linalg.norm would wake the threads of a BLAS.
    norm = float(np.sqrt(np.square(np.asarray(image, dtype=np.float64)).sum()))
    return EPSILON * max(norms, default=0.0) * norm > ALLOWED_ERROR


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
