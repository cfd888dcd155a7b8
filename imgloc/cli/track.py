"""`imgloc track`: where a moving robot is, scan after scan."""

import contextlib
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, NOT_UNIQUE, emit, progress, say
from imgloc.cli.options import flag, option
from imgloc.errors import ConfigError, ScanError
from imgloc.io.files import display, write_text_atomic

_EVERY = (
    "Weigh all places by a scan once the robot has gone M metres or turned DEG degrees; the scans "
    "between correct the best one alone. [default: 0.5,30]"
)


@opt.with_options(opt.mounting, opt.reading, opt.logs, opt.taken, opt.console)
def track(
    map_path: opt.MapPath,
    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG",
            callback=opt.find_scans,
            help="Scans with odometry, in the order of time: a CARMEN .log; a ROS .bag, .mcap or "
            ".db3; .npz or .jsonl with odom. JSON lines from standard input (-) or a named pipe "
            "are followed as they come.",
        ),
    ],
    mounting: opt.Mounting,
    reading: "opt.Reading",
    logs: opt.Logs,
    taken: opt.Resources,
    filter_: opt.FilterName = typer.Option(
        opt.FilterName.TRACKER, "--filter", help="Which filter."
    ),
    start: Any = opt.pose_of("--start", "Where the robot starts, about. [default: anywhere]"),
    kidnap: Any = option(
        None,
        "T,X,Y,YAW",
        "After T seconds the filter believes to be at this pose: a robot carried off.",
        parser=opt.numbers(4, angles=(3,)),
    ),
    follow_: bool = flag("--follow", "Go on with a .jsonl file that grows, until Ctrl-C."),
    every: Any = option(None, "M,DEG", _EVERY, parser=opt.numbers(2)),
    max_sd: Any = option(
        None,
        "M,DEG",
        "A pose is unique only while its standard deviations are at most M metres and DEG degrees. "
        "[default: 0.5,10]",
        parser=opt.numbers(2),
    ),
    resets: bool = flag("--resets/--no-resets", "Draw from p(x | z) when lost.", True),
    simulate_odometry: int | None = option(
        None, "SEED", "Make odometry of the recorded poses, with noise and a bias.", min=0
    ),
    as_json: opt.AsJson = False,
    tum: Path | None = option(None, "TUM", "Write the trajectory, of unique poses only."),
    ros: Path | None = option(
        None,
        "YAML|BAG",
        "Write PoseWithCovarianceStamped while unique, PoseArray while several places fit.",
    ),
    best: bool = flag("--best", "In --ros one pose, the best, also while several places fit."),
    picture: Path | None = option(None, "PNG", "Draw the path over the map."),
    video: Path | None = option(None, "MP4", "Draw the belief over time."),
    seed: opt.Seed = 0,
    range_max: opt.Cut = None,
    strict: bool = flag("--strict", "Exit with 6 unless the last pose is unique."),
    cache: opt.CacheDir = None,
    no_cache: opt.NoCache = False,
    force: opt.Force = False,
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Follow a robot through a log of scans with odometry, from anywhere on the map.

    A line for each scan: unique (the pose is given), ambiguous (several places fit) or lost (no
    place that is known does). No pose is given unless it is unique; the last one is never repeated.
    A scan that says nothing gives none either, "ambiguous: blind": it has no readings, the lens is
    covered, or it is the last scan again. "ambiguous: wide": the standard deviation of the pose is
    above --max-sd.
    Poses are those of the robot's base in the map frame; of the sensor where neither the log nor
    --sensor says where that sits. Several lasers are followed together (--topic /front,/rear).
    """
    import math
    from dataclasses import replace

    import numpy as np

    from imgloc.cli import inputs
    from imgloc.cli.live import live_of
    from imgloc.filters.choose import make_filter
    from imgloc.filters.follow import (
        Every,
        Follower,
        Kidnap,
        Limits,
        Moment,
        follow,
        robot_poses,
        with_odometry,
    )
    from imgloc.io.calibration import calibrated
    from imgloc.io.scanset import ScanSet
    from imgloc.model import LaserScan, Pose2D, to_json
    from imgloc.options import Options
    from imgloc.output.ros import message, write_bag, yaml_text
    from imgloc.output.rows import moment_row
    from imgloc.output.tracks import (
        Video,
        draw_track,
        track_header,
        track_line,
        tum_text,
    )

    folder = inputs.kept_in(cache, wanted=not no_cache)
    if best and ros is None:
        raise ConfigError("--best: is of --ros alone, which is not given")
    if kidnap is not None:
        opt.check_yaw("--kidnap", kidnap[3])
    read = [*inputs.files_of(map_path), log]
    ending_of_ros = ".bag" if ros is not None and ros.suffix.lower() == ".bag" else ".yaml"
    outputs = ((tum, ".tum"), (ros, ending_of_ros), (picture, ".png"), (video, ".mp4"))
    for path, ending in outputs:
        inputs.check_target(path, ending, force=force, inputs=read)
    grid = inputs.load_grid(map_path, taken.memory_budget, allow_lossy=allow_lossy, **reading)
    options = Options(threads=taken.threads, memory_budget=taken.memory_budget)
    options = calibrated(options, map_path, grid)
    live = live_of(log, follow=follow_)
    if live is None:
        scans = inputs.load_set(log, taken.memory_budget, logs)
    elif kidnap is not None or simulate_odometry is not None:
        wrong = "--kidnap" if kidnap is not None else "--simulate-odometry"
        raise ConfigError(f"{wrong}: needs a log that is whole, not one that is being written")
    else:
        scans = ScanSet(())

    def prepared(scan: LaserScan) -> LaserScan:
        return mounting.mount(inputs.cut_scan(scan, range_max))

    mounting.check(scans.scans)
    scans = replace(scans, scans=tuple(map(prepared, scans.scans)))
    if simulate_odometry is not None:
        scans = with_odometry(replace(scans, odom=None), simulate_odometry)[0]
    stamped = scans.stamps is not None and np.isfinite(scans.stamps).any()
    if tum is not None and live is None and not stamped:
        raise ConfigError("--tum: the log has no stamps, which a trajectory needs")
    features = inputs.open_features(
        grid, display(map_path), folder, options, scans=scans.scans, threads=taken.threads
    )
    chosen = make_filter(filter_.value, features, options, seed=seed, resets=resets)
    gap = Every() if every is None else Every(every[0], math.radians(every[1]))
    limits = Limits() if max_sd is None else Limits(max_sd[0], math.radians(max_sd[1]))
    moments: list[Moment] = []
    movie = None if video is None else Video(features)
    with contextlib.ExitStack() as undo:
        if movie is not None:
            undo.callback(movie.close)
        if live is None:
            run = follow(
                features,
                scans,
                chosen,
                every=gap,
                limits=limits,
                start=None if start is None else Pose2D(*start),
                kidnap=None if kidnap is None else Kidnap(kidnap[0], Pose2D(*kidnap[1:])),
                name=inputs.name_of(log),
            )
        else:
            robot = Follower(features, chosen, every=gap, limits=limits, name=inputs.name_of(log))
            if start is not None:
                robot.place(Pose2D(*start), given="start")
            run = live.follow(
                robot, lambda scan: prepared(scan if logs.scale == 1 else scan.scaled(logs.scale))
            )
        begin = time.perf_counter()
        with progress("track", len(scans)) as advance:
            for moment in run:
                if not (moments or as_json):
                    emit(track_header())
                moments.append(moment)
                emit(to_json(moment_row(moment)) if as_json else track_line(moment))
                if movie is not None:
                    movie.add(moment)
                gone = moment.stamp - moments[0].stamp
                took = max(1e-9, time.perf_counter() - begin)
                advance("" if math.isnan(gone) else f"{gone / took:.1f} x real time")
        inputs.keep_features(features, folder)
        if tum is not None:
            write_text_atomic(tum, tum_text(moments), force=force)
            LOG.info("wrote %s", display(tum))
        if ros is not None:
            found = (message(m, grid.origin, best=best) for m in moments)
            messages = [given for given in found if given is not None]
            if ros.suffix.lower() == ".bag":
                write_bag(ros, messages, force=force)
            else:
                write_text_atomic(ros, yaml_text(messages), force=force)
            LOG.info("wrote %s", display(ros))
        if picture is not None:
            known = robot_poses(scans) if live is None else live.poses(len(moments))
            draw_track(grid, moments, known).save(picture, force=force)
            LOG.info("wrote %s", display(picture))
        if movie is not None and video is not None:
            movie.save(video, force=force)
            LOG.info("wrote %s", display(video))
    if not moments:
        raise ScanError(f"{inputs.name_of(log)}: holds no scan with odometry")
    verdicts = [moment.belief.verdict for moment in moments]
    counts = ", ".join(f"{verdicts.count(v)} {v}" for v in ("unique", "ambiguous", "lost"))
    speed = "" if math.isnan(gone) else f"; {gone / took:.1f} x real time"
    speed += "" if live is None else live.latency
    say(f"{len(moments)} scans, {moments[-1].metres:.1f} m: {counts}{speed}")
    if (scale := chosen.options.shared.scale) != options.shared.scale:
        LOG.warning(
            "the scans fit this map far better with their ranges multiplied by %.3f and were taken "
            "so once that was clear; imgloc calibrate MAP --scans LOG finds it once for all",
            scale,
        )
    if strict and verdicts[-1] != "unique":
        raise typer.Exit(NOT_UNIQUE)
