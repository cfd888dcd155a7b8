"""The pose that a robot had when it was switched off, checked by a scan when it starts again.

Nobody knows how long it was off and whether it was carried meanwhile, so one scan is looked for on
the whole map, as if nothing were known. Only a pose that is restored is published at once:

=========  =====================================================================================
restored   the scan is sure of one place, and it is the remembered one; very sure, if the map is
           another one since
moved      the map is the same, and the scan alone is very sure of another place
refused    else: what is remembered counts for nothing
=========  =====================================================================================

>>> pose = '"pose": {"x": 3.0, "y": 2.0, "theta": 0.0}'
>>> Kept.read(f'{{"map": "hall", "identity": "5f", {pose}, "stamp": 1.5}}'.encode(), "robot.json")
Kept(map='hall', identity='5f', pose=Pose2D(x=3.0, y=2.0, theta=0.0), stamp=1.5)
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from imgloc.errors import ConfigError
from imgloc.filters.belief import one_place
from imgloc.io.calibration import map_hash
from imgloc.io.files import PathLike, display, is_folder, is_there, read_file, write_text_atomic
from imgloc.io.own import parse_json
from imgloc.live.policy import alone
from imgloc.model import Localization, OccupancyGrid, Pose2D, base_of

RESTORED, MOVED, REFUSED = OUTCOMES = ("restored", "moved", "refused")
_PLACE = {"x": float, "y": float, "theta": float}
_KIND: dict[str, Any] = {"map": str, "identity": str, "pose": _PLACE, "stamp": float}
_MOST = 1 << 16  # bytes


def identity(grid: OccupancyGrid) -> str:
    """Identity of a map: its cells, resolution and origin."""
    return f"{map_hash(grid)} {grid.origin.x:.6g} {grid.origin.y:.6g} {grid.origin.theta:.6g}"


@dataclass(frozen=True)
class Kept:
    """A sure pose of the robot's base, and on which map it was."""

    map: str  #: name
    identity: str  #: of :func:`identity`
    pose: Pose2D  #: map frame
    stamp: float  #: of its scan, seconds

    @classmethod
    def read(cls, data: bytes, name: str) -> "Kept":
        """It of its text; a ConfigError, which names the file, of anything else."""
        try:
            found = parse_json(data, _KIND)
        except ValueError as error:
            expected = "expected a pose that imgloc has remembered; remove it, or name another file"
            raise ConfigError(f"{name}: {error}; {expected}") from None
        return cls(**{name: found[name] for name in _KIND} | {"pose": Pose2D(**found["pose"])})

    def save(self, path: PathLike) -> None:
        """Write it: a reader sees the old file or the new one, never half of it."""
        write_text_atomic(path, json.dumps(asdict(self)) + "\n", force=True)


def load_kept(path: PathLike) -> Kept | None:
    """Pose that a file remembers; None if there is no file yet, in a folder that there is."""
    name = display(path)
    if not is_there(path):
        if not is_folder(Path(path).parent):
            raise ConfigError(f"{name}: its folder is not there, expected one to write it to")
        return None
    return Kept.read(read_file(path, limit=_MOST, error=ConfigError, what="file"), name)


def checked(kept: Kept, answer: Localization, map_identity: str) -> tuple[str, Pose2D | None]:
    """Return whether a remembered pose holds, by the answer of a first scan on the whole map.

    Parameters
    ----------
    kept : Kept
    answer : Localization
        Of a scan whose `T_base_laser` is known.
    map_identity : str
        Of the map of the answer.

    Returns
    -------
    (str, Pose2D or None)
        ``restored``, ``moved`` or ``refused``, and where the robot's base is, map frame.
    """
    if answer.verdict != "unique":
        return REFUSED, None
    pose = base_of(answer.hypotheses[0].pose, answer.T_base_laser or Pose2D(0.0, 0.0))
    same, there = kept.identity == map_identity, one_place(kept.pose, pose)
    if (same and there) or ((same or there) and alone(answer)):
        return RESTORED if there else MOVED, pose
    return REFUSED, None
