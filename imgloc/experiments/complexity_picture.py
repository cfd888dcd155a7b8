"""One log-log picture of what :mod:`imgloc.experiments.complexity` measured."""

from importlib import import_module

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.experiments.complexity_types import Complexity

_ROWS = {
    "init_s": "init time, s",
    "storage": "storage, bytes",
    "run_s": "run time, s",
    "work": "votes or pixels",
}
_LABELS = {
    "A": "area A, m²",
    "rho_m": "map resolution ρ_m, cells/m",
    "rho_theta": "angle resolution ρ_θ, headings",
    "n": "readings n",
}
_COLOURS = {
    "cbml": "#d55e00", "cbml-o": "#e69f00", "ght": "#56b4e9", "ght-v": "#0072b2", "beam": "#555555",
}  # fmt: skip


def draw(complexity: Complexity) -> npt.NDArray[np.uint8]:
    """Draw all samples as one log-log picture with the exponents, the paper's in brackets.

    Parameters
    ----------
    complexity : Complexity

    Returns
    -------
    (H, W, 3) uint8 array
        BGR, row 0 at the top.

    Raises
    ------
    ConfigError
        If matplotlib is not installed.
    """
    try:
        # By name: the type checker need not know an optional package.
        agg = import_module("matplotlib.backends.backend_agg")
        figure = import_module("matplotlib.figure").Figure(layout="constrained", dpi=110)
    except ImportError as error:
        raise ConfigError("pictures of curves need matplotlib: pip install imgloc[plot]") from error
    axes = list(dict.fromkeys(s.axis for s in complexity.samples))
    rows = [q for q in _ROWS if any(f.quantity == q for f in complexity.fits)]
    figure.set_size_inches(3.4 * len(axes), 2.8 * len(rows))
    canvas = agg.FigureCanvasAgg(figure)
    panels = figure.subplots(len(rows), len(axes), squeeze=False, sharex="col", sharey="row")
    for i, quantity in enumerate(rows):
        for j, axis in enumerate(axes):
            panel = panels[i, j]
            for fit in complexity.fits:
                if (fit.quantity, fit.axis) != (quantity, axis):
                    continue
                mine = [s for s in complexity.samples if (s.method, s.axis) == (fit.method, axis)]
                said = "" if fit.paper is None else f" ({fit.paper:g})"
                panel.plot(
                    [s.value for s in mine],
                    [getattr(s, quantity) for s in mine],
                    "o-",
                    color=_COLOURS[fit.method],
                    markersize=3.5,
                    linewidth=1.2,
                    label=f"{fit.method} {round(fit.exponent, 2) + 0.0:.2f}{said}",
                )
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.minorticks_off()
            ticks = sorted({s.value for s in complexity.samples if s.axis == axis})
            panel.set_xticks(ticks, [f"{t:,.0f}" if t >= 100 else f"{t:.3g}" for t in ticks])
            panel.grid(alpha=0.25)
            panel.legend(fontsize=6.5, loc="upper left", ncols=2, framealpha=1, edgecolor="none")
            if j == 0:
                panel.set_ylabel(_ROWS[quantity])
            if i == len(rows) - 1:
                panel.set_xlabel(_LABELS[axis])
        low, high = panels[i, 0].get_ylim()
        panels[i, 0].set_ylim(low, high * (high / low) ** 0.35)  # room for the legends
    figure.suptitle(f"Growth in the world '{complexity.world}': exponents fitted (the paper's)")
    canvas.draw()
    return np.asarray(cv2.cvtColor(np.asarray(canvas.buffer_rgba()), cv2.COLOR_RGBA2BGR), np.uint8)
