"""LaserScan as `ros2 topic echo` and `rostopic echo` print it: YAML, a document a message."""

import logging
import re
from typing import Any

from imgloc.errors import ScanError
from imgloc.io.badlines import BadLines
from imgloc.io.files import PathLike, display
from imgloc.io.plainyaml import plain_yaml
from imgloc.io.scanset import MAX_RAYS, Entry, ScanSet, collect
from imgloc.io.text import read_text
from imgloc.io.textscans import plain_entry
from imgloc.options import MAX_BAD

_LOG = logging.getLogger("imgloc")
_MOST = 4 * MAX_RAYS  # values of a message: ranges and intensities
_MAP_KEYS = {"image", "resolution", "origin"}
_ALL = "print all of them: ros2 topic echo -f"
_LOST = re.compile(
    r"^A message was lost!!!\s*total count change:\s*(\d+)\s*total count:\s*\d+(---)?\n?",
    re.MULTILINE,
)
_SPOKEN = re.compile(r"^(\[(INFO|WARN|WARNING|ERROR)\]|WARNING:).*$", re.MULTILINE)  # by ROS


def read_echo(path: PathLike, *, max_bad: float = MAX_BAD) -> ScanSet:
    """Read scans from what ``ros2 topic echo -f /scan`` prints, or ``rostopic echo``.

    The names are those of sensor_msgs/LaserScan, as in
    :func:`~imgloc.io.textscans.read_jsonl`; ``---`` stands between messages. Broken messages are
    left out, up to the share `max_bad`, as is a last one that was cut off. ScanError also for
    arrays that were printed shortened, for what is not plain YAML, and for a map's YAML.
    """
    name = display(path)
    text = read_text(path)
    if lost := sum(int(count) for count, _ in _LOST.findall(text)):
        note = "%s: the recording lacks %d message(s), which ros2 topic echo lost"
        _LOG.warning(note, name, lost, extra={"code": "lost"})
    text = _SPOKEN.sub("", _LOST.sub("---\n", text))
    entries, bad = list[Entry](), BadLines(name, max_bad, "messages")
    documents = re.split(r"^---.*$", text, flags=re.MULTILINE)
    there = [document for document in documents if document.strip()]
    for k, document in enumerate(there):
        where, last = f"{name}: message {k}", bool(entries) and document is documents[-1]
        if document.count(",") + document.count("\n") > _MOST:  # cheap to count
            raise ScanError(f"{where}: too many values, expected at most {MAX_RAYS:,} readings")
        try:
            message = plain_yaml(document, where, ScanError, most=_MOST)
            entry = plain_entry(_checked(message, where), where)
            if last and len(entry["ranges"]) < len(entries[-1][1]["ranges"]):
                raise ScanError(f"{where}: cut off")
            entries.append((where, entry))
        except ScanError as error:
            bad.skip(error, where if last else "")
    return collect(entries, name, bad)


def _checked(message: Any, where: str) -> dict[str, Any]:
    """The fields of a message."""
    if not isinstance(message, dict) or "ranges" not in message:
        if isinstance(message, dict) and message.keys() >= _MAP_KEYS:
            hint = "this is a map's YAML: the order is MAP, then SCANS"
        else:
            hint = "expected the fields of a LaserScan, with ranges"
            hint += ": echo the whole topic, not a field of it" * isinstance(message, list)
        raise ScanError(f"{where}: {hint}")
    ranges = message["ranges"]
    if isinstance(ranges, list) and "..." in ranges[-1:]:
        raise ScanError(f"{where}: ranges: shortened after {len(ranges) - 1} readings; {_ALL}")
    if isinstance(ranges, str) and ranges.startswith("<"):  # by the option no-arr
        hint = f"{_ALL}, without its option no-arr"
        raise ScanError(f"{where}: ranges: left out, {ranges[:60]!r}; {hint}")
    return message
