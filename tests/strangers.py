"""A job of somebody else: what a file and a line in the table of jobs are enough for."""

from collections.abc import Iterator
from dataclasses import dataclass

from imgloc.runs.jobs import Answer, Item, Job
from imgloc.runs.opening import Desk


@dataclass(frozen=True, kw_only=True)
class Area(Job):
    """Say how many squares of a side of `step` metres the free cells of a map are."""

    name = "area"
    with_scans = False

    step: float = 1.0

    def open(self, item: Item, desk: Desk) -> Iterator[Answer]:
        """Count the cells of an item's map."""
        grid = desk.grid(item.path, self.maps)
        area = float(grid.free.sum()) * grid.resolution**2
        yield Answer(row={"size": {"squares": area / self.step**2}, "unit": "squares"})
