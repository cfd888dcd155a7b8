"""Images of a map and of likelihoods as a page lays them over it: a pixel a cell, nothing beside.

The lower-left corner of each is that of the map; the top row is the highest y.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from skimage.draw import polygon2mask

from imgloc.errors import ConfigError, MapError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.raycast import cast_rays
from imgloc.geometry import point_on, transform_points, wrap
from imgloc.io.images import encode_png
from imgloc.io.maps import map_png
from imgloc.model import BoolArray, FloatArray, Likelihood, OccupancyGrid, inverse, plain
from imgloc.options import DEFAULTS, LOG_METHODS
from imgloc.output.canvas import wheel

_NEAR = 3.0  # metres, up to which distances have greys of their own: where robots are
_CORNERS = 360  # of what is seen from a place


@dataclass(frozen=True)
class Layer:
    """A picture, and what its greys mean."""

    png: bytes
    resolution: float  #: metres a pixel
    low: float = 0.0  #: what grey 0 stands for, and grey 255
    high: float = 1.0
    slices: int = 0  #: headings of a likelihood
    theta: float = float("nan")  #: heading of this one, map frame, radians

    @property
    def headers(self) -> dict[str, str]:
        """The same as headers of an answer."""
        out = {"Imgloc-Resolution": f"{self.resolution:.9g}"}
        out |= {"Imgloc-Low": f"{self.low:.9g}", "Imgloc-High": f"{self.high:.9g}"}
        if self.slices:
            out["Imgloc-Slices"] = str(self.slices)
        if np.isfinite(self.theta):
            out["Imgloc-Theta"] = f"{self.theta:.9g}"
        return out


def _grey(values: npt.ArrayLike, resolution: float, low: float, high: float) -> Layer:
    share = (np.asarray(values, dtype=np.float32) - low) / max(high - low, 1e-30)
    pixels = np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8)
    return Layer(encode_png(pixels[::-1]), resolution, low, high)


def map_layer(grid: OccupancyGrid) -> Layer:
    """A map as map_saver would write it."""
    return Layer(map_png(grid), grid.resolution, 0, 255)


def feature_layer(features: MapFeatures, what: str) -> Layer:
    """A feature of a map: ``bmap``, ``vmap`` (colour is direction) or ``distance``."""
    cell = features.lattice.resolution
    if what == "bmap":
        return _grey(features.bmap, cell, 0.0, 1.0)
    if what == "distance":
        metres = features.walls * np.float32(features.grid.resolution)
        return _grey(metres, features.grid.resolution, 0.0, min(_NEAR, float(metres.max())))
    x, y = (np.asarray(v, dtype=np.float64) for v in features.vmap)
    strength = np.hypot(x, y)
    colours = wheel(np.arctan2(y, x), strength / max(float(strength.max()), 1e-12))
    return Layer(encode_png(colours[::-1]), cell)


def slice_layer(stack: Likelihood, which: int | None) -> Layer:
    """One heading of a likelihood, or the maximum over all; greys are shares of the highest.

    A ConfigError if there is no such heading.
    """
    values, count = stack.values, len(stack.thetas)
    if which is not None and which >= count:
        raise ConfigError(f"slice: got {which}, expected 0 to {count - 1}, or max")
    image, top = values.max(axis=0) if which is None else values[which], float(values.max())
    low = 0.0 if stack.method in LOG_METHODS else min(0.0, float(values.min()))
    if stack.method in LOG_METHODS:  # as probable as the method is trusted to be
        readings = 1 if stack.scan is None else int(stack.scan.valid.sum())
        temperature = DEFAULTS[stack.method].temperature_at(stack.method, readings)
        image, top = np.exp((image - max(top, -1e30)) / temperature), 1.0
    layer = _grey(image, stack.grid.resolution, low, top)
    turn = stack.grid.origin.theta
    theta = float("nan") if which is None else float(wrap(stack.thetas[which] + turn))
    return Layer(layer.png, layer.resolution, low, top, count, theta)


def region_cells(grid: OccupancyGrid, corners: FloatArray) -> BoolArray:
    """Cells (H, W) whose centre is in a polygon (N, 2), map frame, metres.

    A ConfigError if there is none.

    Examples
    --------
    >>> grid = OccupancyGrid(np.zeros((2, 3), bool), np.ones((2, 3), bool), 1.0)
    >>> corners = np.array([[0.2, 0.2], [1.8, 0.2], [1.8, 0.8], [0.2, 0.8]])
    >>> region_cells(grid, corners).tolist()
    [[True, True, False], [False, False, False]]
    """
    corner = transform_points(inverse(grid.origin), corners)[:, ::-1] / grid.resolution - 0.5
    cells = np.asarray(polygon2mask(grid.occupied.shape, corner), np.bool_)
    if not cells.any():
        raise ConfigError("region: it contains no cell of the map, expected some")
    return cells


def region_layer(grid: OccupancyGrid, corners: FloatArray) -> Layer:
    """A region as the image that `--region` of the command line takes."""
    return _grey(region_cells(grid, corners), grid.resolution, 0.0, 1.0)


def seen_from(features: MapFeatures, at: tuple[float, float]) -> dict[str, object]:
    """The view from a place, map frame: a polygon, and the surface point nearest to it.

    A ConfigError if the place is not on the map, a MapError if the map has no surface.
    """
    grid, surface = features.grid, features.surface
    xy = point_on(grid, at)
    if len(surface) == 0:
        raise MapError("the map has no surface: no occupied cell borders on a free one")
    angles = np.arange(_CORNERS) * (2 * np.pi / _CORNERS)
    ranges = cast_rays(features.walls, xy, angles, features.horizon, grid.resolution)
    reach = np.minimum(ranges, features.horizon)
    ends = xy + reach[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    nearest = int(np.argmin(np.hypot(*(surface.xy - xy).T)))
    point = transform_points(grid.origin, surface.xy[nearest : nearest + 1])[0]
    alpha = float(wrap(surface.alpha[nearest] + grid.origin.theta))
    of = {"x": point[0], "y": point[1], "alpha": alpha}
    polygon_ = transform_points(grid.origin, ends)
    return dict(plain({"at": at, "polygon": polygon_, "surface": of}))
