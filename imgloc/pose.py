"""A pose in the plane, and where a sensor may sit; without NumPy, for which help has no time."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, final

from imgloc.errors import ConfigError

MOUNTED = 5.0
"""Largest distance of a sensor from the base of its robot, metres."""
MOST_TURNED = 4 * math.pi
"""Radians that no direction has: twice around."""
DEGREES = "expected radians, -12.57 to 12.57; are these degrees? multiply them by pi / 180"


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
        if abs(self.theta) > MOST_TURNED:
            raise ConfigError(f"theta: got {self.theta:g}, {DEGREES}")
        theta = math.remainder(self.theta, math.tau)
        object.__setattr__(self, "theta", math.pi if theta <= -math.pi else theta)

    def __iter__(self) -> Iterator[float]:
        """Yield x, y and theta."""
        return iter((self.x, self.y, self.theta))


def wrapped_pose(x: float, y: float, theta: float) -> Pose2D:
    """Return the pose of a robot whose heading, radians, may have been counted on over many turns.

    Examples
    --------
    >>> wrapped_pose(1.0, 2.0, 10 * math.pi + 0.5).theta.__round__(6)
    0.5
    """
    return Pose2D(x, y, math.remainder(theta, math.tau))


def pose_of(value: Any, name: str) -> Pose2D:
    """Return a pose as it is given: a pose, or its x, y and theta; `name` is for the ConfigError.

    Examples
    --------
    >>> pose_of((0.2, 0.0, 0.0), "T_base_laser")
    Pose2D(x=0.2, y=0.0, theta=0.0)
    """
    try:
        return value if isinstance(value, Pose2D) else Pose2D(*value)
    except (TypeError, ValueError):
        expected = "a Pose2D, or x, y, theta: metres, metres, radians"
        raise ConfigError(f"{name}: got {value!r:.60}, expected {expected}") from None


def difference(a: Pose2D, b: Pose2D) -> tuple[float, float]:
    """Distance in metres and angle in radians, 0..pi, between two poses."""
    return math.hypot(a.x - b.x, a.y - b.y), abs(math.remainder(a.theta - b.theta, math.tau))


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
