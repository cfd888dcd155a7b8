"""Logs and maps as `imgloc inspect` reports them; a command imports this when it runs."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imgloc.answers.causes import Cause, cause
from imgloc.answers.logcheck import FOLLOWED, LogReport, check_log, on_map
from imgloc.answers.scanmotion import AGREES
from imgloc.cli import inputs
from imgloc.cli import options as opt
from imgloc.cli.command import Typed
from imgloc.cli.console import LOG, emit
from imgloc.errors import ScanError, as_options
from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.follow import Tracking, follow
from imgloc.filters.motion import increments
from imgloc.io.badlines import warned
from imgloc.io.calibration import calibrated
from imgloc.io.files import display
from imgloc.io.images import IMAGE_ENDINGS, LOSSY_ENDINGS
from imgloc.io.kinds import Kind, kinds_of, lasers_in
from imgloc.io.maps import named_map
from imgloc.io.mapyaml import YAML_ENDINGS
from imgloc.io.scans import SCAN_ENDINGS, why_no_scans
from imgloc.io.scanset import ScanSet
from imgloc.model import to_json
from imgloc.options import Logs, Mounting, Options
from imgloc.output.inspection import draw_log, log_row, log_text
from imgloc.output.tables import report_text
from imgloc.ranges import declared
from imgloc.runs.check import Check
from imgloc.runs.opening import Desk, MapFiles, ScanFiles

_LEAST, _MOST = 10, 80  # scans that are worth following, and that are followed here
_OWN = ("--json", "--picture", "--force")  # options that other commands have not, or mean another


def is_map(path: Path) -> bool:
    """True of a map: an image, a YAML that names one, or a bundled map by its name."""
    ending = path.suffix.lower()
    if ending in YAML_ENDINGS:
        why = why_no_scans(path)
        return bool(why) and not why.startswith("cannot be read")
    if ending in (*IMAGE_ENDINGS, *LOSSY_ENDINGS):
        return True
    return ending not in SCAN_ENDINGS and opt.find_map(path) != path


def show_map(path: Path, how: MapFiles, desk: Desk, typed: Typed, *, as_json: bool) -> None:
    """Print what is in a map, and what is likely to be wrong with it."""
    (answer,) = Check(maps=how).open(inputs.item_of(path), desk)
    known = {"--memory-budget", *(f.flag for f in declared(opt.MapImages))} - {"--allow-lossy"}
    words = _quoted({flag: words for flag, words in typed.items() if flag in known})
    command = " ".join(["imgloc map check", _word(path), *words])
    text = f"{report_text(answer.of)}\n  next        {command}"
    emit(to_json(answer.row | {"next": command}) if as_json else text)


@dataclass(frozen=True)
class Look:
    """Looks at logs, one after the other."""

    desk: Desk
    how: MapFiles
    map: Path | None
    logs: Logs
    mounting: Mounting
    typed: Typed

    def at(self, path: Path, *, as_json: bool, picture: Path | None, force: bool) -> None:
        """Look at a log, print what is in it, draw it."""
        form, kinds = ("standard input", []) if str(path) == "-" else kinds_of(path)
        with warned():
            logs, more = self._topic(path, form, kinds)
        with warned() as said:
            how = inputs.as_recorded(logs, mounting=self.mounting)
            scans = self.desk.scans(path, how).scans
        name = f"{inputs.name_of(path)}: "
        notes = [Cause(code, text.removeprefix(name), serious=False) for text, code in said.items()]
        report = check_log(scans, [*notes, *more], how.given)
        if self.map is not None:
            features = self.desk.features(self.map, self.how, Options(), scans=scans.scans)
            options = Options(memory_budget=self.desk.budget)
            options = calibrated(options, self.map, features.grid)
            given = how.given.beside(self.map, features.grid)
            report = on_map(report, scans, features, options, given)
            report = _followed(report, scans, features, options)
            self.desk.keep(features)
        command = self._next(path, report, logs)
        about = inputs.name_of(path), form, kinds, report, command
        emit(to_json(log_row(*about)) if as_json else log_text(*about))
        if picture is not None:
            draw_log(about[0], report, scans[report.scan]).save(picture, force=force)
            LOG.info("wrote %s", display(picture))

    def _topic(self, path: Path, form: str, kinds: Sequence[Kind]) -> tuple[Logs, list[Cause]]:
        """The laser that is looked at, and a word about the others."""
        lasers = lasers_in(form, list(kinds))
        if len(lasers) < 2 or self.logs.topic is not None:
            return self.logs, []
        names = ",".join(laser.name for laser in lasers)
        first = next((k.name for k in lasers if k.name in ("/scan", "FLASER")), lasers[0].name)
        if first == "/scan":  # the others are often made of it
            return self.logs, []
        key = "two-lasers/topics"
        try:
            how = ScanFiles(**vars(replace(self.logs, topic=names)), many=True)
            every = check_log(self.desk.scans(path, how).scans)
            odd = next((f for f in every.findings if f.code == "two-lasers" and f.options), None)
            if odd is not None:  # the others are taken
                topic = as_options(odd.options).split()[1].split(",")[0]
                return replace(self.logs, topic=topic), [replace(odd, serious=False)]
        except ScanError:  # they are not of one robot, or it is not known where they sit
            key = "two-lasers/apart"
        more = [cause(key, count=len(lasers), first=first, names=names)]
        return replace(self.logs, topic=first), more

    def _next(self, path: Path, report: LogReport, logs: Logs) -> str:
        """The command to go on with: it goes on from the options that were typed."""
        follow = report.can_be_followed and report.facts["scans"] >= _LEAST
        words = ["imgloc", "track" if follow else "localize"]
        words += ["MAP" if self.map is None else _word(self.map), _word(path)]
        words += [] if follow else ["--scans-index", str(report.scan)]
        typed = {flag: one for flag, one in self.typed.items() if flag not in _OWN}
        typed |= {"--topic": ["--topic", logs.topic]} if logs.topic is not None else {}
        mended = dict[str, list[str]]()
        for word in as_options(report.options).split():
            mended.setdefault(word if word[:2] == "--" else list(mended)[-1], []).append(word)
        if "--range-scale" in mended:
            mended["--range-scale"][1] = f"{logs.scale * float(mended['--range-scale'][1]):g}"
        if not follow:
            mended.pop("--odom", None)
        if self.mounting.flipped and "--flipped" in mended:  # it is upright
            del typed["--flipped"], mended["--flipped"]
        return " ".join([*words, *_quoted(typed | mended)])


def _followed(
    report: LogReport, scans: ScanSet, features: MapFeatures, options: Options
) -> LogReport:
    """The report, with what is found where the robot is followed for some metres.

    A similar building fits here and there, but along a way scans pass its walls.
    """
    doubted = any(found.code == "disagree" for found in report.findings)
    wrong = any(f.serious or (f.options and f.code != "disagree") for f in report.findings)
    placed = report.facts["on_map"]
    if wrong or not report.can_be_followed or not placed["unique"] or scans.odom is None:
        return report
    some = scans.take(np.flatnonzero(np.isfinite(scans.odom).all(axis=1)).tolist())
    tracking = Tracking()
    x, y, turn = increments(np.asarray(some.odom)).T
    gone = np.hypot(x, y) / tracking.every.metres + np.abs(turn) / tracking.every.radians
    gone = np.floor(np.append(0.0, gone.cumsum()))
    some = some.take(np.unique(gone, return_index=True)[1][:_MOST].tolist())
    robot = tracking.made(features, options)
    try:
        moments = list(follow(features, some, robot))
    except ScanError:  # stamps that are no seconds, for one: whoever tracks is told
        return report
    unique = sum(moment.pose is not None for moment in moments)
    passed = inputs.aged_along(features.grid, some, moments, robot.options.shared)
    serves, fits = 2 * unique >= len(moments), 2 * placed["unique"] > sum(placed.values())
    if passed is None and fits and not serves and not doubted:
        agreed = (report.facts["agreement"] or 0.0) >= AGREES  # so the odometry may be right
        tried = "" if agreed else "`odom=scans`"
        passed = cause("disagree/along", unique=unique, count=len(moments), options=tried)
    settled = passed is not None or unique >= FOLLOWED * len(moments)
    rest = [
        replace(found, options="") if serves and found.code == "disagree" else found
        for found in report.findings if not (settled and found.code == "map")
    ]  # fmt: skip
    along = {"metres": moments[-1].metres, "scans": len(moments), "unique": unique}
    facts = {**report.facts, "followed": along}
    return replace(report, facts=facts, findings=(*filter(None, [passed]), *rest))


def _word(path: Path) -> str:
    """The word for a file on a command line: a bundled map its name, and a copy its address."""
    return shlex.quote(path.stem if named_map(path.stem) == path else display(path))


def _quoted(typed: Typed) -> list[str]:
    return [shlex.quote(word) for words in typed.values() for word in words]
