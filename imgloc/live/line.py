"""A line of scans in front of one worker: one of each source, and of a robot all in turn."""

import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from imgloc.errors import ImglocError

_SAID = {
    "replaced": "a newer scan of the same source came while this one waited",
    "reset": "the robot was reset, or its map replaced, after this scan came",
    "old": "its stamp lies before that of the last scan of this robot",
    "ahead": "its stamp lies ahead of the clock, and that of the scan before did not",
    "late": "the timeout passed before the answer came",
    "preparing": "the map is still being prepared",
    "closed": "the localizer is closed",
}


class Dropped(ImglocError):  # noqa: N818  (what has become of it)
    """A scan gets no answer; `why` is one word.

    It is ``replaced``, ``reset``, ``old``, ``ahead``, ``late``, ``preparing`` or ``closed``.

    Examples
    --------
    >>> Dropped("late")
    Dropped('the scan was dropped: the timeout passed before the answer came')
    """

    def __init__(self, why: str) -> None:
        super().__init__(f"the scan was dropped: {_SAID[why]}")
        self.why = why


class Key(NamedTuple):
    """A place in the line."""

    kind: Hashable  #: the question, or the robot that asks
    source: Hashable  #: one scan of each waits


@dataclass(eq=False)
class _Task:
    key: Key
    work: Callable[[float], Any]
    stamp: float
    since: float
    future: "Future[Any]"


class Line:
    """Work that is done by one thread, one piece after the other.

    Examples
    --------
    >>> line = Line()
    >>> line.put(Key("localize", None), lambda waited: waited < 60.0).result()
    True
    >>> line.close()
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting = dict[Key, _Task]()
        self.counts = Counter[Key]()  #: scans dropped so far, by their place in the line
        self._turns = dict[Key, int]()  # when each place had its last turn
        self._total = self._done = 0
        self._busy = self._closed = False
        self._thread: threading.Thread | None = None

    @property
    def waiting(self) -> int:
        """Number of scans that wait."""
        return len(self._waiting)

    @property
    def busy(self) -> bool:
        """True if the worker is at work."""
        return self._busy

    @property
    def dropped(self) -> int:
        """Number of scans dropped so far."""
        return self._total

    def put(self, key: Key, work: Callable[[float], Any], stamp: float = math.nan) -> "Future[Any]":
        """Queue work, a function of the seconds that it has waited.

        Work that waits at the same place is dropped, and the new work takes its place. Among the
        places of one kind the one whose turn is longest ago comes first, then the least `stamp`.
        """
        task, old = _Task(key, work, stamp, time.perf_counter(), Future()), None
        # The future must not hold its task: answers would wait for the collector of cycles.
        task.future.add_done_callback(partial(self._leave, key))
        with self._changed:
            if self._closed:
                raise Dropped("closed")
            old = self._waiting.get(key)
            self._waiting[key] = task
            if old is not None:
                self._count(key)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="imgloc", daemon=True)
                self._thread.start()
            self._changed.notify_all()
        _drop(old, "replaced")
        return task.future

    def clear(self, kind: Hashable) -> None:
        """Drop all work of one kind that waits."""
        with self._changed:
            gone = [self._waiting.pop(key) for key in tuple(self._waiting) if key.kind == kind]
            for task in gone:
                self._count(task.key)
        for task in gone:
            _drop(task, "reset")

    def count(self, key: Key) -> None:
        """Count a scan that was dropped while the worker was at it."""
        with self._changed:
            self._count(key)

    def forget(self, kind: Hashable) -> None:
        """Forget the counts of one kind."""
        with self._changed:
            for kept in (self.counts, self._turns):
                for key in [key for key in kept if key.kind == kind]:
                    del kept[key]

    def close(self, *, wait: bool = False) -> None:
        """Drop all work that waits and take no more; the worker finishes its piece.

        Parameters
        ----------
        wait : bool
            Return once it has.
        """
        with self._changed:
            self._closed = True
            gone = list(self._waiting.values())
            self._waiting.clear()
            self._total += len(gone)
            self._changed.notify_all()
        for task in gone:
            _drop(task, "closed")
        if wait and self._thread is not None:
            self._thread.join()

    def _count(self, key: Key) -> None:
        self._total += 1
        self.counts[key] += 1

    def _leave(self, key: Key, future: "Future[Any]") -> None:
        """Take out work that was cancelled while it waited."""
        with self._changed:
            task = self._waiting.get(key)
            if task is not None and task.future is future:
                del self._waiting[key]
                self._total += 1  # a source may be of one scan alone: nothing is kept of it

    def _next(self) -> _Task | None:
        with self._changed:
            self._busy = False
            self._changed.wait_for(lambda: self._waiting or self._closed)
            if not self._waiting:
                return None
            kind = next(iter(self._waiting)).kind
            same = [task for task in self._waiting.values() if task.key.kind == kind]
            task = min(same, key=self._turn)
            del self._waiting[task.key]
            if not math.isnan(task.stamp):  # others have one source a scan
                self._done += 1
                self._turns[task.key] = self._done
            self._busy = True
            return task

    def _turn(self, task: _Task) -> tuple[int, float]:
        return self._turns.get(task.key, 0), 0.0 if math.isnan(task.stamp) else task.stamp

    def _run(self) -> None:
        while (task := self._next()) is not None:
            future, work = task.future, task.work
            if not future.set_running_or_notify_cancel():
                continue
            try:
                found = work(time.perf_counter() - task.since)
            except BaseException as error:  # the caller's to judge
                future.set_exception(error)
            else:
                future.set_result(found)
                del found
            del task, future, work  # nothing is held while it waits


def _drop(task: _Task | None, why: str) -> None:
    if task is not None and task.future.set_running_or_notify_cancel():
        task.future.set_exception(Dropped(why))
