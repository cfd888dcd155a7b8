"""The answers of the service, as data: parameters that it checks, and its OpenAPI 3.1 document."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, replace
from typing import Annotated, Any

from imgloc import options as opt
from imgloc.__about__ import __version__
from imgloc.io.scanset import MAX_RAYS
from imgloc.live.held import ID_BYTES
from imgloc.live.parameters import CORNERS, option, schema_of
from imgloc.live.problems import KINDS, MEDIA
from imgloc.live.requests import NAME
from imgloc.pose import MOUNTED, Pose2D
from imgloc.ranges import Declared, Matches, OneOf, Option, Within, declaration
from imgloc.texts import numbers, pose

STACKS = tuple(opt.METHODS)
LAYERS = ("bmap", "distance", "vmap")
ID = Matches(f"[0-9a-f]{{{2 * ID_BYTES}}}", 2 * ID_BYTES, "an id")


def _own(name: str, text: str, hint: Any, default: Any = None, **more: Any) -> Declared:
    """A parameter that is no option of a command; `more` is how it is read."""
    return declaration(name, Annotated[hint, Option(text, **more)], default)


MAP = _own(
    "map",
    "Name of a map of the service, or id of one that was sent. Without it: the service's only map.",
    Annotated[str, NAME],
)
_SCANS_ID = _own("scans", "Scans that were sent before, instead of a body.", Annotated[str, ID])
_CHOSEN = option(
    opt.Chosen, "index", name="index", text=f"Only these scans of a file: {opt.INDICES}."
)
_SCALE = option(opt.Logs, "scale")
_SENSOR = option(opt.Mounting, "sensor", limit=Within(-MOUNTED, MOUNTED, "metres"))
TAKEN = (
    _SCALE, option(opt.Logs, "range_max"), _SENSOR,
    option(opt.Mounting, "flipped"),
)  # fmt: skip
_READ = (
    _own("name", "Name of the file of scans. Its ending sets the format; without it the content "
         "decides.", Annotated[str, Matches(r"[^\x00-\x1f/\\]+", 200, "a file name")]),
    _own("topic", "Laser to read from a log that has several.",
         Annotated[str, Matches(r"[!-~]+", 200, "a name")]),
    option(opt.Logs, "fov"),
)  # fmt: skip
_SCANS = (_SCANS_ID, *_READ, _CHOSEN, *TAKEN)
KNOWN = {key: option(opt.Known, key) for key in ("near", "sd", "heading", "clearance")}
_REGION = _own(
    "region", "Only poses in this polygon: x1, y1, x2, y2 and so on, map frame, metres.",
    tuple[opt.Place, ...], parse=numbers(*CORNERS),
)  # fmt: skip
_HINTS = _own(
    "hints", "Poses of which one is roughly right: x, y, yaw, standard deviations in metres and "
    "radians, weight (0.001 to 1), and so on. No pose is excluded, and none unique by them.",
    tuple[opt.Place, ...], parse=numbers(*CORNERS),
)  # fmt: skip
DOUBTS = (MAP, *_SCANS, *KNOWN.values(), _HINTS, _REGION)
LOCALIZE = (*DOUBTS, *(option(opt.Options, key) for key in ("method", "top", "theta_step")))
WHICH = (*_SCANS, KNOWN["heading"], KNOWN["clearance"])
FIT = (
    MAP, *_SCANS,
    _own("pose", "Pose of the sensor: x, y, yaw, map frame.", Pose2D, MISSING, parse=pose),
    option(opt.Shared, "scale", default=None, text="Factor of all ranges: evidence.scale of an "
           "answer."),
    option(opt.Drawn, "thinner", text="Metres each side of a wall loses: evidence.thinner."),
    option(opt.Drawn, "bent", text="Metres that pieces of wall stand off: evidence.bent."),
)  # fmt: skip
UPLOAD = (
    _own("name", "What the map is called; its id is another.", Annotated[str, NAME]),
    *(option(opt.Reading, key) for key in opt.Reading.__annotations__ if key != "max_pixels"),
    _own("allow_lossy", "Accept a JPEG or a lossy WebP.", bool, False),
)  # fmt: skip
_FIRST = Annotated[int, Within(0, 1e9, "")]
PAGE = (
    _own("start", "The first scan of the page.", _FIRST, 0),
    _own("count", "Scans of the page.", Annotated[int, Within(1, 200, "scans")], 20),
    *TAKEN,
)
_HELD = _own("scans", "Scans that were sent before.", Annotated[str, ID], MISSING)
LIKELIHOOD = (
    MAP, _HELD, _CHOSEN, *TAKEN,
    _own("method", "Method of the likelihood.", Annotated[str, OneOf(*STACKS)], "cbml"),
    _own("slice", "Number of the heading, or max for the best over all.",
         Annotated[str, Matches(r"max|\d{1,5}", 5, "a number, or max")], "max"),
)  # fmt: skip
ATLAS = (
    MAP, _HELD, _CHOSEN, *TAKEN,
    declaration("step", opt.Spacing, 2.0), declaration("headings", opt.Headings, 1),
    _own("start", "First pose: next of the last answer.", _FIRST, 0),
)  # fmt: skip
VISIBILITY = (MAP, _own("at", "x, y, map frame, metres.", tuple[opt.Place, opt.Place], MISSING))
_TRACK = (
    MAP, *TAKEN, option(opt.Followed, "filter"), option(opt.Followed, "seed"),
    _own("start", "Rough pose at the beginning: x, y, yaw.", Pose2D, parse=pose),
    _own("places", "Add the places of the belief to each line.", bool, False),
)  # fmt: skip

_NUMBER, _NULL_NUMBER = {"type": "number"}, {"type": ["number", "null"]}
_WHOLE, _YES, _WORD = {"type": "integer"}, {"type": "boolean"}, {"type": "string"}
_WARNINGS = {"type": "array", "items": _WORD}
_TURNED = {"type": "number", "minimum": -4 * math.pi, "maximum": 4 * math.pi}
_OR_NULL = {**_TURNED, "type": ["number", "null"]}
_INDEX = {"type": "integer", "minimum": 0, "maximum": 2**31 - 1}
_METRES = {"type": "number", "minimum": -1e300, "maximum": 1e300}
_GIVEN_POSE = {"type": ["array", "null"], "items": _NUMBER, "minItems": 3, "maxItems": 3}
_ANY, _SOME = {"type": "object"}, {"type": "array", "items": {"type": "object"}}
_AT = {"$ref": "#/components/schemas/Pose"}


def _object(needed: str, **properties: Any) -> dict[str, Any]:
    """The schema of an object; `needed` are the names of what it always has."""
    return {"type": "object", "properties": properties, "required": needed.split()}


def _rays(items: Any) -> dict[str, Any]:
    return {"type": "array", "items": items, "minItems": 1, "maxItems": MAX_RAYS}


_SCHEMAS: Mapping[str, Any] = {
    "Problem": _object(
        "type title status detail", title=_WORD, status=_WHOLE, detail=_WORD,
        type={"type": "string", "enum": [f"urn:imgloc:problem:{kind}" for kind in KINDS]},
    ),
    "Pose": _object("x y theta", x=_NUMBER, y=_NUMBER, theta=_NUMBER),
    "LaserScan": _object(
        "ranges",
        ranges=_rays({"anyOf": [_NUMBER, {"type": "null"}, {"enum": ["inf", "-inf", "nan"]}]}),
        angles={**_rays(_TURNED), "type": ["array", "null"]},
        angle_min=_OR_NULL, angle_max=_OR_NULL, angle_increment=_OR_NULL,
        range_min={**_NULL_NUMBER, "minimum": 0},
        range_max={**_NULL_NUMBER, "exclusiveMinimum": 0}, time_increment=_NULL_NUMBER,
        stamp={
            "description": "Seconds, or the stamp of a ROS message.",
            "anyOf": [_NULL_NUMBER, _object("", sec=_NUMBER, nanosec=_NUMBER)],
        },
        odom=_GIVEN_POSE, pose=_GIVEN_POSE, mount=_GIVEN_POSE,
    ) | {
        "description": "Names of sensor_msgs/LaserScan; metres and radians, counter-clockwise, 0 "
        "forward. In ranges null is no reading, 'inf' no return. Other keys may be null: missing.",
    },
    "Map": _object(
        "id name width height resolution origin uploaded version",
        id=_WORD, name=_WORD, width=_WHOLE, height=_WHOLE, resolution=_NUMBER, origin=_AT,
        free_m2=_NUMBER, uploaded=_YES, version=_WORD, path={"type": ["string", "null"]},
        warnings=_WARNINGS,
    ),
    "Scans": _object(
        "id name scans readings poses odom stamps warnings", id=_WORD, name=_WORD, scans=_WHOLE,
        readings=_WHOLE, poses=_YES, odom=_YES, stamps=_YES, warnings=_WARNINGS,
    ),
    "Marks": {**_object("poses", poses={
        "type": "array", "minItems": 1,
        "description": "Index of a scan, and the pose of its sensor: x, y, theta.",
        "items": {"type": "array", "prefixItems": [_INDEX, *(_METRES,) * 3], "items": False,
                  "minItems": 4, "maxItems": 4},
    }), "additionalProperties": False},
    "Answer": _object(
        "index verdict pose hypotheses counts parameters",
        index=_WHOLE, verdict={"enum": ["unique", "ambiguous", "no-match", "invalid"]},
        pose={"oneOf": [_AT, {"type": "null"}]}, hypotheses=_SOME, elsewhere=_NUMBER,
        entropy=_NULL_NUMBER, explained=_NULL_NUMBER, counts=_ANY, timings_ms=_ANY,
        parameters=_ANY, warnings=_WARNINGS, protection={"type": "array", "items": _object(
            "", share=_NUMBER, metres=_NULL_NUMBER, radians=_NULL_NUMBER)},
        things={"type": "array", "items": _object(
            "", bearing=_NUMBER, distance=_NUMBER, share=_NUMBER, through=_YES)},
    ),
    "Choice": _object("index verdict none maps", index=_WHOLE, verdict=_WORD, none=_NULL_NUMBER,
                      maps=_SOME, warnings=_WARNINGS),
    "Fit": _object(
        "pose log_likelihood misfit explained counts rays", pose=_AT, log_likelihood=_NULL_NUMBER,
        per_reading=_NULL_NUMBER, best=_NUMBER, misfit=_NULL_NUMBER, explained=_NULL_NUMBER,
        stands=_YES, readings=_WHOLE, counts=_ANY, rays=_ANY, warnings=_WARNINGS,
    ),
}  # fmt: skip

_BINARY = {"type": "string", "format": "binary"}
_BYTES: dict[str, Any] = {"application/octet-stream": {"schema": _BINARY}}
_FORM = _object("image", image=_BINARY, yaml=_BINARY) | {"additionalProperties": False}
_MAP_BODY: Mapping[str, Any] = {"multipart/form-data": {"schema": _FORM}, **_BYTES}


def _ref(name: str) -> dict[str, Any]:
    return {"application/json": {"schema": {"$ref": f"#/components/schemas/{name}"}}}


#: Who may ask: all, those who have the token (all, if there is none), or who has the id as well.
ALL, TOKEN, OWNER = "all", "token", "owner"
PROBES = "probes"  #: the lane of those that are answered also where there is no room for others


@dataclass(frozen=True)
class Operation:
    """One kind of request: a row of the table of routes."""

    method: str
    path: str
    run: str  #: what answers it: a method of the service, without its underscore
    lane: str  #: where it is computed; empty: at once, from what is there; PROBES: in any case
    about: str
    answer: str  #: in words
    content: Mapping[str, Any]  #: of the answer
    parameters: Sequence[Declared] = ()
    body: Mapping[str, Any] = field(default_factory=dict)  #: media types
    problems: Sequence[int] = ()  #: besides those that follow from the rest
    status: int = 200
    needs_body: bool = False
    who: str = TOKEN  #: may ask
    limit: str = "max_body"  #: of what is sent, a field of :class:`Bounds`
    time: str = "seconds"  #: of an answer, another one

    def document(self) -> dict[str, Any]:
        """The operation object of OpenAPI."""
        parameters = [_path_of(name) for name in ("name", "id") if f"{{{name}}}" in self.path]
        common = {400, 401, 403, 405, *self.problems, *((404,) if "{" in self.path else ())}
        computed = self.lane not in ("", PROBES)
        for there, some in ((self.parameters, (404, 422)), (computed, (503, 504)),
                            (self.body, (408, 413, 415, 503))):  # fmt: skip
            common |= set(some) if there else set()
        ok = {"description": self.answer, **({"content": self.content} if self.content else {})}
        responses = {str(self.status): ok}
        content = {MEDIA: {"schema": {"$ref": "#/components/schemas/Problem"}}}
        for status in sorted(common):
            title = next(title for number, title in KINDS.values() if number == status)
            responses[str(status)] = {"description": title, "content": content}
        parameters += [_parameter(one) for one in self.parameters]
        out: dict[str, Any] = {"summary": self.about, "parameters": parameters}
        if self.body:
            out["requestBody"] = {"required": self.needs_body, "content": self.body}
        return out | {"responses": responses}


_PNG: Mapping[str, Any] = {"image/png": {}}
_OBJECT: Mapping[str, Any] = {"application/json": {"schema": {"type": "object"}}}
_LINES: dict[str, Any] = {"application/x-ndjson": {"schema": {"type": "string"}}}
#: A body of scans: its media types. One of JSON is one scan.
_SCAN_BODY: Mapping[str, Any] = _ref("LaserScan") | _BYTES
_ROWS = "A JSON object; of several scans, one a line."
_SENT: dict[str, Any] = {"status": 201, "needs_body": True}
TRACK = Operation(
    "websocket", "/v1/track", "track", "looks", "Follow a robot: a line in, a line out.", "", {},
    _TRACK, limit="message", time="silence",
)  # fmt: skip
#: The table of routes, but for the files of the page. "files" reads what is large, "looks" answers
#: what is small, "layers" draws, and "answers" is the core's own thread.
OPERATIONS = (
    Operation("get", "/healthz", "health", PROBES, "Whether the service runs.", "It runs.", _OBJECT,
              who=ALL),
    Operation("get", "/readyz", "ready", PROBES, "Whether all maps are prepared.",
              "All maps are prepared.", _OBJECT, problems=(503,), who=ALL),
    Operation("get", "/metrics", "metrics_text", PROBES, "Counts and times.", "Prometheus' text.",
              {"text/plain": {}}),
    Operation("get", "/v1/openapi.json", "document", "", "This document.", "OpenAPI 3.1.", _OBJECT),
    Operation("get", "/v1/maps", "list", "looks", "The maps of the service.", "Their list.",
              _OBJECT),
    Operation("post", "/v1/maps", "send_map", "files",
              "Send a map: its image, or a form with its image and YAML. Its id is a secret.",
              "The map, prepared.", _ref("Map"), UPLOAD, _MAP_BODY, **_SENT),
    Operation("get", "/v1/maps/{name}", "map", "looks", "A map, by its name or id.", "The map.",
              _ref("Map")),
    Operation("delete", "/v1/maps/{name}", "drop_map", "", "Forget a map that was sent.",
              "It is gone.", {}, problems=(409, 503), status=204, who=OWNER),
    Operation("get", "/v1/maps/{name}/image", "image", "looks",
              "A map as an image: occupied 0, unknown 205, free 254.", "PNG.", _PNG),
    Operation("post", "/v1/scans", "send_scans", "files",
              "Send a file of scans, to ask about them again and again. Its id is a secret.",
              "What is in it.", _ref("Scans"), (*_READ, _SCALE), _SCAN_BODY, **_SENT),
    Operation("get", "/v1/scans/{id}", "some_scans", "looks",
              "Scans that were sent, some at a time.", "Them.", _ref("Scans"), PAGE, who=OWNER),
    Operation("delete", "/v1/scans/{id}", "drop_scans", "", "Forget scans that were sent.",
              "They are gone.", {}, status=204, who=OWNER),
    Operation("post", "/v1/scans/{id}/marked", "marked", "files",
              "Some of these scans with poses that are known now, as `imgloc.save_scans` writes "
              "them.", "NPZ.", _BYTES, (), _ref("Marks"), (422,), needs_body=True, who=OWNER),
    Operation("post", "/v1/localize", "localize", "answers",
              "Where scans are on a map: the JSON of `imgloc localize`, with map and version.",
              _ROWS, _ref("Answer") | _LINES, LOCALIZE, _SCAN_BODY),
    Operation("post", "/v1/which", "which", "answers",
              "The map that scans are from: the JSON of `imgloc which`.", _ROWS,
              _ref("Choice") | _LINES, WHICH, _SCAN_BODY),
    Operation("post", "/v1/doubts", "doubts", "layers",
              "What most likely keeps a scan from fitting: the hints of `imgloc localize`.",
              "Sentences.", _OBJECT, DOUBTS, _SCAN_BODY),
    Operation("post", "/v1/score", "fit", "looks", "How a scan fits at a pose.", "The fit.",
              _ref("Fit"), FIT, _SCAN_BODY),
    Operation("post", "/v1/settle", "fit", "looks", "How a scan fits at the best pose nearby.",
              "The fit.", _ref("Fit"), FIT, _SCAN_BODY),
    *(
        Operation("get", f"/v1/layers/{name}", "feature", "layers", f"The {name} of a map.", "PNG.",
                  _PNG, (MAP,))
        for name in LAYERS
    ),
    Operation("get", "/v1/layers/likelihood", "likelihood", "layers",
              "A likelihood of all poses, at one heading or over all.", "PNG.", _PNG, LIKELIHOOD),
    Operation("get", "/v1/layers/atlas", "atlas", "layers",
              "Places where one scan of this laser is enough, some poses at a time.",
              "Some of the poses, and where to go on.", _OBJECT, ATLAS),
    Operation("get", "/v1/layers/visibility", "visibility", "looks", "The view from a place.",
              "A polygon.", _OBJECT, VISIBILITY),
    Operation("get", "/v1/layers/region", "region", "looks",
              "The cells of a region in white: an image for the option region of imgloc localize.",
              "PNG.", _PNG, (MAP, replace(_REGION, default=MISSING))),
)  # fmt: skip


def _parameter(one: Declared) -> dict[str, Any]:
    schema = schema_of(one) | ({} if one.default in (None, MISSING) else {"default": one.default})
    out: dict[str, Any] = {"name": one.name, "in": "query", "description": one.text}
    out["schema"] = schema
    if one.default is MISSING:
        out["required"] = True
    return out | ({"style": "form", "explode": False} if schema["type"] == "array" else {})


def _path_of(name: str) -> dict[str, Any]:
    schema = schema_of(declaration("", Annotated[str, NAME if name == "name" else ID]))
    return {"name": name, "in": "path", "required": True, "schema": schema}


def document(*, token: bool = False) -> dict[str, Any]:
    """The OpenAPI document; `token`: whether requests must carry one.

    Examples
    --------
    >>> sorted(document()["paths"]["/v1/maps"])
    ['get', 'post']
    """
    paths: dict[str, Any] = {}
    for one in OPERATIONS:
        paths.setdefault(one.path, {})[one.method] = one.document()
    about = "Where am I on this map? Metres, radians, map frame; poses are the sensor's."
    out: dict[str, Any] = {
        "openapi": "3.1.0",
        "info": {"title": "imgloc", "version": __version__, "description": about},
        "paths": paths,
        "components": {"schemas": dict(_SCHEMAS)},
    }
    if token:
        out["components"]["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
        out["security"] = [{"token": []}]
    return out
