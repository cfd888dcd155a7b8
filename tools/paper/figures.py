"""Figs. 1, 2, 4 and 5: a world, a pose in it, a scan, each method's stack, and their panels."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from imgloc import LaserScan, Likelihood, MapFeatures, OccupancyGrid, OrientedPoints, Pose2D
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import centre_of, transform_points, uniform_thetas
from imgloc.lab.performance_index import global_maximum
from imgloc.model import FloatArray, compose
from imgloc.output.canvas import INK, PAPER, TRUTH, Image, Part, Picture, map_canvas, marker_size
from imgloc.output.features import draw_bmap, draw_field, draw_surface
from imgloc.output.pictures import draw_likelihood, mosaic
from imgloc.output.plots import framed
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import NICHES, WORLDS, render
from tools.paper.table import CELL, stack_of

ANGLES = np.deg2rad(np.arange(-90, 91))
"""Of the sensor of Sec. VI: 181 rays over 180 degrees."""
WINDOW_FIG_4 = (21.0, 20.0, 27.0, 26.0)
"""The part of the map that Fig. 4 shows: least x and y, greatest x and y, metres."""
_REACH = 60.0  # metres; farther than any wall
_MAXIMUM = (178, 114, 0)
_APART = 0.3  # metres from the true pose at which a maximum is marked


@dataclass(frozen=True)
class Setting:
    """Where a figure's scan is taken, and which stacks are computed."""

    world: str
    truth: Pose2D  #: grid frame
    steps: tuple[tuple[str, float], ...]  #: methods with their steps of headings, degrees
    angles: FloatArray  #: (N,) of the rays
    sigma: float = 0.05  #: of the kernel that blurs the map, metres
    seed: int = 1  #: of the noise


_FINE = (("cbml", 6.0), ("cbml-o", 6.0), ("ght", 12.0), ("ght-v", 12.0))
_WIDE = (("cbml", 30.0), ("cbml-o", 30.0), ("ght", 30.0), ("ght-v", 30.0))
_INSIDE = Pose2D(1.65, 0.05, float(np.deg2rad(198)))  # of a niche
# All headings but the true one are left out of Fig. 4: it is about a false maximum beside it.
_ONE = (("cbml", 360.0), ("cbml-o", 360.0))
SETTINGS: Mapping[str, Setting] = MappingProxyType(
    {
        "fig1": Setting("double_wall", compose(Pose2D(*NICHES[0]), _INSIDE), _FINE, ANGLES),
        "fig2": Setting("visibility", Pose2D(4.35, 6.55, np.pi / 2), _FINE, ANGLES, seed=2),
        "fig4": Setting("large", Pose2D(22.05, 25.05, 0.0), _ONE, ANGLES[45:-45], 0.25, seed=3),
        "fig5": Setting(
            "large",
            Pose2D(12.0, 20.0, float(np.deg2rad(15))),
            (*_WIDE, ("cbml", 3.0), ("cbml-o", 3.0)),
            ANGLES,
            seed=4,
        ),
    }
)
"""The settings of the figures; that they show what the paper says is tested."""


@dataclass(frozen=True)
class Scene:
    """A setting, computed: the scan's points in the sensor's frame, stacks with captions."""

    truth: Pose2D
    features: MapFeatures
    points: OrientedPoints
    stacks: tuple[tuple[str, Likelihood], ...]


def scene(name: str, *, threads: int = 1, advance: Callable[[], None] = lambda: None) -> Scene:
    """Compute what a figure of :data:`SETTINGS` shows; `advance` is called after each stack."""
    setting = SETTINGS[name]
    truth, world = setting.truth, WORLDS[setting.world]()
    features = MapFeatures(
        render(world, CELL), cell=CELL, sigma=setting.sigma, horizon=_REACH, threads=threads
    )
    ranges = simulate_ranges(
        render(world, 0.01), [(truth.x, truth.y, truth.theta)], setting.angles,
        seed=setting.seed, range_max=_REACH,
    )[0]  # fmt: skip
    scan = LaserScan(ranges, setting.angles, range_max=_REACH)
    stacks = []
    for method, step in setting.steps:
        thetas = uniform_thetas(np.deg2rad(step))
        values = stack_of(method, features, scan, thetas, threads)
        heading = f"{step:g} deg" if step < 360 else "true heading"
        stacks.append(
            (f"{method.upper()}, {heading}", Likelihood(values, thetas, features.lattice, method))
        )
        advance()
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    return Scene(truth, features, points, tuple(stacks))


def figure(name: str, threads: int = 1, advance: Callable[[], None] = lambda: None) -> Image:
    """Compute and draw a figure of :data:`SETTINGS`, (H, W, 3) BGR."""
    s = scene(name, threads=threads, advance=advance)
    if name == "fig4":
        return draw_fields(s)
    return draw_comparison(s, scale=1 if name == "fig5" else 3)


def draw_comparison(s: Scene, *, scale: int) -> Image:
    """Draw the map and each method's likelihood, as Figs. 1, 2 and 5 have it.

    The true pose is a red ring in every panel; a blue cross is a maximum that is elsewhere. The
    scan stands between the second stack and the third. `scale` is in pixels per cell.
    """
    part = Part(scale=scale)
    return _panels(
        [("Map, true pose", ring(map_canvas(s.features.grid, part, INK), s.truth))], s, part
    )


def draw_fields(s: Scene) -> Image:
    """Draw what CBML and CBML-O make of :data:`WINDOW_FIG_4`, and what comes of it near a pose."""
    features, box = s.features, np.array(WINDOW_FIG_4).reshape(2, 2)
    part, grid = Part(box, 9), features.grid
    (x0, y0), (x1, y1) = np.rint(box / grid.resolution).astype(int).tolist()
    here = np.zeros(grid.occupied.shape, bool)  # of other places nothing is compared
    here[y0:y1, x0:x1] = True
    stacks = tuple((name, replace(one, values=one.values * here)) for name, one in s.stacks)
    panels = [
        (
            "Map: surface points, true pose",
            ring(draw_surface(grid, features.surface, part), s.truth),
        ),
        ("bmap", draw_bmap(features.bmap, grid.info, part)),
        ("Vector field", draw_field(features.vmap * here, grid.resolution, part)),
    ]
    return _panels(panels, replace(s, stacks=stacks), part)


def _panels(first: list[tuple[str, Picture]], s: Scene, part: Part) -> Image:
    """The first panels, the scan as the fourth, the stacks."""
    panels = [*first, *((caption, _likelihood(stack, s, part)) for caption, stack in s.stacks)]
    scan = draw_scan(s.features.grid, s.truth, s.points, part)
    panels.insert(3, ("Scan with its normals", scan))
    lettered = zip("abcdefghijkl", panels, strict=False)
    return mosaic([framed(c, Pose2D(0, 0), f"({k}) {name}") for k, (name, c) in lettered], 3).image


def draw_scan(grid: OccupancyGrid, truth: Pose2D, points: OrientedPoints, part: Part) -> Picture:
    """Draw a scan (sensor frame) with its normals at its true pose (grid frame), on a pale map."""
    there = replace(points, xy=transform_points(truth, points.xy), alpha=points.alpha + truth.theta)
    # Walls are drawn as what is unknown, pale: the scan is what is to be seen.
    sheet = OccupancyGrid(np.zeros_like(grid.occupied), ~grid.occupied, grid.resolution)
    return ring(draw_surface(sheet, there, part), truth)


def _likelihood(stack: Likelihood, s: Scene, part: Part) -> Picture:
    """One method's panel: its likelihood, the true pose, the maximum if it is elsewhere."""
    grid, row_column = s.features.grid, global_maximum(stack.values, s.features.grid.free)[1:]
    at = centre_of(np.array(row_column), stack.grid.resolution)
    panel = ring(draw_likelihood(stack, grid, part), s.truth)
    return cross(panel, at) if np.hypot(*(at - (s.truth.x, s.truth.y))) > _APART else panel


def ring(canvas: Picture, pose: Pose2D) -> Picture:
    """Mark a pose (grid frame) by a ring and a line along theta; returns `canvas`.

    It leaves visible what is in it.
    """
    radius = 1.6 * marker_size(canvas) / canvas.px_per_m
    turn = np.linspace(0, 2 * np.pi, 49)
    circle = np.array((pose.x, pose.y)) + radius * np.column_stack((np.cos(turn), np.sin(turn)))
    ahead = np.array((np.cos(pose.theta), np.sin(pose.theta))) * radius
    nose = np.array((pose.x, pose.y)) + np.stack((ahead, 2.2 * ahead))
    for colour, thickness in ((PAPER, 5), (TRUTH, 2)):
        canvas.lines(circle[None], colour, thickness)
        canvas.lines(nose[None], colour, thickness)
    return canvas


def cross(canvas: Picture, xy: FloatArray) -> Picture:
    """Mark a position (2,), metres in the grid frame, by an oblique cross; returns `canvas`."""
    arm = 0.8 * marker_size(canvas) / canvas.px_per_m
    strokes = np.stack([xy + np.outer((-arm, arm), turn) for turn in ((1, 1), (1, -1))])
    for colour, thickness in ((PAPER, 5), (_MAXIMUM, 2)):
        canvas.lines(strokes, colour, thickness)
    return canvas
