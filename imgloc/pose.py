"""A pose in the plane, and where a sensor may sit; without NumPy, for which help has no time."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

from imgloc.errors import ConfigError

MOUNTED = 5.0
"""Largest distance of a sensor from the base of its robot, metres."""


@final
@dataclass(frozen=True)
class Pose2D:
    """A pose in the plane: x, y in metres, theta in radians, counter-clockwise.

    `theta` is wrapped to (-pi, pi] at construction.

    Examples
    --------
    >>> round(Pose2D(1.0, 2.0, 3.5).theta, 4)
    -2.7832
    >>> x, y, theta = Pose2D(1.0, 2.0, 0.5)
    >>> x, y, theta
    (1.0, 2.0, 0.5)
    """

    x: float
    y: float
    theta: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "x", float(self.x))
        object.__setattr__(self, "y", float(self.y))
        theta = math.remainder(self.theta, math.tau)
        object.__setattr__(self, "theta", math.pi if theta <= -math.pi else theta)

    def __iter__(self) -> Iterator[float]:
        """Yield x, y and theta."""
        return iter((self.x, self.y, self.theta))


def check_mount(mount: Pose2D, name: str) -> None:
    """Raise a ConfigError if a sensor sits more than :data:`MOUNTED` metres from its robot's base.

    `mount` is the pose of the sensor on the robot. The message calls it `name`.

    Examples
    --------
    >>> check_mount(Pose2D(20.0, 0.0), "--sensor")
    Traceback (most recent call last):
        ...
    imgloc.errors.ConfigError: --sensor: got 20,0: 20 m from the robot's base, expected at most 5 \
m; are these centimetres, or millimetres? write metres
    """
    if not (away := math.hypot(mount.x, mount.y)) <= MOUNTED:
        raise ConfigError(
            f"{name}: got {mount.x:g},{mount.y:g}: {away:g} m from the robot's base, expected at "
            f"most {MOUNTED:g} m; are these centimetres, or millimetres? write metres"
        )
