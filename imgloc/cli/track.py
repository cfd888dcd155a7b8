"""`imgloc track`: where a moving robot is, scan after scan."""

import contextlib
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, NOT_UNIQUE, emit, progress, say
from imgloc.errors import ConfigError, ScanError
from imgloc.io.files import display, map_name, write_text_atomic
from imgloc.options import Drawn, Followed, Logs, Mounting, Options
from imgloc.pose import Pose2D
from imgloc.ranges import Checked, option
from imgloc.texts import pose

if TYPE_CHECKING:
    from imgloc.answers.causes import Cause
    from imgloc.cli.live import Live
    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.filters.belief import Filter
    from imgloc.filters.follow import Moment, Tracking
    from imgloc.filters.watch import Opinion
    from imgloc.io.scanset import ScanSet
    from imgloc.model import FloatArray, OccupancyGrid
    from imgloc.output.mcap import Recording
    from imgloc.output.tracks import Video
    from imgloc.runs.opening import Desk, ScanFiles


@dataclass(frozen=True)
class Outputs:
    """Files that are written of a track."""

    tum: Path | None = option(
        None, "Write the trajectory into this file: unique poses only.", metavar="TUM"
    )
    ros: Path | None = option(
        None,
        "Write ROS messages into this file: PoseWithCovarianceStamped while the pose is unique, "
        "PoseArray while several places fit.",
        metavar="YAML|BAG",
    )
    best: bool = option(
        False,
        "Give the best pose also while several places fit or the robot is lost; it is marked as a "
        "guess.",
    )
    picture: Path | None = option(None, "Draw the path over the map into this file.", metavar="PNG")
    video: Path | None = option(
        None,
        "Draw the belief over time into this file: WebM, which browsers play, or MP4, which they "
        "do not.",
        metavar="WEBM",
    )
    truth: Path | None = option(
        None,
        "True trajectory of the robot in the map frame, a TUM file: print the errors APE and RPE "
        "of the unique poses as evo has them, and draw them below the picture. [default: true "
        "poses of the log]",
        metavar="TUM",
    )
    mcap: Path | None = option(
        None,
        "Write map, scans, places, pose and verdict as messages of ROS 2 into this file, for "
        "Foxglove and RViz; needs imgloc[ros].",
        metavar="MCAP",
    )
    force: opt.Force = False

    def check(self, read: Sequence[Path]) -> None:
        """Refuse what cannot be written, before the work; `read` are files of the command."""
        from imgloc.cli import inputs

        files = (
            (self.tum, ".tum"), (self.ros, (".yaml", ".bag")), (self.picture, ".png"),
            (self.video, (".webm", ".mp4")), (self.mcap, ".mcap"),
        )  # fmt: skip
        read = [*read, *([] if self.truth is None else [self.truth])]
        for path, expected in files:
            inputs.check_target(path, expected, force=self.force, inputs=read)

    def write(
        self, grid: "OccupancyGrid", moments: "Sequence[Moment]", truth: "FloatArray | None",
        movie: "Video | None", recording: "Recording | None", title: str,
    ) -> None:  # fmt: skip
        """Write them; `truth` are known poses (N, 3) of the robot at the moments."""
        from imgloc.output.ros import message, write_bag, yaml_text
        from imgloc.output.tracks import draw_track, tum_text

        force = self.force
        if self.tum is not None:
            write_text_atomic(self.tum, tum_text(moments, best=self.best), force=force)
        if self.ros is not None:
            found = (message(m, grid.origin, best=self.best) for m in moments)
            messages = [given for given in found if given is not None]
            if self.ros.suffix.lower() == ".bag":
                write_bag(self.ros, messages, force=force)
            else:
                write_text_atomic(self.ros, yaml_text(messages), force=force)
        if self.picture is not None:
            draw_track(grid, moments, truth, title).save(self.picture, force=force)
        if self.video is not None and movie is not None:
            movie.save(self.video, force=force)
        if self.mcap is not None and recording is not None:
            recording.save(self.mcap, force=force)
        for path in (self.tum, self.ros, self.picture, self.video, self.mcap):
            if path is not None:
                LOG.info("wrote %s", display(path))


@dataclass(frozen=True)
class Asked(Checked):
    """Questions to the log."""

    start: Pose2D | None = option(
        None,
        "Rough pose at the beginning, map frame: metres, metres, radians (or 90deg). [default: "
        "anywhere]",
        metavar="X,Y,YAW",
        parse=pose,
    )
    watch: Path | None = option(
        None,
        "Poses of another localizer, map frame, a TUM file: each line says whether the scans "
        "agree with its last pose, disagree, or cannot tell.",
        metavar="TUM",
    )
    follow: bool = option(
        False, "Go on with a file of lines that grows, .jsonl or .log, until Ctrl-C."
    )


def track(
    *,
    map_path: opt.MapPath,
    log: Path = option(
        ...,
        "Scans with odometry, in the order of time: a CARMEN .log; a ROS .bag, .mcap or .db3; "
        ".npz or .jsonl with odom. JSON lines or a CARMEN log from standard input (-) or a named "
        "pipe are followed as they come.",
        "LOG",
        parse=opt.find_scans,
    ),
    asked: Asked,
    followed: Followed,
    outputs: Outputs,
    drawn: Drawn,
    mounting: Mounting,
    reading: opt.MapImages,
    logs: Logs,
    taken: opt.Resources,
    as_json: opt.AsJson = False,
    strict: bool = option(False, "Exit with code 6 unless the last pose is unique."),
    kept: opt.Kept,
) -> None:
    """Follow a robot through a log of scans with odometry, from anywhere on the map.

    A line for each scan: unique (the pose is given), ambiguous (several places fit) or lost (no
    known place fits). No pose is given unless it is unique; the last one is never repeated.
    A scan without information gives none either, "ambiguous: blind": it has no readings, the lens
    is covered, or it is the last scan again. "ambiguous: wide": the standard deviation of the pose
    is above --max-sd. "ambiguous: unconfirmed": one place holds the mass, but too few scans agree
    yet. Poses are those of the robot's base in the map frame; of the sensor where neither the log
    nor --sensor has its place. Several lasers are followed together (--topic /front,/rear).

    Examples
    --------
    imgloc track office.yaml run.log --tum out.tum --picture track.png
    imgloc track office.yaml run.bag --ros poses.yaml --json > track.jsonl
    imgloc track office.yaml log.npz --start 3,2,0 --sensor 0.3,0,0
    imgloc track office.yaml log.npz --video out.webm
    """
    from imgloc.answers.diagnose import bent_walls
    from imgloc.answers.logcheck import FOLLOWED, doubt_of_log
    from imgloc.answers.truth import with_true_poses
    from imgloc.cli import inputs
    from imgloc.filters.deviation import deviation_of
    from imgloc.filters.follow import Tracking, follow
    from imgloc.io.calibration import calibrated
    from imgloc.output.mcap import Recording
    from imgloc.output.tracks import Video
    from imgloc.search.asked import check_options

    folder = inputs.kept_in(kept)
    outputs.check([*inputs.files_of(map_path), log])
    desk = inputs.desk_of(**vars(taken), cache=folder)
    maps = inputs.map_files(reading)
    grid = desk.grid(map_path, maps, usable=True)
    options = Options(**vars(taken))
    options = calibrated(options, map_path, grid, drawn)
    how = inputs.as_recorded(logs, mounting=mounting)
    scans, live, given = _scans_of(log, logs, asked, how, desk, outputs)
    features = desk.features(map_path, maps, options, scans=scans.scans)
    check_options(features, options)
    scans = with_true_poses(scans, grid, inputs.name_of(log))
    tracking = Tracking(**vars(followed))
    chosen = _made(tracking, features, options, map_name(map_path))
    run = follow(
        features, live or scans, chosen, every=tracking.every, limits=tracking.limits,
        start=asked.start, name=inputs.name_of(log),
    )  # fmt: skip
    with contextlib.ExitStack() as undo:
        title = f"{map_name(map_path)}: {inputs.name_of(log)}"
        movie = Video(features, video.suffix.lower(), title) if (video := outputs.video) else None
        recording = None if outputs.mcap is None else Recording(grid, scans.lasers)
        shown, seen = list[Any](), scans.scans.__getitem__ if live is None else live.last
        if movie is not None:
            undo.callback(movie.close)
            shown.append(lambda moment: movie.add(moment, seen(moment.index)))
        if recording is not None:
            undo.callback(recording.close)
            shown.append(lambda moment: recording.add(seen(moment.index), moment))
        watched = _watched(asked.watch, features, options, scans, logs)
        told = _Told(grid.origin, as_json, outputs.best, watched)
        moments, words = _printed(run, len(scans), live, shown, told)
        desk.keep(features)
        truth = _truth_of(given, outputs.truth, moments, scans, live)
        outputs.write(grid, moments, truth, movie, recording, title)
    if not moments:
        raise ScanError(f"{inputs.name_of(log)}: has no scan with odometry")
    say(words)
    if truth is not None:
        say(deviation_of(moments, truth).words)
    share = sum(m.belief.verdict == "unique" for m in moments) / len(moments)
    stated = how.given.beside(map_path, grid, drawn)
    aged = inputs.aged_along(grid, scans, moments, chosen.options.shared)
    if live is None and (share < FOLLOWED or (aged is not None and aged.serious)):
        hint = doubt_of_log(features, scans, options, stated, share, asked.start)
    else:
        hint = bent_walls(chosen.options.shared, options.shared, grid.resolution, stated)
    _warn(hint, aged)
    if strict and moments[-1].belief.verdict != "unique":
        raise typer.Exit(NOT_UNIQUE)


def _warn(hint: "Cause | None", aged: "Cause | None") -> None:
    """Warn of a map of another place, unless something else was tried and helps; else of that.

    That scans fit bent walls is another word for not fitting.
    """
    helps = hint is not None and hint.found and hint.code != "bent"
    if said := aged if aged and (not hint or (aged.serious and not helps)) else hint:
        LOG.warning("%s", said.said)


def _made(tracking: "Tracking", features: "MapFeatures", options: Options, name: str) -> "Filter":
    """The filter; a warning if no pose of it can be ``unique`` on the map of this name."""
    made = tracking.made(features, options)
    if made.unsure:
        LOG.warning(
            "%s: %s, so no pose of --filter %s is unique; the tracker allows for it, and --bent 0 "
            "says that walls are straight", name, made.unsure, tracking.filter,
        )  # fmt: skip
    return made


def _truth_of(
    given: "tuple[FloatArray, FloatArray] | None", path: Path | None,
    moments: "Sequence[Moment]", scans: "ScanSet", live: "Live | None",
) -> "FloatArray | None":  # fmt: skip
    """True poses (N, 3) of the robot at the moments: of a file, else those of the log, if any."""
    import numpy as np

    from imgloc.filters.follow import robot_poses

    if not moments:
        return None
    if given is not None:
        return _true_at(np.array([moment.stamp for moment in moments]), given, path)
    if live is not None:
        return live.poses()
    return robot_poses(scans.take([moment.index for moment in moments]))


def _true_at(
    at: "FloatArray", given: "tuple[FloatArray, FloatArray]", path: Path | None
) -> "FloatArray":
    """The poses (N, 3) of a trajectory at the stamps of scans; a ScanError if there is none."""
    import numpy as np

    from imgloc.filters.deviation import at_stamps

    stamps, poses = given
    found = at_stamps(at, stamps, poses)
    if not np.isfinite(found).any():
        name = "" if path is None else display(path)
        raise ScanError(
            f"{name}: no stamp is within 0.01 s of a scan: these are from {stamps[0]:.2f} to "
            f"{stamps[-1]:.2f} s, the scans from {at[0]:.2f} to {at[-1]:.2f} s"
        )
    return found


def _scans_of(
    log: Path, logs: Logs, asked: Asked, how: "ScanFiles", desk: "Desk", outputs: Outputs,
) -> "tuple[ScanSet, Live | None, tuple[FloatArray, FloatArray] | None]":  # fmt: skip
    """The scans of a log, as the sensor sits; or those of one that is still being written.

    Also the stamps and poses of a true trajectory, if one is given. A ConfigError if an output
    needs stamps and there are none.
    """
    import numpy as np

    from imgloc.cli.live import live_of
    from imgloc.io.scanset import ScanSet
    from imgloc.io.tum import load_tum

    given = None if outputs.truth is None else load_tum(outputs.truth, logs.max_bad)
    live = live_of(log, logs, how.mounted, follow=asked.follow)
    if live is not None:
        if logs.straighten != "no":
            raise ConfigError(
                "--straighten: needs the odometry of a whole log, and these scans come while "
                "imgloc runs; leave it out, or record them and pass the file"
            )
        if asked.watch is not None:
            raise ConfigError("--watch: needs a log that is whole, not one that is being written")
        return ScanSet(()), live, given
    scans = desk.scans(log, how).scans
    if scans.stamps is None or not np.isfinite(scans.stamps).any():
        if (outputs.tum or outputs.truth) is not None:
            wrong = "--tum" if outputs.tum is not None else "--truth"
            raise ConfigError(f"{wrong}: the log has no stamps, which a trajectory needs")
    elif given is not None:
        _true_at(scans.stamps, given, outputs.truth)
    return scans, None, given


@dataclass(frozen=True)
class _Told:
    """The way in which a moment is printed."""

    origin: Pose2D  #: of the grid
    as_json: bool
    best: bool  #: guesses, too
    watched: "Callable[[Moment], Opinion] | None" = None  #: what is thought of other poses

    def line(self, moment: "Moment") -> str:
        """The line of a moment."""
        from imgloc.model import to_json
        from imgloc.output.rows import moment_row
        from imgloc.output.tracks import track_line

        opinion = None if self.watched is None else self.watched(moment)
        if self.as_json:
            row = moment_row(moment, self.origin, best=self.best)
            return to_json(row if opinion is None else row | {"watch": opinion.row(moment.stamp)})
        line = track_line(moment, best=self.best)
        return line if opinion is None else f"{line}  {opinion.text}"


def _watched(
    path: Path | None, features: "MapFeatures", options: Options, scans: "ScanSet", logs: Logs
) -> "Callable[[Moment], Opinion] | None":
    """Opinions, after each scan, of the last pose of a trajectory, if there is one."""
    if path is None:
        return None
    import numpy as np

    from imgloc.filters.watch import Watch
    from imgloc.io.tum import load_tum

    stamps, poses = load_tum(path, logs.max_bad)
    if scans.stamps is None or not stamps[0] <= np.nanmax(scans.stamps):
        raise ScanError(f"{display(path)}: no pose has a stamp before that of the last scan")
    watch, taken = Watch(features, options), np.asarray(scans.stamps)

    def odom(k: int) -> Pose2D | None:
        return None if scans.odom is None else Pose2D(*scans.odom[k])

    def opinion(moment: "Moment") -> "Opinion":
        k = int(np.searchsorted(stamps, moment.stamp + 1e-3)) - 1
        if k >= 0:
            at = int(np.abs(taken - stamps[k]).argmin())
            watch.hear(float(stamps[k]), Pose2D(*poses[k]), odom(at))
        return watch.step(scans[moment.index], odom(moment.index), moment)

    return opinion


def _printed(
    run: "Iterable[Moment]", count: int, live: "Live | None",
    shown: "Sequence[Callable[[Moment], None]]", told: "_Told",
) -> "tuple[list[Moment], str]":  # fmt: skip
    """The moments, each printed and `shown` as it comes, and a word about all of them."""
    from imgloc.filters.follow import UNCONFIRMED
    from imgloc.output.tables import bent_words
    from imgloc.output.tracks import track_header, way_words

    moments, begin, speed = list["Moment"](), time.perf_counter(), ""
    with progress("track", count) as advance:
        for moment in run:
            if not (moments or told.as_json):
                emit(track_header())
            moments.append(moment)
            emit(told.line(moment))
            if live is not None:
                live.answered()
            for show in shown:
                show(moment)
            gone = moment.stamp - moments[0].stamp
            took = max(1e-9, time.perf_counter() - begin)
            speed = "" if math.isnan(gone) else f"{gone / took:.1f} x real time"
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
