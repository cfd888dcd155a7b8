"""Bodies of requests to maps and scans: limited before anything is decoded; no path is a client's.

>>> body = b'{"ranges": [1.0, null, "inf"], "angle_min": 0.0, "angle_increment": 0.1}'
>>> sent = scans_of(body, "application/json", "", Bounds())
>>> sent.scans[0].ranges.tolist(), sent.warnings
([1.0, nan, inf], ())
"""

import json
import logging
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, cast

import numpy as np

from imgloc.errors import MapError, OutputError, ScanError, printable
from imgloc.features.budget import scans_bytes
from imgloc.io.badlines import warned
from imgloc.io.files import reason
from imgloc.io.maps import map_of_bytes
from imgloc.io.mapyaml import MAX_YAML_BYTES, parse_map_yaml
from imgloc.io.own import parse_json
from imgloc.io.scans import SCAN_ENDINGS, load_scans, scans_size
from imgloc.io.scanset import MAX_RAYS, ScanSet
from imgloc.io.textscans import MAX_LINE, read_jsonl_line
from imgloc.live.bounds import MIB, Bounds
from imgloc.live.problems import Refused
from imgloc.model import LaserScan, OccupancyGrid
from imgloc.options import Reading
from imgloc.ranges import Matches
from imgloc.runs.opening import ScanFiles

JSON, FORM = "application/json", "multipart/form-data"
_ENDINGS = (*SCAN_ENDINGS, ".yaml", ".yml")
#: What a map may be called.
NAME = Matches(
    r"[A-Za-z0-9][A-Za-z0-9._ -]*", 100,
    "letters, digits, dots, spaces, _ and -, at most 100, a letter or digit first",
)  # fmt: skip
_PARTS = 8  # of a form
_PIECE = 1 << 16  # characters that are counted in one go
# What the parser logs of a form that is damaged, the refusal tells the client.
logging.getLogger("python_multipart").addHandler(logging.NullHandler())


class Part(NamedTuple):
    """A part of a form."""

    name: str
    file: str  #: the name of the file; empty if it is none
    data: bytes


class Sent(NamedTuple):
    """The scans of a body."""

    scans: ScanSet
    warnings: tuple[str, ...] = ()  #: what was left out of it or taken for granted, a sentence each


def kind_of(content_type: str) -> str:
    """The media type without its parameters, in small letters."""
    return content_type.partition(";")[0].strip().lower()


def parts_of(body: bytes, content_type: str) -> list[Part]:
    r"""The parts of a form, at most eight.

    Examples
    --------
    >>> body = b'--x\r\nContent-Disposition: form-data; name="a"\r\n\r\n12\r\n--x--\r\n'
    >>> parts_of(body, "multipart/form-data; boundary=x")
    [Part(name='a', file='', data=b'12')]
    """
    from python_multipart.exceptions import FormParserError
    from python_multipart.multipart import FormParser, parse_options_header

    _, options = parse_options_header(content_type.encode("latin-1", "replace"))
    found, ends = list[Part](), list[bool]()

    def keep(name: bytes | None, file: bytes, data: bytes | None) -> None:
        if len(found) >= _PARTS:
            raise Refused("bad-request", f"the form has more than {_PARTS} parts")
        texts = [(text or b"").decode("utf-8", "replace") for text in (name, file)]
        found.append(Part(texts[0], texts[1], data or b""))

    def field(one: Any) -> None:
        keep(one.field_name, b"", one.value)

    def file(one: Any) -> None:
        keep(one.field_name, one.file_name, one.file_object.getvalue())

    try:
        in_memory = {"MAX_MEMORY_FILE_SIZE": len(body)}
        parser = FormParser(
            FORM, field, file, lambda: ends.append(True), options[b"boundary"], config=in_memory
        )
        parser.write(body)
        parser.finalize()
    except (KeyError, FormParserError, ValueError):
        raise Refused("bad-request", "the body is no form (multipart/form-data)") from None
    if not ends:
        raise Refused("bad-request", "the form is cut: its last boundary is missing")
    return found


def shown(name: str) -> str:
    r"""The last part of a file's name, as it may stand in a message; `body` without one.

    Examples
    --------
    >>> shown("C:\\logs\\a.log"), shown("../../etc/passwd"), shown("")
    ('a.log', 'passwd', 'body')
    """
    last = re.split(r"[/\\]", name)[-1]
    return printable(last, keep="")[:100] or "body"


def scans_of(
    body: bytes, content_type: str, name: str, bounds: Bounds, *, budget: int | None = None,
    topic: str | None = None, fov: float | None = None,
) -> Sent:  # fmt: skip
    """The scans of a body: a LaserScan as JSON, or any file of scans, also as a part of a form.

    The ending of its `name` sets the format; without one the content does. Reading takes at most
    `budget` bytes of memory. `topic` and `fov` (radians) are those of :func:`imgloc.load_scans`.
    """
    if not body:
        raise ScanError("the body is empty, expected a scan or a file of scans")
    kind = kind_of(content_type)
    if kind == FORM:
        parts = [part for part in parts_of(body, content_type) if part.file or part.name == "file"]
        if len(parts) != 1:
            raise Refused("bad-request", f"the form has {len(parts)} files, expected one, of scans")
        body, name = parts[0].data, name or parts[0].file
    elif kind == JSON:
        return Sent(_scan_of(body))
    label, ending = shown(name), PurePosixPath(shown(name)).suffix.lower()
    with TemporaryDirectory(prefix="imgloc-") as folder:
        path = Path(folder, "scans" + (ending if ending in _ENDINGS else ""))
        try:
            path.write_bytes(body)
        except OSError as error:
            raise OutputError(f"{label}: cannot be kept for reading: {error.strerror}") from None
        try:
            size = scans_size(path, topic=topic)
            for count, most, what in (
                (size.scans, bounds.scans, "scans"), (size.numbers, bounds.numbers, "numbers"),
            ):  # fmt: skip
                if count > most:
                    found = f"{count:,} {what}"
                    raise Refused("too-large", f"{label}: up to {found}, expected at most {most:,}")
            need = scans_bytes(size.scans, size.numbers, size.file_bytes, text=size.text)
            if budget is not None and need > budget:
                found = f"{-(-need // MIB)} MiB of memory, of {budget // MIB}"
                raise Refused("too-large", f"{label}: reading it takes {found}; send fewer scans")
            with warned() as texts:
                scans = load_scans(path, topic=topic, fov=fov)
            return Sent(scans, tuple(text.replace(str(path), label) for text in texts))
        except (ScanError, MapError) as error:
            raise type(error)(str(error).replace(str(path), label)) from None


def marked_of(body: bytes, scans: ScanSet) -> ScanSet:
    """The scans that a body marks with the poses of their sensors, map frame.

    Examples
    --------
    >>> from imgloc.model import LaserScan
    >>> scans = ScanSet((LaserScan([1.0], [0.0]), LaserScan([2.0], [0.0])))
    >>> marked_of(b'{"poses": [[1, 3.5, -2, 0.5]]}', scans).poses.tolist()
    [[3.5, -2.0, 0.5]]
    """
    try:
        rows = parse_json(body, {"poses": [[float, float, float, float]]})["poses"]
    except ValueError as error:
        raise Refused("bad-request", f"body: {reason(error)}") from None
    for k, row in enumerate(rows):
        if row[0] % 1:  # 1.0 is a whole number, too
            got = f"body: poses.{k}.0: got {row[0]}, expected a whole number"
            raise Refused("bad-request", got)
    indices = [int(row[0]) for row in rows]
    if not rows or len(set(indices)) != len(rows) or not all(0 <= k < len(scans) for k in indices):
        some = f"each once, 0 to {len(scans) - 1}"
        raise ScanError(f"poses: expected indices of scans, {some}")
    return replace(scans.take(indices), poses=np.array([row[1:] for row in rows]))


def read_line(text: str, where: str) -> ScanSet:
    """The scan of a line of JSON, which no thread can interrupt: a long one is refused before."""
    commas = sum(text.count(",", k, k + _PIECE) for k in range(0, len(text), _PIECE))
    if commas > (most := 4 * MAX_RAYS):  # ranges, angles, intensities, and the rest
        raise Refused("too-large", f"{where}: {commas:,} values, expected at most {most:,}")
    if (found := read_jsonl_line(text, where)) is None:
        raise ScanError(f"{where}: ranges: missing, expected a scan")
    return found


_STEPS, _TURNS = ("angle_min", "angle_max", "angle_increment"), 4 * math.pi  # radians


def _scan_of(body: bytes) -> ScanSet:
    """The scan of a JSON object."""
    if len(body) > MAX_LINE:
        raise Refused("too-large", f"body: {len(body):,} bytes, expected at most {MAX_LINE:,}")
    try:
        text = body.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ScanError(f"body: byte {error.start} is not UTF-8 text") from None
    scan = read_line(text, "body")
    given = json.loads(text)
    for key in (*_STEPS, "range_min", "range_max"):  # also where the angles make a step needless
        value, most = given.get(key), math.inf if key[0] == "r" else _TURNS
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if value is not None and not (number and abs(value) <= most):
            expected = "metres" if key[0] == "r" else "radians, at most two turns"
            raise ScanError(f"body: {key}: got {value!r:.100}, expected {expected}")
    return scan


def taken(scan: LaserScan, how: Mapping[str, Any]) -> LaserScan:
    """The scan as it was taken by the parameters: its reach, and how the sensor sits."""
    files = ScanFiles(
        scale=how.get("range_scale") or 1.0, range_max=how.get("range_max"),
        flipped=bool(how.get("flipped")), mount=how.get("sensor"),
    )  # fmt: skip
    return files.mounted(scan)


def map_of(
    body: bytes, content_type: str, name: str, bounds: Bounds, how: Mapping[str, Any]
) -> tuple[str, OccupancyGrid]:
    """The map of a body, and its name: an image, or a form with an image and perhaps its YAML.

    The YAML's `image:` is a name: nothing is opened by it. It must be that of the image.
    """
    image, yaml, files = body, None, [name]
    if kind_of(content_type) == FORM:
        parts = {part.name: part for part in parts_of(body, content_type)}
        if "image" not in parts or parts.keys() - {"image", "yaml"}:
            some = ", ".join(sorted(repr(shown(key)) for key in parts)) or "none"
            raise Refused("bad-request", f"the form has the parts {some}, expected image and yaml")
        image, files = parts["image"].data, [parts["image"].file]
        if "yaml" in parts:
            yaml = parts["yaml"].data
            _check_yaml(yaml, parts["yaml"].file, files[0])
            files.insert(0, parts["yaml"].file)
    if not image:
        raise MapError("the image is empty, expected that of a map")
    name = name or _called(files)
    if not NAME.admits(name):
        raise MapError(f"name: got {shown(name)!r}, expected {NAME}")
    given = {key: how.get(key) for key in Reading.__annotations__}
    reading = cast(Reading, given | {"max_pixels": bounds.pixels})
    lossy = bool(how.get("allow_lossy"))
    return name, map_of_bytes(image, yaml, name, allow_lossy=lossy, **reading)


def _called(files: Sequence[str]) -> str:
    r"""The name of a map of some files: that of its file; one that is called map as its folder.

    >>> _called(["map.yaml", "hall.png"]), _called(["c:\\lab\\map.yaml", "map.png"]), _called([""])
    ('hall', 'lab', 'map')
    """
    parts = [re.split(r"[/\\]", file)[-2:] for file in files]
    names = [name for *folder, file in parts for name in (PurePosixPath(file).stem, *folder)]
    return next((name for name in names if name not in ("", "map")), "map")


def _check_yaml(yaml: bytes, file: str, image: str) -> None:
    """Refuse a YAML that is too long, or of another image than the one beside it."""
    label = shown(file) if file else "yaml"
    if len(yaml) > MAX_YAML_BYTES:
        found = f"{len(yaml):,} bytes, expected a map YAML of at most {MAX_YAML_BYTES:,}"
        raise MapError(f"{label}: {found}")
    said = shown(parse_map_yaml(yaml, Path(label)).image.name)
    if image and said != shown(image):
        found = f"image: it is of {said!r}, the image that came with it is {shown(image)!r}"
        raise MapError(f"{label}: {found}; send the two that belong together")
