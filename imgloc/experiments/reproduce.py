"""Everything that the paper shows, measured and drawn: its table, figures and appendix."""

import platform
from collections.abc import Callable, Mapping, Sequence
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
from imgloc.experiments.complexity_types import TIMES
from imgloc.experiments.paper import PLACES, Row, table
from imgloc.experiments.paper_trials import STEPS_DEG
from imgloc.experiments.ratios import PAIRS, Ratio, measure_ratios
from imgloc.experiments.scenes import SETTINGS, scene
from imgloc.io.images import encode_png

QUICK = 3
"""Trials in each world of the quick form."""
TIMED, TIMED_QUICK = (8, 3), (2, 1)
"""Scans of each world whose run times are compared, and repeats."""
_WINDOW_FIG_4 = (21.0, 20.0, 27.0, 26.0)


@dataclass(frozen=True)
class Reproduction:
    """What was measured and drawn.

    Parameters
    ----------
    n, seed : int
    rows : tuple of Row
    ratios : tuple of Ratio
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
    ratios: tuple[Ratio, ...]
    claims: tuple[Claim, ...]
    time_claims: tuple[Claim, ...]
    complexity: Complexity
    pictures: Mapping[str, bytes]

    @property
    def holds(self) -> bool:
        """Whether all that is firm in what the paper says is so here; times apart."""
        return all(claim.holds for claim in self.claims if claim.firm)


def steps(n: int, worlds: Sequence[str] = tuple(PLACES), *, quick: bool = False) -> int:
    """How often `advance` is called by :func:`reproduce`."""
    stacks = sum(len(setting.steps) for setting in SETTINGS.values())
    timed, _ = TIMED_QUICK if quick else TIMED
    in_turns = (n * len(STEPS_DEG) + min(timed, n) * len(PAIRS)) * len(worlds)
    return in_turns + stacks + sum(map(len, AXES.values()))


def reproduce(
    n: int = 100,
    seed: int = 0,
    *,
    worlds: Sequence[str] = tuple(PLACES),
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
    worlds : sequence of str
        Of the table and the run times; some of :data:`imgloc.experiments.paper.PLACES`.
    quick : bool
        Only count the work of the appendix, time little.
    threads : int
        No number but the times depends on it.
    advance : callable
        Called :func:`steps` times.

    Raises
    ------
    ConfigError
        If `n` is less than 1, or there is no such world.
    """
    rows = table(n, seed, worlds=worlds, threads=threads, advance=advance)
    timed, repeats = TIMED_QUICK if quick else TIMED
    ratios = measure_ratios(min(timed, n), repeats, seed, trials=n, worlds=worlds, advance=advance)
    pictures = {name: encode_png(figure(name, threads, advance)) for name in SETTINGS}
    grown = measure(repeats=0 if quick else 3, seed=seed, progress=lambda _: advance())
    with suppress(ConfigError):  # without matplotlib the table of exponents says it all
        pictures["complexity"] = encode_png(draw(grown))
    said = claims(rows) + growth_claims(grown)
    return Reproduction(n, seed, rows, ratios, said, time_claims(ratios), grown, pictures)


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
    return draw_comparison(f.grid, s.truth, s.points, s.stacks, scale=1 if wide else 3, columns=3)


def as_dict(reproduction: Reproduction) -> dict[str, Any]:
    """Everything but the pictures as plain values, for ``results.json`` and the report.

    Two runs differ only in what is under ``cost``.
    """
    grown = reproduction.complexity
    samples, fits = [asdict(s) for s in grown.samples], [asdict(f) for f in grown.fits]
    keys = ("method", "axis", "value")
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
        "complexity": {
            "world": grown.world,
            "samples": [{k: v for k, v in s.items() if k not in TIMES} for s in samples],
            "fits": [f for f in fits if f["quantity"] not in TIMES],
        },
        "cost": {
            "claims": [asdict(claim) for claim in reproduction.time_claims],
            "ratios": [asdict(ratio) for ratio in reproduction.ratios],
            "complexity": {
                "samples": [{k: s[k] for k in (*keys, *TIMES)} for s in samples],
                "fits": [f for f in fits if f["quantity"] in TIMES],
            },
        },
    }  # fmt: skip


def _row(row: Row) -> dict[str, Any]:
    out = asdict(row)
    del out["ms"]
    out["cost"] = {"ms": row.median_ms}
    return {"place": PLACES[row.world], **out, "interval": list(row.interval)}
