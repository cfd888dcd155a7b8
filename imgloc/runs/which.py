"""The job ``which``: from which of several maps each scan of a file is, or from none."""

import contextlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from imgloc.answers.causes import Cause, cause
from imgloc.answers.diagnose import doubts
from imgloc.choice.choose import OPTIONS, Choice, Opened, at_first, bounds_of, choose, search
from imgloc.choice.folder_index import MapIndex, open_index
from imgloc.errors import ConfigError, MapError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import evenly
from imgloc.io.calibration import calibrated, said_scale
from imgloc.io.contents import content_hash, files_of
from imgloc.io.files import display
from imgloc.io.scanset import ScanSet
from imgloc.model import LaserScan, Localization
from imgloc.options import NAMED, Known, Length, Options, Prior, Sure
from imgloc.pipeline import localize
from imgloc.runs.jobs import LOCATING, Answer, Item, Job
from imgloc.runs.opening import LOG, Desk, ScanFiles, Taken
from imgloc.search.asked import check_options
from imgloc.search.priors import leaves_none, prior_of

Unusable = MapError | ConfigError
_TRIED = 3  # scans without a map that are located again


@dataclass(frozen=True, kw_only=True)
class Which(Job):
    """Name the map of each scan, of all maps of an item."""

    name = "which"
    all_maps = True
    decided_by = LOCATING | {"choose", "folder_index"}

    scans: ScanFiles = field(default_factory=ScanFiles)
    cell: Length = 0.1  #: of the poses, metres
    known: Known = field(default_factory=Known)  #: what is known of all poses, but no place
    sure: Sure = NAMED  #: probability that a map needs to be named

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.known.near is not None:
            raise ConfigError("`near`: a place belongs to one map, and several are to be compared")

    def open(self, item: Item, desk: Desk, *, file: Path | None = None) -> "Choosing":
        """Read the scans of an item, and look at all of its maps: see :meth:`look`."""
        taken = desk.scans(item.scans_path, self.scans)
        return self.look(item, desk, taken, file=file)

    def look(
        self, item: Item, desk: Desk, taken: Taken | None = None, *, file: Path | None = None
    ) -> "Choosing":
        """Make the index of an item's maps, or read what of it is in a `file`, which is kept.

        Few maps are all searched, so without a file they need none.
        """
        found = Choosing(self, item, desk, taken)
        if file is None and at_first(len(item.maps)) == len(item.maps):
            found.index = MapIndex(tuple(found.files), (), ())
            return found
        about = f"{sorted(self.maps.reading.items())} {self.maps.allow_lossy}"
        contents = tuple(content_hash(files_of(path)) for _, path in item.maps)

        def make() -> tuple[MapIndex, dict[str, Unusable]]:
            with desk.progress("prepare", len(item.maps)) as advance:
                return open_index(
                    dict(item.maps), found.features, about=about, file=file,
                    memory_budget=desk.budget, advance=advance,
                )  # fmt: skip

        found.index, errors = desk.once("index", (item.maps, contents, self.digest, file), make)
        found.failed.update(errors)
        for error in list(errors.values())[len(errors) == len(item.maps) :]:
            LOG.warning("left out: %s", error)  # the first may be the reason of the next error
        found.check()
        return found


@dataclass(kw_only=True, eq=False)
class Named(Answer):
    """The answer to one scan."""

    of: Choice
    fits: Mapping[str, Localization]  #: in the maps that were searched
    scan: LaserScan
    best: str  #: the map that is likeliest


class Choosing:
    """Lazy iterator of answers: the map of each scan."""

    index: MapIndex

    def __init__(self, job: Which, item: Item, desk: Desk, taken: Taken | None) -> None:
        self.job, self.item, self.desk, self.taken = job, item, desk, taken
        self.files = dict(item.maps)
        self.failed: dict[str, Unusable] = {}  #: maps that cannot be used
        self.options = replace(OPTIONS, threads=desk.threads, memory_budget=desk.memory_budget)

    def features(self, path: Path) -> MapFeatures:
        """One of the maps, prepared."""
        scans = () if self.taken is None else self.taken.scans.scans
        return self.desk.features(
            path, self.job.maps, self.options, cell=self.job.cell, scans=scans, hint="crop the map"
        )

    def check(self) -> None:
        """Raise an error if no map is left."""
        errors = list(self.failed.values())
        if len(errors) == len(self.files):  # too little memory is no fault of the maps
            kind = MapError if any(isinstance(e, MapError) for e in errors) else ConfigError
            none = f"none of its {len(errors)} maps can be used"
            raise kind(f"{self.item.map}: {none}: {errors[0]}")

    @contextlib.contextmanager
    def _opened(self, name: str) -> Iterator[Opened | None]:
        path = self.files[name]
        try:
            features = self.features(path)
            prior = prior_of(self.job.known, features.grid)
            options = calibrated(replace(self.options, prior=prior), path, features.grid)
            if leaves_none(prior, features):
                LOG.info("%s: left out, no place for the robot satisfies the prior", display(path))
                yield None
                return
            check_options(features, options)
        except (MapError, ConfigError) as error:
            LOG.warning("left out: %s", error)
            self.failed[name] = error
            yield None
            return
        yield features, options
        self.desk.keep(features)

    def __iter__(self) -> Iterator[Named]:
        if self.taken is None:
            return
        scans = self.taken.scans.scans
        coarse = replace(self.options, prior=Prior(None, self.job.known.heading))
        said = [said_scale(self.files[name]) for name in self.index.names]
        bounds = partial(bounds_of, self.index, said, options=coarse)
        steps = len(scans) * at_first(len(self.index.names))
        with self.desk.progress("which", steps, lines=False) as advance:
            fits = search(scans, self.index.names, bounds, self._opened, advance)
        self.check()
        if not all(fits):
            raise ConfigError("`clearance`: no map has a place in which the robot can be")
        left_out = [{"map": name, "message": str(error)} for name, error in self.failed.items()]
        for (k, scan, _), some in zip(self.taken, fits, strict=True):
            ruled_out = len(self.index.names) - len(some)
            choice = choose(some, self.options.trust, sure=self.job.sure, ruled_out=ruled_out)
            best = next(iter(choice.probability))
            yield Named(
                row=choice.as_row(some, k),
                of=choice,
                beside={"left_out": left_out} if left_out else {},
                ms=sum(answer.timings_ms["localize"] for answer in some.values()),
                doubtful=choice.verdict != best,
                index=k,
                drawn=self._drawn(best, some[best], scan, k),
                fits=some,
                scan=scan,
                best=best,
            )

    def doubts(self, answers: Sequence[Named]) -> list[Cause]:
        """Causes if most of the scans have no map, tried in the map that fits most.

        `which` allows for no error that all readings share, because every map would gain by one;
        `localize` does, and may be sure of a scan that has no map here.
        """
        lost = [answer for answer in answers if answer.of.verdict in ("none", "undecided")]
        if 2 * len(lost) <= len(answers):
            return []
        lost = [lost[k] for k in evenly(len(lost), _TRIED).tolist()]
        likely = Counter(name for one in lost for name in list(one.of.probability)[:_TRIED])
        for name, _ in likely.most_common(_TRIED):
            if found := self._doubts(name, ScanSet(tuple(answer.scan for answer in lost))):
                return [found]
        return []

    def _doubts(self, name: str, scans: ScanSet) -> Cause | None:
        """Causes that keep scans from being of one of the maps, if any was found."""
        features = self.features(self.files[name])
        prior = prior_of(self.job.known, features.grid)
        options = Options(
            prior=prior, threads=self.desk.threads, memory_budget=self.desk.memory_budget
        )
        options = calibrated(options, self.files[name], features.grid)
        located = [localize(features, scan, options) for scan in scans.scans]
        said = [(answer.verdict, answer.evidence) for answer in located]
        given = self.job.scans.given.beside(self.files[name], features.grid)
        for doubt in doubts(features, scans, said, options, given):
            return replace(doubt, text=f"{name}: {doubt.text}") if doubt.found else None
        if 2 * sum(answer.verdict == "unique" for answer in located) <= len(located):
            return None
        return cause("none", name=name)

    def _drawn(
        self, best: str, answer: Localization, scan: LaserScan, index: int
    ) -> tuple[Any, ...]:
        if self.job.pictures == "none":  # the map may have to be prepared again
            return ()
        title = f"{best}: {self.item.scans}, scan {index}"
        return "answer", self.features(self.files[best]), answer, scan, None, self.options, title
