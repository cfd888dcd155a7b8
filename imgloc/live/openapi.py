"""What the service answers, as data: parameters that it checks, and its OpenAPI 3.1 document."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from imgloc.__about__ import __version__
from imgloc.io.scanset import MAX_RAYS
from imgloc.live.parameters import PLACE, TURN, Flag, Number, Numbers, Parameter, Text, Word
from imgloc.live.problems import KINDS, MEDIA
from imgloc.live.requests import NAME, NAME_WORDS

_DEVIATION = (0.001, 3.2)  # radians that a heading may be off
_RADIUS = (0.01, 1e6)  # metres
_METHODS = ("fused", "cbml", "cbml-o", "ght", "ght-v", "beam")
STACKS = _METHODS[1:]
FILTERS = ("tracker", "grid", "particle")
LAYERS = ("bmap", "distance", "vmap")
_FILE = r"[^\x00-\x1f/\\]{1,200}"
_LIST = r"(\d{1,9}|\d{0,9}:\d{0,9}(:0{0,9}[1-9]\d{0,8})?)"
INDEX_WORDS = "indices from 0, ranges A:B (without B) or A:B:STEP, and commas between"
X_Y_YAW = Numbers(3, (PLACE, PLACE, TURN))

MAP = Parameter(
    "map",
    "Name of the map. Without it: the only one given at the start, or else the only one sent.",
    Text(NAME, 100, NAME_WORDS),
)
SCANS_ID = Parameter(
    "scans",
    "Scans that were sent before, instead of a body.",
    Text("[0-9a-f]{16}", 16, "an id"),
)
FILE = Parameter(
    "name",
    "Name of the file of scans. Its ending sets the format; without it the content decides.",
    Text(_FILE, 200, "a file name"),
)
INDEX = Parameter(
    "index",
    f"Only these scans of a file: {INDEX_WORDS}.",
    Text(f"{_LIST}(,{_LIST}){{0,99}}", 2000, INDEX_WORDS),
)
TOPIC = Parameter(
    "topic", "Laser to read from a log that has several.", Text(r"[!-~]{1,200}", 200, "a name")
)
FOV = Parameter(
    "fov_deg",
    "Angle from the first to the last ray, for a file that does not contain it.",
    Number(0.01, 360, "degrees"),
)
SCALE = Parameter("range_scale", "Metres that a range of 1 stands for.", Number(1e-6, 1e6), 1.0)
CUT = Parameter(
    "range_max", "Reach: a longer reading counts as no return.", Number(1e-3, 1e6, "metres")
)
SENSOR = Parameter(
    "sensor",
    "Pose of the sensor on the robot (x, y, yaw); answers then contain poses of the base.",
    Numbers(3, ((-5.0, 5.0), (-5.0, 5.0), TURN)),
)
FLIPPED = Parameter(
    "flipped", "The sensor is upside down: its angles run clockwise.", Flag(), False
)
TAKEN = (SCALE, CUT, SENSOR, FLIPPED)
READ = (FILE, TOPIC, FOV)
SCANS = (SCANS_ID, *READ, INDEX, *TAKEN)
HEADING = Parameter(
    "heading", "Only poses that face this heading, up to a deviation.",
    Numbers(1, (TURN, _DEVIATION)),
)  # fmt: skip
CLEARANCE = Parameter(
    "clearance",
    "Only poses at least this far from walls and unknown space: the radius of the robot.",
    Number(0, 1000, "metres"),
)
REGION = Parameter(
    "region", "Only poses in this polygon: x1, y1, x2, y2 and so on, map frame, metres.",
    Numbers(6, (PLACE,) * 200),
)  # fmt: skip
PRIOR = (
    Parameter(
        "near",
        "Only poses near this one: x, y, yaw, then radius and deviation of the heading.",
        Numbers(3, (PLACE, PLACE, TURN, _RADIUS, _DEVIATION)),
    ),
    HEADING,
    CLEARANCE,
    REGION,
)
METHOD = Parameter(
    "method", "Localization method; fused is the default of imgloc.", Word(_METHODS), "fused"
)
LOCALIZE = (
    MAP, *SCANS, *PRIOR, METHOD,
    Parameter("top", "Number of hypotheses to list.", Number(1, 1000, "hypotheses", whole=True)),
    Parameter("theta_step_deg", "Step between headings, degrees.", Number(0.5, 180, "degrees")),
    Parameter("exact", "Search by branch and bound, for fused and cbml.", Flag(), False),
)  # fmt: skip
WHICH = (*SCANS, HEADING, CLEARANCE)
FIT = (
    MAP, *SCANS,
    Parameter("pose", "Pose of the sensor: x, y, yaw, map frame.", X_Y_YAW, needed=True),
    Parameter("scale", "Factor of all ranges: evidence.scale of an answer.",
              Number(0.5, 2)),
    Parameter("thinner", "Metres that walls lose on each side: evidence.thinner.",
              Number(0, 10, "metres")),
    Parameter("bent", "Metres that pieces of wall stand off: evidence.bent.",
              Number(0, 1, "metres")),
)  # fmt: skip
UPLOAD = (
    Parameter("name", "Name of the map.", Text(NAME, 100, NAME_WORDS)),
    Parameter("resolution", "Metres per cell.", Number(0.001, 10, "metres")),
    Parameter("origin", "Pose of the lower-left corner: x, y, yaw.", X_Y_YAW),
    Parameter("mode", "How map_server reads greys.", Word(("trinary", "scale", "raw"))),
    Parameter(
        "semantics",
        "Whose map_server: thresholds and transparency.",
        Word(("nav2", "ros1")),
        "nav2",
    ),
    Parameter("occupied_thresh", "Occupancy from which a pixel is a wall.", Number(0, 1)),
    Parameter("free_thresh", "Occupancy up to which a pixel is free.", Number(0, 1)),
    Parameter("negate", "White pixels are walls.", Flag()),
    Parameter("allow_lossy", "Accept a JPEG or a lossy WebP.", Flag(), False),
)
UPLOAD_SCANS = (*READ, SCALE)
PAGE = (
    Parameter("start", "The first scan of the page.", Number(0, 1e9, "scans", whole=True), 0),
    Parameter("count", "Scans of the page.", Number(1, 200, "scans", whole=True), 20),
)
_HELD = Parameter("scans", "Scans that were sent before.", SCANS_ID.kind, needed=True)
LIKELIHOOD = (
    MAP, _HELD, INDEX, *TAKEN,
    Parameter("method", "Method of the likelihood.", Word(STACKS), "cbml"),
    Parameter("slice", "Number of the heading, or max for the best over all.",
              Text(r"max|\d{1,5}", 5, "a number, or max"), "max"),
)  # fmt: skip
ATLAS = (
    MAP, _HELD, INDEX, *TAKEN,
    Parameter("step", "Metres between two places.", Number(0.05, 1000, "metres"), 2.0),
    Parameter("headings", "Headings at each place.", Number(1, 72, whole=True), 1),
    Parameter("start", "First pose: next of the last answer.", Number(0, 1e9, whole=True), 0),
)  # fmt: skip
VISIBILITY = (
    MAP,
    Parameter("at", "x, y, map frame, metres.", Numbers(2, (PLACE, PLACE)), needed=True),
)
REGION_LAYER = (MAP, Parameter("region", REGION.about, REGION.kind, needed=True))
TRACK = (
    MAP, *TAKEN,
    Parameter("filter", "Filter that follows the robot.", Word(FILTERS), "tracker"),
    Parameter("seed", "Seed of the random numbers.", Number(0, 2**31, whole=True), 0),
    Parameter("start", "Rough pose at the beginning: x, y, yaw.", X_Y_YAW),
    Parameter("places", "Add the places of the belief to each line.", Flag(), False),
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


_SCHEMAS: Mapping[str, Any] = {
    "Problem": _object(
        "type title status detail",
        type={"type": "string", "enum": [f"urn:imgloc:problem:{kind}" for kind in KINDS]},
        title=_WORD, status=_WHOLE, detail=_WORD,
    ),
    "Pose": _object("x y theta", x=_NUMBER, y=_NUMBER, theta=_NUMBER),
    "LaserScan": {
        "type": "object",
        "description": "Names of sensor_msgs/LaserScan; metres and radians, counter-clockwise, 0 "
        "forward. In ranges null is no reading, 'inf' no return. Other keys may be null: missing.",
        "properties": {
            "ranges": {
                "type": "array",
                "minItems": 1,
                "maxItems": MAX_RAYS,
                "items": {"anyOf": [_NUMBER, {"type": "null"}, {"enum": ["inf", "-inf", "nan"]}]},
            },
            "angles": {
                "type": ["array", "null"], "items": _TURNED, "minItems": 1, "maxItems": MAX_RAYS,
            },
            "angle_min": _OR_NULL, "angle_max": _OR_NULL, "angle_increment": _OR_NULL,
            "range_min": {"type": ["number", "null"], "minimum": 0},
            "range_max": {"type": ["number", "null"], "exclusiveMinimum": 0},
            "stamp": {
                "description": "Seconds, or the stamp of a ROS message.",
                "anyOf": [
                    _NULL_NUMBER,
                    {"type": "object", "properties": {"sec": _NUMBER, "nanosec": _NUMBER}},
                ],
            },
            "odom": _GIVEN_POSE, "pose": _GIVEN_POSE, "mount": _GIVEN_POSE,
        },
        "required": ["ranges"],
    },
    "Map": _object(
        "name width height resolution origin uploaded version",
        name=_WORD, width=_WHOLE, height=_WHOLE, resolution=_NUMBER, origin=_AT, free_m2=_NUMBER,
        uploaded=_YES, version=_WORD, path={"type": ["string", "null"]},
        warnings=_WARNINGS,
    ),
    "Scans": _object(
        "id name scans readings poses odom stamps warnings",
        id=_WORD, name=_WORD, scans=_WHOLE, readings=_WHOLE, poses=_YES, odom=_YES, stamps=_YES,
        warnings=_WARNINGS,
    ),
    "Marks": {
        **_object(
            "poses",
            poses={
                "type": "array",
                "description": "Index of a scan, and the pose of its sensor: x, y, theta.",
                "minItems": 1,
                "items": {
                    "type": "array",
                    "prefixItems": [_INDEX, *(_METRES,) * 3],
                    "items": False, "minItems": 4, "maxItems": 4,
                },
            },
        ),
        "additionalProperties": False,
    },
    "Answer": _object(
        "index verdict pose hypotheses counts parameters",
        index=_WHOLE, verdict={"enum": ["unique", "ambiguous", "no-match", "invalid"]},
        pose={"oneOf": [_AT, {"type": "null"}]}, hypotheses=_SOME, elsewhere=_NUMBER,
        entropy=_NULL_NUMBER, explained=_NULL_NUMBER,
        protection={
            "type": "array",
            "items": {
                "type": "object",
                "properties": {
                    "share": _NUMBER, "metres": _NULL_NUMBER, "radians": _NULL_NUMBER,
                },
            },
        },
        counts=_ANY, timings_ms=_ANY, parameters=_ANY, warnings=_WARNINGS,
    ),
    "Choice": _object(
        "index verdict none maps", index=_WHOLE, verdict=_WORD, none=_NULL_NUMBER, maps=_SOME,
        warnings=_WARNINGS,
    ),
    "Fit": _object(
        "pose log_likelihood misfit explained counts rays",
        pose=_AT, log_likelihood=_NULL_NUMBER, per_reading=_NULL_NUMBER, best=_NUMBER,
        misfit=_NULL_NUMBER, explained=_NULL_NUMBER, stands=_YES, readings=_WHOLE, counts=_ANY,
        rays=_ANY, warnings=_WARNINGS,
    ),
}  # fmt: skip

_BINARY = {"type": "string", "format": "binary"}
_BYTES: dict[str, Any] = {"application/octet-stream": {"schema": _BINARY}}
_MAP_BODY: Mapping[str, Any] = {
    "multipart/form-data": {
        "schema": {
            "type": "object",
            "properties": {"image": _BINARY, "yaml": _BINARY},
            "required": ["image"],
            "additionalProperties": False,
        }
    },
    **_BYTES,
}


def _ref(name: str) -> dict[str, Any]:
    return {"application/json": {"schema": {"$ref": f"#/components/schemas/{name}"}}}


@dataclass(frozen=True)
class Operation:
    """What one request does."""

    path: str
    about: str
    answer: Mapping[int, tuple[str, Mapping[str, Any]]]  #: by status: in words, and its content
    parameters: Sequence[Parameter] = ()
    body: Mapping[str, Any] = field(default_factory=dict)
    method: str = "get"
    needs_body: bool = False
    problems: Sequence[int] = ()  #: besides those that every request may have

    def document(self) -> dict[str, Any]:
        """The operation object of OpenAPI."""
        parameters = [_path_of(name) for name in ("name", "id") if f"{{{name}}}" in self.path]
        parameters += [_parameter(one) for one in self.parameters]
        responses = {
            str(status): {"description": words, **({"content": content} if content else {})}
            for status, (words, content) in self.answer.items()
        }
        content = {MEDIA: {"schema": {"$ref": "#/components/schemas/Problem"}}}
        common = (400, 401, 403, 405, *self.problems)
        for status in sorted({*common, *((404, 422) if self.parameters else ())}):
            title = next(title for number, title in KINDS.values() if number == status)
            responses[str(status)] = {"description": title, "content": content}
        out: dict[str, Any] = {"summary": self.about, "parameters": parameters}
        if self.body:
            out["requestBody"] = {"required": self.needs_body, "content": self.body}
        return out | {"responses": responses}


_BODY, _LOOK = (408, 413, 415, 503, 504), (503, 504)  # problems of what has a body, of a look
_PNG: Mapping[str, Any] = {"image/png": {}}
_OBJECT: Mapping[str, Any] = {"application/json": {"schema": {"type": "object"}}}
_LINES: dict[str, Any] = {"application/x-ndjson": {"schema": {"type": "string"}}}


def _get(
    path: str, about: str, words: str, content: Mapping[str, Any],
    parameters: Sequence[Parameter] = (), problems: Sequence[int] = (),
) -> Operation:  # fmt: skip
    return Operation(path, about, {200: (words, content)}, parameters, problems=problems)


def _delete(path: str, about: str, words: str, *problems: int) -> Operation:
    return Operation(path, about, {204: (words, {})}, method="delete", problems=problems)


def _ask(
    name: str, about: str, words: str, content: Mapping[str, Any], parameters: Sequence[Parameter]
) -> Operation:
    """What is asked about scans, which are in the body or were sent before."""
    answer = {200: (words, content)}
    return Operation(f"/v1/{name}", about, answer, parameters, SCAN_BODY, "post", problems=_BODY)


def _send(
    path: str, about: str, answer: Mapping[int, tuple[str, Mapping[str, Any]]],
    parameters: Sequence[Parameter], body: Mapping[str, Any], *problems: int,
) -> Operation:  # fmt: skip
    """What needs a body."""
    return Operation(
        path, about, answer, parameters, body, "post", needs_body=True, problems=(*problems, *_BODY)
    )


#: A body of scans: its media types. One of JSON is one scan.
SCAN_BODY: Mapping[str, Any] = _ref("LaserScan") | _BYTES
_ROWS = "A JSON object; of several scans, one a line."
OPERATIONS = (
    _get("/healthz", "Whether the service runs.", "It runs.", _OBJECT),
    _get("/readyz", "Whether all maps are prepared.", "All maps are prepared.", _OBJECT,
         problems=(503,)),
    _get("/metrics", "Counts and times.", "Prometheus' text.", {"text/plain": {}}),
    _get("/v1/openapi.json", "This document.", "OpenAPI 3.1.", _OBJECT),
    _get("/v1/maps", "The maps of the service.", "Their list.", _OBJECT),
    _send("/v1/maps", "Send a map: its image, or a form with its image and YAML.",
          {201: ("The map, prepared.", _ref("Map"))}, UPLOAD, _MAP_BODY, 409),
    _get("/v1/maps/{name}", "A map.", "The map.", _ref("Map"), problems=(404, 503)),
    _delete("/v1/maps/{name}", "Forget a map that was sent.", "It is gone.", 404, 409, 503),
    _get("/v1/maps/{name}/image", "A map as an image: occupied 0, unknown 205, free 254.", "PNG.",
         _PNG, problems=(404, 503)),
    _send("/v1/scans", "Send a file of scans, to ask about them again and again.",
          {201: ("What is in it.", _ref("Scans"))}, UPLOAD_SCANS, SCAN_BODY),
    _get("/v1/scans/{id}", "Scans that were sent, some at a time.", "Them.", _ref("Scans"), PAGE,
         _LOOK),
    _delete("/v1/scans/{id}", "Forget scans that were sent.", "They are gone.", 404),
    _send("/v1/scans/{id}/marked",
          "Some of these scans with poses that are known now, as `imgloc.save_scans` writes them.",
          {200: ("NPZ.", _BYTES)}, (), _ref("Marks"), 404, 422),
    _ask("localize", "Where scans are on a map: the JSON of `imgloc localize`.", _ROWS,
         _ref("Answer") | _LINES, LOCALIZE),
    _ask("which", "The map that scans are from: the JSON of `imgloc which`.", _ROWS,
         _ref("Choice") | _LINES, WHICH),
    _ask("score", "How a scan fits at a pose.", "The fit.", _ref("Fit"), FIT),
    _ask("settle", "How a scan fits at the best pose nearby.", "The fit.", _ref("Fit"), FIT),
    *(
        _get(f"/v1/layers/{name}", f"The {name} of a map.", "PNG.", _PNG, (MAP,), _LOOK)
        for name in LAYERS
    ),
    _get("/v1/layers/likelihood", "A likelihood of all poses, at one heading or over all.", "PNG.",
         _PNG, LIKELIHOOD, _LOOK),
    _get("/v1/layers/atlas",
         "Places where one scan of this laser is enough, some poses at a time.",
         "Some of the poses, and where to go on.", _OBJECT, ATLAS, _LOOK),
    _get("/v1/layers/visibility", "The view from a place.", "A polygon.", _OBJECT, VISIBILITY,
         _LOOK),
    _get("/v1/layers/region",
         "The cells of a region in white: an image for the option region of imgloc localize.",
         "PNG.", _PNG, REGION_LAYER, _LOOK),
)  # fmt: skip


def _parameter(one: Parameter) -> dict[str, Any]:
    schema = one.kind.schema | ({} if one.default is None else {"default": one.default})
    out: dict[str, Any] = {"name": one.name, "in": "query", "description": one.about}
    out["schema"] = schema
    if one.needed:
        out["required"] = True
    return out | ({"style": "form", "explode": False} if schema["type"] == "array" else {})


def _path_of(name: str) -> dict[str, Any]:
    schema = {"type": "string", "pattern": f"^(?:{NAME})$" if name == "name" else "^[0-9a-f]{16}$"}
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
