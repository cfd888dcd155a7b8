"""Loops in threads, which end between two steps where nobody waits for their result any more."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from threading import Event
from typing import TypeVar

Unit = TypeVar("Unit")

#: Whether somebody waits for the work of this context; who runs it sets this.
wanted: ContextVar[Callable[[], bool]] = ContextVar("wanted", default=lambda: True)


class Unwanted(BaseException):
    """Nobody waits for a piece of work any more: raised where it runs, between two steps of it."""


def while_wanted(units: Iterable[Unit]) -> Iterator[Unit]:
    """Yield each of `units`, and raise :class:`Unwanted` once nobody waits for the work.

    Examples
    --------
    >>> list(while_wanted([1, 2]))
    [1, 2]
    """
    asked = wanted.get()
    for unit in units:
        if not asked():
            raise Unwanted
        yield unit


def over_slices(
    work: Callable[[Iterable[Unit]], object], units: Sequence[Unit], threads: int
) -> None:
    """Call ``work(share)`` for disjoint shares of `units`, one share per thread.

    With one share per thread, and not one task per unit, `work` allocates its scratch only once.

    Examples
    --------
    >>> done = []
    >>> over_slices(done.extend, [0, 1, 2], threads=2)
    >>> sorted(done)
    [0, 1, 2]
    """
    threads = min(threads, len(units))
    if threads <= 1:
        work(while_wanted(units))
        return
    asked, ended, context = wanted.get(), Event(), copy_context()
    context.run(wanted.set, lambda: asked() and not ended.is_set())
    pool = ThreadPoolExecutor(threads)
    shares = [while_wanted(units[i::threads]) for i in range(threads)]
    try:
        for future in [pool.submit(context.copy().run, work, share) for share in shares]:
            future.result()
    finally:  # where one fails, or somebody stops it, the others end at their next step
        ended.set()
        pool.shutdown()
