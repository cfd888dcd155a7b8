"""`imgloc track`: where a moving robot is, scan after scan."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, NOT_UNIQUE, say
from imgloc.errors import ScanError
from imgloc.io.files import display, map_name, write_text_atomic
from imgloc.options import Drawn, Followed, Logs, Mounting, Options
from imgloc.pose import Pose2D
from imgloc.ranges import Checked, option
from imgloc.texts import pose

if TYPE_CHECKING:
    from imgloc.filters.follow import Moment
    from imgloc.model import FloatArray, OccupancyGrid
    from imgloc.output.mcap import Recording
    from imgloc.output.tracks import Video


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
        sinks: "Mapping[Path, Video | Recording]", title: str,
    ) -> None:  # fmt: skip
        """Write them; `truth` are known poses (N, 3) of the robot at the moments.

        The `sinks` have had each moment, by the file that they write.
        """
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
        for file, sink in sinks.items():
            sink.save(file, force=force)
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
    from imgloc.cli.tracking import Told, filter_of, printed, scans_of, truth_of, warn, watched
    from imgloc.filters.deviation import deviation_of
    from imgloc.filters.follow import Tracking, follow
    from imgloc.io.calibration import calibrated
    from imgloc.output.mcap import Recording
    from imgloc.output.tracks import Video
    from imgloc.search.asked import check_options

    outputs.check([*inputs.files_of(map_path), log])
    desk = inputs.desk_of(**vars(taken), cache=inputs.kept_in(kept))
    maps = inputs.map_files(reading)
    grid = desk.grid(map_path, maps, usable=True)
    options = calibrated(Options(**vars(taken)), map_path, grid, drawn)
    how = inputs.as_recorded(logs, mounting=mounting)
    needs = {"--watch": asked.watch, "--tum": outputs.tum, "--truth": outputs.truth}
    scans, live, given = scans_of(log, logs, how, desk, needs, follow=asked.follow)
    features = desk.features(map_path, maps, options, scans=scans.scans)
    check_options(features, options)
    scans = with_true_poses(scans, grid, inputs.name_of(log))
    tracking = Tracking(**vars(followed))
    chosen = filter_of(tracking, features, options, map_name(map_path))
    run = follow(
        features, live or scans, chosen, every=tracking.every, limits=tracking.limits,
        start=asked.start, name=inputs.name_of(log),
    )  # fmt: skip
    with contextlib.ExitStack() as undo:
        title = f"{map_name(map_path)}: {inputs.name_of(log)}"
        sinks: dict[Path, Video | Recording] = {}
        if outputs.video is not None:
            sinks[outputs.video] = Video(features, outputs.video.suffix.lower(), title)
            undo.callback(sinks[outputs.video].close)
        if outputs.mcap is not None:
            sinks[outputs.mcap] = Recording(grid, scans.lasers)
            undo.callback(sinks[outputs.mcap].close)
        seen = scans.scans.__getitem__ if live is None else live.last
        opinion = watched(asked.watch, features, options, scans, logs)
        told = Told(grid.origin, as_json, outputs.best, opinion)
        moments, words = printed(run, len(scans), live, told, [*sinks.values()], seen)
        desk.keep(features)
        truth = truth_of(given, outputs.truth, moments, scans, live)
        outputs.write(grid, moments, truth, sinks, title)
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
    warn(hint, aged)
    if strict and moments[-1].belief.verdict != "unique":
        raise typer.Exit(NOT_UNIQUE)
