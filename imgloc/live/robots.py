"""Robots that are followed over a WebSocket: a line in, a line out.

So many at a time. A robot that sends no line for long is followed no more, and the one that has
been silent for longest makes room for another.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import anyio
from starlette.websockets import WebSocket, WebSocketDisconnect

from imgloc.errors import ScanError
from imgloc.filters.follow import Moment, Tracking
from imgloc.live.bounds import Bounds
from imgloc.live.lanes import Lane, waited
from imgloc.live.line import Dropped
from imgloc.live.localizer import Localizer
from imgloc.live.openapi import TRACK
from imgloc.live.problems import Refused
from imgloc.live.requests import read_line, taken
from imgloc.live.sites import Site
from imgloc.model import LaserScan, Pose2D, to_json
from imgloc.output.rows import moment_row
from imgloc.robot.stamps import Heard


@dataclass(eq=False)
class _Session:
    map: str
    heard: float  # when its last line came, by the loop
    until: anyio.CancelScope | None = None  # while the next one is waited for


class Robots:
    """Those that a service follows.

    Parameters
    ----------
    core : Localizer
    bounds : Bounds
    lane : Lane
        Reads and writes the lines.
    count : callable
        Told of each answer: its kind, its verdict, and when its line had come.
    """

    def __init__(
        self, core: Localizer, bounds: Bounds, lane: Lane, count: Callable[[str, str, float], None]
    ) -> None:
        self._core, self._bounds, self._lane, self._count = core, bounds, lane, count
        self._there = list[_Session]()

    def __len__(self) -> int:
        return len(self._there)

    def within(self, name: str) -> int:
        """Number of those in a map."""
        return sum(one.map == name for one in self._there)

    async def follow(
        self, socket: WebSocket, values: Mapping[str, Any], name: str, find: Callable[[], Site]
    ) -> None:
        """Follow one until it goes, or its line cannot be used, which is raised.

        Its map is looked for (`find`) once it counts as followed: from then on it stays.
        """
        session, robot, seconds = self._begun(name), None, self._bounds.seconds
        try:
            site = find()
            tracking = Tracking(filter=values["filter"], seed=values["seed"])
            clock = Heard()  # the robot's own: what is ahead of this one is no error
            robot = await asyncio.to_thread(self._core.robot, name, tracking, clock=clock)
            if values["start"] is not None:
                await self._lane.run(partial(robot.start_at, values["start"]), seconds)
            offered = socket.scope.get("subprotocols", [])
            await socket.accept("imgloc" if "imgloc" in offered else None)
            origin = site.features.grid.origin if values["places"] else None
            count = 0
            async for line in self._lines(socket, session):
                begin, where = time.perf_counter(), f"line {count + 1}"
                if line is None:
                    raise ScanError(f"{where}: got bytes, expected a text: JSON")
                if not line.strip():
                    continue
                scan, odom = await self._lane.run(partial(_read, line, where, values), seconds)
                clock.hear(scan.stamp)
                future = asyncio.wrap_future(robot.update_soon(scan, odom))
                try:
                    moment = replace((await waited(future, seconds)).value, index=count)
                except Dropped as dropped:
                    if dropped.why not in ("old", "ahead"):
                        raise
                    row = to_json({"index": count, "verdict": "dropped", "why": dropped.why})
                else:
                    row = await self._lane.run(partial(_row, moment, origin), seconds)
                    self._count("track", moment.belief.verdict, begin)
                try:
                    with anyio.fail_after(self._bounds.patience):
                        await socket.send_text(row)
                except TimeoutError:
                    raise Refused("too-slow", f"{where}: its answer is not read") from None
                count += 1
        except WebSocketDisconnect:
            pass
        finally:
            if session in self._there:
                self._there.remove(session)
            if robot is not None:
                robot.end()

    def _begun(self, name: str) -> _Session:
        """A place for one more."""
        now = asyncio.get_running_loop().time()
        if len(self) >= self._bounds.sockets:
            late = now - self._bounds.patience
            silent = [(one.heard, one.until, one) for one in self._there if one.until is not None]
            heard, until, oldest = min(silent, default=(now, None, None), key=lambda one: one[0])
            if until is None or oldest is None or heard > late:
                raise Refused("busy", f"{len(self)} robots are followed", retry=5)
            self._there.remove(oldest)
            until.deadline = now
        self._there.append(session := _Session(name, now))
        return session

    async def _lines(self, socket: WebSocket, session: _Session) -> AsyncIterator[str | None]:
        """The lines of a robot as they come, None for what is no text, until it goes."""
        loop = asyncio.get_running_loop()
        while True:
            try:
                with anyio.fail_after(getattr(self._bounds, TRACK.time)) as session.until:
                    message = await socket.receive()
            except TimeoutError:
                quiet = f"no line for {loop.time() - session.heard:.0f} s"
                raise Refused("too-slow", f"{quiet}: the robot is followed no more") from None
            session.until, session.heard = None, loop.time()
            if message["type"] != "websocket.receive":
                return
            yield message.get("text")


def _row(moment: Moment, origin: Pose2D | None) -> str:
    return to_json(moment_row(moment, origin))


def _read(line: str, where: str, how: Mapping[str, Any]) -> tuple[LaserScan, Any]:
    """A line of a log, as a robot sends it: its scan, and its odometry (3,), if any."""
    one = read_line(line, where)
    return taken(one[0], how), None if one.odom is None else one.odom[0]
