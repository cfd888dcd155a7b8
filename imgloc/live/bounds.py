"""Limits of a service on those who ask: declared once, also for the command line."""

from dataclasses import dataclass
from typing import Annotated

from imgloc.options import Bytes, Count
from imgloc.ranges import Checked, Within, option
from imgloc.texts import byte_count

MIB = 1 << 20
Seconds = Annotated[float, Within(0.05, 86_400, "seconds")]


@dataclass(frozen=True)
class Bounds(Checked):
    """Sizes, counts and times; options of commands have them in their texts."""

    seconds: Seconds = option(30.0, "Seconds after which an answer is given up.")
    patience: Seconds = option(
        15.0,
        "Seconds that a client has for the head of a request, for its body, and to take an answer.",
    )
    waiting: Annotated[int, Within(1, 10_000, "")] = option(
        16, "Requests that may wait for an answer; more are refused."
    )
    max_body: Bytes = option(
        64 * MIB, "Largest body of a request, such as 512K or 2M. [default: 64M]", parse=byte_count
    )
    pixels: Count = 25_000_000  #: of an uploaded map
    numbers: Count = 20_000_000  #: ranges, angles and more of an uploaded file of scans
    scans: Count = 200_000  #: of an uploaded file
    each: Count = 1000  #: scans that one request asks about
    message: Annotated[int, Within(1, 1 << 30, "bytes")] = 4 * MIB  #: a line of a WebSocket
    silence: Seconds = 600.0  #: until a robot that sends no line is followed no more
    connections: Count = 100
    sockets: Count = 16  #: robots that are followed
    held: Count = 8  #: uploaded maps, and files of scans
