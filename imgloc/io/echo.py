"""LaserScan as `ros2 topic echo` and `rostopic echo` print it: YAML, a document a message."""

import re
from typing import Any

from imgloc.errors import ScanError
from imgloc.io.files import PathLike, display
from imgloc.io.plainyaml import plain_yaml
from imgloc.io.scanset import MAX_RAYS, Entry, ScanSet, collect
from imgloc.io.text import read_text
from imgloc.io.textscans import plain_entry

_MOST = 4 * MAX_RAYS  # values of a message: ranges and intensities
_MAP_KEYS = {"image", "resolution", "origin"}


def read_echo(path: PathLike) -> ScanSet:
    """Read scans from what ``ros2 topic echo -f /scan`` prints, or ``rostopic echo``.

    The names are those of sensor_msgs/LaserScan, as in
    :func:`~imgloc.io.textscans.read_jsonl`; ``---`` stands between messages. ScanError also for
    arrays that were printed shortened, for what is not plain YAML, and for a map's YAML.
    """
    name = display(path)
    text = read_text(path)
    entries: list[Entry] = []
    for document in re.split(r"^---.*$", text, flags=re.MULTILINE):
        if document.strip():
            where = f"{name}: message {len(entries)}"
            if document.count(",") + document.count("\n") > _MOST:  # cheap to count
                raise ScanError(f"{where}: too many values, expected at most {MAX_RAYS:,} readings")
            message = plain_yaml(document, where, ScanError, most=_MOST)
            entries.append((where, plain_entry(_checked(message, where), where)))
    return collect(entries, name)


def _checked(message: Any, where: str) -> dict[str, Any]:
    """The fields of a message, with numbers that YAML takes for words made numbers."""
    if not isinstance(message, dict) or "ranges" not in message:
        if isinstance(message, dict) and message.keys() >= _MAP_KEYS:
            hint = "this is a map's YAML: the order is MAP, then SCANS"
        else:
            hint = "expected the fields of a LaserScan, with ranges"
        raise ScanError(f"{where}: {hint}")
    ranges = message["ranges"]
    if isinstance(ranges, list) and "..." in ranges[-1:]:
        hint = "print all of them: ros2 topic echo -f"
        raise ScanError(f"{where}: ranges: shortened after {len(ranges) - 1} readings; {hint}")
    for key in ("angle_min", "angle_max", "angle_increment"):
        if isinstance(message.get(key), str):  # 5e-2 has no point: a string to YAML 1.1
            try:
                message[key] = float(message[key])
            except ValueError:
                continue  # refused where it is used
    return message
