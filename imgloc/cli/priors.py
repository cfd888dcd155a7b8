"""Options that say where the robot may be, and how its sensor is mounted."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imgloc.cli.options import Flipped
from imgloc.cli.values import check_range, check_yaw, numbers, some_numbers
from imgloc.errors import ConfigError

if TYPE_CHECKING:
    from imgloc.model import LaserScan, OccupancyGrid, Pose2D
    from imgloc.options import Prior

RADIUS, TOLERANCE = 2.0, 0.8
"""How far from --near a robot may be, and turned how far, unless stated: metres, radians."""


@dataclass(frozen=True)
class Known:
    """What the options say of the pose, map frame; None where they say nothing."""

    near: tuple[float, ...] | None
    heading: tuple[float, ...] | None
    region: Path | None
    clearance: float | None


def known(
    near: Annotated[
        Any,
        typer.Option(
            metavar="X,Y,YAW[,R[,T]]",
            parser=some_numbers(3, 5),
            help="Only poses within R metres of a pose in the map frame and turned from it by at "
            f"most T radians. [default: R = {RADIUS:g}, T = {TOLERANCE:g}]",
        ),
    ] = None,
    heading: Annotated[
        Any,
        typer.Option(
            metavar="YAW[,T]",
            parser=some_numbers(1, 2),
            help="Only poses with this heading in the map frame (a compass), up to T radians. "
            f"[default: T = {TOLERANCE:g}]",
        ),
    ] = None,
    region: Annotated[
        Path | None,
        typer.Option(
            metavar="PNG",
            help="Only poses in the white part of an image as large as the map's.",
        ),
    ] = None,
    clearance: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Only poses at least M metres from what is not free: the robot's size.",
        ),
    ] = None,
) -> Known:
    """Options of the prior."""
    if near is not None and len(near) > 3:
        check_range("--near, R", near[3], 0.01, 1e6, "metres")
    for option, given, yaw, tolerance in (("--near", near, 2, 4), ("--heading", heading, 0, 1)):
        if given is not None:
            check_yaw(option, given[yaw])
            if len(given) > tolerance:
                check_range(f"{option}, T", given[tolerance], 0.001, 3.2, "radians")
    check_range("--clearance", clearance, 0, 1000, "metres")
    return Known(near, heading, region, clearance)


def prior_of(known: Known, grid: "OccupancyGrid", *, allow_lossy: bool = False) -> "Prior":
    """Make the prior of a map; its region may be a JPEG if the map may.

    Raises
    ------
    ConfigError
        If the heading is given twice, or the region is not as large as the map.
    MapError
        If the region is not an image.
    """
    from imgloc.geometry import compose, inverse
    from imgloc.model import Pose2D
    from imgloc.options import Prior
    from imgloc.search import priors

    prior, to_grid = Prior(), inverse(grid.origin)
    if known.near is not None:
        x, y, yaw, *rest = known.near
        radius, tolerance = (*rest, *(RADIUS, TOLERANCE)[len(rest) :])
        at = compose(to_grid, Pose2D(x, y, yaw))
        disc = priors.near(grid.info, at.x, at.y, radius)
        about = {"x": x, "y": y, "theta": yaw, "radius": radius, "tolerance": tolerance}
        prior &= Prior(disc, (at.theta, tolerance), {"near": about})
    if known.heading is not None:
        yaw, tolerance = (*known.heading, TOLERANCE)[:2]
        about = {"theta": yaw, "tolerance": tolerance}
        prior &= Prior(None, (yaw + to_grid.theta, tolerance), {"heading": about})
    if known.region is not None:
        cells = _region(known.region, grid, allow_lossy)
        prior &= Prior(cells, None, {"region": {"cells": int(cells.sum())}})
    if known.clearance:
        prior &= Prior(
            priors.clearance(grid, known.clearance), None, {"clearance": known.clearance}
        )
    return prior


def _region(path: Path, grid: "OccupancyGrid", allow_lossy: bool) -> Any:
    """The white pixels of an image that are not transparent, row 0 lowest."""
    from imgloc.io.files import display
    from imgloc.io.images import image_size, read_image

    size = image_size(path)[:2]  # of which there is memory enough if it is that of the map
    if size[::-1] != grid.occupied.shape:
        height, width = grid.occupied.shape
        raise ConfigError(
            f"{display(path)}: {size[0]} x {size[1]} pixels, expected {width} x {height} as the map"
        )
    read = read_image(path, allow_lossy=allow_lossy)
    image = read.pixels
    # The darkest channel decides, alpha being one of them: neither colour nor nothing is white.
    grey = image if image.ndim == 2 else image.min(axis=2)
    cells = grey[::-1] > read.white // 2
    if not cells.any():
        raise ConfigError(f"{display(path)}: no white pixel, expected white where the robot may be")
    return cells


@dataclass(frozen=True)
class Mounting:
    """How the sensor sits on the robot."""

    sensor: tuple[float, float, float] | None
    flipped: bool

    @property
    def pose(self) -> "Pose2D | None":
        """Pose of the sensor on the robot, if it was given."""
        from imgloc.model import Pose2D

        return None if self.sensor is None else Pose2D(*self.sensor)

    @property
    def about(self) -> dict[str, object]:
        """What was given, as plain values, for the record."""
        names = ("x", "y", "theta")
        sensor = self.sensor and dict(zip(names, self.sensor, strict=True))
        return {"sensor": sensor, "flipped": self.flipped}

    def mount(self, scan: "LaserScan") -> "LaserScan":
        """The scan as that of a sensor that is mounted upright, with the mounting pose given."""
        scan = scan.flipped if self.flipped else scan
        return scan if self.pose is None else replace(scan, T_base_laser=self.pose)


def mounting(
    sensor: Annotated[
        Any,
        typer.Option(
            metavar="X,Y,YAW",
            parser=numbers(3),
            help="Pose of the sensor on the robot (metres, radians): poses of the robot's base are "
            "given too.",
        ),
    ] = None,
    flipped: Flipped = False,
) -> Mounting:
    """Options of the mounting."""
    if sensor is not None:
        check_yaw("--sensor", sensor[2])
    return Mounting(sensor, flipped)
