"""The values of options as they are typed: numbers, angles, poses, bytes, names.

Each function makes a value of a text, or raises a ConfigError with what it got and expected.
"""

import math
import re
from collections.abc import Callable, Sequence

from imgloc.errors import ConfigError
from imgloc.pose import Pose2D

_BINARY = {"": 0, "K": 10, "M": 20, "G": 30, "T": 40}  # powers of two
_TURN = math.tau + 1e-6  # radians
FAR = 1e6  #: metres: no place has greater coordinates


def byte_count(text: str) -> int:
    """Bytes of a number with a unit, which is a power of 1024, or without one.

    Examples
    --------
    >>> byte_count("512M"), byte_count("1.5 GiB"), byte_count("2k"), byte_count("1024")
    (536870912, 1610612736, 2048, 1024)
    """
    found = re.fullmatch(r"(\d+(?:\.\d*)?)\s*([KMGT]?)(?:i?B)?", text.strip(), re.IGNORECASE)
    if found is None:
        raise ConfigError(f"got {text!r}, expected a number of bytes such as 512M or 2G")
    return int(float(found[1]) * (1 << _BINARY[found[2].upper()]))


def angle(text: str) -> float:
    """Radians of an angle that is typed in radians, or in degrees as ``90deg``.

    Examples
    --------
    >>> angle("-1.5"), round(angle("90deg"), 4)
    (-1.5, 1.5708)
    """
    text = text.strip()
    if text.endswith("deg"):
        if abs(degrees := number(text[:-3])) > 360:
            raise ConfigError(f"got {text}, expected -360deg to 360deg")
        return math.radians(degrees)
    if abs(value := number(text)) > _TURN:
        raise ConfigError(
            f"got an angle of {value:g}, expected radians, -6.2832 to 6.2832; are these degrees? "
            f"write {value:g}deg, or multiply them by pi / 180"
        )
    return value


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?|[-+]?inf|nan", re.ASCII | re.IGNORECASE)


def number(text: str) -> float:
    """The number of a text; a ValueError for what Python alone takes for one, such as ``1_0``."""
    if not _NUMBER.fullmatch(text.strip()):
        raise ValueError(text)
    return float(text)


WITH_COMMAS = "numbers with commas between"


def numbers(
    least: int, most: int | None = None, *, rest: Sequence[float] = (), angles: Sequence[int] = ()
) -> Callable[[str], tuple[float, ...]]:
    """Return what reads `least` finite numbers with commas between them, or up to `most`.

    `rest` holds the values of further ones that may be left out; those at `angles` are read by
    :func:`angle`.

    Examples
    --------
    >>> numbers(3, rest=(2.0,), angles=(2,))("1, 2, 0.5")
    (1.0, 2.0, 0.5, 2.0)
    >>> numbers(3, rest=(8.0, 9.0))("1,2,3,4")
    (1.0, 2.0, 3.0, 4.0, 9.0)
    """
    most = most or least + len(rest)
    count = f"{least}" if least == most else f"{least} to {most}"

    def read(text: str) -> tuple[float, ...]:
        words = text.split(",")
        try:
            values = [angle(w) if k in angles else number(w) for k, w in enumerate(words)]
        except ValueError:
            values = []
        if not least <= len(values) <= most or not all(map(math.isfinite, values)):
            raise ConfigError(f"got {text!r}, expected {count} {WITH_COMMAS}")
        return (*values, *rest[len(values) - least :])

    return read


def pose(text: str) -> Pose2D:
    """The pose of x, y and yaw: metres, metres, and an angle."""
    x, y, theta = numbers(3, angles=(2,))(text)
    if max(abs(x), abs(y)) > FAR:
        raise ConfigError(f"got {text!r}, expected x and y of at most {FAR:g} m")
    return Pose2D(x, y, theta)


def metres_degrees(text: str) -> tuple[float, float]:
    """Metres and radians of a distance in metres and an angle in degrees.

    Examples
    --------
    >>> metres_degrees("0.5,180")
    (0.5, 3.141592653589793)
    """
    metres, degrees = numbers(2)(text)
    if not 0 <= degrees <= 360:
        raise ConfigError(f"got {degrees:g} degrees, expected 0 to 360")
    return metres, math.radians(degrees)


def names(known: Sequence[str]) -> Callable[[str], tuple[str, ...]]:
    """Return what reads some of the `known` names, with commas between, each once and in order.

    Examples
    --------
    >>> names(["ght", "ght-v", "beam"])("beam,ght")
    ('beam', 'ght')
    """

    def read(text: str) -> tuple[str, ...]:
        some = [name.strip() for name in text.split(",")]
        if (strange := next((name for name in some if name not in known), None)) is not None:
            raise ConfigError(f"got {strange!r}, expected {','.join(known)} or some of them")
        return tuple(dict.fromkeys(some))

    return read
