"""Drawings of an explanation as SVG: rays on the map, a covariance, a scan.

Lines stay sharp in print; the map's cells are an image. A kind of ray has a colour and a
shape, so that neither the colour-blind nor a grey printer loses anything. Here is what is drawn
where; how it is written is in ``templates/svg.html``, and the page's style sheet has the colours.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from imgloc.answers.explain import RayFit
from imgloc.errors import as_options
from imgloc.features.scanpoints import scan_xy
from imgloc.geometry import rotation
from imgloc.io.images import encode_picture
from imgloc.model import BoolArray, FloatArray, Hypothesis, LaserScan, OccupancyGrid, Pose2D
from imgloc.output.canvas import INK, Image, Part, deviation_ellipse, map_canvas, round_length

#: Shapes of the ends of rays, drawn around the point.
SHAPES = {
    "agrees": "h0",
    "orientation": "m0-4.2l4.2 4.2l-4.2 4.2l-4.2-4.2z",
    "visibility": "m-3.4-3.4l6.8 6.8m0-6.8l-6.8 6.8",
    "unexplained": "m-3 0a3 3 0 1 0 6 0a3 3 0 1 0-6 0",
}
_ORDER = ("unexplained", "agrees", "orientation", "visibility")  # drawn one over the other
_FAR = 60.0  # metres; readings farther off do not widen a picture
_SIDE = 1400  # pixels that the image of the map has at most along a side


def number(value: float) -> str:
    """A coordinate, to a tenth of a pixel.

    Examples
    --------
    >>> number(3.04), number(-0.02), number(12.5)
    ('3', '0', '12.5')
    """
    return f"{round(float(value), 1) + 0.0:g}" if abs(value) < 1e5 else f"{value:.0f}"


#: Of all templates; whatever is put into one is escaped.
ENVIRONMENT = Environment(
    loader=PackageLoader("imgloc.output"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
ENVIRONMENT.filters |= {"n": number, "as_options": as_options}
ENVIRONMENT.globals["shapes"] = SHAPES


def macro(name: str, template: str = "svg.html", /, **values: Any) -> Markup:
    """Render a macro of a template."""
    rendered: Markup = getattr(ENVIRONMENT.get_template(template).module, name)(**values)
    return rendered


@dataclass(frozen=True)
class View:
    """A window of the grid frame, and the width in pixels that it is drawn at."""

    x: float  #: of the lower left corner, metres
    y: float
    width: float  #: metres
    height: float
    px: float  #: width of the drawing, pixels

    @property
    def scale(self) -> float:
        """Pixels per metre."""
        return self.px / self.width

    @property
    def tall(self) -> float:
        """Height of the drawing, pixels."""
        return self.height * self.scale

    @property
    def rule(self) -> tuple[str, float]:
        """A round length that fits into the lower left corner: its name and its pixels."""
        length = round_length(0.25 * self.width)
        factor, unit = (1, "m") if length >= 1 else (100, "cm") if length >= 0.01 else (1000, "mm")
        return f"{factor * length:g} {unit}", length * self.scale

    def pixels(self, xy: FloatArray) -> FloatArray:
        """Positions (N, 2) in metres as (N, 2) pixels from the upper left corner."""
        corner = np.array([self.x, self.y + self.height])
        return np.asarray((xy - corner) * (self.scale, -self.scale)) + 0.0  # no -0

    def at(self, x: float, y: float) -> tuple[float, float]:
        """One position in metres as pixels."""
        (px, py), *_ = self.pixels(np.array([[x, y]])).tolist()
        return px, py


def path(lines: FloatArray) -> str:
    """Polylines (N, P, 2) in pixels as the ``d`` of a path; of one point each, dots.

    Examples
    --------
    >>> path(np.array([[[0, 0], [1.5, 2]]])), path(np.array([[[3, 4]]]))
    ('M0 0L1.5 2', 'M3 4h0')
    """
    parts = []
    for line in np.asarray(lines).tolist():
        words = [f"{number(x)} {number(y)}" for x, y in line]
        parts.append(f"M{'L'.join(words)}" + ("h0" if len(words) == 1 else ""))
    return "".join(parts)


def marks(kind: str, at: FloatArray) -> str:
    """The ``d`` of a path that has the shape of a kind at each point (N, 2), pixels."""
    return "".join(f"M{number(x)} {number(y)}{SHAPES[kind]}" for x, y in at.tolist())


def data_of(picture: Image) -> str:
    """A picture as the text of a ``data:image/png;base64`` address."""
    return base64.b64encode(encode_picture(picture)).decode("ascii")


def map_image(grid: OccupancyGrid, view: View) -> Markup:
    """The cells of a map within a view as an image; what is off the map stays empty."""
    size = np.array([view.width, view.height])
    low = np.array([view.x, view.y])
    whole = grid.resolution * np.array(grid.occupied.shape[::-1])
    if (low >= whole).any() or (low + size <= 0).any():
        return Markup()
    canvas = map_canvas(grid, Part(np.array([low, low + size]), 1, _SIDE), INK)
    height, width = np.array(canvas.image.shape[:2]) / canvas.px_per_m * view.scale
    x, bottom = view.at(*canvas.corner)
    png = data_of(canvas.image)
    return macro("cells", x=x, y=bottom - height, width=width, height=height, png=png)


def window(poses: Sequence[Pose2D], fits: Sequence[RayFit], px: float) -> list[View]:
    """Views of one size and `px` pixels wide, each around a pose and the ends of the rays there."""
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


def draw_rays(grid: OccupancyGrid, pose: Pose2D, fit: RayFit, view: View, name: str) -> Markup:
    """The scan on the map at a pose, grid frame: each ray in the colour of its kind.

    The `name` is the label of the robot; that of the best pose is "1".
    """
    start = np.array([view.at(pose.x, pose.y)])
    ends = {kind: view.pixels(fit.end[fit.kind == kind]) for kind in _ORDER}
    rays = [
        (kind, path(np.stack((np.broadcast_to(start, at.shape), at), axis=1)))
        for kind, at in ends.items()
    ]
    through = fit.kind == "visibility"
    reach = np.linalg.norm(ends["visibility"] - start, axis=1)
    share = fit.wall[through] * view.scale / np.maximum(reach, 1e-9)
    hole = start + (ends["visibility"] - start) * np.minimum(share, 1)[:, None]
    said = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in fit.counts.items())
    return macro(
        "rays",
        view=view,
        grid=map_image(grid, view),
        pose=pose,
        name=name,
        paths=rays,
        beyond=path(np.stack((hole, ends["visibility"]), axis=1)),
        ends=[(kind, marks(kind, at)) for kind, at in ends.items()],
        label=f"Scan at hypothesis {name}: {said}",
    )


def _around(points: FloatArray, share: float, more: float, px: float) -> View:
    """A view of points (N, 2) with a margin of a `share` of their longer side and `more` metres."""
    low, high = points.min(axis=0), points.max(axis=0)
    around = share * float((high - low).max()) + more
    (x, y), (width, height) = (low - around).tolist(), (high - low + 2 * around).tolist()
    return View(x, y, width, height, px)


def draw_covariance(hypothesis: Hypothesis) -> Markup:
    """One and two standard deviations of the position, and two of the heading as a wedge.

    It has a scale of its own: the ellipse is mostly too small to be seen on the map.
    """
    theta = hypothesis.pose.theta
    unit = deviation_ellipse(hypothesis.covariance, 73)
    reach = 2.6 * max(float(np.linalg.norm(unit, axis=1).max()), 1e-6)
    view = View(-reach, -reach, 2 * reach, 2 * reach, 190.0)
    turn = min(2 * float(np.sqrt(max(hypothesis.covariance[2, 2], 0.0))), np.pi)
    arc = theta + np.linspace(-turn, turn, 25)
    wedge = np.vstack(((0.0, 0.0), 0.9 * reach * np.column_stack((np.cos(arc), np.sin(arc)))))
    nose = 0.9 * reach * np.array([[0.0, 0.0], [np.cos(theta), np.sin(theta)]])
    lines = {"wedge": wedge, "two": 2 * unit, "one": unit, "nose": nose}
    paths = [
        (kind, path(view.pixels(xy)[None]) + ("Z" if kind == "wedge" else ""))
        for kind, xy in lines.items()
    ]
    return macro("covariance", view=view, paths=paths)


def draw_scan(scan: LaserScan) -> Markup:
    """A scan as the sensor sees it, forward up: its points, and the rays without a return."""
    ahead = rotation(np.pi / 2)
    points = scan_xy(scan)[scan.valid] @ ahead.T
    near = points[_near(points)]
    reach = float(np.max(np.linalg.norm(near, axis=1), initial=1.0))
    angles = scan.angles[scan.no_return] + np.pi / 2
    out = reach * np.column_stack((np.cos(angles), np.sin(angles)))
    drawn = np.concatenate((np.zeros((1, 2)), near, 1.05 * out))
    view = _around(drawn, 0.06, 0.05, 300.0)
    return macro(
        "scan",
        view=view,
        missed=path(np.stack((view.pixels(0.97 * out), view.pixels(1.05 * out)), axis=1)),
        ends=marks("agrees", view.pixels(points)),
        pose=Pose2D(0.0, 0.0, np.pi / 2),
        label=f"The scan: {scan.counts['valid']} valid readings",
    )
