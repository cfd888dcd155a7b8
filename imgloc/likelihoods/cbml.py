"""CBML and CBML-O: the scan correlated with the blurred map (Secs. II and III)."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.features.fields import BMAP_LEVELS, in_levels
from imgloc.likelihoods.correlate import WEIGHTED, choose_engine, correlate
from imgloc.likelihoods.kernels import remap_stack
from imgloc.likelihoods.shift import Summable, merge_repeats, shift_stack, tiles_of
from imgloc.likelihoods.slices import cell_offsets, check_arguments, finishing, output_stack
from imgloc.model import Float32Array, FloatArray, IntArray, OrientedPoints

# Projections are in -VMAP_LEVELS..VMAP_LEVELS: sums of 258 readings fit into int16.
VMAP_LEVELS = 127


def cbml(
    bmap: Float32Array,
    points_xy: FloatArray,
    thetas: FloatArray,
    resolution: float,
    *,
    engine: str = "auto",
    threads: int = 1,
    out: Float32Array | None = None,
) -> Float32Array:
    """Correlate the scan with the blurred map: CBML, Alg. 1 in the order of Alg. 2.

    `bmap` is rounded to 256 levels, so that the sums are integers. Every number of threads, and
    every engine but ``remap``, gives the same bits.

    Parameters
    ----------
    bmap : (H, W) float array
        Blurred walls, 0..1, from :func:`imgloc.features.fields.bmap`.
    points_xy : (N, 2) float array
        Scan points, sensor frame, metres. Points that are not finite are left out.
    thetas, resolution, engine, threads, out
        See :func:`imgloc.likelihoods.correlate.correlate`.

    Returns
    -------
    (K, H, W) float32 array
        ``L[theta, y, x]``, between 0 and N.

    Raises
    ------
    ConfigError, ValueError
        If `engine`, `threads` or `resolution` is out of its range; if an array does not fit, or
        `bmap` leaves 0..1.

    Examples
    --------
    >>> bmap = np.zeros((3, 3), dtype=np.float32)
    >>> bmap[:, 2] = 1  # a wall on the right
    >>> cbml(bmap, np.array([[1.0, 0.0], [1.0, 1.0]]), np.zeros(1), 1.0)[0]
    array([[0., 2., 0.],
           [0., 2., 0.],
           [0., 1., 0.]], dtype=float32)
    """
    image = in_levels(bmap, "; see imgloc.features.fields.bmap")
    return correlate(
        image, points_xy, thetas, resolution, divisor=BMAP_LEVELS,
        engine=engine, threads=threads, out=out,
    )  # fmt: skip


def cbml_o(
    vmap: Float32Array,
    points: OrientedPoints,
    thetas: FloatArray,
    resolution: float,
    *,
    directions: int = 64,
    engine: str = "auto",
    threads: int = 1,
    projections: npt.NDArray[np.int16] | None = None,
    out: Float32Array | None = None,
) -> Float32Array:
    """Correlate the oriented scan with the blurred vector field: CBML-O, Alg. 3.

    The direction ``alpha_i + theta`` of each normal is rounded to one of `directions`. The field is
    projected on these directions, so that a point adds one shifted image, as in CBML.

    Parameters
    ----------
    vmap : (2, H, W) float array
        Field of vectors of length 0..1, from :func:`imgloc.features.fields.vmap`.
    points : OrientedPoints
        Scan points, sensor frame, metres and radians. Points without a valid normal are left out.
    directions : int
        Number of directions to which normals are rounded, even. With 64 a scalar product of equal
        normals changes by at most 0.12 %.
    engine : {"auto", "filter2d", "shift", "dft", "remap"}
        How to compute it. The engines agree up to 0.004 per reading, the rounding of projections,
        but for ``remap``, which interpolates.
    projections : (directions // 2, H, W) int16 array, optional
        The field's projections from :func:`project`, to be reused from scan to scan. Only ``shift``
        uses them.
    thetas, resolution, threads, out
        See :func:`imgloc.likelihoods.correlate.correlate`.

    Returns
    -------
    (K, H, W) float32 array
        ``L[theta, y, x]``, between -N and N. It is negative if the normals contradict the map.

    Raises
    ------
    ConfigError, ValueError
        If `engine`, `threads`, `resolution` or `directions` is out of its range; if an array does
        not fit, or a vector is longer than 1.

    Examples
    --------
    A wall on the right faces left. Seen from the left its normal points back at the sensor:

    >>> vmap = np.zeros((2, 1, 3), dtype=np.float32)
    >>> vmap[0, 0, 2] = -1
    >>> scan = OrientedPoints([[1.0, 0.0]], [np.pi], [0.1], [True])
    >>> cbml_o(vmap, scan, np.zeros(1), 1.0)[0].round(2).tolist()
    [[0.0, 1.0, 0.0]]
    """
    field = checked_field(vmap, directions)
    check_arguments(resolution, threads)
    usable = points.select(
        points.valid & np.isfinite(points.xy).all(axis=1) & np.isfinite(points.alpha)
    )
    headings = np.asarray(thetas, dtype=np.float64)
    half, shape = directions // 2, (int(field.shape[1]), int(field.shape[2]))
    out = output_stack(out, (len(headings), *shape))
    expected = (half, *shape)
    if projections is not None and projections.shape != expected:
        raise ValueError(f"projections must be {expected}, got {projections.shape}")
    if out.size == 0:
        return out

    def facing(turn: FloatArray | float) -> tuple[IntArray, IntArray]:
        """Direction of each normal, and its projection: k >= 0 to add, -1 - k to subtract."""
        turned = (usable.alpha + turn) * (directions / (2 * np.pi))
        direction = np.floor(turned + 0.5).astype(np.int64) % directions
        return direction, np.where(direction < half, direction, half - 1 - direction)

    offsets = cell_offsets(usable.xy, headings, resolution)
    direction, which = facing(headings[:, None])
    tiles = tiles_of(shape)
    engine = choose_engine(engine, offsets, shape, tiles, components=2, which=which)
    if engine in WEIGHTED:
        vectors = unit_vectors(directions)[direction].transpose(0, 2, 1)  # Alg. 3, l. 4
        WEIGHTED[engine](field, offsets, vectors, threads, out, False, finishing(1.0))
        return out
    limit, finish = np.iinfo(np.int16).max // VMAP_LEVELS, finishing(VMAP_LEVELS)
    if engine == "shift":
        images = project(field, directions) if projections is None else projections
        shift_stack(
            list(images), lambda k: merge_repeats(offsets[k], which[k]), limit, tiles, threads,
            out, finish,
        )  # fmt: skip
        return out

    def turned_projections(image: Float32Array, theta: float) -> Sequence[Summable]:
        c, s = np.float32(np.cos(theta)), np.float32(np.sin(theta))
        x, y = image[..., 0], image[..., 1]
        return list(project(np.stack((c * x + s * y, c * y - s * x)), directions))

    scan = merge_repeats(cell_offsets(usable.xy, np.zeros(1), resolution)[0], facing(0.0)[1])
    remap_stack(
        np.ascontiguousarray(np.moveaxis(field, 0, -1)), headings, turned_projections, scan,
        limit, threads, out, finish,
    )  # fmt: skip
    return out


def project(vmap: Float32Array, directions: int = 64) -> npt.NDArray[np.int16]:
    """Project a vector field on directions, once per map, for the shift engine of CBML-O.

    `vmap` is a (2, H, W) field of vectors of length 0..1, `directions` an even number. The result
    (directions // 2, H, W) int16 is ``127 (vx cos a + vy sin a)``, rounded, for
    a = 2 pi d / directions. The other half of the circle is its negative.

    Examples
    --------
    >>> vmap = np.array([[[1.0]], [[0.0]]], dtype=np.float32)
    >>> project(vmap, 8).ravel().tolist()
    [127, 90, 0, -90]
    """
    field = checked_field(vmap, directions)
    out = np.empty((directions // 2, *field.shape[1:]), dtype=np.int16)
    for image, (c, s) in zip(out, unit_vectors(directions), strict=False):
        np.rint(VMAP_LEVELS * (field[0] * c + field[1] * s), out=image, casting="unsafe")
    return out


def unit_vectors(directions: int) -> Float32Array:
    """Cosine and sine of each direction, (directions, 2) float32."""
    a = np.arange(directions) * (2 * np.pi / directions)
    return np.stack((np.cos(a), np.sin(a)), axis=1).astype(np.float32)


def checked_field(vmap: Float32Array, directions: int) -> Float32Array:
    """Return `vmap` as float32, a pair of images of magnitude 0..1, if `directions` is even."""
    field = np.asarray(vmap, dtype=np.float32)
    if field.ndim != 3 or field.shape[0] != 2:
        raise ValueError(f"vmap must have shape (2, H, W), got {field.shape}")
    longest = np.sqrt(np.max(field[0] ** 2 + field[1] ** 2, initial=0.0))
    if not longest <= 1 + 1e-5:
        raise ValueError(f"vmap must have vectors of length 0..1, got {longest:g}")
    if directions < 2 or directions % 2:
        raise ConfigError(f"directions must be an even number of at least 2, got {directions}")
    return field
