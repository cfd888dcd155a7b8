"""What can be different about a sensor, its mounting or a map."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from imgloc.model import LaserScan, Pose2D
from imgloc.simulate import Sensor


@dataclass(frozen=True)
class Condition:
    """What is different.

    Parameters
    ----------
    sensor : Sensor
    cell : float
        Of the map, metres.
    flipped : bool
        The sensor hangs upside down, and says so.
    """

    sensor: Sensor = field(default_factory=Sensor)
    cell: float = 0.1
    flipped: bool = False


def _sensor(**changed: object) -> Condition:
    return Condition(replace(Sensor(), **changed))  # type: ignore[arg-type]


CONDITIONS: Mapping[str, Condition] = MappingProxyType(
    {
        "as in the paper": Condition(),
        "10 % of the rays stopped short": _sensor(outliers=0.1),
        "30 % of the rays stopped short": _sensor(outliers=0.3),
        "50 % of the rays stopped short": _sensor(outliers=0.5),
        "10 % of the rays dropped": _sensor(dropped=0.1),
        "reach of 5 m": _sensor(range_max=5.0),
        "field of view 90 deg": _sensor(fov=np.pi / 2),
        "field of view 270 deg": _sensor(fov=1.5 * np.pi),
        "field of view 360 deg": _sensor(fov=2 * np.pi),
        "31 rays": _sensor(rays=31),
        "361 rays": _sensor(rays=361),
        "1081 rays": _sensor(rays=1081),
        "map at 2.5 cm": Condition(cell=0.025),
        "map at 5 cm": Condition(cell=0.05),
        "map at 20 cm": Condition(cell=0.2),
        "sensor off-centre": _sensor(mount=Pose2D(0.3, -0.2, 0.5)),
        "sensor upside down": Condition(replace(Sensor(), mount=Pose2D(0.3, 0.0, 0.2)), 0.1, True),
    }
)
"""The conditions of the table by name."""


def upside_down(scan: LaserScan) -> LaserScan:
    """What a sensor with a symmetric fan records when it hangs upside down: clockwise.

    `--flipped` is to make up for it, see :attr:`~imgloc.model.LaserScan.flipped`.
    """
    return replace(scan, ranges=scan.ranges[::-1])
