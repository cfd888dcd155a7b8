"""Answers as JSON and as text for people."""

import json
import math
from collections.abc import Mapping
from typing import Any

from imgloc.cli.tables import as_plain
from imgloc.geometry import base_of
from imgloc.model import Localization, Pose2D

SURE = ("unique", "ambiguous")
"""Verdicts under which there is a pose to be named; the others list what fits best at most."""


def as_json(
    index: int,
    answer: Localization,
    more: Mapping[str, object],
    mount: Pose2D | None = None,
) -> str:
    """Return one line of JSON for one scan.

    Parameters
    ----------
    index : int
        Of the scan in its file.
    answer : Localization
    more : mapping
        Joined to the answer's parameters.
    mount : Pose2D, optional
        Pose of the sensor on the robot; None if it is not known. ``base_pose`` is the robot's.

    Examples
    --------
    >>> line = as_json(3, Localization((), "invalid", 0.0, float("nan")), {})
    >>> line[:52], '"explained": null' in line
    ('{"index": 3, "verdict": "invalid", "pose": null, "ba', True)
    """
    pose = answer.pose if answer.verdict in SURE else None
    row = {
        "index": index,
        "verdict": answer.verdict,
        "pose": as_pose(pose),
        "base_pose": None if pose is None or mount is None else _pose(base_of(pose, mount)),
        "hypotheses": [
            _pose(h.pose)
            | {"mass": h.mass, "log_likelihood": h.log_likelihood}
            | {"covariance": h.covariance.tolist()}
            | ({} if mount is None else {"base": _pose(base_of(h.pose, mount))})
            for h in answer.hypotheses
        ],
        "elsewhere": answer.elsewhere,
        "complete": answer.complete,
        "entropy": answer.entropy,
        "explained": answer.explained,
        "counts": answer.counts,
        "timings_ms": {key: round(ms, 3) for key, ms in answer.timings_ms.items()},
        "parameters": {**answer.parameters, **more},
    }
    return to_json(row)


def to_json(row: Mapping[str, object]) -> str:
    """Return one line of JSON; what is not finite becomes null."""
    return json.dumps(plain(row), allow_nan=False)


def plain(value: Any) -> Any:
    """Return `value` as JSON knows it: what is not finite becomes null.

    Examples
    --------
    >>> plain({"a": (1.5, float("inf"))})
    {'a': [1.5, None]}
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy's scalars and arrays
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def header(mount: Pose2D | None = None) -> str:
    """Return what stands above the lines of :func:`as_line`."""
    place = f"{'x / m':>10} {'y / m':>10} {'theta / deg':>12}"
    base = f"  {'base x':>10} {'base y':>10} {'base theta':>12}"
    return (
        f"{'index':>6}  {'verdict':<10} {place} {'mass':>8} {'explained':>10}"
        f"{'' if mount is None else base}"
    )


def as_line(index: int, answer: Localization, mount: Pose2D | None = None) -> str:
    """Return one line of text for one scan, to stand below :func:`header`.

    Parameters
    ----------
    index : int
        Of the scan in its file.
    answer : Localization
    mount : Pose2D, optional
        Pose of the sensor on the robot, to state the robot's.
    """
    start = f"{index:>6}  {answer.verdict:<10} "
    late = "" if answer.complete else "  out of time"
    if answer.pose is None:
        base = "" if mount is None else f"  {'-':>10} {'-':>10} {'-':>12}"
        return start + f"{'-':>10} {'-':>10} {'-':>12} {'-':>8} {'-':>10}{base}{late}"
    mass = answer.hypotheses[0].mass
    base = "" if mount is None else f"  {_columns(base_of(answer.pose, mount))}"
    return start + (
        f"{_columns(answer.pose)} {100 * mass:6.1f} % {100 * answer.explained:8.1f} %{base}{late}"
    )


def _columns(pose: Pose2D) -> str:
    return f"{pose.x:10.3f} {pose.y:10.3f} {math.degrees(pose.theta):12.2f}"


def as_text(
    title: str, answer: Localization, truth: Pose2D | None = None, mount: Pose2D | None = None
) -> str:
    """Return what is known about one scan, with a table of its hypotheses.

    Parameters
    ----------
    title : str
    answer : Localization
    truth : Pose2D, optional
        True pose in the map frame, to state the error.
    mount : Pose2D, optional
        Pose of the sensor on the robot, to state the robot's.
    """
    counts = ", ".join(f"{n} {key.replace('_', ' ')}" for key, n in answer.counts.items())
    times = ", ".join(f"{key} {ms:.0f} ms" for key, ms in answer.timings_ms.items())
    lines = [f"{title}: {answer.verdict}" + ("" if answer.complete else ", out of time")]
    if answer.pose is not None:
        sure = answer.verdict in SURE
        lines.append(f"  {'pose      ' if sure else 'best guess'} {describe(answer.pose)}")
        if not sure:
            lines.append("             not to be trusted: the map does not explain the scan there")
        if mount is not None:
            lines.append(f"  base       {describe(base_of(answer.pose, mount))}")
    if truth is not None:
        lines.append(f"  truth      {describe(truth)}")
    if truth is not None and answer.pose is not None:
        away, turned = difference(answer.pose, truth)
        lines.append(f"  error      {away:.3f} m, {math.degrees(turned):.2f} deg")
    if answer.pose is not None:
        lines.append(
            f"  trust      {100 * answer.explained:.0f} % of the rays explained, "
            f"entropy {answer.entropy:.3f} nats"
        )
    lines += [f"  readings   {counts}", f"  time       {times}"]
    if answer.hypotheses:
        lines += ["", _table(answer)]
    return "\n".join(lines)


def describe(pose: Pose2D) -> str:
    """Return a pose in words.

    Examples
    --------
    >>> describe(Pose2D(1.0, -2.0, 0.5))
    'x 1.000 m, y -2.000 m, theta 28.65 deg'
    """
    return f"x {pose.x:.3f} m, y {pose.y:.3f} m, theta {math.degrees(pose.theta):.2f} deg"


def difference(a: Pose2D, b: Pose2D) -> tuple[float, float]:
    """Distance in metres and angle in radians, 0..pi, between two poses."""
    return math.hypot(a.x - b.x, a.y - b.y), abs(Pose2D(0.0, 0.0, a.theta - b.theta).theta)


def as_pose(pose: Pose2D | None) -> dict[str, float | list[list[float]]] | None:
    """A pose as plain values; None stays None."""
    return None if pose is None else _pose(pose)


def _pose(pose: Pose2D) -> dict[str, float | list[list[float]]]:
    return {"x": pose.x, "y": pose.y, "theta": pose.theta}


def _table(answer: Localization) -> str:
    """Hypotheses, best first, as plain text."""
    columns = ("#", "mass", "x / m", "y / m", "theta / deg", "+- xy / m", "+- deg", "log L")
    rows = []
    for k, h in enumerate(answer.hypotheses, start=1):
        xy, turn = h.covariance[0, 0] + h.covariance[1, 1], h.covariance[2, 2]
        row = (
            str(k),
            f"{100 * h.mass:.1f} %",
            f"{h.pose.x:.3f}",
            f"{h.pose.y:.3f}",
            f"{math.degrees(h.pose.theta):.2f}",
            f"{math.sqrt(max(0.0, xy)):.3f}",
            f"{math.degrees(math.sqrt(max(0.0, turn))):.2f}",
            f"{h.log_likelihood:.1f}",
        )
        rows.append(row)
    return as_plain(columns, rows)
