"""Locate every scan of a folder in every map of another: `imgloc.run_batch` in a script.

    python -m tools.localize_folder floors scans out
    python -m tools.localize_folder pairs.csv out

Each item, a map with a file of scans, gets a row in ``out/results.jsonl``, and each scan a line
here as it is done. Run it again to go on where it stopped.
"""

import argparse
from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Any

from imgloc import ALL_METHODS, ImglocError, Job, Options, run_batch
from imgloc.options import FUSED
from imgloc.output.drawings import DRAWINGS
from imgloc.runs.batch import TIMEOUT


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; return the exit code: 0, or 5 if an item has no answer, or that of an error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("maps", type=Path, help="a map, a folder tree of them, a CSV of pairs")
    parser.add_argument("scans", type=Path, nargs="?", help="a file of scans, a folder tree")
    parser.add_argument("out", type=Path, help="folder of the results")
    parser.add_argument("--method", choices=ALL_METHODS, default=FUSED)
    parser.add_argument("--workers", type=int, help="processes; default: all processors")
    parser.add_argument("--timeout", type=float, default=TIMEOUT, help="seconds for an item")
    parser.add_argument("--pictures", action="store_true", help="draw what is doubtful")
    given = parser.parse_args(arguments)
    job = Job(
        "localize",
        Options(method=given.method),
        pictures="doubtful" if given.pictures else "none",
        drawings=DRAWINGS,
    )
    try:
        summary = run_batch(
            given.maps,
            given.scans,
            given.out,
            job,
            workers=given.workers,
            timeout=given.timeout,
            resume=True,
            on_row=tell,
        )
    except ImglocError as error:
        parser.exit(error.exit_code, f"{error}\n")
    print(f"{summary.items} items, {summary.failed} without an answer: {given.out}/results.jsonl")
    return 5 if summary.failed else 0


def tell(row: dict[str, Any]) -> None:
    """Print a line for each scan of a row."""
    where = f"{row['map']} {row['scans']}"
    if row["status"] != "ok":
        print(f"{where}: {row['status']}: {row['message']}")
    for answer in row["answers"]:
        said = f"{where} {answer['index']}: {answer['verdict']}"
        if (pose := answer["pose"]) is not None:
            said += f" {pose['x']:.3f} {pose['y']:.3f} {degrees(pose['theta']):.2f} deg"
        print(said)


if __name__ == "__main__":
    raise SystemExit(main())
