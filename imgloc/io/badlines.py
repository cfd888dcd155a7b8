"""Lines or messages of a file that are broken: left out, counted and named, or too many."""

import contextlib
import logging
import re
import threading
from collections.abc import Iterator

from imgloc.errors import ScanError
from imgloc.options import MAX_BAD

_LOG = logging.getLogger("imgloc")
_SHOWN = 3  # lines that a note names


@contextlib.contextmanager
def warned(*, also_printed: bool = False) -> Iterator[dict[str, str]]:
    """Collect the warnings of this thread: each text once, with the code of its finding.

    Examples
    --------
    >>> with warned() as texts:
    ...     BadLines("a.jsonl").skip(ScanError("no JSON"), "a.jsonl: line 9")
    >>> texts
    {'a.jsonl: line 9: the last line was cut off and is left out': 'cut'}
    """
    texts, thread = dict[str, str](), threading.get_ident()

    def heard(record: logging.LogRecord) -> bool:
        if record.levelno < logging.WARNING or record.thread != thread:
            return True
        texts.setdefault(record.getMessage(), getattr(record, "code", "reader"))
        return also_printed

    _LOG.addFilter(heard)
    try:
        yield texts
    finally:
        _LOG.removeFilter(heard)


@contextlib.contextmanager
def held(name: str = "", shown: str = "") -> Iterator[None]:
    """Hold back what is logged in a block until its end, where standard error is none in it.

    A file of this name has another one there.

    Examples
    --------
    >>> with warned() as texts, held():
    ...     BadLines("a.jsonl").skip(ScanError("no JSON"), "a.jsonl: line 9")
    ...     texts
    {}
    >>> len(texts)
    1
    """
    records = list[logging.LogRecord]()

    def hold(record: logging.LogRecord) -> bool:
        records.append(record)
        return False

    _LOG.filters.insert(0, hold)
    try:
        yield
    finally:
        _LOG.removeFilter(hold)
        for record in records:
            record.msg, record.args = record.getMessage().replace(name, shown), ()
            _LOG.handle(record)


class BadLines:
    """Lines that a reader leaves out because they are broken.

    Parameters
    ----------
    name : str
        Name of the file, for messages.
    most : float
        Share of the lines, 0 to 1, that may be broken.
    what : str
        What its parts are called.

    Examples
    --------
    >>> bad = BadLines("a.log", 0.5)
    >>> bad.skip(ScanError("a.log: line 3: FLASER: 12 words, expected 190"))
    >>> bad.check(1)
    >>> bad.skip(ScanError("a.log: line 4: FLASER: 13 words, expected 190"))
    >>> bad.check(1)
    Traceback (most recent call last):
        ...
    imgloc.errors.ScanError: a.log: line 3: FLASER: 12 words, expected 190 (2 of 3 are broken; \
`max_bad=0.67` leaves them out)
    """

    def __init__(self, name: str, most: float = MAX_BAD, what: str = "lines") -> None:
        self.name, self.most, self.what, self.count = name, most, what, 0
        self._first: list[ScanError] = []

    def skip(self, error: ScanError, cut: str = "") -> None:
        """Leave out the line that this error is about; `cut` is where the last one ends too early.

        That one does not count.
        """
        if cut:
            text = f"the last {self.what.removesuffix('s')} was cut off and is left out"
            _LOG.warning("%s: %s", cut, text, extra={"code": "cut"})
            return
        self.count += 1
        if len(self._first) < _SHOWN:
            self._first.append(error)

    def check(self, good: int) -> None:
        """Say which lines were left out of a file of `good` ones, or raise the error of the first.

        That is raised if more of the lines are broken than may be.
        """
        if not self.count:
            return
        total = self.count + good
        if self.count > self.most * total:
            hint = ""
            if self.count <= 3 * good:  # else the file is another one, and little would be left
                share = min(1.0, 0.01 * -(-100 * self.count // total))
                are = "is" if self.count == 1 else "are"
                hint = f" ({self.count:,} of {total:,} {are} broken; "
                hint += f"`max_bad={share:g}` leaves {'it' if self.count == 1 else 'them'} out)"
            raise ScanError(f"{self._first[0]}{hint}") from None
        texts = [re.sub(rf"^{re.escape(self.name)}: ", "", str(error)) for error in self._first]
        more = self.count - len(texts)
        _LOG.warning(
            "%s: left out %d of %d %s, which are broken: %s%s",
            self.name, self.count, total, self.what, "; ".join(texts),
            f"; and {more:,} more" if more else "",
            extra={"code": "broken"},
        )  # fmt: skip
