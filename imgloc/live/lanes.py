"""Work off the event loop: so much at once, so much that waits, and the rest is refused."""

import asyncio
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

from starlette.types import Receive

from imgloc.live.guard import Gone, ending
from imgloc.live.problems import Refused
from imgloc.threads import Unwanted, wanted

T = TypeVar("T")


class Piece:
    """Work that ends between two of its steps once nobody waits for it, in whatever thread."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self._work, self._wanted = work, True

    def __call__(self) -> Any:
        """Do it; :class:`~imgloc.threads.Unwanted` if it is stopped."""
        if not self._wanted:
            raise Unwanted
        before = wanted.set(lambda: self._wanted)
        try:
            return self._work()
        finally:
            wanted.reset(before)

    def stop(self) -> None:
        """Let it end at its next step, or where it begins."""
        self._wanted = False


@dataclass
class _Place:
    client: str
    here: asyncio.Future[Any]
    pushed: bool = False  # out of the lane, by a client that has fewer places


class Lane:
    """A bounded queue in front of some work, of which no client has all places.

    So many pieces may be `waiting` besides those that run in its `threads`; with none, the work
    that comes is a future already. Beyond it the client with most places gives one that waits to a
    client with fewer; others are refused. A lane that `stops` stops what nobody waits for between
    two of its steps, others before it runs.
    """

    def __init__(self, waiting: int, threads: int = 0, *, stops: bool = False) -> None:
        self._most, self._stops = waiting + max(threads, 1), stops
        self._pool = ThreadPoolExecutor(threads, "imgloc") if threads else None
        self._places, self._stopped = dict[Future[Any], _Place](), False

    @property
    def pending(self) -> int:
        """Number of pieces that run or wait."""
        return len(self._places)

    async def run(
        self, work: Callable[[], Any], seconds: float, receive: Receive | None = None,
        client: str = "",
    ) -> Any:  # fmt: skip
        """Result of the work: called in a thread of the lane, or without one here, for a future.

        It is refused after so many `seconds`, and taken back if the client of `receive` goes.
        """
        if self._stopped:
            raise ending()
        self._make_place(client)
        piece = Piece(work)
        future: Future[Any] = self._pool.submit(piece) if self._pool else work()
        here, loop = asyncio.wrap_future(future), asyncio.get_running_loop()
        place = self._places[future] = _Place(client, here)

        def done(_: Any) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(self._places.pop, future, None)

        future.add_done_callback(done)
        try:
            return await waited(here, seconds, receive)
        except Refused:
            if place.pushed:
                raise self._busy() from None
            raise
        finally:
            if self._stops:
                piece.stop()

    def _busy(self) -> Refused:
        return Refused("busy", f"{self.pending} requests under way; come back in a second", retry=1)

    def _make_place(self, client: str) -> None:
        """Refuse a client if the lane is full and no other has more places."""
        if self.pending < self._most:
            return
        counts = Counter(place.client for place in self._places.values())
        (most, count), *_ = counts.most_common(1)
        for future, place in reversed(list(self._places.items())):
            if place.client == most and count > counts[client] + 1 and future.cancel():
                place.pushed = True
                self._places.pop(future, None)
                return
        raise self._busy()

    def give_up(self) -> None:
        """Refuse also what runs."""
        for place in tuple(self._places.values()):
            place.here.cancel()

    def stop(self) -> None:
        """Refuse what comes, and what waits."""
        self._stopped = True
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)


async def waited(here: "asyncio.Future[T]", seconds: float, receive: Receive | None = None) -> T:
    """The result of a future, unless time runs out or the client goes."""
    gone = None if receive is None else asyncio.ensure_future(_until_gone(receive))
    try:
        both: set[asyncio.Future[Any]] = {here} if gone is None else {here, gone}
        await asyncio.wait(both, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
        if here.done():
            if here.cancelled():
                raise ending()
            return here.result()
        if gone is not None and gone.done():
            raise Gone
        raise Refused("out-of-time", f"no answer within {seconds:g} s; ask for less at once")
    finally:
        here.cancel()
        if gone is not None:
            gone.cancel()


async def _until_gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
