"""`imgloc localize`: the poses of scans in a map."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imgloc.cli import options as opt
from imgloc.cli.command import Without
from imgloc.cli.console import LOG, NOT_UNIQUE, emit, say, width
from imgloc.errors import ConfigError, as_options
from imgloc.io.files import display, write_text_atomic
from imgloc.options import Cell, Chosen, Drawn, Known, Logs, Mounting, Options
from imgloc.ranges import option

if TYPE_CHECKING:
    from imgloc.answers.causes import Cause
    from imgloc.model import Evidence, LaserScan, Pose2D
    from imgloc.runs.localize import Located, Locating

_MANY = 5  # scans whose verdicts one does not count oneself
_WIDE = 112  # columns of a line with the poses of the sensor and of the base


def localize(
    *,
    map_path: opt.MapPath,
    scans_paths: opt.ScansPaths,
    search: Annotated[Options, Without("threads", "memory_budget", "engine")],
    known: Known,
    drawn: Drawn,
    mounting: Mounting,
    reading: opt.MapImages,
    logs: Logs,
    chosen: Chosen,
    taken: opt.Resources,
    region: Path | None = option(
        None,
        "Consider only positions in the white part of this image, which has the size of the "
        "map's. [default: anywhere]",
        metavar="PNG",
    ),
    prior_image: Path | None = option(
        None,
        "Weights of positions: the greys of this image, which has the size of the map's, white 1, "
        "black 0. None is unique by its weight. [default: all alike]",
        metavar="PNG",
    ),
    as_json: opt.AsJson = False,
    picture: opt.Picture = None,
    explain: Path | None = option(
        None,
        "Write a page that explains the answer ray by ray; of several scans NAME-0003.html and "
        "so on.",
        metavar="HTML",
    ),
    strict: opt.Strict = False,
    cell: Cell = 0.1,
    kept: opt.Kept,
    force: opt.Force = False,
) -> None:
    """Find the pose of each scan in a map, without an initial guess.

    Verdicts: unique (one pose holds nearly all of the mass), ambiguous (several fit), no-match (the
    best pose does not explain the scan), invalid (too few readings). Poses are those of the sensor,
    in the map frame. Look at the mass of the second hypothesis before trusting the first.

    Formats
    -------
    Scans (ranges in metres, angles in radians, counter-clockwise, 0 forward):
      .csv                    a scan a line; or two columns, angle and range, a reading a line:
                                # angle_min=-1.5708, angle_max=1.5708, range_max=30
                                8.30,9.81,9.14,nan,4.20,3.32,3.41,inf,5.67,5.18,3.94,2.58,1.97
                              at least 10 readings; columns of rostopic, ros2, bagpy, PlotJuggler
      .jsonl, .json           an object a line, with the names of sensor_msgs/LaserScan, as of
                              rosbridge, Foxglove or CSM:
                                {"angle_min": -1.57, "angle_increment": 0.26, "range_max": 30,
                                 "ranges": [8.30, 9.81, null, "inf", 4.20, 3.32, ...]}
      .npz                    ranges (N,B), angles (B,), range_max; poses (N,3), stamps, odom
      .log, .clf              CARMEN: FLASER, ROBOTLASER1, RAWLASER1, ODOM, PARAM; L of homework
      .bag, .mcap, .db3       ROS 1 and 2, or the folder of a recording (pip install 'imgloc[ros]')
      .yaml                   ros2 topic echo -f /scan > scans.yaml
      .log.gz, .csv.gz ...    any of these texts, packed by gzip
      -                       standard input, any of these

    Examples
    --------
    imgloc localize office.yaml scans.npz
    imgloc localize office.yaml scans.npz --scans-index 3 --picture answer.png
    imgloc localize office.yaml run.log --scans-index 7,100:120 --explain why.html
    imgloc localize office.png scan.csv --resolution 0.05 --origin -12.5,-8,0
    imgloc localize office.yaml monday.log tuesday.bag --sensor 0.2,0,180deg
    imgloc localize office.yaml - < scan.csv
    imgloc localize office.yaml scans.npz --json --strict > answers.jsonl
    imgloc localize office.yaml scans.npz --method ght-v --theta-step-deg 5
    """
    from imgloc.cli import inputs
    from imgloc.runs.localize import Localize
    from imgloc.search.asked import check_options

    folder = inputs.kept_in(kept)
    if list(map(str, scans_paths)).count("-") > 1:
        raise ConfigError("-: got it more than once, but standard input can be read only once")
    read = [*inputs.files_of(map_path), *filter(None, (region, prior_image))]
    inputs.check_target(picture, ".png", force=force, inputs=read)
    inputs.check_target(explain, ".html", force=force)
    job = Localize(
        options=replace(search, theta_step=None).stepped(search.theta_step),
        maps=inputs.map_files(reading),
        scans=inputs.as_recorded(logs, chosen, mounting),
        cell=cell,
        known=known,
        drawn=drawn,
        region=region,
        prior_image=prior_image,
    )
    desk = inputs.desk_of(**vars(taken), cache=folder)
    desk.grid(map_path, job.maps)  # a map that is not there is told before scans are waited for
    runs = []
    for path in scans_paths:
        runs.append(job.open(inputs.item_of(map_path, path), desk).with_true_poses())
        desk.held += inputs.held_bytes(runs[-1].taken.scans.scans)
    sink = _Sink(runs, as_json, mounting, force)
    sink.pictures = inputs.targets(picture, ".png", sink.numbers, force=force, inputs=read)
    sink.pages = inputs.targets(explain, ".html", sink.numbers, force=force)
    inputs.check_prior(known, region, runs[0].features, runs[0].options)
    check_options(runs[0].features, runs[0].options)
    sink.begin(display(map_path))
    for run in runs:
        for n, answer in zip(sink.numbers_of(run), run, strict=True):
            sink.take(run, answer, n)
    sink.end()
    if strict and {verdict for verdict, _ in sink.said} != {"unique"}:
        raise typer.Exit(NOT_UNIQUE)


class _Sink:
    """Prints answers as they come, and draws them."""

    def __init__(
        self, runs: "list[Locating]", as_json: bool, mounting: Mounting, force: bool
    ) -> None:
        self.runs, self.as_json, self.mounting, self.force = runs, as_json, mounting, force
        counts = [len(run) for run in runs]
        self.many, self.several = sum(counts) > 1, len(runs) > 1
        # Files are numbered through all sets, as two of these may have the same index.
        self.numbers = range(sum(counts)) if self.several else runs[0].taken.indices
        self.pictures: dict[int, Path] = {}
        self.pages: dict[int, Path] = {}
        self.narrow = (width() or _WIDE) < _WIDE
        self.scans: list[LaserScan] = []
        self.said: list[tuple[str, Evidence]] = []  # of each scan
        self.sure: list[tuple[LaserScan, Pose2D]] = []  # unique ones, in metres of the map
        self.errors: list[tuple[float, float]] = []  # metres, radians
        self.hints: list[Cause] = []  # about the last scan

    def numbers_of(self, run: "Locating") -> Sequence[int]:
        """Those of the scans of a file."""
        before = sum(len(other) for other in self.runs[: self.runs.index(run)])
        return self.numbers[before : before + len(run)]

    def begin(self, name: str) -> None:
        """Say what is located where, and what the columns of a table are."""
        from imgloc.output.tables import answer_header

        taken = [run.taken for run in self.runs]
        names, total = ", ".join(t.name for t in taken), sum(t.total for t in taken)
        grid = self.runs[0].features.grid
        LOG.info("%s: %d x %d cells of %g m", name, *grid.info.shape, grid.resolution)
        LOG.info("%s: %d of %d scans", names, len(self.numbers), total)
        mounted = any(scan.T_base_laser is not None for t in taken for scan in t.scans.scans)
        if self.many and not self.as_json:
            emit(answer_header(mounted and not self.narrow))

    def take(self, run: "Locating", answer: "Located", n: int) -> None:
        """Draw and print an answer, the `n`-th."""
        from imgloc.features.floor import as_located
        from imgloc.io.scanset import ScanSet
        from imgloc.output.tables import times_words
        from imgloc.pose import difference

        found = answer.of
        self.scans.append(answer.scan)
        self.said.append((found.verdict, found.evidence))
        if found.pose is not None and found.complete:
            self.sure.append((as_located(answer.scan, found.evidence), found.pose))
        if found.best is not None and answer.truth is not None:
            self.errors.append(difference(found.best, answer.truth))
        about = run.taken.name, answer.index, found.verdict, times_words(found)
        LOG.info("%s, scan %d: %s, %s", *about)
        if n in self.pictures or n in self.pages:
            self.hints = run.doubts(ScanSet((answer.scan,)), self.said[-1:])
        if n in self.pictures:
            self._draw(run, answer, self.pictures[n])
        if n in self.pages:
            self._explain(run, answer, self.pages[n])
        self._print(run, answer, first=answer.index == run.taken.indices[0])

    def _draw(self, run: "Locating", answer: "Located", path: Path) -> None:
        from imgloc.output.pictures import draw

        note = as_options("; ".join(hint.short for hint in self.hints))
        image = draw(
            run.features.grid, answer.of, answer.scan, truth=answer.truth, note=note,
            title=run.title(answer.index),
        )  # fmt: skip
        image.save(path, force=self.force)

    def _explain(self, run: "Locating", answer: "Located", path: Path) -> None:
        from imgloc.answers.causes import RAY_BY_RAY
        from imgloc.answers.explain import explain
        from imgloc.output.pages import render_explanation

        reason = explain(run.features, answer.scan, answer.of, run.options)
        title = f"{Path(run.taken.name).name}, scan {answer.index}, on {run.map_name}"
        hints = [as_options(h.said.replace(f"; {RAY_BY_RAY}", "")) for h in self.hints]
        html = render_explanation(reason, title, truth=answer.truth, hints=hints)
        write_text_atomic(path, html, force=self.force)

    def _print(self, run: "Locating", answer: "Located", *, first: bool) -> None:
        from imgloc.output.tables import answer_line, answer_text

        if self.several and first and not self.as_json:
            emit(f"{run.taken.name}:")
        if self.as_json:
            from imgloc.model import to_json
            from imgloc.output.rows import answer_row

            about = {"scans": run.taken.name} if self.several else {}
            sensor, flipped = self.mounting.sensor, self.mounting.flipped
            row = answer_row(
                answer.of, answer.scan, answer.index, sensor=sensor, flipped=flipped, about=about
            )
            emit(to_json(row))
        elif self.many:
            emit(answer_line(answer.index, answer.of, narrow=self.narrow))
        else:
            emit(answer_text(f"scan {answer.index}", answer.of, answer.truth))

    def end(self) -> None:
        """Say how it went, and what most likely keeps scans from fitting."""
        from imgloc.cli.inputs import aged
        from imgloc.io.scanset import ScanSet
        from imgloc.output.tables import run_words

        verdicts = [verdict for verdict, _ in self.said]
        if len(verdicts) >= _MANY and not self.as_json:
            say(run_words(verdicts, self.errors))
        for files in (self.pictures, self.pages):
            if written := [display(path) for path in files.values()]:
                one = len(written) == 1
                text = written[0] if one else f"{len(written)} files, {written[0]} to {written[-1]}"
                LOG.log(logging.INFO if self.as_json or one else logging.WARNING, "wrote %s", text)
        if self.as_json and set(verdicts) == {"invalid"}:
            return  # rows say it themselves, to a program
        first = self.runs[0]
        scans = ScanSet(tuple(self.scans)) if self.several else first.taken.scans
        if self.many or not (self.pictures or self.pages):
            self.hints = first.doubts(scans, self.said)
        passed = aged(first.features.grid, self.sure, first.options.shared)
        if passed and not self.hints:  # to a sensor upside down walls are gone, too
            found = first.misread(scans, self.said)
            self.hints = [found or passed]
        for hint in self.hints:
            if hint.code != "swapped":  # is said when the map is read
                LOG.warning("%s", hint.said)
        if not self.hints and 2 * verdicts.count("unique") < len(verdicts):
            from imgloc.answers.logcheck import warn_of

            for run in self.runs:
                warn_of(run.taken.scans, run.taken.name)
