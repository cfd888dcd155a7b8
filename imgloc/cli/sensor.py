"""Options of a simulated sensor, the same wherever scans are simulated."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from imgloc.cli.values import check_range, check_yaw, numbers

if TYPE_CHECKING:
    from imgloc.simulate import Sensor


def sensor(
    rays: Annotated[int, typer.Option(min=1, metavar="N", help="Readings of a scan.")] = 181,
    fov_deg: Annotated[
        float, typer.Option(metavar="DEG", help="Angle that a scan covers, degrees.")
    ] = 180.0,
    sigma: Annotated[
        float, typer.Option(metavar="M", help="Standard deviation of a reading's noise, metres.")
    ] = 0.02,
    outliers: Annotated[
        float,
        typer.Option(metavar="P", help="Share of the rays that something unmapped stops, 0..1."),
    ] = 0.0,
    dropped: Annotated[
        float, typer.Option(metavar="P", help="Share of the rays that give no measurement, 0..1.")
    ] = 0.0,
    clearance: Annotated[
        float,
        typer.Option(
            metavar="M", help="Least distance of the robot from what is not free, metres."
        ),
    ] = 0.3,
    mount: Annotated[
        Any,
        typer.Option(
            metavar="X,Y,YAW",
            parser=numbers(3),
            help="Pose of the sensor on the robot: metres, metres, radians. [default: 0,0,0]",
        ),
    ] = None,
) -> "Sensor":
    """Options of the sensor, but for its reach."""
    check_range("--fov-deg", fov_deg, 0.01, 360, "degrees")
    check_range("--sigma", sigma, 0, 10, "metres")
    check_range("--outliers", outliers, 0, 1, "a share")
    check_range("--dropped", dropped, 0, 1, "a share")
    check_range("--clearance", clearance, 0, 1000, "metres")
    if mount is not None:
        check_yaw("--mount", mount[2])
    import numpy as np

    from imgloc.model import Pose2D
    from imgloc.simulate import Sensor

    return Sensor(
        rays=rays,
        fov=float(np.deg2rad(fov_deg)),
        sigma=sigma,
        outliers=outliers,
        dropped=dropped,
        clearance=clearance,
        mount=Pose2D(*(mount or (0.0, 0.0, 0.0))),
    )
