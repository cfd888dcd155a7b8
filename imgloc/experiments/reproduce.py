"""Everything that the paper shows, measured and drawn: its table, figures and appendix."""

import platform
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np

from imgloc import __version__
from imgloc.draw.figures import draw_comparison, draw_fields
from imgloc.errors import ConfigError
from imgloc.experiments.claims import Claim, claims, growth_claims, time_claims
from imgloc.experiments.complexity import AXES, Complexity, draw, measure
from imgloc.experiments.paper import PLACES, STEPS_DEG, Row, table
from imgloc.experiments.scenes import SETTINGS, scene
from imgloc.io.output import encode_png

QUICK = 5
"""Trials in each world of the quick form."""
_WINDOW_FIG_4 = (19.5, 18.0, 28.5, 27.0)


@dataclass(frozen=True)
class Reproduction:
    """What was measured and drawn.

    Parameters
    ----------
    n, seed : int
    rows : tuple of Row
    claims, time_claims : tuple of Claim
        Those about the index, the maxima and counted work; and those about times, which are
        this machine's.
    complexity : Complexity
    pictures : mapping of str to bytes
        PNG files by name.
    """

    n: int
    seed: int
    rows: tuple[Row, ...]
    claims: tuple[Claim, ...]
    time_claims: tuple[Claim, ...]
    complexity: Complexity
    pictures: Mapping[str, bytes]

    @property
    def holds(self) -> bool:
        """Whether all that is firm in what the paper says is so here; times apart."""
        return all(claim.holds for claim in self.claims if claim.firm)


def steps(n: int) -> int:
    """How often `advance` is called by :func:`reproduce`."""
    stacks = sum(len(setting.steps) for setting in SETTINGS.values())
    return n * len(PLACES) * len(STEPS_DEG) + stacks + sum(map(len, AXES.values()))


def reproduce(
    n: int = 100,
    seed: int = 0,
    *,
    quick: bool = False,
    threads: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> Reproduction:
    """Run the experiment of Sec. VI, draw Figs. 1, 2, 4 and 5, measure the appendix.

    Parameters
    ----------
    n : int
        Trials in each world.
    seed : int
        Of everything random.
    quick : bool
        Only count the work of the appendix, time nothing there.
    threads : int
        No number but the times depends on it.
    advance : callable
        Called :func:`steps` times.

    Raises
    ------
    ConfigError
        If `n` is less than 1.
    """
    rows = table(n, seed, threads=threads, advance=advance)
    pictures = {name: encode_png(figure(name, threads, advance)) for name in SETTINGS}
    grown = measure(repeats=0 if quick else 1, seed=seed, progress=lambda _: advance())
    with suppress(ConfigError):  # without matplotlib the table of exponents says it all
        pictures["complexity"] = encode_png(draw(grown))
    said = claims(rows) + growth_claims(grown)
    return Reproduction(n, seed, rows, said, time_claims(rows), grown, pictures)


def figure(
    name: str, threads: int = 1, advance: Callable[[], None] = lambda: None
) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Draw a figure of :data:`imgloc.experiments.scenes.SETTINGS`, (H, W, 3) BGR."""
    s = scene(name, threads=threads, advance=advance)
    f = s.features
    if name == "fig4":
        return draw_fields(
            f.grid, f.surface, f.bmap, f.vmap, s.truth, s.points, s.stacks, window=_WINDOW_FIG_4
        )
    wide = name == "fig5"
    return draw_comparison(
        f.grid, s.truth, s.points, s.stacks, scale=1 if wide else 3, columns=4 if wide else 3
    )


def as_dict(reproduction: Reproduction) -> dict[str, Any]:
    """Everything but the pictures as plain values, for ``results.json`` and the report.

    Two runs differ only in what is under ``cost`` and in the times of ``complexity``.
    """
    return {
        "paper": "A. Censi, A comparison of algorithms for likelihood approximation in "
        "Bayesian localization",
        "version": __version__,
        "libraries": {
            "python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__,
        },
        "n": reproduction.n,
        "seed": reproduction.seed,
        "holds": reproduction.holds,
        "claims": [asdict(claim) for claim in reproduction.claims],
        "table": [_row(row) for row in reproduction.rows],
        "cost": {"claims": [asdict(claim) for claim in reproduction.time_claims]},
        "complexity": asdict(reproduction.complexity),
    }  # fmt: skip


def _row(row: Row) -> dict[str, Any]:
    out = asdict(row)
    del out["ms"]
    out["cost"] = {"ms": row.median_ms}
    return {"place": PLACES[row.world], **out, "interval": list(row.interval)}
