"""Two maps that lie on each other, written: text, picture, poses, YAML."""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.distance import distance_image
from imgloc.geometry import rotation, transform_points, values_at
from imgloc.io.files import display, read_file
from imgloc.io.maps import MapSettings, yaml_text
from imgloc.io.text import csv_text
from imgloc.lab.align import SCALES, Alignment, corners_of
from imgloc.model import FloatArray, OccupancyGrid, Pose2D, compose, inverse
from imgloc.output.canvas import INK, PAPER, SHADE, Colour, Picture, building, sheet
from imgloc.output.plots import AREA, framed
from imgloc.output.tables import pose_words

BOTH, ONLY_A, ONLY_B = INK, (178, 114, 0), (0, 94, 213)
_SEEN: Colour = (247, 245, 243)  # free in one of them
_NEAR = 0.2  # metres between walls that count as the same
_LARGEST = 4000  # cells of the picture along a side
_MOST = 16 << 20  # bytes of a CSV of poses
_HEADINGS = ("theta", "yaw")
_LISTED = 3  # other places that the text has


def alignment_text(row: Mapping[str, Any]) -> str:
    """Return the row of an alignment as text."""
    lines = [f"{row['b']} in the frame of {row['a']}: {row['verdict']}"]
    if row["x"] is None:
        lines += _no_match_text(row["others"][0], scanned="scans" in row)
    else:
        agree = f"{100 * row['agreement']:.0f} %"
        against = f"{row['contradicting_m']:.0f} m that one has and the other sees free"
        lines += [
            f"  pose       {_pose(row)}",
            f"  walls      {agree} agree: {row['agreeing_m']:.0f} m, against {against}",
            f"  residual   {row['residual']:.3f} m; {_thickness(row['thicker'])}",
            f"  bend       the maps are bent against each other by up to {row['bend']:.2f} m",
            f"  overlap    {100 * row['overlap']:.0f} % of the smaller map's free space",
        ]
        others = row["others"] if row["verdict"] == "ambiguous" else []
        lines += [
            f"  or         {_pose(o)}: {100 * o['agreement']:.0f} % agree, {o['agreeing_m']:.0f} m "
            f"against {o['contradicting_m']:.0f} m"
            for o in others[:_LISTED]
        ]
    if (scans := row.get("scans")) is not None:
        lines += _scans_text(scans)
    return "\n".join(lines)


def _no_match_text(best: Mapping[str, Any], *, scanned: bool) -> list[str]:
    """Why the place where the walls agree best is no answer."""
    low, high, _ = SCALES
    agree = f"  walls      {100 * best['agreement']:.0f} % agree at the best place"
    if not low <= best["scale"] <= high:
        return [
            f"{agree}, where the scale of B is {best['scale']:.3f}, expected {low:g} to {high:g}: "
            "is the resolution of both maps right?"
        ]
    lines = [
        f"{agree}; walls of different buildings may agree as well",
        "             Either the maps show different places, or they share too little.",
    ]
    asked = "             To find out, pass `scans`: imgloc locates them in both maps."
    return lines if scanned else [*lines, asked]


def _thickness(metres: float) -> str:
    """Compare walls of B with those of A, in words: thicker or thinner."""
    if abs(metres) < 0.005:
        return "walls of both are as thick"
    return f"walls of B are {abs(metres):.2f} m {'thicker' if metres > 0 else 'thinner'}"


def _pose(row: Mapping[str, Any]) -> str:
    text = pose_words(Pose2D(row["x"], row["y"], row["theta"]))
    return text if row.get("scale", 1) == 1 else f"{text}, scale {row['scale']:.4f}"


def _scans_text(scans: Mapping[str, Any]) -> list[str]:
    if scans["pose"] is None and scans["located"] < 2:
        few = f"too few have a pose in both maps: {scans['located']}, expected at least 2"
        return [f"  scans      {few}"]
    if scans["pose"] is None:
        return ["  scans      no transform fits more than half of them"]
    lines = [
        f"  scans      {_pose(scans['pose'])}",
        f"             {scans['used']} of {scans['given']} agree, residual "
        f"{scans['residual']:.3f} m, {math.degrees(scans['turn']):.2f} deg",
    ]
    if scans["walls_apart"] is not None:
        poses, halves = (max(scans[key]) for key in ("corners_apart", "halves_apart"))
        lines += [
            f"             walls differ there by {scans['walls_apart']:.3f} m, "
            f"{math.degrees(scans['walls_turned']):.2f} deg",
            f"  corners    of B: by walls and by scans up to {poses:.2f} m apart, "
            f"by either half of the scans up to {halves:.2f} m",
        ]
    return lines


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Poses of a CSV, and the cells of its rows."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    columns: tuple[int, ...]  #: of x, y and, if there is one, the heading
    poses: FloatArray  #: (N, 3) metres, metres, radians


def read_poses(path: Path) -> Waypoints:
    """Read a CSV with columns x, y and perhaps theta or yaw, metres and radians."""
    name = display(path)
    data = read_file(path, limit=_MOST, error=ConfigError, what="CSV of poses")
    lines = list(csv.reader(data.decode("utf-8-sig", "surrogateescape").splitlines()))
    header = tuple(cell.strip() for cell in lines[0]) if lines else ()
    by = {cell.lower(): k for k, cell in enumerate(header)}
    if not {"x", "y"} <= by.keys():
        found = ", ".join(header) or "nothing"
        raise ConfigError(f"{name}: got the columns {found}, expected x, y and perhaps theta")
    columns = [by["x"], by["y"], *[by[key] for key in _HEADINGS if key in by][:1]]
    rows, poses = list[tuple[str, ...]](), list[list[float]]()
    for line, cells in enumerate(lines[1:], start=2):
        if not cells:
            continue
        try:
            values = [float(cells[k]) for k in columns]
        except (ValueError, IndexError):
            values = [math.nan]
        if not all(map(math.isfinite, values)):
            raise ConfigError(f"{name}: line {line}: expected numbers: metres, metres, radians")
        rows.append(tuple(cells))
        poses.append([*values, 0.0][:3])
    return Waypoints(header, tuple(rows), tuple(columns), np.array(poses).reshape(-1, 3))


def moved_text(given: Waypoints, found: Alignment) -> str:
    """The CSV of poses of `b` in the frame of `a`; what is no pose stays as it was."""
    rows = [list(cells) for cells in given.rows]
    for row, pose in zip(rows, found.move(given.poses).tolist(), strict=True):
        for column, value in zip(given.columns, pose, strict=False):
            row[column] = f"{value:.6f}"
    return csv_text([given.header, *rows])


def moved_yaml(settings: MapSettings, found: Alignment, folder: Path) -> str:
    """The YAML, for a file in a folder, of `b`, read by its `settings`, in the frame of `a`."""
    place = found.best
    if place is None:
        raise ConfigError("expected maps that match")
    corner = settings.origin
    scaled = Pose2D(place.scale * corner.x, place.scale * corner.y, corner.theta)
    resolution, origin = place.scale * settings.resolution, compose(place.pose, scaled)
    return yaml_text(replace(settings, resolution=resolution, origin=origin), folder)


def draw_alignment(
    a: OccupancyGrid, b: OccupancyGrid, found: Alignment, names: Sequence[str] = ("A", "B")
) -> Picture:
    """Draw `b` over `a`: walls of both, and walls of one where the other is free or unknown.

    Nothing bends: walls that the maps have in two places are drawn twice. Without a match the best
    place is drawn.
    """
    place = found.places[0]
    corners = [
        transform_points(compose(place.pose, Pose2D(0, 0)), place.scale * corners_of(b)),
        corners_of(a),
    ]
    local = transform_points(inverse(a.origin), np.concatenate(corners))
    low, high = local.min(axis=0), local.max(axis=0)
    cell = max(a.resolution, float((high - low).max()) / _LARGEST)
    width, height = (int(n) for n in np.ceil((high - low) / cell).clip(1))
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    at = np.column_stack((column.ravel(), row.ravel())) * cell + low
    x, y, theta, scale, _ = place.bend.pose.tolist()
    layers = []
    for grid, xy in ((a, at), (b, (at - (x, y)) @ rotation(theta) / scale)):
        images = (values_at(image, xy, grid.resolution) for image in (grid.occupied, grid.free))
        layers.append([image.reshape(height, width) for image in images])
    (wall_a, free_a), (wall_b, free_b) = layers
    near = _NEAR / cell
    beside_a, beside_b = (distance_image(wall) <= near for wall in (wall_a, wall_b))
    both = (wall_a & beside_b) | (wall_b & beside_a)
    classes = np.zeros((height, width), np.uint8)
    for k, cells in enumerate((free_a | free_b, free_a & free_b, wall_a, wall_b, both), 1):
        classes[cells] = k
    left, bottom = transform_points(a.origin, low[None])[0]
    walls, origin = wall_a | wall_b, Pose2D(left, bottom, a.origin.theta)
    shown = OccupancyGrid(walls, (free_a | free_b) & ~walls, cell, origin)
    palette = (SHADE, _SEEN, PAPER, ONLY_A, ONLY_B, BOTH)
    canvas = sheet(classes, shown.info, building(shown), palette)
    entries = [
        (BOTH, AREA, f"walls of both, within {_NEAR:g} m: {100 * place.agreement.share:.0f} %"),
        (ONLY_A, AREA, f"only in {names[0]}"),
        (ONLY_B, AREA, f"only in {names[1]}"),
        (_SEEN, AREA, "seen in one of them"),
    ]
    at = f"x {x:.2f} m, y {y:.2f} m, turned by {math.degrees(theta):.1f} degrees"
    title = f"{names[1]} in the frame of {names[0]}: {found.verdict}, {at}"
    return framed(canvas, shown.origin, title, entries)
