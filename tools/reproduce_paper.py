"""Run the paper's experiment again: its table, Figs. 1, 2, 4 and 5, and its appendix.

Writes results.json, the figures as PNG and one self-contained report.html into a folder:

    python tools/reproduce_paper.py --out paper            # 100 trials in each world
    python tools/reproduce_paper.py --out paper --quick    # a few, in under a minute

Everything but times is the same for the same -n and --seed, whatever the threads. The exit
code is 1 if the order of the methods or a counted exponent is not the paper's.
"""

import argparse
import os
import sys
from pathlib import Path

import cv2

from imgloc.cli.console import progress
from imgloc.errors import ConfigError, ImglocError, OutputError
from imgloc.experiments.paper import PLACES
from imgloc.experiments.reproduce import QUICK, Reproduction, as_dict, reproduce, steps
from imgloc.experiments.scenes import SETTINGS
from imgloc.io.output import refuse_existing, write_bytes_atomic, write_text_atomic
from imgloc.output.json import to_json
from imgloc.report.paper import render_report

FILES = ("results.json", "report.html", *(f"{name}.png" for name in (*SETTINGS, "complexity")))


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, run, write the files; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder, made if need be")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} trials, time nothing twice")
    parser.add_argument("-n", type=int, help="trials in each world (default: 100)")
    parser.add_argument(
        "--worlds", nargs="+", choices=tuple(PLACES), default=tuple(PLACES), metavar="WORLD",
        help="of the table (default: visibility large curved)",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="of everything random (default: 0)")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--force", action="store_true", help="overwrite files in --out")
    given = parser.parse_args(arguments)
    try:
        return run(given)
    except ImglocError as error:
        print(f"reproduce_paper: error: {error}", file=sys.stderr)
        return error.exit_code


def run(given: argparse.Namespace) -> int:
    """Do what the command line asks for."""
    n = given.n if given.n is not None else QUICK if given.quick else 100
    if n < 2 or given.seed < 0 or given.threads < 1:
        raise ConfigError(
            f"-n {n}, --seed {given.seed} and --threads {given.threads}: expected at least "
            "2 trials, a seed of 0 or more, 1 thread or more"
        )
    try:
        given.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{given.out}: cannot be made: {error.strerror}") from None
    if not given.force:
        for name in FILES:  # now, not after minutes of work
            refuse_existing(given.out / name)
    cv2.setNumThreads(given.threads)
    worlds = tuple(dict.fromkeys(given.worlds))
    total = steps(n, worlds, quick=given.quick)
    with progress("the paper's experiment", total, lines=False) as advance:
        found = reproduce(
            n, given.seed, worlds=worlds, quick=given.quick, threads=given.threads, advance=advance
        )
    write(given.out, found, force=given.force)
    for row in found.rows:
        paper = "" if row.paper is None else f", the paper's {row.paper:.2f}"
        print(f"{row.world} {row.method}: S {row.index.value:.2f}{paper}")
    for claim in (*found.claims, *found.time_claims):
        print(f"{'holds' if claim.holds else 'FAILS'}: {claim.text} ({claim.found})")
    print(given.out / "report.html")
    return 0 if found.holds else 1


def write(folder: Path, found: Reproduction, *, force: bool) -> None:
    """Write the files, each of them whole or not at all; the report last."""
    results = as_dict(found)
    for name, png in found.pictures.items():
        write_bytes_atomic(folder / f"{name}.png", png, force=force)
    write_text_atomic(folder / "results.json", to_json(results) + "\n", force=force)
    page = render_report(results, found.pictures)
    write_text_atomic(folder / "report.html", page, force=force)


if __name__ == "__main__":
    sys.exit(main())
