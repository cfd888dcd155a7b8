"""The HTTP service: what each request asks of the core, and what is answered.

Nothing is computed on the event loop. Scans and maps are read in one lane, answers come from the
core's own thread, what a page looks at from a third; each lane holds so many requests, and refuses
the rest with a time to come back.
"""

import asyncio
import hashlib
import json
import logging
import math
import time
import traceback
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, Router, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from imgloc.answers.fit import fit_at
from imgloc.doors import behind
from imgloc.errors import ConfigError, ImglocError, ScanError
from imgloc.features.budget import MIB, check_budget
from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.follow import Tracking
from imgloc.io.calibration import map_hash
from imgloc.io.maps import DRAWN, SWAPPED, looks_drawn, looks_swapped
from imgloc.io.scans import write_npz
from imgloc.io.scanset import ScanSet
from imgloc.io.textscans import read_jsonl_line
from imgloc.likelihoods.stacks import likelihood
from imgloc.live import layers, openapi
from imgloc.live.guard import HEADERS, Access, Gone, Message, Receive, Scope, Send, read_body
from imgloc.live.held import Held
from imgloc.live.lanes import Lane, waited
from imgloc.live.localizer import Localizer
from imgloc.live.metrics import Metrics
from imgloc.live.openapi import OPERATIONS
from imgloc.live.parameters import Parameter, read_query, with_defaults
from imgloc.live.problems import MEDIA, Problem, Refused, problem_of
from imgloc.live.requests import Bounds, Sent, map_of, marked_of, scans_of, taken
from imgloc.live.sites import Site
from imgloc.live.static import page_files
from imgloc.model import LaserScan, Likelihood, OccupancyGrid, Pose2D, plain, to_json
from imgloc.options import FUSED, RADIUS, TOLERANCE, Chosen, Known, Prior
from imgloc.output.rows import answer_row, moment_row
from imgloc.pipeline import prepare
from imgloc.search.asked import answer_bytes
from imgloc.search.priors import prior_of

LOG = logging.getLogger("imgloc")
_LINES = "application/x-ndjson"
_DRAIN = 1.0  # seconds in which what a client still sends of a refused body is thrown away
Values = Mapping[str, Any]
Endpoint = Callable[[Request, Values], Awaitable[Response]]


@dataclass(frozen=True)
class ScansHeld:
    """A file of scans that was sent, and how it is called."""

    id: str
    name: str
    scans: ScanSet
    warnings: tuple[str, ...] = ()  #: of its reader

    def about(self) -> dict[str, Any]:
        """What is in it."""
        s = self.scans
        readings = max(len(scan.ranges) for scan in s.scans)
        known = {"poses": s.poses, "odom": s.odom, "stamps": s.stamps}
        return (
            {"id": self.id, "name": self.name, "scans": len(s), "readings": readings}
            | {key: value is not None for key, value in known.items()}
            | {"warnings": list(self.warnings)}
        )


@dataclass(frozen=True)
class Given:
    """What a service is given to begin with."""

    #: paths of the maps, by name, as the command line has them
    paths: Mapping[str, str] = field(default_factory=dict)
    opened: ScansHeld | None = None  #: scans that the page shows first


class Service:
    """An ASGI application around a core.

    Parameters
    ----------
    core : Localizer
        Its maps; clients may send more.
    access : Access
    bounds : Bounds
    given : Given
    """

    def __init__(
        self,
        core: Localizer,
        access: Access | None = None,
        bounds: Bounds | None = None,
        given: Given | None = None,
    ) -> None:
        self.core, self.access = core, access or Access()
        self.bounds, self.given = bounds or Bounds(), given or Given()
        self.metrics, self.page = Metrics(), page_files()
        self.stopping = asyncio.Event()
        some = self.bounds.waiting
        self.lanes = {"files": Lane(some, 1), "answers": Lane(some), "looks": Lane(some, 1),
                      "layers": Lane(some, 1)}  # fmt: skip
        self._maps: Held[str] = Held(self.bounds.held, self._budget // 2)
        self._begun_with = frozenset(core.names)
        self._scans: Held[ScansHeld] = Held(self.bounds.held, 2 * self.bounds.numbers)
        self._stack: tuple[object, Likelihood] | None = None
        self._about: dict[str, tuple[MapFeatures, dict[str, Any]]] = {}
        self._followed = Counter[str]()  # robots, by map
        self._router = Router(self._routes())

    @property
    def _budget(self) -> int:
        return self.core.options.memory_budget or 1 << 30

    # ---- ASGI -----------------------------------------------------------------------------------

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or follow one robot."""
        scope["app"] = self  # else Starlette answers what is not there itself, in plain text
        if scope["type"] == "lifespan":
            await self._router(scope, receive, send)
            return
        if scope["type"] == "websocket":
            await self._socket(scope, receive, send)
            return
        ended = False

        async def receive_(message: Message | None = None) -> Message:
            nonlocal ended
            message = await receive()
            ended = ended or not message.get("more_body", False)
            return message

        async def send_(message: Message) -> None:
            if message["type"] == "http.response.start":
                named = {name.lower() for name, _ in message["headers"]}
                message["headers"] = [*message["headers"], *(
                    (key.lower().encode(), value.encode()) for key, value in HEADERS.items()
                    if key.lower().encode() not in named
                )]  # fmt: skip
                self.metrics.requests.labels(str(message["status"])).inc()
            await send(message)

        try:
            self.access.check(scope)
            await self._router(scope, receive_, send_)
        except Gone:
            return
        except Exception as error:
            problem = self._problem(_refused(error))
            await self._refuse(problem, scope, receive_, send_, lambda: ended)

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Follow a robot, or refuse to before the handshake."""
        accepted = False

        async def send_(message: Message) -> None:
            nonlocal accepted
            accepted = accepted or message["type"] == "websocket.accept"
            await send(message)

        try:
            self.access.check(scope)
            await self._router(scope, receive, send_)
        except Exception as error:
            problem = self._problem(_refused(error))
            if accepted:
                await send({"type": "websocket.close", "code": 1011, "reason": "internal error"})
            else:
                await receive()
                await self._deny(send, problem)

    def _problem(self, error: Exception) -> Problem:
        problem = problem_of(error)
        self.metrics.refused.labels(problem.document["type"].rpartition(":")[2]).inc()
        if problem.status == 500:
            frame = traceback.extract_tb(error.__traceback__)[-1]
            at = f"{Path(frame.filename).name}:{frame.lineno}"
            LOG.error("internal error at %s: %s: %s", at, type(error).__name__, error)
        return problem

    async def _refuse(
        self, problem: Problem, scope: Scope, receive: Receive, send: Send,
        ended: Callable[[], bool],
    ) -> None:  # fmt: skip
        """Send a problem; a client that is still sending gets to read it before the end."""
        body = json.dumps(problem.document).encode()
        headers = {"Content-Type": MEDIA, "Content-Length": str(len(body)), **problem.headers}
        names = {name for name, _ in scope["headers"]}
        sends = not ended() and bool({b"content-length", b"transfer-encoding"} & names)
        if sends:
            headers["Connection"] = "close"
        raw = [(key.lower().encode(), value.encode("latin-1")) for key, value in headers.items()]
        start = {"type": "http.response.start", "status": problem.status, "headers": raw}
        await send(start)
        head_only = scope["method"] == "HEAD"
        out = {"type": "http.response.body", "body": b"" if head_only else body}
        if not sends or b"expect" in names:
            await send(out)
            return
        await send({**out, "more_body": True})
        try:
            async with asyncio.timeout(_DRAIN):
                while (await receive()).get("more_body", False):
                    pass
        except TimeoutError:
            pass
        await send({"type": "http.response.body", "body": b""})

    async def _deny(self, send: Send, problem: Problem) -> None:
        body = json.dumps(problem.document).encode()
        self.metrics.requests.labels(str(problem.status)).inc()
        headers = [(b"content-type", MEDIA.encode()), (b"content-length", str(len(body)).encode())]
        kind = "websocket.http.response"
        await send({"type": f"{kind}.start", "status": problem.status, "headers": headers})
        await send({"type": f"{kind}.body", "body": body})

    def stop(self) -> None:
        """Refuse what comes and what waits; what runs may end."""
        self.stopping.set()
        for lane in self.lanes.values():
            lane.stop()

    def _routes(self) -> list[Route | WebSocketRoute]:
        does: dict[tuple[str, str], Endpoint] = {
            ("get", "/healthz"): self._health, ("get", "/readyz"): self._ready,
            ("get", "/metrics"): self._metrics, ("get", "/v1/openapi.json"): self._document,
            ("get", "/v1/maps"): self._list, ("post", "/v1/maps"): self._send_map,
            ("get", "/v1/maps/{name}"): self._map, ("delete", "/v1/maps/{name}"): self._drop_map,
            ("get", "/v1/maps/{name}/image"): self._image,
            ("post", "/v1/scans"): self._send_scans, ("get", "/v1/scans/{id}"): self._some_scans,
            ("delete", "/v1/scans/{id}"): self._drop_scans,
            ("post", "/v1/scans/{id}/marked"): self._marked,
            ("post", "/v1/localize"): self._localize, ("post", "/v1/which"): self._which,
            ("post", "/v1/score"): partial(self._fit, settle=False),
            ("post", "/v1/settle"): partial(self._fit, settle=True),
            ("get", "/v1/layers/likelihood"): self._likelihood,
            ("get", "/v1/layers/atlas"): self._atlas,
            ("get", "/v1/layers/visibility"): self._visibility,
            ("get", "/v1/layers/region"): self._region,
        }  # fmt: skip
        does |= {("get", f"/v1/layers/{n}"): partial(self._feature, what=n) for n in openapi.LAYERS}
        methods: dict[str, dict[str, tuple[Endpoint, Sequence[Parameter]]]] = {}
        for one in OPERATIONS:
            methods.setdefault(one.path, {})[one.method] = (
                does[one.method, one.path],
                one.parameters,
            )
        routes: list[Route | WebSocketRoute] = [
            Route(path, _endpoint(by), methods=[m.upper() for m in by])
            for path, by in methods.items()
        ]
        routes.append(WebSocketRoute("/v1/track", self._track))
        routes += [
            Route(path, _endpoint({"get": (partial(self._static, path=path), ())}))
            for path in self.page
        ]
        return routes

    # ---- the service itself ---------------------------------------------------------------------

    async def _health(self, _: Request, __: Values) -> Response:
        return JSONResponse({"status": "ok"})

    async def _ready(self, _: Request, __: Values) -> Response:
        if self.stopping.is_set():
            raise Refused("stopping", "the service ends; ask another one", retry=5)
        if not self._prepared():
            raise Refused("not-ready", "maps are being prepared", retry=1)
        return JSONResponse({"status": "ok"})

    def _prepared(self) -> bool:
        return all(self.core.state(name) == "ready" for name in self.core.names)

    async def _metrics(self, _: Request, __: Values) -> Response:
        for name, lane in self.lanes.items():
            self.metrics.queue.labels(name).set(lane.pending)
        self.metrics.dropped.set(self.core.dropped)
        self.metrics.maps.set(len(self.core.names))
        self.metrics.sockets.set(self._followed.total())
        return Response(self.metrics.text(), media_type="text/plain; version=0.0.4")

    async def _document(self, _: Request, __: Values) -> Response:
        return JSONResponse(openapi.document(token=self.access.token is not None))

    async def _static(self, request: Request, _: Values, *, path: str) -> Response:
        file = self.page[path]
        headers = {"ETag": file.tag, "Cache-Control": "no-cache"}
        if request.headers.get("if-none-match") == file.tag:
            return Response(status_code=304, headers=headers)
        return Response(file.data, headers={**headers, "Content-Type": file.media})

    # ---- maps -----------------------------------------------------------------------------------

    def _site(self, name: str | None) -> tuple[str, Site]:
        """The map that is asked for, prepared.

        What one client uploads must not change what another one, which names no map, is answered.
        """
        names = self.core.names
        if name is None:
            own = [one for one in names if self._is_own(one)] if self._begun_with else names
            if len(own) != 1:
                some = f"one of {', '.join(own)}" if own else "a map; none is held, send one"
                raise ConfigError(f"map: missing, expected {some}")
            (name,) = own
        if name not in names:
            some = f"expected one of {', '.join(names)}" if names else "none is held, send one"
            raise Refused("not-found", f"map: there is no {name!r}, {some}")
        if self.core.state(name) == "preparing":
            raise Refused("not-ready", f"{name}: is being prepared", retry=1)
        if name in self._maps:
            self._maps.get(name)
        return name, self.core.site(name)

    def _is_own(self, name: str) -> bool:
        """Whether the service was started with this map."""
        return name in self._begun_with and name not in self._maps

    def _describe(self, name: str) -> dict[str, Any]:
        """What there is to say of a map."""
        features = self.core.site(name).features
        known = self._about.get(name)
        if known is not None and known[0] is features:
            return known[1]
        grid = features.grid
        height, width = grid.occupied.shape
        said = {
            "name": name, "width": width, "height": height, "resolution": grid.resolution,
            "origin": grid.origin, "free_m2": float(grid.free.sum()) * grid.resolution**2,
            "uploaded": name in self._maps, "version": map_hash(grid),
            "path": self.given.paths.get(name),
            "warnings": [text for text, seen in ((SWAPPED, looks_swapped(grid)),
                                                 (DRAWN, looks_drawn(grid))) if seen],
        }  # fmt: skip
        self._about[name] = features, dict(plain(said))
        return self._about[name][1]

    async def _list(self, _: Request, __: Values) -> Response:
        states = {name: self.core.state(name) for name in self.core.names}
        ready = [name for name, state in states.items() if state == "ready"]
        preparing = [name for name, state in states.items() if state == "preparing"]
        described = await self._look(lambda: [self._describe(name) for name in ready])
        b, opened = self.bounds, self.given.opened
        limits = {"body": b.body, "pixels": b.pixels, "scans": b.scans, "numbers": b.numbers,
                  "each": b.each, "message": b.message, "seconds": b.seconds}  # fmt: skip
        about = None if opened is None else opened.about()
        return JSONResponse(
            {"maps": described, "preparing": preparing, "limits": limits, "opened": about}
        )

    async def _map(self, request: Request, _: Values) -> Response:
        name, _site = self._site(request.path_params["name"])
        return JSONResponse(await self._look(lambda: self._describe(name)))

    async def _image(self, request: Request, _: Values) -> Response:
        site = self._site(request.path_params["name"])[1]
        return await self._layer(lambda: layers.map_layer(site.features.grid))

    async def _send_map(self, request: Request, values: Values) -> Response:
        body, kind = await self._body(request)

        def held() -> str:
            name, grid = map_of(body, kind, values["name"] or "", self.bounds, values)
            if name in self.core.names and name not in self._maps:
                hint = "it is a map of the service itself; send yours by another name"
                raise Refused("name-taken", f"name: there is a map {name!r} already: {hint}")
            if name in self.core.names:
                if not _same(self.core.site(name).features.grid, grid):
                    hint = "another one was sent by this name; send yours by another name"
                    raise Refused("name-taken", f"name: there is a map {name!r} already: {hint}")
                self._maps.get(name)
                return name
            options = self.core.options
            features = prepare(
                grid, name, ready=False,
                memory_budget=options.memory_budget, threads=options.threads,
            )  # fmt: skip
            need = features.bytes_for(FUSED)
            what = f"{name}: a map of {grid.info.width} x {grid.info.height} cells"
            all_of_it = need + answer_bytes(features, options)
            check_budget(all_of_it, self._budget // 2, what, "crop the map")
            compared = not self._begun_with
            self.core.put(name, features, background=False, compared=compared)
            for gone in self._maps.put(name, name, need):
                self._forget(gone)
            return name

        name = await self.lanes["files"].run(held, self.bounds.seconds)
        described = await self._look(lambda: self._describe(name))
        return JSONResponse(described, 201, {"Location": f"/v1/maps/{name.replace(' ', '%20')}"})

    async def _drop_map(self, request: Request, _: Values) -> Response:
        name, _site = self._site(request.path_params["name"])
        if name not in self._maps:
            raise Refused(
                "name-taken", f"{name}: is a map of the service itself, and cannot be removed"
            )
        if count := self._followed[name]:
            some = "a robot is" if count == 1 else f"{count} robots are"
            raise Refused("in-use", f"{name}: {some} followed in it; remove it when they are gone")
        self._maps.drop(name)
        self._forget(name)
        return Response(status_code=204)

    def _forget(self, name: str) -> None:
        """Hold nothing of a map any more."""
        self.core.drop(name)
        self._about.pop(name, None)
        self._stack = None

    # ---- scans ----------------------------------------------------------------------------------

    async def _body(self, request: Request) -> tuple[bytes, str]:
        """The body, and its media type."""
        limit, seconds = self.bounds.body, self.bounds.patience
        body = await read_body(
            request.scope, request.receive, limit=limit, seconds=seconds, stopping=self.stopping
        )
        return body, request.headers.get("content-type", "")

    async def _asked(self, request: Request, values: Values) -> tuple[list[int], Sent]:
        """Which scans are asked about, and the set that they are of."""
        body, kind = await self._body(request)
        if values["scans"] is not None:
            if body:
                raise ConfigError("scans: expected either it or a body, not both")
            held = self._held(values["scans"])
            sent = Sent(held.scans, held.warnings)
        else:
            small = len(body) < MIB >> 4 and kind.startswith("application/json")
            sent = await self._read(lambda: self._scans_in(body, kind, values), small=small)
        chosen = Chosen(values["index"]).of(len(sent.scans), "the file")
        if len(chosen) > self.bounds.each:
            most = f"at most {self.bounds.each:,} at once; index names some"
            raise Refused("too-large", f"{len(chosen):,} scans, expected {most}")
        return chosen, sent

    def _scans_in(self, body: bytes, kind: str, values: Values) -> Sent:
        fov = None if values["fov_deg"] is None else math.radians(values["fov_deg"])
        return scans_of(
            body, kind, values["name"] or "", self.bounds,
            topic=values["topic"], fov=fov, budget=self._budget // 4,
        )  # fmt: skip

    async def _read(self, work: Callable[[], Any], *, small: bool = False) -> Any:
        """Read a file off the loop; a single scan takes less than to hand it over."""
        return work() if small else await self.lanes["files"].run(work, self.bounds.seconds)

    def _held(self, id_: str) -> ScansHeld:
        opened = self.given.opened
        return opened if opened is not None and opened.id == id_ else self._scans.get(id_, "scans")

    async def _send_scans(self, request: Request, values: Values) -> Response:
        body, kind = await self._body(request)

        def held() -> ScansHeld:
            scans, warnings = self._scans_in(body, kind, values)
            if values["range_scale"] != 1:
                scaled = tuple(scan.scaled(values["range_scale"]) for scan in scans.scans)
                scans = replace(scans, scans=scaled)
            how = json.dumps([values[key] for key in ("name", "topic", "fov_deg", "range_scale")])
            digest = hashlib.sha256(how.encode() + b"\0" + body).hexdigest()[:16]
            return ScansHeld(digest, values["name"] or "scans", scans, warnings)

        found = await self.lanes["files"].run(held, self.bounds.seconds)
        weight = sum(2 * len(scan.ranges) for scan in found.scans.scans)
        self._scans.put(found.id, found, weight)
        return JSONResponse(found.about(), 201, {"Location": f"/v1/scans/{found.id}"})

    async def _some_scans(self, request: Request, values: Values) -> Response:
        held = self._held(_id_of(request))
        start = values["start"]

        def text() -> str:
            some = range(start, min(start + values["count"], len(held.scans)))
            items = [scan_row(held.scans, k) for k in some]
            return json.dumps({**held.about(), "start": start, "items": items}, allow_nan=False)

        body = await self.lanes["files"].run(text, self.bounds.seconds, request.receive)
        return Response(body, media_type="application/json")

    async def _drop_scans(self, request: Request, _: Values) -> Response:
        self._scans.drop(_id_of(request), "scans")
        return Response(status_code=204)

    async def _marked(self, request: Request, _: Values) -> Response:
        held = self._held(_id_of(request))
        body, _kind = await self._body(request)
        npz = await self._read(lambda: write_npz(marked_of(body, held.scans)))
        return Response(npz, media_type="application/octet-stream")

    # ---- answers --------------------------------------------------------------------------------

    async def _localize(self, request: Request, values: Values) -> Response:
        name, site = self._site(values["map"])
        chosen, (scans, warnings) = await self._asked(request, values)
        step = values["theta_step_deg"]
        options = replace(
            self.core.options,
            method=values["method"],
            top=values["top"],
            exact=values["exact"],
            prior=self._prior(values, site),
        ).stepped(None if step is None else math.radians(step))
        sensor = None if values["sensor"] is None else Pose2D(*values["sensor"])
        flipped = values["flipped"]

        async def row(k: int) -> str:
            scan, begin = taken(scans[k], values), time.perf_counter()
            start = partial(self.core.localize_soon, scan, name, options, source=object())
            answer = (await self._answer(start, request)).value
            self._count("localize", answer.verdict, begin)
            found = answer_row(answer, scan, k, sensor=sensor, flipped=flipped)
            return to_json(_warned(found, warnings))

        return _rows([await row(k) for k in chosen])

    async def _which(self, request: Request, values: Values) -> Response:
        if not self.core.names:
            raise Refused("not-found", "there is no map, send one")
        if not self._prepared():
            raise Refused("not-ready", "maps are being prepared", retry=1)
        chosen, (scans, warnings) = await self._asked(request, values)
        known = Known(None, _turned(values["heading"], 1), values["clearance"])

        async def row(k: int) -> str:
            scan, begin = taken(scans[k], values), time.perf_counter()
            start = partial(self.core.which_soon, scan, known=known, source=object())
            found = (await self._answer(start, request)).value
            kinds = ("none", "undecided", "invalid")
            verdict = found.choice.verdict if found.choice.verdict in kinds else "named"
            self._count("which", verdict, begin)
            return to_json(_warned(found.choice.as_row(found.fits, k), warnings))

        return _rows([await row(k) for k in chosen])

    async def _answer(self, start: Callable[[], Any], request: Request) -> Any:
        return await self.lanes["answers"].run(start, self.bounds.seconds, request.receive)

    def _count(self, kind: str, verdict: str, begin: float) -> None:
        self.metrics.answers.labels(kind, verdict).inc()
        self.metrics.seconds.labels(kind).observe(time.perf_counter() - begin)

    def _prior(self, values: Values, site: Site) -> Prior:
        """What a request says of the pose."""
        near = values["near"]
        if near is not None:
            near = (*near, *(RADIUS, TOLERANCE)[len(near) - 3 :]) if len(near) < 5 else near
        grid = site.features.grid
        known = Known(near, _turned(values["heading"], 1), values["clearance"])
        prior = prior_of(known, grid)
        if values["region"] is not None:
            cells = layers.region_cells(grid, _corners(values["region"]))
            prior &= Prior(cells, None, {"region": {"cells": int(cells.sum())}})
        return prior

    async def _fit(self, request: Request, values: Values, *, settle: bool) -> Response:
        site = self._site(values["map"])[1]
        chosen, (scans, warnings) = await self._asked(request, values)
        if len(chosen) != 1:
            raise ConfigError(f"index: got {len(chosen)} scans, expected one")
        scan, grid = taken(scans[chosen[0]], values), site.features.grid
        options, thinner = site.options(self.core.options), values["thinner"]
        given: dict[str, Any] = {name: values[name] for name in ("scale", "bent")}
        if thinner is not None:
            given["thinner"] = round(thinner / grid.resolution)
        given = {name: value for name, value in given.items() if value is not None}
        shared = replace(options.shared, **given)
        if shared.thinner > 0 and not site.features.peels:
            raise ConfigError("thinner: the map is too large to make its walls thinner, expected 0")
        pose, begin = Pose2D(*values["pose"]), time.perf_counter()

        def text() -> str:
            found = fit_at(site.features, scan, pose, options, shared=shared, settle=settle)
            return to_json(_warned(found.as_row(), warnings))

        body = await self._look(text, request)
        self._count("settle" if settle else "score", "fit", begin)
        return Response(body, media_type="application/json")

    async def _look(self, work: Callable[[], Any], request: Request | None = None) -> Any:
        receive = None if request is None else request.receive
        return await self.lanes["looks"].run(work, self.bounds.seconds, receive)

    # ---- layers ---------------------------------------------------------------------------------

    async def _layer(self, work: Callable[[], layers.Layer]) -> Response:
        layer = await self.lanes["layers"].run(work, self.bounds.seconds)
        headers = {**layer.headers, "Cache-Control": "no-store"}
        return Response(layer.png, media_type="image/png", headers=headers)

    async def _feature(self, _: Request, values: Values, *, what: str) -> Response:
        site = self._site(values["map"])[1]
        return await self._layer(lambda: layers.feature_layer(site.features, what))

    async def _likelihood(self, _: Request, values: Values) -> Response:
        site = self._site(values["map"])[1]
        k, scan = self._held_scan(values)
        options = site.options(replace(self.core.options, method=values["method"]))
        which = None if values["slice"] == "max" else int(values["slice"])
        how = [str(values[k]) for k in ("scans", "method", "range_scale", "range_max", "flipped")]
        key = (site.features, k, *how)

        def drawn() -> layers.Layer:
            if self._stack is None or self._stack[0] != key:
                self._stack = None  # before the next one takes its memory
                budget = replace(options, memory_budget=self._budget // 2)
                self._stack = key, likelihood(site.features, scan, budget)
            return layers.slice_layer(self._stack[1], which)

        return await self._layer(drawn)

    def _held_scan(self, values: Values) -> tuple[int, LaserScan]:
        """The scan of a file that was sent before, and its index there."""
        scans = self._held(values["scans"]).scans
        k = Chosen(values["index"] or "0").of(len(scans), "the file")[0]
        return k, taken(scans[k], values)

    async def _atlas(self, request: Request, values: Values) -> Response:
        site = self._site(values["map"])[1]
        _, scan = self._held_scan(values)
        options = site.options(self.core.options)
        how = {key: values[key] for key in ("step", "headings", "start")}
        work = partial(behind("survey_part"), site.features, scan, options, **how)
        run = self.lanes["layers"].run(work, self.bounds.seconds, request.receive)
        return JSONResponse(await run)

    async def _visibility(self, request: Request, values: Values) -> Response:
        site = self._site(values["map"])[1]
        work = partial(layers.seen_from, site.features, values["at"])
        return JSONResponse(await self._look(work, request))

    async def _region(self, _: Request, values: Values) -> Response:
        site = self._site(values["map"])[1]
        corners = _corners(values["region"])
        return await self._layer(lambda: layers.region_layer(site.features.grid, corners))

    # ---- a robot --------------------------------------------------------------------------------

    async def _track(self, socket: WebSocket) -> None:
        """A line in, a line out, as `imgloc track --json` has it."""
        given = read_query(socket.scope["query_string"], openapi.TRACK)
        values = with_defaults(given, openapi.TRACK)
        name, _ = self._site(values["map"])
        if self.stopping.is_set() or self._followed.total() >= self.bounds.sockets:
            raise Refused("busy", f"{self._followed.total()} robots are followed", retry=5)
        tracking = Tracking(filter=values["filter"], seed=values["seed"])
        self._followed[name] += 1
        robot = None
        try:
            robot = await asyncio.to_thread(self.core.robot, name, tracking)
            if values["start"] is not None:
                robot.start_at(Pose2D(*values["start"]))
            offered = socket.scope.get("subprotocols", [])
            await socket.accept("imgloc" if "imgloc" in offered else None)
            count, last = 0, -math.inf
            while (message := await socket.receive())["type"] == "websocket.receive":
                line = message.get("text")
                if line is None:
                    raise ScanError(f"line {count + 1}: got bytes, expected a text: JSON")
                if not line.strip():
                    continue
                begin = time.perf_counter()
                scan, odom = moment_of(line, f"line {count + 1}", values)
                if scan.stamp < last:
                    got = f"stamp: got {scan.stamp} s, expected {last} s or later"
                    raise ScanError(f"line {count + 1}: {got}, the stamp of the line before")
                last = scan.stamp
                self._site(name)  # it is in use, so others have to make room first
                future = robot.update_soon(scan, odom)
                moment = (await waited(future, self.bounds.seconds, None)).value
                self._count("track", moment.belief.verdict, begin)
                origin = self._site(name)[1].features.grid.origin if values["places"] else None
                row = moment_row(replace(moment, index=count), origin)
                await socket.send_text(to_json(row))
                count += 1
        except WebSocketDisconnect:
            pass
        except ImglocError as error:
            if socket.application_state != WebSocketState.CONNECTED:
                raise
            await socket.send_text(json.dumps(self._problem(error).document))
            await socket.close(1007, "see the last message")
        finally:
            self._followed[name] -= 1
            if robot is not None:
                robot.end()


def _same(one: OccupancyGrid, other: OccupancyGrid) -> bool:
    """Whether two maps have the same cells, and lie at the same place."""
    return map_hash(one) == map_hash(other) and one.origin == other.origin


def _endpoint(
    by_method: Mapping[str, tuple[Endpoint, Sequence[Parameter]]],
) -> Callable[[Request], Awaitable[Response]]:
    """What Starlette calls: the query is checked, and what a method does is called with it."""

    async def run(request: Request) -> Response:
        does, parameters = by_method["get" if request.method == "HEAD" else request.method.lower()]
        given = read_query(request.scope["query_string"], parameters)
        return await does(request, with_defaults(given, parameters))

    return run


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


def _id_of(request: Request) -> str:
    return str(request.path_params["id"])


def _turned(given: tuple[float, ...] | None, least: int) -> tuple[float, float] | None:
    """A heading and how far it may be off."""
    return None if given is None else (given[0], given[1] if len(given) > least else TOLERANCE)


def _corners(numbers: Sequence[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The corners (N, 2) of a polygon."""
    if len(numbers) % 2:
        raise ConfigError(f"region: got {len(numbers)} numbers, expected pairs x, y")
    return np.array(numbers, dtype=np.float64).reshape(-1, 2)


def scan_row(scans: ScanSet, k: int) -> dict[str, Any]:
    """A scan of a set as JSON that is read back as the same scan; what is not known is left out.

    Examples
    --------
    >>> scans = ScanSet((LaserScan([1.0, np.inf, np.nan], [0.0, 0.1, 0.2]),))
    >>> scan_row(scans, 0)
    {'index': 0, 'ranges': [1.0, 'inf', None], 'angles': [0.0, 0.1, 0.2], 'range_min': 0.0, \
'time_increment': 0.0}
    """
    scan = scans[k]
    words = {math.inf: "inf", -math.inf: "-inf"}
    ranges = [r if math.isfinite(r) else words.get(r) for r in scan.ranges.tolist()]
    row: dict[str, Any] = {"index": k, "ranges": ranges, "angles": scan.angles.tolist()}
    stamp = scan.stamp if scans.stamps is None else float(scans.stamps[k])
    numbers = {"range_min": scan.range_min, "range_max": scan.range_max, "stamp": stamp}
    numbers["time_increment"] = scan.time_increment
    row |= {key: value for key, value in numbers.items() if math.isfinite(value)}
    poses = {"pose": scans.poses, "odom": scans.odom}
    for key, rows in poses.items():
        if rows is not None and np.isfinite(rows[k]).all():
            row[key] = dict(zip(("x", "y", "theta"), rows[k].tolist(), strict=True))
    if scan.T_base_laser is not None:
        row["mount"] = plain(scan.T_base_laser)
    return row


def moment_of(line: str, where: str, how: Mapping[str, Any]) -> tuple[LaserScan, Any]:
    """A line of a log, as a robot sends it: its scan, and its odometry (3,)."""
    one = read_jsonl_line(line, where)
    if one.odom is None:
        missing = "odom: missing, expected the pose of the odometry, [x, y, theta]"
        raise ScanError(f"{where}: {missing}")
    return taken(one[0], how), one.odom[0]
