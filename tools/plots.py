"""Curves by matplotlib, which is optional, as arrays like all other pictures."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError

COLOURS = {
    "cbml": "#d55e00", "cbml-o": "#e69f00", "ght": "#56b4e9", "ght-v": "#0072b2", "beam": "#555555",
}  # fmt: skip
"""Of the methods, in all curves."""


def blank(
    width: float, height: float, **options: Any
) -> tuple[Any, Callable[[], npt.NDArray[Any]]]:
    """An empty matplotlib figure, in inches, and what turns it into pixels (H, W, 3), BGR.

    Raises
    ------
    ConfigError
        If matplotlib is not installed.
    """
    try:  # by name: the type checker need not know an optional package
        agg = import_module("matplotlib.backends.backend_agg")
        figure = import_module("matplotlib.figure").Figure((width, height), **options)
    except ImportError as error:
        raise ConfigError("pictures of curves need matplotlib: pip install imgloc[plot]") from error
    canvas = agg.FigureCanvasAgg(figure)

    def pixels() -> npt.NDArray[np.uint8]:
        canvas.draw()
        image = cv2.cvtColor(np.asarray(canvas.buffer_rgba()), cv2.COLOR_RGBA2BGR)
        return np.asarray(image, np.uint8)

    return figure, pixels
