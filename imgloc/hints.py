"""What to look at after a batch: of scans that fit no map a few are looked at again.

A file of scans that fits one of its maps is as it should be, though it fits none of the others.
"""

import contextlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

from imgloc.doubts import Doubt
from imgloc.io.results import Id, Row, id_of
from imgloc.jobs import Item, Job, look_again
from imgloc.options import FUSED

_TRIED = 12  # items at most
_NAMED = 2  # of those that a hint is about
Said = list[tuple[str, float, float]]  # of each scan its verdict, and what it was fitted with


@dataclass
class Doubtful:
    """The items of a batch that most likely have something wrong, among the rows noted."""

    _said: dict[Id, Said] = field(default_factory=dict)
    _fits: set[str] = field(default_factory=set)  # files of which most scans are unique somewhere

    def noting(self, rows: Iterable[Row]) -> Iterator[Row]:
        """The rows, each noted on its way."""
        for row in rows:
            answers = row["answers"]
            if answers and "hypotheses" in answers[0] and row["scans"] is not None:
                self._note(id_of(row), answers)
            yield row

    def _note(self, item: Id, answers: Sequence[Row]) -> None:
        unique = sum(answer["verdict"] == "unique" for answer in answers)
        evidence = [answer["evidence"] for answer in answers]
        bent = [e.get("scale", 1.0) != 1.0 or e.get("thinner", 0.0) > 0 for e in evidence]
        if 2 * unique >= len(answers):
            self._fits.add(str(item[1]))
            if 2 * sum(bent) <= len(answers):
                return
        self._said[item] = [
            (answer["verdict"], e.get("scale", 1.0), e.get("thinner", 0.0))
            for answer, e in zip(answers, evidence, strict=True)
        ]

    def of(self, items: Iterable[Item]) -> list[tuple[Item, Said]]:
        """A few of the items that are doubtful: of many files, and each with other maps."""
        there = [item for item in items if item.id in self._said]
        unique = {item.id for item in there if _mostly_unique(self._said[item.id])}
        there = [item for item in there if item.id in unique or item.scans not in self._fits]
        files = {name: k for k, name in enumerate(sorted({str(i.scans) for i in there}))}
        maps = {name: k for k, name in enumerate(sorted({i.map for i in there}))}
        thin = max(1, -(-len(files) // _TRIED))
        there = [item for item in there if files[str(item.scans)] % thin == 0]

        def turn(item: Item) -> tuple[int, int]:
            file = files[str(item.scans)] // thin
            return (maps[item.map] - file) % len(maps), file

        return [(item, self._said[item.id]) for item in sorted(there, key=turn)[:_TRIED]]


def _mostly_unique(said: Said) -> bool:
    return 2 * sum(verdict == "unique" for verdict, _, _ in said) >= len(said)


def hints_of(
    doubtful: Sequence[tuple[Item, Said]], job: Job, executor: Executor
) -> list[dict[str, Any]]:
    """Look at items again: each hint with how many of them it is about, and the first of these.

    What helps where it was tried comes alone; only without any it is said where else to look.
    """
    if job.name != "localize" or job.options.method != FUSED:
        return []
    begun = [(item, executor.submit(look_again, item, job, said)) for item, said in doubtful]
    found = defaultdict[Doubt, list[str]](list)
    for item, future in begun:
        with contextlib.suppress(Exception):  # its row is there; a hint is all that is missed
            for hint in future.result():
                found[hint].append(f"{item.scans} on {item.map}")
    sure = any(hint.found for hint in found)
    return [
        {"hint": hint.text, "items": len(names), "of": len(begun), "first": names[:_NAMED]}
        for hint, names in sorted(found.items(), key=lambda kv: (-len(kv[1]), kv[0].text))
        if hint.found or not sure
    ]
