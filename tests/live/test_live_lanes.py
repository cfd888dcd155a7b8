"""Lanes: places are shared among clients, and what nobody waits for any more is stopped."""

import asyncio
import threading
import time
from collections.abc import Iterable

import numpy as np
import pytest

from imgloc import METHODS, LaserScan, MapFeatures, OccupancyGrid, Options, likelihood
from imgloc.live.held import Held
from imgloc.live.lanes import Lane, Piece
from imgloc.live.problems import Refused
from imgloc.threads import Unwanted, over_slices

WALLS = np.pad(np.zeros((900, 900), bool), 3, constant_values=True)
FEATURES = MapFeatures(OccupancyGrid(WALLS, ~WALLS, 0.05))
SCAN = LaserScan(np.linspace(1, 8, 181), np.linspace(-1.5, 1.5, 181), range_max=30.0)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("method", METHODS)
def test_the_likelihood_of_each_method_is_stopped_where_it_runs(method: str, threads: int) -> None:
    begun, ends = threading.Event(), list[object]()

    def work() -> None:
        begun.set()
        likelihood(FEATURES, SCAN, Options(method, memory_budget=8 << 30, threads=threads))
        ends.append("done")

    piece = Piece(work)

    def run() -> None:
        try:
            ends.append(piece())
        except Unwanted as end:
            ends.append(type(end))

    thread = threading.Thread(target=run)
    thread.start()
    begun.wait()
    piece.stop()
    thread.join()
    assert ends == [Unwanted]


def test_where_one_thread_fails_the_others_end_at_their_next_step() -> None:
    seen = list[int]()

    def work(share: Iterable[int]) -> None:
        for unit in share:
            seen.append(unit)
            time.sleep(0.01 * bool(100 // unit))

    with pytest.raises(ZeroDivisionError):
        over_slices(work, range(2_000), 2)
    assert len(seen) < 900


def test_work_that_is_stopped_before_it_begins_does_not_begin() -> None:
    piece = Piece(pytest.fail)
    piece.stop()
    with pytest.raises(Unwanted):
        piece()


def test_a_client_that_fills_a_lane_gives_places_to_others() -> None:
    async def run() -> None:
        lane, gate = Lane(3, 1), threading.Event()

        def ask(client: str) -> "asyncio.Task[str]":
            def work() -> str:
                gate.wait()
                return client

            return asyncio.ensure_future(lane.run(work, 60, client=client))

        first = [ask("a") for _ in range(4)]
        await asyncio.sleep(0.01)
        with pytest.raises(Refused, match="come back in a second"):
            await ask("a")
        second = [ask("b") for _ in range(2)]
        with pytest.raises(Refused):  # each has two by now
            await ask("b")
        third = ask("c")
        await asyncio.sleep(0.01)
        gate.set()
        found = await asyncio.gather(*first, *second, third, return_exceptions=True)
        words = [one if isinstance(one, str) else type(one).__name__ for one in found]
        assert words == ["a", "Refused", "Refused", "Refused", "b", "b", "c"]
        await asyncio.sleep(0.01)
        assert lane.pending == 0

    asyncio.run(run())


def test_uploads_push_out_those_of_their_own_client() -> None:
    held, gone = Held[str](4), list[str]()
    mine = held.put("mine", client="a")[0]
    for k in range(100):
        gone += held.put(f"{k}", client="b")[1]
    assert held.get(mine) == "mine"
    assert len(held) == 4
    assert len(gone) == 97
