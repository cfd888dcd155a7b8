"""Pictures of what is computed from a map: surfaces, blurred maps, visibility, distances.

Those of arrays are bare, for :func:`imgloc.output.plots.framed`.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import MapError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import point_on, transform_points
from imgloc.model import (
    Float32Array,
    FloatArray,
    GridInfo,
    IntArray,
    OccupancyGrid,
    OrientedPoints,
)
from imgloc.output.canvas import (
    GREY,
    INK,
    PALETTE,
    PAPER,
    SHADE,
    WHOLE,
    Image,
    Part,
    Picture,
    building,
    faded,
    map_canvas,
    marker_size,
    sheet,
    wheel,
)
from imgloc.output.plots import AREA, DOT, Bar, Entry, framed

_NEAR = 3.0  # metres, up to which distances have colours of their own
_GREYS: Image = np.array([[faded(INK, share) for share in np.linspace(0, 1, 64)]], np.uint8)
_WALLS: Sequence[Entry] = ((GREY, AREA, "wall"), (SHADE, AREA, "unknown"))
_TITLES = {
    "bmap": "bmap: blurred walls, in which CBML looks up endpoints",
    "vmap": "vmap: blurred directions of walls, with which CBML-O compares those of a scan",
    "surface": "Surface: the points of walls that can be seen, and the way that they face",
    "visibility": "Visibility: what one point of a wall sees",
    "distance": "Distance of each cell to the nearest wall",
}
#: What :func:`draw_feature` draws.
SUBJECTS = ("map", *_TITLES)


def draw_map(grid: OccupancyGrid, title: str = "") -> Picture:
    """Draw a map with axes: walls dark, free space white, unknown space grey."""
    canvas = map_canvas(grid, building(grid), INK)
    wide, high = np.ptp(canvas.box, axis=0).tolist()
    title = title or f"Map: {wide:.1f} m x {high:.1f} m, a cell is {grid.resolution:.4g} m"
    entries = [(INK, AREA, "wall"), (PAPER, AREA, "free"), (SHADE, AREA, "unknown")]
    return framed(canvas, grid.origin, title, entries)


def draw_feature(
    features: MapFeatures, what: str, at: tuple[float, float] | None = None
) -> Picture:
    """Draw a map, or one of its features: `what` is one of :data:`SUBJECTS`, else a ValueError.

    ``visibility`` is that of the surface point nearest to `at`, metres, map frame, by default of
    the one that sees most; it is a MapError if the map has no surface.
    """
    grid, lattice = features.grid, features.lattice
    if what == "map":
        return draw_map(grid)
    if what not in SUBJECTS:
        raise ValueError(f"cannot draw {what!r}, expected one of {', '.join(SUBJECTS)}")
    part, bar, entries = building(grid), None, list[Entry]()
    if what == "bmap":
        canvas = draw_bmap(features.bmap, lattice, part)
        bar = Bar(_GREYS, 0.0, 1.0, 0.25, "blurred walls: 1 on a wall, 0 far from walls")
    elif what == "distance":
        canvas = draw_distance(features.walls * np.float32(grid.resolution), grid.info, part)
        colours = _viridis(np.linspace(0, _NEAR, 64)[None])
        about = f"metres to a wall ({_NEAR:g}: or more), a line at each metre"
        bar = Bar(colours, 0.0, _NEAR, 1.0, about)
    elif what == "visibility":
        canvas, entries = _visibility(features, at, part)
    else:
        turn = wheel(np.linspace(-np.pi, np.pi, 73)[None], np.full((1, 73), 0.8))
        bar = Bar(turn, -180, 180, 90, "the wall faces, degrees: 0 to the right, 90 upwards")
        if what == "vmap":
            canvas = draw_field(features.vmap, lattice.resolution, part)
        else:
            canvas = draw_surface(grid, features.surface, part)
            entries = list(_WALLS)
            unsure = not features.surface.valid.all()
            entries += [(INK, DOT, "a wall without a sure direction")] * unsure
    return framed(canvas, grid.origin, _TITLES[what], entries, bar=bar)


def _visibility(
    features: MapFeatures, at: tuple[float, float] | None, part: Part
) -> tuple[Picture, list[Entry]]:
    """Draw what the surface point nearest to `at` sees, or the one that sees most."""
    grid, surface = features.grid, features.surface
    if len(surface) == 0:
        raise MapError("the map has no surface: no occupied cell borders on a free one")
    there = None if at is None else point_on(grid, at)
    horizon = min(features.horizon, float(np.hypot(*grid.occupied.shape)) * grid.resolution)
    vis = np.minimum(replace(features, horizon=horizon).visibility, horizon)
    if there is None:
        # Of a point inside a building nearly all rays end; the one that sees most is typical.
        reach = np.asarray(vis, dtype=np.float64)
        inside = (reach < 0.999 * horizon).mean(axis=0) > 0.97
        best = int(np.argmax((reach**2).sum(axis=0) * (inside if inside.any() else 1)))
    else:
        best = int(np.argmin(np.hypot(*(surface.xy - there).T)))
    alpha = float(np.nan_to_num(surface.alpha[best]))
    point, seen = surface.xy[best], vis[:, best]
    canvas = draw_visibility(grid, point, seen, part, horizon=horizon, alpha=alpha)
    x, y = transform_points(grid.origin, point[None])[0]
    entries = [(INK, DOT, f"point of a wall, x {x:.2f} m, y {y:.2f} m")]
    entries.append((faded(PALETTE[4], 0.3), AREA, f"what it sees, up to {horizon:.1f} m"))
    return canvas, [*entries, *_WALLS]


def draw_surface(grid: OccupancyGrid, surface: OrientedPoints, part: Part = WHOLE) -> Picture:
    """Draw surface points, grid frame, with their directed normals, coloured by direction.

    Points without a normal are black dots.
    """
    canvas = map_canvas(grid, part)
    points = surface.select(surface.valid)
    length = max(2.5 * grid.resolution, 8 / canvas.px_per_m)
    heads = points.xy + length * np.column_stack((np.cos(points.alpha), np.sin(points.alpha)))
    colours = wheel(points.alpha, np.ones(len(points)))
    for tail, head, colour in zip(points.xy, heads, colours.tolist(), strict=True):
        canvas.lines(np.stack((tail, head))[None], tuple(colour))
    canvas.dots(surface.xy[~surface.valid], INK, 1.5)
    return canvas


def draw_field(vmap: Float32Array, resolution: float, part: Part = WHOLE) -> Picture:
    """Draw a blurred vector field (Fig. 4c): colour is direction, saturation is intensity.

    `vmap` (2, H, W) has the x and y components in cells with a side of `resolution` metres. Arrows
    are about 14 pixels apart.
    """
    x, y = (np.asarray(v, dtype=np.float64) for v in vmap)
    strength = np.hypot(x, y)
    strength = strength / max(float(strength.max()), 1e-12)
    info = GridInfo(x.shape[0], x.shape[1], resolution)
    canvas = sheet(wheel(np.arctan2(y, x), 0.55 * strength), info, part)
    apart = max(1, round(14 / (canvas.px_per_m * resolution)))
    rows, columns = _strongest(strength, apart)
    centre = (np.column_stack((columns // apart, rows // apart)) + 0.5) * apart * resolution
    length = 0.9 * apart * resolution
    arrow = np.column_stack((x[rows, columns], y[rows, columns]))
    arrow *= (length / np.maximum(np.hypot(*arrow.T), 1e-12) * strength[rows, columns])[:, None]
    tails, heads = canvas.pixels(centre - arrow / 2), canvas.pixels(centre + arrow / 2)
    for a, b in np.rint(np.stack((tails, heads), axis=1)).astype(int).tolist():
        cv2.arrowedLine(canvas.image, a, b, INK, 1, cv2.LINE_AA, tipLength=0.35)
    return canvas


def draw_bmap(bmap: npt.ArrayLike, grid: GridInfo, part: Part = WHOLE) -> Picture:
    """Draw a blurred map (H, W) on its lattice (Fig. 3): white at 0, black at 1."""
    share = np.clip(np.asarray(bmap, dtype=np.float64), 0, 1)[..., None]
    colours = np.rint(255 + share * (np.array(INK) - 255)).astype(np.uint8)
    return sheet(colours, grid, part)


def draw_distance(distance: npt.ArrayLike, grid: GridInfo, part: Part = WHOLE) -> Picture:
    """Draw distances (H, W) to the nearest wall, metres: a fine line at each full metre.

    Walls, where they are 0, are dark; what is 3 m away or more has the last colour.
    """
    metres = np.asarray(distance, dtype=np.float64)
    colours = _viridis(metres)
    floor = np.floor(metres)
    steps = np.pad(floor, ((0, 1), (0, 1)), mode="edge")
    line = (floor != steps[1:, :-1]) | (floor != steps[:-1, 1:])
    colours[line] = np.rint(0.6 * colours[line] + 0.4 * 255)
    colours[metres <= 0] = INK
    return sheet(colours, grid, part)


def _viridis(metres: FloatArray) -> Image:
    """Colours (H, W, 3) of distances, which change where robots are: in the first 3 metres."""
    grey = np.rint(255 * np.minimum(metres / _NEAR, 1)).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS), dtype=np.uint8)


def draw_visibility(
    grid: OccupancyGrid, xy: npt.ArrayLike, vis: npt.ArrayLike, part: Part = WHOLE, *,
    horizon: float, alpha: float = 0.0,
) -> Picture:  # fmt: skip
    """Draw what the point `xy` (2,) of a surface sees: the array ``vis_j`` of Sec. V as a fan.

    The grid frame, metres, radians. `vis` (n_psi,) are distances to the nearest obstacle; where
    inf, the fan ends at `horizon`. Bin 0 points along `alpha`: the normal, if relative to it.
    """
    canvas, xy = map_canvas(grid, part), np.asarray(xy, dtype=np.float64)
    reach = np.minimum(np.asarray(vis, dtype=np.float64), horizon)
    n = len(reach)
    # Each bin is a sector: it reaches half a bin to either side of its psi.
    edges = alpha + (np.arange(n)[:, None] + np.linspace(-0.5, 0.5, 5)) * (2 * np.pi / n)
    fan = np.stack((np.cos(edges), np.sin(edges)), axis=-1) * reach[:, None, None]
    outline = fan.reshape(-1, 2) + xy
    canvas.polygon(outline, PALETTE[4], 0.3)
    canvas.lines(np.concatenate((outline, outline[:1]))[None], PALETTE[0])
    canvas.dots(xy[None], INK, 0.7 * marker_size(canvas))
    return canvas


def _strongest(strength: FloatArray, apart: int) -> tuple[IntArray, IntArray]:
    """Row and column of the strongest cell in each block, `apart` cells a side."""
    height, width = (-(-n // apart) for n in strength.shape)
    short = np.array((height, width)) * apart - strength.shape
    padded = np.pad(strength, ((0, short[0]), (0, short[1])))
    blocks = padded.reshape(height, apart, width, apart).swapaxes(1, 2).reshape(height, width, -1)
    row, column = np.nonzero(blocks.max(axis=2) > 0.2)
    down, right = np.divmod(blocks.argmax(axis=2)[row, column], apart)
    return row * apart + down, column * apart + right
