"""The options of commands that locate recorded scans in maps: how these are read."""

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, TypeVar

from imgloc.options import Chosen, Logs, Mounting

if TYPE_CHECKING:
    from imgloc.runs.opening import ScanFiles

Part = TypeVar("Part", Logs, Chosen, Mounting)


@dataclass(frozen=True)
class Recorded(Mounting, Chosen, Logs):
    """How files of scans are read, which of their scans, and how the sensor sits."""

    @property
    def files(self) -> "ScanFiles":
        """How a job reads them."""
        from imgloc.cli import inputs

        return inputs.as_recorded(self._of(Logs), self._of(Chosen), self._of(Mounting))

    @property
    def as_they_are(self) -> bool:
        """True if nothing is stated but which scans are looked at."""
        return (self._of(Logs), self._of(Mounting)) == (Logs(), Mounting())

    def _of(self, kind: type[Part]) -> Part:
        return kind(**{part.name: getattr(self, part.name) for part in fields(kind)})
