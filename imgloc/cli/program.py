"""Options of the program, which many commands take: they are declared here, once.

Any line of the program loads this file, so it has no time for what declares the search.
"""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, TypedDict

from imgloc.ranges import Bytes, Count, Option, option
from imgloc.texts import byte_count

Force = Annotated[bool, Option("Overwrite output files that exist.")]
AsJson = Annotated[bool, Option("Print JSON instead of text: one object a line.", "--json")]


class Written(TypedDict, total=False):
    """The way in which results are written."""

    as_json: AsJson
    force: Force


def count_threads(wanted: int | None = None) -> int:
    """Return `wanted`, or the number of processors that this process may use."""
    if wanted is None and hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return wanted or os.cpu_count() or 1


def fixed_budget(memory_budget: int | None = None) -> int:
    """Bytes that a command may take to its end: by default half of what is there at its start."""
    from imgloc.features.budget import default_budget

    return default_budget() if memory_budget is None else memory_budget


MemoryBudget = Annotated[
    Bytes,
    Option(
        "Memory that may be taken, such as 512M or 2G; what needs more is refused. [default: "
        "half of what is available]",
        parse=byte_count,
    ),
]


@dataclass(frozen=True)
class Resources:
    """The share of the machine that a command may take: threads, and bytes of memory."""

    threads: Count = option(
        ...,
        "Threads; no result depends on their number. [default: all processors]",
        factory=count_threads,
    )
    memory_budget: MemoryBudget = field(default_factory=fixed_budget)

    def __post_init__(self) -> None:
        import cv2

        cv2.setNumThreads(min(self.threads, count_threads()))


@dataclass(frozen=True)
class Kept:
    """Where prepared maps are kept."""

    cache: Path | None = option(
        None, "Folder that keeps prepared maps. [default: the user's cache folder]", metavar="DIR"
    )
    no_cache: bool = option(False, "Prepare maps anew, and keep nothing of them.")
