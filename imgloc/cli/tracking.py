"""The run of `imgloc track`: scans that come while it runs, poses as they are printed, the truth.

Scans come from standard input, a pipe or a file that grows. A command imports this when it runs.
"""

import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imgloc.answers.causes import Cause
from imgloc.cli import inputs
from imgloc.cli.console import LOG, emit, progress
from imgloc.errors import ConfigError, ScanError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import Filter
from imgloc.filters.deviation import at_stamps
from imgloc.filters.follow import UNCONFIRMED, Moment, Reading, Tracking, robot_poses
from imgloc.filters.watch import Opinion, Watch
from imgloc.io import stream
from imgloc.io.files import display
from imgloc.io.scanset import ScanSet
from imgloc.io.tum import load_tum
from imgloc.model import FloatArray, LaserScan, Pose2D, to_json
from imgloc.options import Logs, Options
from imgloc.output.mcap import Recording
from imgloc.output.rows import moment_row
from imgloc.output.tables import bent_words
from imgloc.output.tracks import Video, track_header, track_line, way_words
from imgloc.robot.recording import SCANS
from imgloc.runs.opening import Desk, ScanFiles


class Live:
    """The scans of a source, as :func:`imgloc.follow` takes them, and how long each took."""

    def __init__(
        self, source: Iterator[tuple[float, ScanSet]],
        prepared: Callable[[LaserScan], LaserScan], *, by_scans: bool = False,
    ) -> None:  # fmt: skip
        self._source, self._prepared, self._begin = source, prepared, 0.0
        self._by_scans = by_scans  # whether the scans alone are to tell the motion
        self._seconds: list[float] = []  # from line in to line out, of each scan
        self._scan: LaserScan | None = None
        self._truth: list[tuple[float, float, float]] = []  # known poses of the robot

    def __iter__(self) -> Iterator[Reading]:
        for begin, one in self._source:
            self._begin = begin
            scan, odom = self._prepared(one.scans[0]), None
            if one.odom is not None and not self._by_scans:
                odom = one.odom[0]
                if (truth := robot_poses(replace(one, scans=(scan,)))) is not None:
                    self._truth.append(tuple(truth[0]))
            self._scan = scan
            yield scan, odom

    def last(self, _: int) -> LaserScan:
        """The scan that came last."""
        assert self._scan is not None
        return self._scan

    def answered(self) -> None:
        """Take note that the line of the last scan is out."""
        self._seconds.append(time.perf_counter() - self._begin)

    def poses(self) -> FloatArray | None:
        """Known poses (N, 3) of the robot, if all of the scans have one."""
        return np.array(self._truth) if len(self._truth) == len(self._seconds) else None

    @property
    def latency(self) -> str:
        """From line in to line out, in words; nothing without a scan."""
        if not self._seconds:
            return ""
        half, most = 1e3 * np.percentile(self._seconds, (50, 99))
        return f"from line in to line out p50 {half:.0f} ms, p99 {most:.0f} ms"


def live_of(
    log: Path, logs: Logs, prepared: Callable[[LaserScan], LaserScan], *, follow: bool
) -> Live | None:
    """The scans of a source that is still being written; None for a log that is whole.

    Standard input is one if it begins as JSON lines do, or is a pipe and begins as a CARMEN log.
    """
    if follow:
        if str(log) == "-" or stream.is_pipe(log):
            raise ConfigError("--follow: is of a file that grows; a pipe is followed anyway")
        lines = _growing(log)
    elif stream.is_pipe(log):
        lines = stream.piped(log)
    elif str(log) == "-" and stream.comes_in_lines(sys.stdin.buffer):
        lines = stream.lines_of(sys.stdin.buffer)
    else:
        return None

    name = inputs.name_of(log)
    read = stream.scans_of(lines, name, topic=logs.topic, fov=logs.fov, max_bad=logs.max_bad)
    return Live(read, prepared, by_scans=logs.odom == SCANS)


def _growing(log: Path) -> Iterator[bytes]:
    """The lines of a file that grows, until Ctrl-C: from the first one that is asked for."""
    yield from stream.growing(log, _interrupted())


def _interrupted() -> Callable[[], bool]:
    """Make Ctrl-C an end that can be asked for; the second one interrupts as ever."""
    asked = list[int]()

    def ask(number: int, _: object) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        asked.append(number)

    signal.signal(signal.SIGINT, ask)
    return lambda: bool(asked)


def warn(hint: Cause | None, aged: Cause | None) -> None:
    """Warn of a map of another place, unless something else was tried and helps; else of that.

    That scans fit bent walls is another word for not fitting.
    """
    helps = hint is not None and hint.found and hint.code != "bent"
    if said := aged if aged and (not hint or (aged.serious and not helps)) else hint:
        LOG.warning("%s", said.said)


def filter_of(tracking: Tracking, features: MapFeatures, options: Options, name: str) -> Filter:
    """The filter; a warning if no pose of it can be ``unique`` on the map of this name."""
    made = tracking.made(features, options)
    if made.unsure:
        LOG.warning(
            "%s: %s, so no pose of --filter %s is unique; the tracker allows for it, and --bent 0 "
            "says that walls are straight", name, made.unsure, tracking.filter,
        )  # fmt: skip
    return made


def truth_of(
    given: tuple[FloatArray, FloatArray] | None, path: Path | None,
    moments: Sequence[Moment], scans: ScanSet, live: Live | None,
) -> FloatArray | None:  # fmt: skip
    """True poses (N, 3) of the robot at the moments: of a file, else those of the log, if any."""
    if not moments:
        return None
    if given is not None:
        return true_at(np.array([moment.stamp for moment in moments]), given, path)
    if live is not None:
        return live.poses()
    return robot_poses(scans.take([moment.index for moment in moments]))


def true_at(at: FloatArray, given: tuple[FloatArray, FloatArray], path: Path | None) -> FloatArray:
    """The poses (N, 3) of a trajectory at the stamps of scans; a ScanError if there is none."""
    stamps, poses = given
    found = at_stamps(at, stamps, poses)
    if not np.isfinite(found).any():
        name = "" if path is None else display(path)
        raise ScanError(
            f"{name}: no stamp is within 0.01 s of a scan: these are from {stamps[0]:.2f} to "
            f"{stamps[-1]:.2f} s, the scans from {at[0]:.2f} to {at[-1]:.2f} s"
        )
    return found


def scans_of(
    log: Path, logs: Logs, how: ScanFiles, desk: Desk, needs: Mapping[str, Path | None], *,
    follow: bool,
) -> tuple[ScanSet, Live | None, tuple[FloatArray, FloatArray] | None]:  # fmt: skip
    """The scans of a log, as the sensor sits; or those of one that is still being written.

    Also the stamps and poses of a true trajectory, if one is given. A ConfigError if an option
    needs stamps, or a whole log, and there is none: `needs` has those that were given.
    """
    given = None if (truth := needs["--truth"]) is None else load_tum(truth, logs.max_bad)
    live = live_of(log, logs, how.mounted, follow=follow)
    if live is not None:
        if logs.straighten != "no":
            raise ConfigError(
                "--straighten: needs the odometry of a whole log, and these scans come while "
                "imgloc runs; leave it out, or record them and pass the file"
            )
        if needs["--watch"] is not None:
            raise ConfigError("--watch: needs a log that is whole, not one that is being written")
        return ScanSet(()), live, given
    scans = desk.scans(log, how).scans
    if scans.stamps is None or not np.isfinite(scans.stamps).any():
        for option in ("--tum", "--truth"):
            if needs[option] is not None:
                raise ConfigError(f"{option}: the log has no stamps, which a trajectory needs")
    elif given is not None:
        true_at(scans.stamps, given, truth)
    return scans, None, given


@dataclass(frozen=True)
class Told:
    """The way in which a moment is printed."""

    origin: Pose2D  #: of the grid
    as_json: bool
    best: bool  #: guesses, too
    watched: Callable[[Moment], Opinion] | None = None  #: what is thought of other poses

    def line(self, moment: Moment) -> str:
        """The line of a moment."""
        opinion = None if self.watched is None else self.watched(moment)
        if self.as_json:
            row = moment_row(moment, self.origin, best=self.best)
            return to_json(row if opinion is None else row | {"watch": opinion.row(moment.stamp)})
        line = track_line(moment, best=self.best)
        return line if opinion is None else f"{line}  {opinion.text}"


def watched(
    path: Path | None, features: MapFeatures, options: Options, scans: ScanSet, logs: Logs
) -> Callable[[Moment], Opinion] | None:
    """Opinions, after each scan, of the last pose of a trajectory, if there is one."""
    if path is None:
        return None
    stamps, poses = load_tum(path, logs.max_bad)
    if scans.stamps is None or not stamps[0] <= np.nanmax(scans.stamps):
        raise ScanError(f"{display(path)}: no pose has a stamp before that of the last scan")
    watch, taken = Watch(features, options), np.asarray(scans.stamps)

    def odom(k: int) -> Pose2D | None:
        return None if scans.odom is None else Pose2D(*scans.odom[k])

    def opinion(moment: Moment) -> Opinion:
        k = int(np.searchsorted(stamps, moment.stamp + 1e-3)) - 1
        if k >= 0:
            at = int(np.abs(taken - stamps[k]).argmin())
            watch.hear(float(stamps[k]), Pose2D(*poses[k]), odom(at))
        return watch.step(scans[moment.index], odom(moment.index), moment)

    return opinion


def printed(
    run: Iterable[Moment], count: int, live: Live | None, told: Told,
    sinks: Sequence[Video | Recording], seen: Callable[[int], LaserScan],
) -> tuple[list[Moment], str]:  # fmt: skip
    """The moments, each printed as it comes, and a word about all of them.

    The `sinks` take each with its scan, which is `seen` by its index.
    """
    moments, begin, speed = list[Moment](), time.perf_counter(), ""
    with progress("track", count) as advance:
        for moment in run:
            if not (moments or told.as_json):
                emit(track_header())
            moments.append(moment)
            emit(told.line(moment))
            if live is not None:
                live.answered()
            for sink in sinks:
                sink.add(moment, seen(moment.index))
            gone = moment.stamp - moments[0].stamp
            took = max(1e-9, time.perf_counter() - begin)
            speed = f"{gone / took:.1f} x real time" if gone >= 0 else ""
            advance(speed)
    verdicts = [moment.belief.verdict for moment in moments]
    counts = ", ".join(f"{verdicts.count(v)} {v}" for v in ("unique", "ambiguous", "lost"))
    if soon := sum(moment.withheld == UNCONFIRMED for moment in moments):
        counts += f" ({soon} of the ambiguous ones at one place that is not confirmed yet)"
    way = way_words(moments[-1]) if moments else "0.0 m"
    walls = bent_words(moments[-1]) if moments else None
    about = [
        f"{len(moments)} scans, {way}: {counts}", f"allows for {walls}" if walls else "",
        speed, live.latency if live else "",
    ]  # fmt: skip
    return moments, "; ".join(filter(None, about))
