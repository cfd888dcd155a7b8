"""A track as a file for Foxglove: MCAP with Foxglove's own schemas, by foxglove-sdk.

======================== ==================== ====================================================
topic                    schema               what it has
======================== ==================== ====================================================
``/map``                 foxglove.Grid        the map, once
``/scan``                foxglove.LaserScan   each scan at the best place, whatever the verdict;
                                              of several lasers each has a topic of its own
``/imgloc/hypotheses``   PosesInFrame         every place, best first
``/imgloc/pose``         PoseInFrame          the pose while it is unique, and at no other time
``/tf``                  FrameTransform       ``map`` to ``base_link``, at the same times
``/imgloc/verdict``      foxglove.Log         unique, ambiguous or lost, and why
``/imgloc/track``        JSON                 the row of `imgloc track --json`
======================== ==================== ====================================================
"""

import importlib
import math
import tempfile
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from imgloc.errors import OutputError
from imgloc.filters.belief import UNIQUE
from imgloc.filters.follow import Moment
from imgloc.geometry import transform_poses
from imgloc.io.files import PathLike, display, write_bytes_atomic
from imgloc.io.lasers import scan_topics
from imgloc.model import FloatArray, LaserScan, OccupancyGrid, Pose2D, compose
from imgloc.output.rows import moment_row

_MAP, _BASE = "map", "base_link"
_LATEST = 2**32 - 1  # seconds of a stamp at most: it has 32 bits
_GREYS = {"free": (255, 255, 255, 255), "occupied": (40, 40, 40, 255)}  # unknown is clear
_LISTED = 20  # places of a message at most
_RAYS = 20_000  # of an uneven scan at most


class Recording:
    """The file of a track while it is made; written whole or not at all.

    Parameters
    ----------
    grid : OccupancyGrid
    lasers : iterable of str
        Of which laser each scan is.

    Raises
    ------
    OutputError
        If foxglove-sdk is not installed; from :meth:`add`, if a stamp is no time that MCAP has.
    """

    def __init__(self, grid: OccupancyGrid, lasers: Iterable[str] = ()) -> None:
        try:
            names = ("foxglove", "foxglove.channels", "foxglove.messages", "foxglove.mcap")
            sdk, channels, made, mcap = map(importlib.import_module, names)
        except ImportError:
            need = "MCAP needs foxglove-sdk: pip install 'imgloc[foxglove]'"
            raise OutputError(need) from None
        self._made, self._grid, self._began = made, grid, False
        self._folder = tempfile.TemporaryDirectory()
        self._path = Path(self._folder.name) / "track.mcap"
        self._context = context = sdk.Context()  # which channels do not keep
        # One thread: with several the order of the chunks, and so the bytes, would be by chance.
        options = mcap.MCAPWriteOptions(compression_threads=0)
        row = sdk.Schema(name="imgloc.track", encoding="jsonschema", data=b'{"type": "object"}')
        self._writer = sdk.open_mcap(self._path, context=context, writer_options=options)
        self._scans = {
            laser: channels.LaserScanChannel(topic, context=context)
            for laser, topic in scan_topics(lasers).items()
        }
        self._to = SimpleNamespace(
            map=channels.GridChannel("/map", context=context),
            places=channels.PosesInFrameChannel("/imgloc/hypotheses", context=context),
            pose=channels.PoseInFrameChannel("/imgloc/pose", context=context),
            tf=channels.FrameTransformChannel("/tf", context=context),
            verdict=channels.LogChannel("/imgloc/verdict", context=context),
            track=sdk.Channel(
                "/imgloc/track", schema=row, message_encoding="json", context=context
            ),
        )

    def add(self, scan: LaserScan, moment: Moment) -> None:
        """Add a scan and what is believed since."""
        made, to = self._made, self._to
        # A log without stamps is one with a scan a second.
        seconds = moment.stamp if math.isfinite(moment.stamp) else float(moment.index)
        if not 0 <= seconds <= _LATEST:
            hint = "are these milliseconds or nanoseconds?" if seconds > 0 else "add an offset"
            raise OutputError(
                f"MCAP: the stamp {seconds:.6g} s, expected 0 to {_LATEST:,} s; {hint}"
            )
        at = made.Timestamp.from_epoch_secs(seconds)
        now = {"log_time": at.sec * 10**9 + at.nsec}
        if not self._began:
            to.map.log(self._map(at), **now)
            self._began = True
        frame = {"timestamp": at, "frame_id": _MAP}
        if moment.best is not None:
            laser = compose(moment.best, scan.T_base_laser or Pose2D(0.0, 0.0))
            angles, ranges = evenly(scan)
            ends = {"start_angle": float(angles[0]), "end_angle": float(angles[-1])}
            self._scans.get(scan.laser, next(iter(self._scans.values()))).log(
                made.LaserScan(**frame, pose=self._pose(laser), ranges=ranges.tolist(), **ends),
                **now,
            )
        rows = transform_poses(self._grid.origin, moment.belief.poses[:_LISTED]).tolist()
        poses = [self._pose(Pose2D(*row)) for row in rows]
        to.places.log(made.PosesInFrame(**frame, poses=poses), **now)
        if moment.pose is not None:
            pose = self._pose(moment.pose)
            to.pose.log(made.PoseInFrame(**frame, pose=pose), **now)
            link = {"translation": made.Vector3(x=moment.pose.x, y=moment.pose.y, z=0.0)}
            frames = {"parent_frame_id": _MAP, "child_frame_id": _BASE}
            rotation = self._turned(moment.pose.theta)
            to.tf.log(made.FrameTransform(timestamp=at, **frames, **link, rotation=rotation), **now)
        level = made.LogLevel.Info if moment.belief.verdict == UNIQUE else made.LogLevel.Warning
        words = ": ".join(filter(None, (moment.belief.verdict, moment.withheld)))
        to.verdict.log(made.Log(timestamp=at, level=level, message=words, name="imgloc"), **now)
        to.track.log(moment_row(moment, self._grid.origin), **now)

    def _map(self, at: Any) -> Any:
        """The map, a pixel a cell; row 0 is the lowest y here as there."""
        made, grid = self._made, self._grid
        pixels = np.zeros((*grid.occupied.shape, 4), np.uint8)
        for name, colour in _GREYS.items():
            pixels[getattr(grid, name)] = colour
        kind = made.PackedElementFieldNumericType.Uint8
        fields = [
            made.PackedElementField(name=name, offset=k, type=kind)
            for k, name in enumerate(("red", "green", "blue", "alpha"))
        ]
        return made.Grid(
            timestamp=at, frame_id=_MAP, pose=self._pose(grid.origin), fields=fields,
            column_count=grid.info.width, cell_stride=4, row_stride=4 * grid.info.width,
            cell_size=made.Vector2(x=grid.resolution, y=grid.resolution), data=pixels.tobytes(),
        )  # fmt: skip

    def _pose(self, pose: Pose2D) -> Any:
        position = self._made.Vector3(x=pose.x, y=pose.y, z=0.0)
        return self._made.Pose(position=position, orientation=self._turned(pose.theta))

    def _turned(self, theta: float) -> Any:
        return self._made.Quaternion(x=0.0, y=0.0, z=math.sin(theta / 2), w=math.cos(theta / 2))

    def save(self, path: PathLike, *, force: bool = False) -> None:
        """Write the file; an OutputError if there is one already, unless `force`."""
        self._writer.close()
        try:
            data = self._path.read_bytes()
        except OSError as error:
            raise OutputError(f"{display(path)}: cannot be written: {error.strerror}") from None
        self.close()
        write_bytes_atomic(path, data, force=force)

    def close(self) -> None:
        """Drop what was recorded."""
        self._writer.close()
        self._folder.cleanup()


def evenly(scan: LaserScan) -> tuple[FloatArray, FloatArray]:
    """Angles and ranges, (N,) each, of a scan whose angles are evenly spaced and rise.

    Foxglove knows the first and the last angle alone. A scan of other angles has the nearest ray of
    each; NaN where none is as near as half a step.

    Examples
    --------
    >>> angles, ranges = evenly(LaserScan([1.0, 2.0, 4.0], [0.0, 1.0, 3.0]))
    >>> angles.tolist(), ranges.tolist()
    ([0.0, 1.0, 2.0, 3.0], [1.0, 2.0, nan, 4.0])
    """
    order = np.argsort(scan.angles, kind="stable")
    angles, ranges = scan.angles[order], scan.ranges[order]
    steps = np.diff(angles)
    if not len(steps) or np.ptp(steps) <= 1e-3 * steps.mean():
        return angles, ranges
    apart = steps[steps > 0]
    step = float(np.quantile(apart, 0.25, method="lower")) if len(apart) else 1.0
    even = np.linspace(angles[0], angles[-1], min(1 + round(float(np.ptp(angles)) / step), _RAYS))
    near = np.clip(np.searchsorted(angles, even), 1, len(angles) - 1)
    near -= even - angles[near - 1] < angles[near] - even
    away = np.abs(angles[near] - even) > 0.51 * step
    return even, np.where(away, np.nan, ranges[near])
