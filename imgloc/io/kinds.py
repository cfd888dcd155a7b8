"""The contents of a file before it is read: kinds of lines, or topics with their types."""

import re
from collections import Counter
from dataclasses import dataclass

from imgloc.io.bags import LASER, topics_of
from imgloc.io.files import PathLike
from imgloc.io.scans import format_of, lasers_of_table
from imgloc.io.text import read_text
from imgloc.io.textscans import topics_in

_SHOWN = 40  # characters of a word
_MANY = 200  # kinds of lines in a log
_ECHOED, _FRAME = "echo of a topic", re.compile(r"^ +frame_id: *['\"]?([^'\"\s]+)", re.MULTILINE)


@dataclass(frozen=True)
class Kind:
    """Lines that begin with a word, or messages of a topic."""

    name: str
    count: int
    type: str = ""  #: of a topic's messages


def kinds_of(path: PathLike) -> tuple[str, list[Kind]]:
    """The format of a file of scans, and what kinds of lines or topics are in it.

    ScanError if it cannot be read.
    """
    form = format_of(path)
    if form == "bag":
        return form, [Kind(topic, count, kind) for topic, kind, count in topics_of(path)]
    if form == "JSON":
        return form, [Kind(t, n, kind) for (t, kind), n in sorted(topics_in(path).items())]
    if form == "CSV":
        return form, [Kind(laser, n, LASER) for laser, n in lasers_of_table(path).items()]
    if form == _ECHOED:
        frames = Counter(_FRAME.findall(read_text(path, errors="replace")))
        return form, [Kind(frame, n, LASER) for frame, n in frames.items()]
    if form == "CARMEN log":
        lines = read_text(path, errors="replace").split("\n")
        words = Counter(w[0][:_SHOWN] for line in lines if (w := line.split(None, 1)))
        return form, [Kind(word, n) for word, n in words.most_common(_MANY)]
    return form, []


def lasers_in(form: str, kinds: list[Kind]) -> list[Kind]:
    """Those kinds that are lasers, most messages first.

    Examples
    --------
    >>> [kind.name for kind in lasers_in("CARMEN log", [Kind("ODOM", 9), Kind("FLASER", 8)])]
    ['FLASER']
    """
    words = ("FLASER", "RLASER") if form == "CARMEN log" else ()
    found = [k for k in kinds if k.count and (k.type == LASER or k.name in words)]
    return sorted(found, key=lambda kind: (-kind.count, kind.name))
