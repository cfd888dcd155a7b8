"""The job ``check``: what is in a map, and what is likely to be wrong with it."""

from collections.abc import Iterator
from dataclasses import dataclass

from imgloc.io.mapcheck import check_bytes, check_map
from imgloc.io.maps import reading_of
from imgloc.runs.jobs import Answer, Item, Job
from imgloc.runs.opening import Desk, image_of, quiet_libraries


@dataclass(frozen=True, kw_only=True)
class Check(Job):
    """Report a map; one without walls or free space is reported, not refused."""

    name = "check"
    with_scans = False
    decided_by = frozenset()

    def open(self, item: Item, desk: Desk) -> Iterator[Answer]:
        """Look at a map, which is read once more if it is drawn."""
        path = item.path
        reading = reading_of(path, self.maps.reading) if self.maps.many else self.maps.reading
        size, what = image_of(path, reading)
        desk.check(check_bytes(size), what, "crop the map")
        with quiet_libraries():
            report = check_map(path, **reading)
        yield Answer(
            row=report.as_row(), of=report, doubtful=bool(report.warnings),
            drawn=("map", path, reading),
        )  # fmt: skip
