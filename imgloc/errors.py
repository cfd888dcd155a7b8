"""The exceptions of imgloc: one base, one class per kind of input.

A message is one line that names the file, the key, the value received, what was
expected and, where there is one, the next step. The command line prints the message and
ends with the class's exit code; anything that is not an :class:`ImglocError` is a defect.
"""


class ImglocError(Exception):
    """Base of every error that imgloc raises on purpose."""

    exit_code = 1


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
