"""The HTTP service: what each request asks of the core, and what is answered.

Nothing is computed on the event loop, neither is what was sent read there: each row of the table of
routes (:data:`imgloc.live.openapi.OPERATIONS`) has a lane, which holds so many requests and refuses
the rest with a time to come back.
"""

import asyncio
import contextlib
import hashlib
import json
import logging
import mimetypes
import time
import traceback
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import anyio
import numpy as np
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, Router, WebSocketRoute
from starlette.staticfiles import NotModifiedResponse, StaticFiles
from starlette.types import Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketState

from imgloc.answers.causes import Given
from imgloc.answers.diagnose import doubts, is_doubtful
from imgloc.answers.fit import fit_at
from imgloc.doors import behind
from imgloc.errors import ConfigError
from imgloc.features.budget import check_budget
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.calibration import map_hash
from imgloc.io.maps import DRAWN, SWAPPED, looks_drawn, looks_swapped
from imgloc.io.scans import write_npz
from imgloc.io.scanset import ScanSet
from imgloc.likelihoods.stacks import likelihood
from imgloc.live import layers, openapi
from imgloc.live.bounds import Bounds
from imgloc.live.connections import FULL
from imgloc.live.guard import HEADERS, Access, Bodies, Gone, ending, read_body
from imgloc.live.held import Held
from imgloc.live.lanes import Lane
from imgloc.live.localizer import Localizer
from imgloc.live.metrics import Metrics
from imgloc.live.openapi import KNOWN, OPERATIONS, Operation
from imgloc.live.parameters import read_query
from imgloc.live.problems import Refused, problem_of
from imgloc.live.requests import Sent, map_of, marked_of, scans_of, taken
from imgloc.live.robots import Robots
from imgloc.live.sites import Site
from imgloc.model import FloatArray, LaserScan, Likelihood, plain, to_json
from imgloc.options import FUSED, Chosen, Hint, Known, Prior, Shared
from imgloc.output.rows import answer_row, scan_row
from imgloc.pipeline import localize, prepare
from imgloc.search.asked import answer_bytes
from imgloc.search.priors import prior_of

LOG = logging.getLogger("imgloc")
_LINES = "application/x-ndjson"
_DRAIN = 1.0  # seconds in which what a client still sends of a refused body is thrown away
_LOOKS = 4  # threads for what is small
_SMALL = 1 << 16  # bytes of JSON up to which a body is small
_EACH = 100  # numbers whose memory a scan takes besides its own
_OPEN = {one.path for one in OPERATIONS if one.who == openapi.ALL}
_PAGE = Path(__file__).with_name("page")
_PROBES = {one.path for one in OPERATIONS if one.lane == openapi.PROBES}
Values = Mapping[str, Any]


@dataclass(frozen=True)
class ScansHeld:
    """A file of scans that was sent, and how it is called."""

    name: str
    scans: ScanSet
    warnings: tuple[str, ...] = ()  #: of its reader
    #: how it was read: options of the command that has opened it, each with Python's argument
    options: tuple[tuple[str, str], ...] = ()
    indices: tuple[int, ...] | None = None  #: of these scans in the file, if they are not all
    #: how its scans were taken, by parameters of requests: the page begins with it
    taken: Mapping[str, Any] = field(default_factory=dict)

    def about(self, id_: str) -> dict[str, Any]:
        """Its contents, in short."""
        s = self.scans
        readings = max(len(scan.ranges) for scan in s.scans)
        known = {"poses": s.poses, "odom": s.odom, "stamps": s.stamps}
        return (
            {"id": id_, "name": self.name, "scans": len(s), "readings": readings}
            | {key: value is not None for key, value in known.items()}
            | {key: getattr(self, key) for key in ("warnings", "options", "indices", "taken")}
        )


OPENED = "0" * 32  #: id of the scans that a service is given to begin with


@dataclass(frozen=True)
class Begun:
    """Maps and scans that a service has from the beginning."""

    #: paths of the maps, by name, as the command line has them
    paths: Mapping[str, str] = field(default_factory=dict)
    opened: ScansHeld | None = None  #: scans that the page shows first
    #: by which the maps are read, by name, as those of scans
    options: Mapping[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Ask:
    """A request that fits the table: what it asks for, and where that is computed."""

    request: Request
    values: Values
    route: Operation
    lanes: Mapping[str, Lane]
    bounds: Bounds

    async def run(self, work: Callable[[], Any], lane: str = "") -> Any:
        """Run some work, by default in the lane of the route, and return its result."""
        there, seconds = self.lanes[lane or self.route.lane], getattr(self.bounds, self.route.time)
        return await there.run(work, seconds, self.request.receive, self.client)

    @property
    def client(self) -> str:
        """Who asks: its address."""
        return (self.request.scope.get("client") or ("",))[0]

    @property
    def id(self) -> str:
        """The id or name in the path."""
        return str(next(iter(self.request.path_params.values())))

    @property
    def last(self) -> str:
        """The last word of the path."""
        return self.route.path.rpartition("/")[2]


Endpoint = Callable[[Ask], Awaitable[Response]]


class Service:
    """An ASGI application around a core and its maps; clients may send more, each for itself."""

    def __init__(
        self, core: Localizer, access: Access | None = None, bounds: Bounds | None = None,
        given: Begun | None = None,
    ) -> None:  # fmt: skip
        self.core, self.access = core, access or Access()
        self.bounds, self.given = bounds or Bounds(), given or Begun()
        self.metrics = Metrics()
        self.page = {"/", *(f"/{file.name}" for file in _PAGE.iterdir())}
        self.stopping = asyncio.Event()
        threads = {"files": 1, "answers": 0, "looks": _LOOKS, "layers": 1}
        self.lanes = {name: Lane(self.bounds.waiting, count, stops=name == "layers")
                      for name, count in threads.items()}  # fmt: skip
        self.robots = Robots(core, self.bounds, self.lanes["looks"], self._count)
        budget = core.options.memory_budget or 1 << 30
        self._part = budget // 4  # of the memory: for maps that are held twice as much
        self.bodies = Bodies(max(self._part, self.bounds.max_body))
        self._maps: Held[str] = Held(self.bounds.held, 2 * self._part, "map", self.robots.within)
        self._scans: Held[ScansHeld] = Held(self.bounds.held, 2 * self.bounds.numbers, "scans")
        self._own = core.names  # those that the service begins with
        self._stack: tuple[object, Likelihood] | None = None
        self._about = WeakKeyDictionary[MapFeatures, dict[str, Any]]()
        self._router = Router(self._routes())

    # ---- ASGI -----------------------------------------------------------------------------------

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or follow one robot."""
        scope["app"] = self  # else Starlette answers what is not there itself, in plain text
        if scope["type"] == "lifespan":
            await self._router(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._socket(scope, receive, send)
        else:
            await self._http(scope, receive, send)

    async def _enter(self, scope: Scope, receive: Receive, send: Send) -> None:
        path = scope["path"]
        self.access.check(scope, guarded=path not in self.page and path not in _OPEN)
        if path not in _PROBES:
            if scope.get("state", {}).get(FULL):
                raise Refused("busy", "too many connections", retry=1)
            if self.stopping.is_set():
                raise ending()
        await self._router(scope, receive, send)

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        ended = False

        async def receive_(message: Message | None = None) -> Message:
            nonlocal ended
            message = await receive()
            ended = ended or not message.get("more_body", False)
            return message

        async def send_(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for key, value in HEADERS.items():
                    headers.setdefault(key, value)
                self.metrics.requests.labels(str(message["status"])).inc()
            await send(message)

        try:
            await self._enter(scope, receive_, send_)
        except Gone:
            return
        except Exception as error:
            problem = self._problem(_refused(error))
            await self._refuse(problem, scope, receive_, send_, lambda: ended)
        finally:
            self.bodies.held -= scope.get("body", 0)

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Follow a robot, or refuse to before the handshake."""
        try:
            await self._enter(scope, receive, send)
        except Exception as error:
            problem = self._problem(_refused(error))
            await receive()
            self.metrics.requests.labels(str(problem.status_code)).inc()
            await problem(scope, receive, send)

    def _problem(self, error: Exception) -> Response:
        kind, problem = problem_of(error)
        self.metrics.refused.labels(kind).inc()
        if problem.status_code == 500:
            frame = traceback.extract_tb(error.__traceback__)[-1]
            at = f"{Path(frame.filename).name}:{frame.lineno}"
            LOG.error("internal error at %s: %s: %s", at, type(error).__name__, error)
        return problem

    async def _refuse(
        self, problem: Response, scope: Scope, receive: Receive, send: Send,
        ended: Callable[[], bool],
    ) -> None:  # fmt: skip
        """Send a problem; a client that is still sending gets to read it before the end."""
        headers, names = problem.raw_headers, {name for name, _ in scope["headers"]}
        sends = not ended() and bool({b"content-length", b"transfer-encoding"} & names)
        if sends or scope.get("state", {}).get(FULL):
            headers.append((b"connection", b"close"))
        start = {"type": "http.response.start", "status": problem.status_code, "headers": headers}
        await send(start)
        head_only = scope["method"] == "HEAD"
        out = {"type": "http.response.body", "body": b"" if head_only else problem.body}
        if not sends or b"expect" in names:
            await send(out)
            return
        await send({**out, "more_body": True})
        with contextlib.suppress(TimeoutError):
            with anyio.fail_after(_DRAIN):
                while (await receive()).get("more_body", False):
                    pass
        await send({"type": "http.response.body", "body": b""})

    def stop(self) -> None:
        """Refuse what comes and what waits; what runs may end."""
        self.stopping.set()
        for name, lane in self.lanes.items():
            if name != "looks":  # writes what was found
                lane.stop()

    def give_up(self) -> None:
        """Refuse also what runs."""
        for lane in self.lanes.values():
            lane.stop()
            lane.give_up()

    def _routes(self) -> list[Route | WebSocketRoute]:
        by_path: dict[str, dict[str, tuple[Operation, Endpoint]]] = {}
        for one in OPERATIONS:
            by_path.setdefault(one.path, {})[one.method] = one, getattr(self, f"_{one.run}")
        routes = [Route(path, self._endpoint(by), methods=[m.upper() for m in by])
                  for path, by in by_path.items()]  # fmt: skip
        files = _Files(directory=_PAGE, html=True, follow_symlink=True)
        routes += [Route(path, files) for path in self.page]
        return [WebSocketRoute(openapi.TRACK.path, self._track), *routes]

    def _endpoint(
        self, by_method: Mapping[str, tuple[Operation, Endpoint]]
    ) -> Callable[[Request], Awaitable[Response]]:
        """A function for Starlette: it checks the query, and calls what a method does with it."""

        async def run(request: Request) -> Response:
            method = "get" if request.method == "HEAD" else request.method.lower()
            route, does = by_method[method]
            values = read_query(request.scope["query_string"], route.parameters)
            return await does(Ask(request, values, route, self.lanes, self.bounds))

        return run

    # ---- the service itself ---------------------------------------------------------------------

    async def _health(self, _: Ask) -> Response:
        return JSONResponse({"status": "ok"})

    async def _ready(self, ask: Ask) -> Response:
        if self.stopping.is_set():
            raise ending()
        self._check_prepared()
        return await self._health(ask)

    def _check_prepared(self) -> None:
        if not all(self.core.state(name) == "ready" for name in self._names):
            raise Refused("not-ready", "maps are being prepared", retry=1)

    async def _metrics_text(self, _: Ask) -> Response:
        for name, lane in self.lanes.items():
            self.metrics.queue.labels(name).set(lane.pending)
        self.metrics.dropped.set(self.core.dropped)
        self.metrics.maps.set(len(self.core.names))
        self.metrics.sockets.set(len(self.robots))
        return Response(self.metrics.text(), media_type="text/plain; version=0.0.4")

    async def _document(self, _: Ask) -> Response:
        return JSONResponse(openapi.document(token=self.access.token is not None))

    # ---- maps -----------------------------------------------------------------------------------

    @property
    def _names(self) -> list[str]:
        """The maps that everybody sees: none that a client has sent."""
        there = self.core.names
        return [name for name in self._own if name in there]

    def _site(self, name: str | None) -> tuple[str, Site]:
        """The map that is asked for, prepared: by its name, or by the id of one that was sent."""
        names = self._names
        some = f"one of {', '.join(names)}, or the id of one that was sent"
        if name is None:
            if len(names) != 1:
                raise ConfigError(f"map: missing, expected {some if names else 'the id of one'}")
            name = names[0]
        if name not in names:
            try:
                self._maps.get(name)
                return name, self.core.site(name, timeout=0)
            except (Refused, ConfigError):  # or it has gone just now
                raise Refused("not-found", f"map: there is no {name!r}, expected {some}") from None
        if self.core.state(name) == "preparing":
            raise Refused("not-ready", f"{name}: is being prepared", retry=1)
        return name, self.core.site(name)

    def _describe(self, name: str, site: Site) -> dict[str, Any]:
        """A map in short."""
        features, label = site.features, None
        if features not in self._about:
            grid = features.grid
            height, width = grid.occupied.shape
            said = {
                "width": width, "height": height, "resolution": grid.resolution,
                "origin": grid.origin, "free_m2": float(grid.free.sum()) * grid.resolution**2,
                "version": map_hash(grid), "path": self.given.paths.get(name),
                "calibrated": bool(site.calibrations) or site.shared != Shared(),
                "warnings": [text for text, seen in ((SWAPPED, looks_swapped(grid)),
                                                     (DRAWN, looks_drawn(grid))) if seen],
            }  # fmt: skip
            self._about[features] = dict(plain(said))
        with contextlib.suppress(Refused):
            label = self._maps.get(name)
        return {"id": name, "name": label or name, "uploaded": label is not None,
                "options": self.given.options.get(name, ()), **self._about[features]}  # fmt: skip

    async def _list(self, ask: Ask) -> Response:
        names, b, opened = self._names, self.bounds, self.given.opened
        ready = [(one, self.core.site(one)) for one in names if self.core.state(one) == "ready"]
        preparing = [name for name in names if self.core.state(name) == "preparing"]
        keys = ("max_body", "pixels", "scans", "numbers", "each", "message", "seconds")
        described = await ask.run(lambda: [self._describe(*one) for one in ready])
        about = None if opened is None else opened.about(OPENED)
        return JSONResponse({"maps": described, "preparing": preparing,
                             "limits": {key.removeprefix("max_"): getattr(b, key) for key in keys},
                             "opened": about})  # fmt: skip

    async def _map(self, ask: Ask) -> Response:
        found = self._site(ask.id)
        return JSONResponse(await ask.run(lambda: self._describe(*found)))

    async def _image(self, ask: Ask) -> Response:
        site = self._site(ask.id)[1]
        return _png(await ask.run(lambda: layers.map_layer(site.features.grid)))

    async def _send_map(self, ask: Ask) -> Response:
        body, kind = await self._body(ask)
        values = ask.values

        def held() -> dict[str, Any]:
            label, grid = map_of(body, kind, values["name"] or "", self.bounds, values)
            options = self.core.options
            limits = {"memory_budget": options.memory_budget, "threads": options.threads}
            features = prepare(grid, label, ready=False, **limits)
            need, most = features.bytes_for(FUSED), 2 * self._part
            what = f"{label}: a map of {grid.info.width} x {grid.info.height} cells"
            check_budget(need + answer_bytes(features, options), most, what, "crop the map")
            id_, gone = self._maps.put(label, need, ask.client)
            for one in gone:
                self._forget(one)
            try:
                self.core.put(id_, features, background=False, compared=False)
            except BaseException:
                self._maps.get(id_, drop=True)
                raise
            return self._describe(id_, self.core.site(id_))

        described = await ask.run(held)
        return JSONResponse(described, 201, {"Location": f"/v1/maps/{described['id']}"})

    async def _drop_map(self, ask: Ask) -> Response:
        name = self._site(ask.id)[0]
        if name not in self._maps:
            raise Refused("name-taken", f"{name}: a map of the service itself cannot be removed")
        if count := self.robots.within(name):
            some = "a robot is" if count == 1 else f"{count} robots are"
            raise Refused("in-use", f"{name}: {some} followed in it; remove it when they are gone")
        self._maps.get(name, drop=True)
        self._forget(name)
        return Response(status_code=204)

    def _forget(self, name: str) -> None:
        """Hold nothing of a map any more."""
        with contextlib.suppress(ConfigError):
            self.core.drop(name)
        self._stack = None

    # ---- scans ----------------------------------------------------------------------------------

    async def _body(self, ask: Ask, limit: int | None = None) -> tuple[bytes, str]:
        """The body, and its media type."""
        request, limit = ask.request, limit or getattr(self.bounds, ask.route.limit)
        body = await read_body(request.scope, request.receive, self.bodies, self.stopping,
                               limit=limit, seconds=self.bounds.patience)  # fmt: skip
        return body, request.headers.get("content-type", "")

    async def _asked(self, ask: Ask, site: Site | None) -> tuple[list[int], Sent, Prior]:
        """Which scans are asked about, the set that they are of, and what is known of the pose."""
        body, kind = await self._body(ask)
        values = ask.values
        held = None if values["scans"] is None else self._held(values["scans"])
        if held is not None and body:
            raise ConfigError("scans: expected either it or a body, not both")

        def read() -> tuple[list[int], Sent, Prior]:
            sent = Sent(held.scans, held.warnings) if held else self._scans_in(body, kind, values)
            chosen = Chosen(values["index"]).of(len(sent.scans), "the file", self.bounds.each)
            if len(chosen) > self.bounds.each:
                most = f"expected at most {self.bounds.each:,} at once; index names some"
                raise Refused("too-large", f"more scans than one request asks about: {most}")
            return chosen, sent, Prior() if site is None else _prior(values, site)

        small = held is not None or (len(body) < _SMALL and kind.startswith("application/json"))
        found: tuple[list[int], Sent, Prior] = await ask.run(read, "looks" if small else "files")
        return found

    def _scans_in(self, body: bytes, kind: str, values: Values) -> Sent:
        return scans_of(
            body, kind, values["name"] or "", self.bounds,
            topic=values["topic"], fov=values["fov_deg"], budget=self._part,
        )  # fmt: skip

    def _held(self, id_: str) -> ScansHeld:
        opened = self.given.opened
        return opened if opened is not None and id_ == OPENED else self._scans.get(id_)

    async def _send_scans(self, ask: Ask) -> Response:
        body, kind = await self._body(ask)
        values = ask.values

        def held() -> dict[str, Any]:
            scans, warnings = self._scans_in(body, kind, values)
            if values["range_scale"] != 1:
                scaled = tuple(scan.scaled(values["range_scale"]) for scan in scans.scans)
                scans = replace(scans, scans=scaled)
            one = ScansHeld(values["name"] or "scans", scans, warnings)
            weight = sum(2 * len(scan.ranges) + _EACH for scan in scans.scans)
            return one.about(self._scans.put(one, weight, ask.client)[0])

        found = await ask.run(held)
        return JSONResponse(found, 201, {"Location": f"/v1/scans/{found['id']}"})

    async def _some_scans(self, ask: Ask) -> Response:
        held, values = self._held(ask.id), ask.values
        start = values["start"]

        def text() -> str:
            some = range(start, min(start + values["count"], len(held.scans)))
            there = held.scans.take(some)
            there = replace(there, scans=tuple(taken(scan, values) for scan in there.scans))
            items = [{**scan_row(there, k), "index": start + k} for k in range(len(some))]
            return json.dumps({**held.about(ask.id), "start": start, "items": items},
                              allow_nan=False)  # fmt: skip

        return Response(await ask.run(text), media_type="application/json")

    async def _drop_scans(self, ask: Ask) -> Response:
        self._scans.get(ask.id, drop=True)
        return Response(status_code=204)

    async def _marked(self, ask: Ask) -> Response:
        held = self._held(ask.id)
        body, _kind = await self._body(ask, 200 + 200 * len(held.scans))  # a line for each
        npz = await ask.run(lambda: write_npz(marked_of(body, held.scans)))
        return Response(npz, media_type="application/octet-stream")

    # ---- answers --------------------------------------------------------------------------------

    async def _localize(self, ask: Ask) -> Response:
        name, site = self._site(ask.values["map"])
        chosen, (scans, warnings), prior = await self._asked(ask, site)
        values = ask.values
        given = {key: values[key] for key in ("method", "top")}
        options = replace(self.core.options, **given, prior=prior)
        options = options.stepped(values["theta_step_deg"])

        async def row(k: int) -> str:
            begin = time.perf_counter()
            scan = await ask.run(lambda: taken(scans[k], values), "looks")
            start = partial(self.core.localize_soon, scan, name, options, source=object(), at=site)
            answer = (await ask.run(start)).value
            self._count("localize", answer.verdict, begin)

            def text() -> str:
                of = {"map": name, "version": self._describe(name, site)["version"]}
                found = answer_row(
                    answer, scan, k, sensor=values["sensor"], flipped=values["flipped"]
                )
                return to_json(_warned({**found, **of}, warnings))

            return str(await ask.run(text, "looks"))

        return _rows([await row(k) for k in chosen])

    async def _doubts(self, ask: Ask) -> Response:
        """Causes of a scan that does not fit, as the command has them; options in backquotes."""
        site, values = self._site(ask.values["map"])[1], ask.values
        chosen, (scans, _), prior = await self._asked(ask, site)

        def text() -> list[str]:
            scan = taken(scans[chosen[0]], values)
            options = site.options(replace(self.core.options, prior=prior))
            found = localize(site.features, scan, options)
            said = [(found.verdict, found.evidence)]
            if not is_doubtful(*said[0]):
                return []
            given = Given(values["flipped"], values["range_scale"])
            hints = doubts(site.features, ScanSet((scan,)), said, options, given)
            return [hint.said for hint in hints]

        return JSONResponse({"hints": await ask.run(text)})

    async def _which(self, ask: Ask) -> Response:
        if not self._names:
            raise Refused("not-found", "the service has no map")
        self._check_prepared()
        chosen, (scans, warnings), _ = await self._asked(ask, None)
        values = ask.values
        known = Known(None, values["heading"], values["clearance"])

        async def row(k: int) -> str:
            begin = time.perf_counter()
            scan = await ask.run(lambda: taken(scans[k], values), "looks")
            start = partial(self.core.which_soon, scan, known=known, source=object())
            found = (await ask.run(start)).value
            kinds = ("none", "undecided", "invalid")
            verdict = found.choice.verdict if found.choice.verdict in kinds else "named"
            self._count("which", verdict, begin)
            return to_json(_warned(found.choice.as_row(found.fits, k), warnings))

        return _rows([await row(k) for k in chosen])

    def _count(self, kind: str, verdict: str, begin: float) -> None:
        self.metrics.answers.labels(kind, verdict).inc()
        self.metrics.seconds.labels(kind).observe(time.perf_counter() - begin)

    async def _fit(self, ask: Ask) -> Response:
        site, kind = self._site(ask.values["map"])[1], ask.last
        chosen, (scans, warnings), _ = await self._asked(ask, None)
        if len(chosen) != 1:
            raise ConfigError(f"index: got {len(chosen)} scans, expected one")
        values, grid, begin = ask.values, site.features.grid, time.perf_counter()
        options, names = site.options(self.core.options), ("scale", "thinner", "bent")
        given = {name: values[name] for name in names if values[name] is not None}
        if "thinner" in given:
            given["thinner"] = round(given["thinner"] / grid.resolution)
        shared = replace(options.shared, **given)

        def text() -> str:
            scan, pose = taken(scans[chosen[0]], values), values["pose"]
            settle = kind == "settle"
            found = fit_at(site.features, scan, pose, options, shared=shared, settle=settle)
            return to_json(_warned(found.as_row(), warnings))

        body = await ask.run(text)
        self._count(kind, "fit", begin)
        return Response(body, media_type="application/json")

    # ---- layers ---------------------------------------------------------------------------------

    async def _feature(self, ask: Ask) -> Response:
        site = self._site(ask.values["map"])[1]
        return _png(await ask.run(lambda: layers.feature_layer(site.features, ask.last)))

    async def _likelihood(self, ask: Ask) -> Response:
        site, values = self._site(ask.values["map"])[1], ask.values
        held = self._held(values["scans"])
        options = site.options(replace(self.core.options, method=values["method"]))
        which = None if values["slice"] == "max" else int(values["slice"])
        names = ("scans", "index", "method", "range_scale", "range_max", "flipped")
        key = (site.features, *(str(values[name]) for name in names))

        def drawn() -> layers.Layer:
            if self._stack is None or self._stack[0] != key:
                scan = _one_of(held, values)
                self._stack = None  # before the next one takes its memory
                budget = replace(options, memory_budget=2 * self._part)
                self._stack = key, likelihood(site.features, scan, budget)
            return layers.slice_layer(self._stack[1], which)

        return _png(await ask.run(drawn))

    async def _atlas(self, ask: Ask) -> Response:
        site, values = self._site(ask.values["map"])[1], ask.values
        held, options = self._held(values["scans"]), site.options(self.core.options)
        how = {key: values[key] for key in ("step", "headings", "start")}
        survey = behind("survey_part")
        return JSONResponse(await ask.run(
            lambda: survey(site.features, _one_of(held, values), options, **how)))  # fmt: skip

    async def _visibility(self, ask: Ask) -> Response:
        site = self._site(ask.values["map"])[1]
        at = ask.values["at"]
        return JSONResponse(await ask.run(lambda: layers.seen_from(site.features, at)))

    async def _region(self, ask: Ask) -> Response:
        site = self._site(ask.values["map"])[1]
        corners = _corners(ask.values["region"])
        return _png(await ask.run(lambda: layers.region_layer(site.features.grid, corners)))

    async def _track(self, socket: WebSocket) -> None:
        """A line in, a line out, as `imgloc track --json` has it."""
        values = read_query(socket.scope["query_string"], openapi.TRACK.parameters)
        name = self._site(values["map"])[0]
        try:
            await self.robots.follow(socket, values, name, lambda: self._site(name)[1])
        except Exception as error:
            if socket.application_state != WebSocketState.CONNECTED:
                raise
            problem = self._problem(error)
            with contextlib.suppress(TimeoutError):  # of one that does not read
                with anyio.fail_after(_DRAIN):
                    await socket.send_text(bytes(problem.body).decode())
                    code = 1011 if problem.status_code == 500 else 1007
                    await socket.close(code, "see the last message")


class _Files(StaticFiles):
    """The files of the page: each is sent whole, with a tag of what is in it."""

    def file_response(
        self, full_path: Any, _: Any, scope: Scope, status_code: int = 200
    ) -> Response:
        """The file, or nothing but its tag if the client has it."""
        body = Path(full_path).read_bytes()
        tag = {"etag": f'"{hashlib.blake2b(body, digest_size=16).hexdigest()}"'}
        answer = Response(body, status_code, tag, mimetypes.guess_type(full_path)[0])
        same = self.is_not_modified(answer.headers, Headers(scope=scope))
        return NotModifiedResponse(answer.headers) if same else answer


def _one_of(held: ScansHeld, values: Values) -> LaserScan:
    """The scan of a file that is asked for, as it was taken."""
    k = Chosen(values["index"] or "0").of(len(held.scans), "the file", 1)[0]
    return taken(held.scans[k], values)


def _prior(values: Values, site: Site) -> Prior:
    """The poses, on a map, that a request leaves: near one, in a region, and so on."""
    grid = site.features.grid
    given = values["hints"] or ()
    if len(given) % 6:
        raise ConfigError(f"hints: got {len(given)} numbers, expected six for each pose")
    hints = tuple(Hint(*row) for row in np.reshape(given, (-1, 6)).tolist())
    prior = prior_of(Known(**{key: values[key] for key in KNOWN}, hints=hints), grid)
    if values["region"] is not None:
        cells = layers.region_cells(grid, _corners(values["region"]))
        prior &= Prior(cells, None, {"region": {"cells": int(cells.sum())}})
    return prior


def _png(layer: layers.Layer) -> Response:
    headers = {**layer.headers, "Cache-Control": "no-store"}
    return Response(layer.png, media_type="image/png", headers=headers)


def _refused(error: Exception) -> Exception:
    """Starlette's own refusals as ours."""
    if not isinstance(error, HTTPException):
        return error
    if error.status_code == 405:
        allowed = (error.headers or {}).get("Allow", "")
        return Refused("method-not-allowed", f"expected {allowed}", allow=allowed)
    return Refused("not-found", "there is nothing at this address; /v1/openapi.json lists all")


def _warned(row: Mapping[str, Any], warnings: Sequence[str]) -> dict[str, Any]:
    """The row, and what the reader of its scans warned of, if it did."""
    return {**row, "warnings": list(warnings)} if warnings else dict(row)


def _rows(lines: Sequence[str]) -> Response:
    """JSON lines; one alone is a JSON object."""
    media = "application/json" if len(lines) == 1 else _LINES
    return Response("".join(f"{line}\n" for line in lines), media_type=media)


def _corners(numbers: Sequence[float]) -> FloatArray:
    """The corners (N, 2) of a polygon."""
    if len(numbers) % 2:
        raise ConfigError(f"region: got {len(numbers)} numbers, expected pairs x, y")
    return np.reshape(numbers, (-1, 2))
