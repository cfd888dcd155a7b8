"""Values of options: their parsers, and the refusal of those that cannot be meant."""

import math
import re
from collections.abc import Callable

import typer

from imgloc.errors import ConfigError

_UNITS = {"": 0, "K": 10, "M": 20, "G": 30, "T": 40}


def byte_count(text: str) -> int:
    """Parse a number of bytes, with a unit of powers of 1024 or none.

    Examples
    --------
    >>> byte_count("512M") == 512 * 1024**2, byte_count("1.5GiB") == 3 * 2**29
    (True, True)
    """
    found = re.fullmatch(r"(\d+(?:\.\d*)?)\s*([KMGT]?)(?:i?B)?", text.strip(), re.IGNORECASE)
    if found is None:
        raise typer.BadParameter(f"got {text!r}, expected a number of bytes such as 512M or 2G")
    return int(float(found[1]) * (1 << _UNITS[found[2].upper()]))


def numbers(count: int) -> Callable[[str], tuple[float, ...]]:
    """Return a parser of `count` finite numbers with commas between them.

    Examples
    --------
    >>> numbers(3)("1,-2.5,0")
    (1.0, -2.5, 0.0)
    """

    def parse(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(word) for word in text.split(","))
        except ValueError:
            values = ()
        if len(values) != count or not all(map(math.isfinite, values)):
            raise typer.BadParameter(f"got {text!r}, expected {count} numbers with commas between")
        return values

    return parse


def some_numbers(least: int, most: int) -> Callable[[str], tuple[float, ...]]:
    """Return a parser of `least` to `most` finite numbers with commas between them.

    Examples
    --------
    >>> some_numbers(1, 2)("0.5")
    (0.5,)
    """

    def parse(text: str) -> tuple[float, ...]:
        count = min(max(text.count(",") + 1, least), most)
        try:
            return numbers(count)(text)
        except typer.BadParameter:
            raise typer.BadParameter(
                f"got {text!r}, expected {least} to {most} numbers with commas between"
            ) from None

    return parse


def check_yaw(option: str, yaw: float) -> None:
    """Refuse an angle that was meant in degrees.

    Raises
    ------
    ConfigError
        If it is more than a turn.
    """
    if abs(yaw) > 2 * math.pi + 1e-6:
        raise ConfigError(
            f"{option}: got a yaw of {yaw:g}, expected radians, -6.2832 to 6.2832; are these "
            "degrees? multiply them by pi / 180"
        )


def check_range(option: str, value: float | None, low: float, high: float, unit: str) -> None:
    """Refuse a value that is not in ``low..high``; None, an option not given, passes.

    Raises
    ------
    ConfigError
        Naming the option.
    """
    if value is not None and not low <= value <= high:  # NaN fails both
        raise ConfigError(f"{option}: got {value:g}, expected {unit}, {low:g} to {high:g}")
