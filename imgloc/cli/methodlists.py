"""Options about several methods: their names with commas between, values for some of them."""

from collections.abc import Sequence

from imgloc.cli.values import check_range
from imgloc.errors import ConfigError


def methods_of(text: str, known: Sequence[str]) -> list[str]:
    """Names of methods, each once, in the order given.

    Raises
    ------
    ConfigError
        Naming the one that is not known.

    Examples
    --------
    >>> methods_of("ght, beam,ght", ["beam", "ght"])
    ['ght', 'beam']
    """
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in known:
            raise ConfigError(
                f"--methods: got {name!r}, expected {','.join(known)} or some of them"
            )
    return list(dict.fromkeys(names))


def for_each(
    option: str,
    texts: Sequence[str] | None,
    methods: Sequence[str],
    low: float,
    high: float,
    unit: str,
) -> dict[str, float]:
    """Values by method of an option given as VALUE, for all, or METHOD=VALUE.

    Raises
    ------
    ConfigError
        If a value is not in ``low..high``, or its method not one of `methods`.

    Examples
    --------
    >>> for_each("--cell", ["ght=0.2", "0.1"], ["ght", "beam"], 0, 1, "metres")
    {'ght': 0.2, 'beam': 0.1}
    """
    out: dict[str, float] = {}
    for text in sorted(texts or (), key=lambda t: "=" in t):  # those for one method win
        name, _, number = text.rpartition("=")
        if name and name not in methods:
            raise ConfigError(f"{option}: got {text!r}, {name!r} is not one of --methods")
        value = number_of(option, number)
        check_range(option, value, low, high, unit)
        out |= dict.fromkeys([name] if name else methods, value)
    return out


def number_of(option: str, text: str) -> float:
    """Parse a number.

    Raises
    ------
    ConfigError
        Naming the option.
    """
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{option}: got {text!r}, expected a number") from None
