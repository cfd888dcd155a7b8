"""Work off the event loop: so much at once, so much that waits, and the rest is refused."""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from imgloc.live.guard import Gone, Receive, ending
from imgloc.live.problems import Refused

T = TypeVar("T")


class Lane:
    """A bounded queue in front of some work.

    Parameters
    ----------
    waiting : int
        How many may be under way, running or waiting; more are refused with a time to come back.
    threads : int
        Of the lane's own executor; 0: the work that comes is a future already.
    """

    def __init__(self, waiting: int, threads: int = 0) -> None:
        self._most, self.pending = waiting + max(threads, 1), 0
        self._pool = ThreadPoolExecutor(threads, "imgloc") if threads else None
        self._stopped, self._waited = False, set[asyncio.Future[Any]]()

    async def run(
        self,
        work: Callable[[], Any],
        seconds: float,
        receive: Receive | None = None,
        unwanted: threading.Event | None = None,
    ) -> Any:
        """What the work returns, here a function or what starts it and gives its future.

        Parameters
        ----------
        work : callable
            Called in a thread of the lane; in one without threads here, for a future.
        seconds : float
            After which it is refused as out of time. What runs by then runs to its end, and keeps
            its place until then.
        receive : callable, optional
            Of the request: if its client goes, what still waits is taken back.
        unwanted : Event, optional
            Set once nobody waits for the result any more.
        """
        if self._stopped:
            raise ending()
        if self.pending >= self._most:
            found = f"{self.pending} requests are under way"
            raise Refused("busy", f"{found}; come back in a second", retry=1)
        future: Future[Any] = self._pool.submit(work) if self._pool else work()
        self.pending += 1
        loop = asyncio.get_running_loop()

        def done(_: Any) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(self._leave)

        future.add_done_callback(done)
        here = asyncio.wrap_future(future)
        self._waited.add(here)
        try:
            return await waited(here, seconds, receive)
        finally:
            self._waited.discard(here)
            if unwanted is not None:
                unwanted.set()

    def _leave(self) -> None:
        self.pending -= 1

    def give_up(self) -> None:
        """Refuse also what runs."""
        for one in tuple(self._waited):
            one.cancel()

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
