"""The status of a robot: where it is, how sure that is, and why, in one JSON object."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imgloc.answers.diagnose import few_readings
from imgloc.filters.belief import LOST
from imgloc.filters.follow import BLIND, STANDING, UNCONFIRMED, WIDE, Moment
from imgloc.geometry import transform_poses
from imgloc.live.policy import GIVEN_UP, QUIET, FirstPose
from imgloc.model import SURE, FloatArray, LaserScan, Localization, Pose2D, base_of, plain
from imgloc.options import Hint, Prior
from imgloc.search.priors import ranked
from imgloc.search.protection import SHARES, protection

HINTED = "hinted"
"""Word for why a pose is withheld that hints speak against."""
LISTED = 10  # places of a message at most
WHY = {
    BLIND: "blind: it sees nothing, or repeats an old scan",
    UNCONFIRMED: "unconfirmed: drive on, too few scans agree yet",
    STANDING: "the robot has not moved: drive on, or turn",
    HINTED: "hinted: poses on ~/hint speak against it",
    WIDE: "wide: the standard deviation is above the limit",
}
"""Sentences for why a pose is withheld."""
OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostic_msgs/DiagnosticStatus."""


@dataclass(frozen=True)
class Found:
    """An answer as the robot has it: poses of its base, map frame, best first."""

    stamp: float  #: of the scan, seconds
    map: str | None  #: name
    verdict: str
    poses: tuple[Pose2D, ...] = ()
    masses: tuple[float, ...] = ()
    covariance: FloatArray | None = None  #: (3, 3) of the first pose
    explained: float = math.nan  #: share of the readings that the first pose explains
    why: str = ""  #: a pose was withheld: a word of Moment
    readings: str = ""  #: why the scan is invalid, in words
    diagonal: float = math.inf  #: from corner to corner of the map, metres

    @property
    def pose(self) -> Pose2D | None:
        """The pose that can be relied upon: only if it is unique."""
        return self.poses[0] if self.verdict == "unique" else None

    @property
    def score(self) -> float:
        """VDA 5050's localizationScore: the mass of the first pose; 0 if nothing fits."""
        return self.masses[0] if self.masses and self.verdict in SURE else 0.0

    @property
    def deviation(self) -> float:
        """VDA 5050's deviationRange: the radius that holds the true position at 95 %, metres."""
        if self.covariance is None:
            return math.inf
        poses, mass = np.array([(p.x, p.y, p.theta) for p in self.poses]), np.array(self.masses)
        elsewhere = max(0.0, 1 - float(mass.sum()))
        about = poses, mass, self.covariance[None], elsewhere, SHARES[:1]
        return protection(*about, farthest=self.diagonal)[0].metres


def found_of(answer: Localization, stamp: float, name: str | None) -> Found:
    """An answer to one scan, whose `T_base_laser` is known."""
    mount = answer.T_base_laser or Pose2D(0.0, 0.0)
    listed = answer.hypotheses[:LISTED]
    poses = tuple(base_of(h.pose, mount) for h in listed)
    covariance = None
    if listed:
        covariance = base_covariance(listed[0].covariance, listed[0].pose, poses[0])
    masses = tuple(h.mass for h in listed)
    return Found(stamp, name, answer.verdict, poses, masses, covariance, answer.explained)


def found_blind(scan: LaserScan, name: str | None) -> Found:
    """Finding of a scan with too few readings: why."""
    return Found(scan.stamp, name, "invalid", readings=few_readings([scan]))


def found_along(
    moment: Moment, origin: Pose2D, name: str | None, scan: LaserScan | None = None
) -> Found:
    """Belief along the way; `origin` is that of the grid, in whose frame beliefs are.

    With the scan, a belief that has seen nothing has the reason.
    """
    if scan is not None and moment.withheld == BLIND and not len(moment.belief.poses):
        return found_blind(scan, name)
    belief = moment.belief
    rows = transform_poses(origin, belief.poses[:LISTED]).tolist()
    poses, masses = tuple(Pose2D(*row) for row in rows), tuple(belief.mass[:LISTED].tolist())
    verdict = "no-match" if belief.verdict == LOST else belief.verdict
    return Found(
        moment.stamp, name, verdict, poses, masses, moment.covariance if poses else None,
        why=moment.withheld, diagonal=moment.diagonal,
    )  # fmt: skip


def weighed(found: Found, hints: tuple[Hint, ...], sure: float) -> Found:
    """The same with the weights of hints of the base, map frame: see :func:`ranked`.

    A unique pose stays so only with a mass of `sure` after all.

    Examples
    --------
    >>> twins = Found(1.0, "hall", "ambiguous", (Pose2D(1.0, 0.0), Pose2D(9.0, 0.0)), (0.6, 0.4))
    >>> found = weighed(twins, (Hint(9.0, 0.0, 0.0, 0.5, 0.2),), 0.9)
    >>> found.poses[0].x, round(found.masses[0], 2), found.verdict
    (9.0, 0.87, 'ambiguous')
    """
    if not hints or not found.poses:
        return found
    rows = np.array([(p.x, p.y, p.theta) for p in found.poses])
    order, share = ranked(Prior(hints=(hints,)), rows, np.array(found.masses), 1.0)
    same, verdict, why = order[0] == 0, found.verdict, found.why
    if verdict == "unique" and not (same and share[0] >= sure):
        verdict, why = "ambiguous", HINTED
    return replace(
        found, verdict=verdict, why=why, poses=tuple(found.poses[k] for k in order),
        masses=tuple(share.tolist()), covariance=found.covariance if same else None,
    )  # fmt: skip


def base_covariance(covariance: FloatArray, sensor: Pose2D, base: Pose2D) -> FloatArray:
    """Sensor covariance (3, 3) moved to the base; both poses in one frame.

    Examples
    --------
    >>> turned = np.diag([0.0, 0.0, 0.01])  # 0.1 rad
    >>> base_covariance(turned, Pose2D(0.0, 0.0), Pose2D(-2.0, 0.0)).round(6).tolist()[1]
    [0.0, 0.04, -0.02]
    """
    J = np.eye(3)
    J[:2, 2] = sensor.y - base.y, base.x - sensor.x
    return np.asarray(J @ covariance @ J.T)


def status_row(
    found: Found | None, first: FirstPose, *, now: float, stands: bool, dropped: int, said: str,
    late: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """The object of ``~/status``: VDA 5050 3.0's words where it has them, then imgloc's.

    Parameters
    ----------
    found : Found, optional
        The last answer.
    first : FirstPose
        How far the first pose is.
    now : float
        Seconds, of the clock that stamps are of.
    stands : bool
        Whether a sure pose holds: it is followed, or the robot has not moved on.
    dropped : int
        Scans that were not looked at.
    said : str
        The sentence of the diagnostics.
    late : bool
        Whether scans, or what belongs to them, do not come in time.
    """
    one = found or Found(math.nan, None, "")
    # The other places, or all of them while none can be relied upon.
    places = list(zip(one.poses, one.masses, strict=True))
    pose = one.poses[0] if one.poses and stands else None
    why = "" if found is None or pose is not None else one.why or ("late" if late else "")
    row: dict[str, Any] = {
        "localized": pose is not None,
        "localizationScore": one.score,
        "deviationRange": None if pose is None else one.deviation,
        "mapId": one.map or "",
        **(dict.fromkeys(("x", "y", "theta")) if pose is None else plain(pose)),
        "verdict": one.verdict or None,
        "withheld": why,
        "state": first.state,
        "alternatives": [plain(p) | {"mass": mass} for p, mass in places[int(pose is not None) :]],
        **{name: getattr(one, name) for name in ("masses", "explained", "stamp")},
        "age": now - one.stamp,
        "tries": first.tries,
        "dropped": dropped,
        "message": said,
    }
    return dict(plain(row))


def health(
    first: FirstPose, found: Found | None, *, silent: Sequence[str], alive: bool,
    errors: Sequence[str], waits: str, track: bool, stands: bool = False,
) -> tuple[int, str]:  # fmt: skip
    """Level and sentence of the diagnostics.

    Parameters
    ----------
    first, found : FirstPose, Found, optional
    silent : sequence of str
        Lasers that are silent.
    alive : bool
        Whether another one does.
    errors : sequence of str
        Why maps cannot be used.
    waits : str
        What is lacking before a scan can be looked at; nothing if all is there.
    track : bool
        Whether the robot is followed, and its filter has had a pose.
    stands : bool
        Whether that pose holds.

    Examples
    --------
    >>> health(FirstPose(), None, silent=["/scan"], alive=False, errors=[], waits="",
    ...        track=False)
    (3, 'no scans on /scan')
    """
    if errors:
        return ERROR, "; ".join(errors)
    if silent:
        return (WARN if alive else STALE), f"no scans on {', '.join(silent)}"
    if waits:
        return WARN, waits
    last = "no answer yet" if found is None else f"the last scan is {found.verdict}"
    if found is not None and (why := found.readings or WHY.get(found.why, found.why)):
        last += f": {why}"
    if track and found is not None:
        return (OK, "the pose is unique") if stands else (WARN, last)
    if first.state == QUIET:
        return OK, "the pose was published"
    if first.state == GIVEN_UP:
        hint = "drive on and call ~/localize, or give a pose"
        if found is not None and found.readings:
            hint = "mend what the laser sends, then call ~/localize"
        return WARN, f"gave up after {first.tries} scans: {last}; {hint}"
    return WARN, f"{first.state}: {last}"
