"""A track as a recording of ROS 2, for Foxglove, RViz and ``ros2 bag play``.

======================== ============================ ==============================================
topic                    message                      content
======================== ============================ ==============================================
``/map``                 OccupancyGrid                the map, once
``/scan``                LaserScan                    each scan in a frame at the best place,
                                                      whatever the verdict; of several lasers each
                                                      has a topic of its own
``/imgloc/hypotheses``   PoseArray                    every place, best first
``/imgloc/pose``         PoseWithCovarianceStamped    the pose while it is unique, at no other time
``/tf``                  TFMessage                    ``map`` to ``base_link`` at the same times,
                                                      and to the frames of the scans
``/imgloc/verdict``      String                       unique, ambiguous or lost, and why
``/imgloc/track``        String                       the row of `imgloc track --json`
======================== ============================ ==============================================
"""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from imgloc.errors import OutputError
from imgloc.filters.follow import Moment
from imgloc.geometry import transform_poses
from imgloc.io.bags import GRID, LASER, TF
from imgloc.io.files import PathLike, display, reason, write_bytes_atomic
from imgloc.io.lasers import frame_of, scan_topics
from imgloc.io.messages import grid_to_msg, header_fields, link_fields, pose_fields, scan_to_msg
from imgloc.model import FloatArray, LaserScan, OccupancyGrid, Pose2D, compose, to_json
from imgloc.output.ros import ARRAY, POSE, TOPICS, Bag, message
from imgloc.output.rows import PLACES, moment_row

_MAP, _BASE = "map", "base_link"
_TEXT = "std_msgs/msg/String"
_LATEST = 2**32 - 1  # seconds of a stamp at most: it has 32 bits
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
        If rosbags is not installed; from :meth:`add`, if a stamp is no time that a message has.
    """

    def __init__(self, grid: OccupancyGrid, lasers: Iterable[str] = ()) -> None:
        self._bag, self._grid, self._topics = Bag(), grid, scan_topics(lasers)
        self._began = False
        self.close = self._bag.close

    def add(self, moment: Moment, scan: LaserScan) -> None:
        """Add a scan and what is believed since."""
        # A log without stamps is one with a scan a second.
        seconds = moment.stamp if math.isfinite(moment.stamp) else float(moment.index)
        if not 0 <= seconds <= _LATEST:
            hint = "are these milliseconds or nanoseconds?" if seconds > 0 else "add an offset"
            raise OutputError(
                f"MCAP: the stamp {seconds:.6g} s, expected 0 to {_LATEST:,} s; {hint}"
            )
        write, header, links = self._bag.write, header_fields(seconds, _MAP), []
        if not self._began:
            write("/map", GRID, seconds, grid_to_msg(self._grid, _MAP, seconds))
            self._began = True
        if moment.best is not None:
            topic = self._topics.get(scan.laser, next(iter(self._topics.values())))
            links.append(link_fields(compose(moment.best, scan.mount), header, frame_of(topic)))
            angles, ranges = evenly(scan)
            even = replace(scan, angles=angles, ranges=ranges, stamp=seconds)
            write(topic, LASER, seconds, scan_to_msg(even, frame_of(topic)))
        rows = transform_poses(self._grid.origin, moment.belief.poses[:PLACES]).tolist()
        places = {"header": header, "poses": [pose_fields(Pose2D(*row)) for row in rows]}
        write(TOPICS[ARRAY], ARRAY, seconds, places)
        unique = message(replace(moment, stamp=seconds), self._grid.origin)
        if moment.pose is not None and unique is not None:
            write("/imgloc/pose", POSE, seconds, unique.body)
            links.append(link_fields(moment.pose, header, _BASE))
        if links:
            write("/tf", TF[0], seconds, {"transforms": links})
        words = ": ".join(filter(None, (moment.belief.verdict, moment.withheld)))
        write("/imgloc/verdict", _TEXT, seconds, {"data": words})
        row = to_json(moment_row(moment, self._grid.origin))
        write("/imgloc/track", _TEXT, seconds, {"data": row})

    def save(self, path: PathLike, *, force: bool = False) -> None:
        """Write the file; an OutputError if there is one already, unless `force`."""
        try:
            data = self._bag.content()
        except OSError as error:
            raise OutputError(f"{display(path)}: cannot be written: {reason(error)}") from None
        write_bytes_atomic(path, data, force=force)


def evenly(scan: LaserScan) -> tuple[FloatArray, FloatArray]:
    """Angles and ranges, (N,) each, of a scan whose angles are evenly spaced and rise.

    A message has the first and the last angle alone. A scan of other angles has the nearest ray of
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
