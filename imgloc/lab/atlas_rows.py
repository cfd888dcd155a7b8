"""The atlas as CSV, one row for each pose, and the journal from which a survey continues."""

import csv
import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from imgloc.errors import OutputError
from imgloc.io.files import display, open_regular, reason
from imgloc.io.own import parse_json

COLUMNS = (
    "x", "y", "theta", "kind", "mass", "error", "turn", "twin_x", "twin_y", "twin_theta",
    "twin_mass", "places",
)  # fmt: skip
"""Map frame, metres and radians; kind is unique, ambiguous, no-match or wrong."""
_KIND = frozenset({"unique", "ambiguous", "no-match", "wrong"})
_ROW = [float] * 3 + [_KIND] + [(float, None)] * 6 + [float] * 2
_MOST = 1 << 26  # most bytes of a journal, ten times those of the largest atlas


def as_csv(rows: Sequence[Sequence[object]]) -> str:
    """Rows of :data:`COLUMNS` below their names. NaN is left empty.

    Examples
    --------
    >>> as_csv([(1.0, 2.5, 0.0, "unique", 1.0, 0.01, 0.0, None, None, None, 0.0, 1)]).split()[1]
    '1.0,2.5,0.0,unique,1.0,0.01,0.0,,,,0.0,1'
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([_plain(value) for value in row] for row in rows)
    return out.getvalue()


def _plain(value: object) -> object:
    lost = value is None or (isinstance(value, float) and not math.isfinite(value))
    return "" if lost else value


class Journal:
    """A file to which rows are appended, so that a survey can continue after a stop.

    Whole rows stay in the file whenever the program stops, even while it starts again. `key` has
    the parameters that decide the rows. An OutputError is raised if the file belongs to a survey
    with another key, or cannot be read or written.
    """

    def __init__(self, path: Path, key: Mapping[str, object]) -> None:
        self.path, head = path, (json.dumps(key, sort_keys=True) + "\n").encode()
        self.rows: list[list[object]] = []
        name = display(path)
        try:
            fd = open_regular(path, OutputError, "journal of an atlas", follow=False, write=True)
            self._file = os.fdopen(fd, "r+b")
            try:
                content = self._file.read(_MOST)
                if len(content) == _MOST:
                    raise ValueError("it is too long")
                if not content.startswith(head) and not head.startswith(content):
                    why = "begun with another map or other options; remove it, or go on with those"
                    raise OutputError(f"{name}: {why}")
                # A stop may have cut the last line, perhaps the only one. Only that line is lost.
                whole = content[: content.rfind(b"\n") + 1]
                lines = whole[len(head) :].splitlines()
                self.rows = [parse_json(line, _ROW) for line in lines]
                if any(len({value is None for value in row[7:10]}) > 1 for row in self.rows):
                    raise ValueError("half a twin")
                self._file.seek(len(whole))
                self._file.truncate()
                if not whole:
                    self._file.write(head)
                    self._file.flush()
            except BaseException:
                self._file.close()
                raise
        except (OSError, ValueError) as error:
            raise OutputError(
                f"{name}: cannot be used to go on from: {reason(error)}; remove it"
            ) from None

    def add(self, row: Sequence[object]) -> None:
        """Append a row, at once."""
        self.rows.append(list(row))
        line = json.dumps([None if _plain(v) == "" else v for v in row])
        self._file.write(f"{line}\n".encode())
        self._file.flush()

    def close(self) -> None:
        """Keep the file for the next time."""
        self._file.close()

    def remove(self) -> None:
        """Remove the file, because the survey is complete."""
        self._file.close()
        self.path.unlink()
