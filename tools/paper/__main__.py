"""Run the paper's experiment again: its table, Figs. 1, 2, 4 and 5, and its appendix.

Writes results.json, the figures as PNG and one self-contained report.html into a folder:

    python -m tools.paper --out paper            # 100 trials in each world
    python -m tools.paper --out paper --quick    # a few, in under a minute

Everything but times is the same for the same -n and --seed, whatever the threads. The exit
code is 1 if the order of the methods or a counted exponent is not the paper's.
"""

import argparse
import os
import platform
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from imgloc import ConfigError, __version__
from imgloc.io.files import write_bytes_atomic, write_text_atomic
from imgloc.io.images import encode_png
from imgloc.model import to_json
from tools.paper.claims import claims, growth_claims, time_claims
from tools.paper.complexity import AXES, TIMES, draw, measure
from tools.paper.figures import SETTINGS, figure
from tools.paper.page import render_report
from tools.paper.table import PAIRS, PLACES, STEPS_DEG, TableRow, measure_ratios, table
from tools.script import ended, make_folder, parser_of, progress

FILES = ("results.json", "report.html", *(f"{name}.png" for name in (*SETTINGS, "complexity")))
QUICK = 3
"""Trials in each world of the quick form."""
TIMED, TIMED_QUICK = (8, 3), (2, 1)
"""Scans of each world whose run times are compared, and repeats."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, run, write the files; return the exit code."""
    parser = parser_of("tools.paper", __doc__, seed=0)
    parser.add_argument("--out", type=Path, required=True, help="folder, made if need be")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} trials, time nothing twice")
    parser.add_argument("-n", type=int, help="trials in each world (default: 100)")
    parser.add_argument(
        "--worlds", nargs="+", choices=tuple(PLACES), default=tuple(PLACES), metavar="WORLD",
        help="of the table (default: visibility large curved)",
    )  # fmt: skip
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--force", action="store_true", help="overwrite files in --out")
    given = parser.parse_args(arguments)
    return ended("paper", lambda: run(given))


def run(given: argparse.Namespace) -> int:
    """Do what the command line asks for."""
    n = given.n if given.n is not None else QUICK if given.quick else 100
    if n < 2 or given.seed < 0 or given.threads < 1:
        raise ConfigError(
            f"-n {n}, --seed {given.seed} and --threads {given.threads}: expected at least "
            "2 trials, a seed of 0 or more, 1 thread or more"
        )
    make_folder(given.out, FILES, force=given.force)
    cv2.setNumThreads(given.threads)
    worlds = tuple(dict.fromkeys(given.worlds))
    total = steps(n, worlds, quick=given.quick)
    with progress("the paper's experiment", total) as advance:
        results, pictures = reproduce(
            n, given.seed, worlds, quick=given.quick, threads=given.threads, advance=advance
        )
    for name, png in pictures.items():
        write_bytes_atomic(given.out / f"{name}.png", png, force=given.force)
    write_text_atomic(given.out / "results.json", to_json(results) + "\n", force=given.force)
    page = render_report(results, pictures)  # last, when all the rest is there
    write_text_atomic(given.out / "report.html", page, force=given.force)
    for row in results["table"]:
        paper = "" if row["paper"] is None else f", the paper's {row['paper']:.2f}"
        print(f"{row['world']} {row['method']}: S {row['index']['value']:.2f}{paper}")
    for claim in (*results["claims"], *results["cost"]["claims"]):
        print(f"{'holds' if claim['holds'] else 'FAILS'}: {claim['text']} ({claim['found']})")
    print(given.out / "report.html")
    return 0 if results["holds"] else 1


def steps(n: int, worlds: Sequence[str] = tuple(PLACES), *, quick: bool = False) -> int:
    """How often `advance` is called by :func:`reproduce`."""
    stacks = sum(len(setting.steps) for setting in SETTINGS.values())
    timed, _ = TIMED_QUICK if quick else TIMED
    in_turns = (n * len(STEPS_DEG) + min(timed, n) * len(PAIRS)) * len(worlds)
    return in_turns + stacks + sum(map(len, AXES.values()))


def reproduce(
    n: int, seed: int, worlds: Sequence[str], *, quick: bool, threads: int,
    advance: Callable[[], None],
) -> tuple[dict[str, Any], dict[str, bytes]]:  # fmt: skip
    """Run the experiment of Sec. VI, draw Figs. 1, 2, 4 and 5, measure the appendix.

    `n` trials in each world; if `quick`, only count the work of the appendix and time little.
    `advance` is called :func:`steps` times. Plain values for ``results.json`` and the report, of
    which two runs differ only in what is under ``cost``; PNG files by name.
    """
    rows = table(n, seed, worlds=worlds, threads=threads, advance=advance)
    timed, repeats = TIMED_QUICK if quick else TIMED
    ratios = measure_ratios(min(timed, n), repeats, seed, trials=n, worlds=worlds, advance=advance)
    pictures = {name: encode_png(figure(name, threads, advance)) for name in SETTINGS}
    grown = measure(repeats=0 if quick else 3, seed=seed, progress=lambda _: advance())
    pictures["complexity"] = encode_png(draw(grown))
    said = claims(rows) + growth_claims(grown)
    samples, fits = [asdict(s) for s in grown.samples], [asdict(f) for f in grown.fits]
    results = {
        "paper": "A. Censi, A comparison of algorithms for likelihood approximation in "
        "Bayesian localization",
        "version": __version__,
        "libraries": {
            "python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__,
        },
        "n": n,
        "seed": seed,
        # All that is firm in what the paper says; times apart.
        "holds": all(claim.holds for claim in said if claim.firm),
        "claims": [asdict(claim) for claim in said],
        "table": [as_dict(row) for row in rows],
        "complexity": {
            "world": grown.world,
            "samples": [{k: v for k, v in s.items() if k not in TIMES} for s in samples],
            "fits": [f for f in fits if f["quantity"] not in TIMES],
        },
        "cost": {
            "claims": [asdict(claim) for claim in time_claims(ratios)],
            "ratios": [asdict(ratio) for ratio in ratios],
            "complexity": {
                "samples": [
                    {k: s[k] for k in ("method", "axis", "value", *TIMES)} for s in samples
                ],
                "fits": [f for f in fits if f["quantity"] in TIMES],
            },
        },
    }  # fmt: skip
    return results, pictures


def as_dict(row: TableRow) -> dict[str, Any]:
    """A row of the table as plain values."""
    out = asdict(row)
    del out["ms"]
    out["cost"] = {"ms": float(np.median(row.ms))}
    return {"place": PLACES[row.world], **out, "interval": list(row.interval)}


if __name__ == "__main__":
    sys.exit(main())
