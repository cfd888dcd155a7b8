"""Pictures of an explanation, as SVG: rays on the map, all hypotheses, a covariance, a scan.

Colours and shapes both say what a ray is, so that neither the colour-blind nor a grey printer
loses anything. The style sheet of the page has the colours.
"""

from collections.abc import Sequence

import numpy as np

from imgloc.draw.marks import marks
from imgloc.draw.svg import View, map_image, number, path, robot, scale_bar
from imgloc.explain import RayFit
from imgloc.features.scanpoints import scan_xy
from imgloc.geometry import rotation
from imgloc.model import BoolArray, FloatArray, Hypothesis, LaserScan, OccupancyGrid, Pose2D

_ORDER = ("unexplained", "agrees", "orientation", "visibility")  # drawn one over the other
_FAR = 60.0  # metres; readings farther off do not widen a picture


def window(poses: Sequence[Pose2D], fits: Sequence[RayFit], px: float) -> list[View]:
    """Views of one size, each around a pose and the ends of the rays there.

    Parameters
    ----------
    poses : sequence of Pose2D
        Grid frame.
    fits : sequence of RayFit
    px : float
        Width of each drawing, pixels.
    """
    boxes = []
    for pose, fit in zip(poses, fits, strict=True):
        centre = np.array([[pose.x, pose.y]])
        end = fit.end[np.isfinite(fit.end).all(axis=1)]
        points = np.concatenate((centre, end[_near(end - centre)]))
        boxes.append((points.min(axis=0), points.max(axis=0)))
    size = np.max([high - low for low, high in boxes], axis=0) * 1.08 + 1.0
    size = np.maximum(size, 0.7 * size.max())  # neither a ribbon nor a pillar
    width, height = size.tolist()
    corners = [((low + high - size) / 2).tolist() for low, high in boxes]
    return [View(x, y, width, height, px) for x, y in corners]


def _near(away: FloatArray) -> BoolArray:
    """Which of the vectors (N, 2) are worth a wider picture, (N,) bool."""
    distance = np.linalg.norm(away, axis=1)
    return np.asarray(distance <= max(_FAR, 1.5 * float(np.min(distance, initial=np.inf))))


def draw_rays(
    grid: OccupancyGrid, hypothesis: Hypothesis, fit: RayFit, view: View, name: str
) -> str:
    """The scan on the map at a hypothesis: each ray in the colour of what it says.

    Parameters
    ----------
    grid : OccupancyGrid
    hypothesis : Hypothesis
        Grid frame.
    fit : RayFit
        Its rays.
    view : View
    name : str
        Label of the robot.

    Returns
    -------
    str
        ``<svg>``.
    """
    pose = hypothesis.pose
    start = view.pixels(np.array([[pose.x, pose.y]]))
    parts = [map_image(grid, view)]
    ends = {kind: view.pixels(fit.end[fit.kind == kind]) for kind in _ORDER}
    for kind in _ORDER:
        rays = np.stack((np.broadcast_to(start, ends[kind].shape), ends[kind]), axis=1)
        parts.append(f'<path class="ray {kind}" d="{path(rays)}"/>')
    through = fit.kind == "visibility"
    reach = np.linalg.norm(ends["visibility"] - start, axis=1)
    share = fit.wall[through] * view.scale / np.maximum(reach, 1e-9)
    hole = start + (ends["visibility"] - start) * np.minimum(share, 1)[:, None]
    parts.append(f'<path class="beyond" d="{path(np.stack((hole, ends["visibility"]), axis=1))}"/>')
    parts += [f'<path class="end {kind}" d="{marks(kind, ends[kind])}"/>' for kind in _ORDER]
    parts += [robot(view, pose, name, "best" if name == "1" else "other"), scale_bar(view)]
    said = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in fit.counts.items())
    return _svg(view, f"Scan at hypothesis {name}: {said}", parts)


def draw_overview(
    grid: OccupancyGrid,
    hypotheses: Sequence[Hypothesis],
    fits: Sequence[RayFit],
    px: float = 1000.0,
) -> str:
    """The whole map with every hypothesis on it, the ends of the rays of the best, and axes.

    Parameters
    ----------
    grid : OccupancyGrid
    hypotheses : sequence of Hypothesis
        Best first, grid frame.
    fits : sequence of RayFit
    px : float
        Width, pixels.
    """
    view = _known_part(grid, hypotheses, px)
    parts = [map_image(grid, view), _frame(grid, view)]
    if fits:
        used = np.isfinite(fits[0].end).all(axis=1)
        parts.append(
            f'<path class="end agrees" d="{marks("agrees", view.pixels(fits[0].end[used]))}"/>'
        )
    for k in range(len(hypotheses), 0, -1):
        parts.append(robot(view, hypotheses[k - 1].pose, str(k), "best" if k == 1 else "other", 11))
    parts += [_axes(grid, view), scale_bar(view)]
    return _svg(view, f"The map with {len(hypotheses)} hypotheses", parts)


def _known_part(grid: OccupancyGrid, hypotheses: Sequence[Hypothesis], px: float) -> View:
    """A view of all that is known of a map, as wide as `px` but not much taller than wide."""
    known = ~grid.unknown
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    cells = np.array([(columns[0], rows[0]), (columns[-1] + 1, rows[-1] + 1)]) * grid.resolution
    poses = [(h.pose.x, h.pose.y) for h in hypotheses]
    points = np.concatenate((cells, np.array(poses).reshape(-1, 2)))
    low, high = points.min(axis=0), points.max(axis=0)
    around = 0.03 * float((high - low).max())
    x, y = (low - around).tolist()
    width, height = (high - low + 2 * around).tolist()
    return View(x, y, width, height, min(px, 0.72 * px * width / height))


def _frame(grid: OccupancyGrid, view: View) -> str:
    """Where the map ends."""
    height, width = (n * grid.resolution for n in grid.occupied.shape)
    (x, y), (x1, y1) = view.pixels(np.array([[0, height], [width, 0]])).tolist()
    return (
        f'<rect class="frame" x="{number(x)}" y="{number(y)}" width="{number(x1 - x)}" '
        f'height="{number(y1 - y)}"/>'
    )


def _axes(grid: OccupancyGrid, view: View) -> str:
    """Where x and y of the map frame point, in the lower right corner."""
    centre = np.array([view.px - 52, view.height * view.scale - 52])
    parts = []
    for axis, turn in (("x", 0.0), ("y", np.pi / 2)):
        along = rotation(turn - grid.origin.theta)[:, 0] * (1, -1)
        side = along[::-1] * (1, -1)
        tip, back = centre + 32 * along, centre + 24 * along
        head = np.array([[back + 4 * side, tip, back - 4 * side]])
        x, y = (centre + 43 * along + (0, 4)).tolist()
        parts.append(
            f'<path d="{path(np.array([[centre, tip]]))}{path(head)}"/>'
            f'<text x="{number(x)}" y="{number(y)}">{axis}</text>'
        )
    return f'<g class="axes">{"".join(parts)}</g>'


def draw_covariance(hypothesis: Hypothesis, px: float = 190.0) -> str:
    """One and two standard deviations of the position, and two of the heading as a wedge.

    It has a scale of its own: the ellipse is mostly too small to be seen on the map.
    """
    pose = hypothesis.pose
    values, vectors = np.linalg.eigh(hypothesis.covariance[:2, :2])
    s = np.linspace(0, 2 * np.pi, 73)
    circle = np.column_stack((np.cos(s), np.sin(s)))
    unit = (circle * np.sqrt(np.maximum(values, 0))) @ vectors.T
    reach = 2.6 * float(np.sqrt(max(values.max(), 1e-12)))
    view = View(-reach, -reach, 2 * reach, 2 * reach, px)
    turn = min(2 * float(np.sqrt(max(hypothesis.covariance[2, 2], 0.0))), np.pi)
    arc = pose.theta + np.linspace(-turn, turn, 25)
    rim = 0.9 * reach * np.column_stack((np.cos(arc), np.sin(arc)))
    nose = 0.9 * reach * np.array([[[0.0, 0.0], [np.cos(pose.theta), np.sin(pose.theta)]]])
    wedge = path(view.pixels(np.vstack(((0.0, 0.0), rim)))[None])
    parts = [
        f'<path class="wedge" d="{wedge}Z"/>',
        f'<path class="two" d="{path(view.pixels(2 * unit)[None])}"/>',
        f'<path class="one" d="{path(view.pixels(unit)[None])}"/>',
        f'<path class="nose" d="{path(view.pixels(nose[0])[None])}"/>',
        scale_bar(view),
    ]
    return _svg(view, "Standard deviations of the position and of the heading", parts)


def draw_scan(scan: LaserScan, px: float = 300.0) -> str:
    """A scan as the sensor sees it, forward up: its points, and the rays without a return."""
    ahead = rotation(np.pi / 2)
    points = scan_xy(scan)[scan.valid] @ ahead.T
    near = points[_near(points)]
    reach = float(np.max(np.linalg.norm(near, axis=1), initial=1.0))
    angles = scan.angles[scan.no_return] + np.pi / 2
    out = reach * np.column_stack((np.cos(angles), np.sin(angles)))
    drawn = np.concatenate((np.zeros((1, 2)), near, 1.05 * out))
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    around = 0.06 * float((high - low).max()) + 0.05
    (x, y), (width, height) = (low - around).tolist(), (high - low + 2 * around).tolist()
    view = View(x, y, width, height, px)
    none = np.stack((view.pixels(0.97 * out), view.pixels(1.05 * out)), axis=1)
    parts = [
        f'<path class="end no_return" d="{path(none)}"/>',
        f'<path class="end agrees" d="{marks("agrees", view.pixels(points))}"/>',
        robot(view, Pose2D(0.0, 0.0, np.pi / 2), "", "best", 7),
        scale_bar(view),
    ]
    counts = scan.counts
    return _svg(view, f"The scan: {counts['valid']} valid readings", parts)


def _svg(view: View, label: str, parts: Sequence[str]) -> str:
    return f'<svg viewBox="{view.box}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
