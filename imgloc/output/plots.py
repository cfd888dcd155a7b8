"""Curves, histograms and panels by matplotlib, as pictures like all others."""

import warnings
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from imgloc.output.canvas import Colour, Image


def blank(width: float, height: float, **options: Any) -> tuple[Any, Callable[[], Image]]:
    """An empty matplotlib figure, in inches of 100 pixels, and what turns it into a picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # takes half a second
    from matplotlib.figure import Figure

    figure = Figure((width, height), **{"dpi": 100, **options})
    canvas = FigureCanvasAgg(figure)

    def pixels() -> Image:
        with warnings.catch_warnings():  # names may have letters that no font here has
            warnings.simplefilter("ignore", UserWarning)
            canvas.draw()
        image = cv2.cvtColor(np.asarray(canvas.buffer_rgba()), cv2.COLOR_RGBA2BGR)
        return np.asarray(image, np.uint8)

    return figure, pixels


def ink(colour: Colour) -> tuple[float, float, float]:
    """A colour of a picture as matplotlib has it: red, green, blue, 0..1."""
    b, g, r = (value / 255 for value in colour)
    return r, g, b
