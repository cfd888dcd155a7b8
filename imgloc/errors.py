"""The exceptions of imgloc: one base, one class per kind of input; and arguments of another kind.

A message is one line that names the file, the key, the value received, what was
expected and, where there is one, the next step. It names an argument in backquotes, with a value
where one is advised: `force=True`. The command line prints that as the option, ``--force``, and
ends with the class's exit code; anything that is not an :class:`ImglocError` is a defect.
"""

import re
import threading

STDERR = threading.RLock()
"""Held while standard error leads nowhere: an error that another thread prints waits for it."""
_ARGUMENT = re.compile(r"`([a-z][a-z_]*)(?:=([^`\s]+))?`")
_OPTIONS = {
    "index": "scans-index",
    "fov": "fov-deg",
    "theta_step": "theta-step-deg",
    "max_turn": "max-turn-deg",
}  # arguments that the command line takes by another name


def printable(text: str, keep: str = "\n\t") -> str:
    r"""Return text from anywhere as a terminal may have it: what would steer that is spelled out.

    Keys, topics and names in files may hold escape sequences, which set titles and colours or
    worse. The characters in `keep` stay.

    Examples
    --------
    >>> printable("\x1b[31mred\n")
    '\\x1b[31mred\n'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else repr(c)[1:-1] for c in text)


def as_options(message: str) -> str:
    """Return a message for the command line: each argument in backquotes becomes an option.

    Examples
    --------
    >>> as_options("a.png: exists; pass `force=True`, or try `range_scale=0.001`, `negate=False`")
    'a.png: exists; pass --force, or try --range-scale 0.001, --no-negate'
    """

    def option(found: re.Match[str]) -> str:
        name, value = _OPTIONS.get(found[1], found[1]).replace("_", "-"), found[2]
        denied = "no-" if value == "False" else ""
        return f"--{denied}{name}" + ("" if value in (None, "True", "False") else f" {value}")

    return _ARGUMENT.sub(option, message)


class ImglocError(Exception):
    """Base of every error that imgloc raises on purpose; its text can be printed anywhere."""

    exit_code = 1

    def __str__(self) -> str:
        return printable(super().__str__())


class ConfigError(ImglocError):
    """An option or parameter is out of its range, or two of them contradict."""

    exit_code = 2


class MapError(ImglocError):
    """A map file is missing, damaged, ambiguous or not usable for localization."""

    exit_code = 3


class ScanError(ImglocError):
    """A scan file is missing, damaged or not made of laser scans."""

    exit_code = 4


class OutputError(ImglocError):
    """A result cannot be written: no folder, no space, or a file that is not ours."""

    exit_code = 1


_MADE = {
    "OccupancyGrid": "load_map(path) reads one",
    "MapFeatures": "prepare(grid) makes them",
    "LaserScan": "load_scans(path)[k] is one",
    "ScanSet": "load_scans(path) reads one, ScanSet([scan]) makes one",
    "Options": 'Options(method="...") makes them',
    "Mapping": "{name: prepare(grid)}",
    "Localization": "localize(features, scan) gives one",
}


def expect(value: object, kind: type, name: str) -> None:
    """Raise TypeError for an argument of another kind: a grid for features, a string for options.

    Examples
    --------
    >>> expect(1, str, "method")
    Traceback (most recent call last):
        ...
    TypeError: method must be str, got int 1
    """
    if not isinstance(value, kind):
        made = f": {_MADE[kind.__name__]}" if kind.__name__ in _MADE else ""
        raise TypeError(
            f"{name} must be {kind.__name__}, got {type(value).__name__} {value!r:.40}{made}"
        )
