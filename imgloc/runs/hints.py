"""Hints after a batch: of scans that fit no map a few are looked at again.

A file of scans that fits one of its maps is as it should be, though it fits none of the others.
"""

import contextlib
import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

from imgloc.answers.causes import Cause
from imgloc.answers.diagnose import Said, is_doubtful, tilted
from imgloc.model import Evidence, Floor
from imgloc.options import FUSED
from imgloc.runs.jobs import Item, Job, hash_of
from imgloc.runs.localize import Localize
from imgloc.runs.opening import Means
from imgloc.runs.results import Id, Row, id_of

_TRIED = 12  # items at most
_NAMED = 2  # of those that a hint is about


@dataclass
class Doubtful:
    """The items of a batch that most likely have something wrong, among the rows noted."""

    _said: dict[Id, Said] = field(default_factory=dict)
    _fits: set[str] = field(default_factory=set)  # files of which most scans are unique somewhere
    _single: set[str] = field(default_factory=set)  # files of one scan
    # For each map: scans of such files with a shared error, less the scans without one.
    _bent: Counter[str] = field(default_factory=Counter)

    def noting(self, rows: Iterable[Row]) -> Iterator[Row]:
        """The rows, each noted on its way."""
        for row in rows:
            answers = row["answers"]
            if answers and "hypotheses" in answers[0] and row["scans"] is not None:
                self._note(id_of(row), answers)
            yield row

    def _note(self, item: Id, answers: Sequence[Row]) -> None:
        said = [(answer["verdict"], evidence_of(answer["evidence"])) for answer in answers]
        if len(said) == 1:
            self._single.add(str(item[1]))
        if _unique(said):
            bent = sum(e.scale != 1.0 or e.thinner > 0 for _, e in said)
            self._fits.add(str(item[1]))
            self._bent[item[0]] += 2 * bent - len(said)
            if 2 * bent > len(said):
                self._said[item] = said
        elif 2 * sum(is_doubtful(*one) for one in said) > len(said):
            self._said[item] = said
        if tilted(said):
            self._said[item] = said

    def of(self, items: Iterable[Item]) -> list[tuple[Item, Said]]:
        """A few of the items that are doubtful, in an order that mixes files and maps."""
        # One scan that fits nowhere is nothing unusual: files of one speak together.
        fine = self._fits
        if 2 * len(self._single - fine) <= len(self._single):
            fine = fine | self._single

        def doubted(item: Item) -> bool:
            if item.id in self._said and _unique(self._said[item.id]):
                return self._bent[item.map] > 0 or bool(tilted(self._said[item.id]))
            return item.id in self._said and item.scans not in fine

        there = sorted(filter(doubted, items), key=lambda item: hash_of(item.id))
        return [(item, self._said[item.id]) for item in there[:_TRIED]]


def evidence_of(row: Row) -> Evidence:
    """The evidence of a row, as far as a doubt looks at it: misfit, scale, walls and floor."""
    names = ("misfit", "scale", "thinner", "bent")
    told: dict[str, Any] = {key: row[key] for key in names if row.get(key) is not None}
    if share := row.get("floor"):
        at = (row.get(f"floor_{of}") for of in ("distance", "direction"))
        distance, direction = (math.nan if value is None else value for value in at)
        told["floor"] = Floor(distance, direction, share)
    return Evidence(**told)


def _unique(said: Said) -> bool:
    """Return whether at least half of an item's scans are."""
    return 2 * sum(verdict == "unique" for verdict, _ in said) >= len(said)


def look_again(item: Item, job: Localize, said: Said, means: Means) -> list[Cause]:
    """Diagnose an item from its verdicts, `said`, and a few of its scans."""
    found = job.open(item, means.desk())
    return found.doubts(found.taken.scans, said)


def hints_of(
    doubtful: Sequence[tuple[Item, Said]], job: Job, executor: Executor, means: Means
) -> list[dict[str, Any]]:
    """Look at items again: each hint with how many of them it is about, and the first of these.

    What helps where it was tried comes alone; only without any it is said where else to look.
    """
    if not isinstance(job, Localize) or job.options.method != FUSED:
        return []
    begun = [(item, executor.submit(look_again, item, job, said, means)) for item, said in doubtful]
    found, named = dict[tuple[str, str], Cause](), defaultdict[tuple[str, str], list[str]](list)
    for item, future in begun:
        with contextlib.suppress(Exception):  # its row is there; a hint is all that is missed
            for hint in future.result():  # of one cause the first sentence stands for all
                kind = hint.code, hint.options
                found.setdefault(kind, hint)
                named[kind].append(f"{item.scans} on {item.map}")
    sure = any(hint.found for hint in found.values())
    return [
        {"hint": found[kind].said, "items": len(names), "of": len(begun), "first": names[:_NAMED]}
        for kind, names in sorted(named.items(), key=lambda kv: (-len(kv[1]), kv[0]))
        if found[kind].found or not sure
    ]
