"""One core that answers robots: maps kept ready, one scan at a time, the newest first.

>>> import imgloc
>>> from imgloc.io.maps import bundled_maps
>>> grid = imgloc.load_map(bundled_maps() / "curved.yaml")
>>> scan = imgloc.simulate(grid, 1, seed=1)[0]
>>> with Localizer(grid) as core:
...     answer = core.localize(scan)
>>> answer.value.verdict, answer.map, answer.dropped
('unique', 'map', 0)
"""

import atexit
import itertools
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as Late
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from imgloc.choice.choose import OPTIONS, Choice, Opened, bounds_of, choose, search
from imgloc.choice.folder_index import MapIndex, index_of
from imgloc.errors import ConfigError, expect
from imgloc.filters.evidence import DEVIATION
from imgloc.filters.follow import Follower, Moment, Tracking, start_of
from imgloc.live.line import Dropped, Key, Line
from imgloc.live.sites import Maker, MapLike, Site, site_of, warm
from imgloc.model import FloatArray, LaserScan, Localization, Pose2D, plain
from imgloc.options import NAMED, Known, Options, Prior
from imgloc.pipeline import localize
from imgloc.robot.stamps import AHEAD, OLD
from imgloc.search.priors import leaves_none, prior_of

T = TypeVar("T")
Clock = Callable[[], float]
Maps = MapLike | Maker | Mapping[str, MapLike | Maker]
ALONE = "map"
"""The name of a map that was given without one."""
READY, PREPARING, FAILED = "ready", "preparing", "failed"


@dataclass(frozen=True)
class Answer(Generic[T]):
    """A result, with the stamp and the age of its scan."""

    value: T
    map: str | None  #: name of the map; None if :meth:`Localizer.which` names none
    stamp: float  #: of the scan, seconds; NaN when unknown
    age: float  #: seconds from the stamp to the answer, by the clock; NaN when unknown
    waited_ms: float  #: time in the line
    took_ms: float  #: time at work
    dropped: int  #: number of scans of this source dropped so far
    era: int = 0  #: number of resets of the robot, or version of the map, when the scan came

    def about(self) -> dict[str, Any]:
        """All fields but the value, as plain values for JSON."""
        names = ("map", "stamp", "age", "waited_ms", "took_ms", "dropped", "era")
        return dict(plain({name: getattr(self, name) for name in names}))


@dataclass(frozen=True)
class Chosen:
    """The map that a scan is from, and how the scan fits the maps that were compared."""

    choice: Choice
    fits: Mapping[str, Localization]

    @property
    def best(self) -> Localization | None:
        """The answer in the named map; None if no map is named."""
        return self.fits.get(self.choice.verdict)

    def as_row(self, index: int = 0) -> dict[str, Any]:
        """The row of `imgloc which --json`."""
        return self.choice.as_row(self.fits, index)


@dataclass(eq=False)
class _Entry:
    """A map and its preparation."""

    made: MapLike | Maker
    era: int
    compared: bool = True
    site: Site | None = None
    error: Exception | None = None

    @property
    def state(self) -> str:
        if self.error is not None:
            return FAILED
        return PREPARING if self.site is None else READY


class Localizer:
    """Keeps maps prepared and answers scans; all methods may be called from any thread.

    One thread computes, one scan at a time, in the order of arrival. One scan of each source
    waits: a newer one replaces it, and the caller of the older one gets :class:`Dropped`.

    Parameters
    ----------
    maps : OccupancyGrid, MapFeatures, Site, callable, or a mapping of str to these
        A callable makes the map in the thread that prepares it. A single map is named ``map``.
    options : Options, optional
        Options of :meth:`localize` and of robots, unless a call passes others.
    tracking : Tracking, optional
        How robots are followed, unless :meth:`robot` gets another one.
    background : bool
        Return at once, and prepare the maps in a thread: see `ready`, :meth:`wait` and `errors`.
        Otherwise the constructor prepares them and raises the first error.
    clock : callable
        Returns the time in seconds, on the same clock as the stamps of the scans.
    prepared : callable, optional
        Called with name and site before a map counts as ready, in the thread that prepares it.

    Raises
    ------
    ImglocError
        If a map cannot be used and `background` is false.

    Examples
    --------
    >>> import imgloc
    >>> from imgloc.io.maps import bundled_maps
    >>> floors = {name: bundled_maps() / f"{name}.yaml" for name in ("curved", "corridor")}
    >>> made = {name: lambda path=path: imgloc.load_map(path) for name, path in floors.items()}
    >>> with Localizer(made, background=True) as core:
    ...     ready = core.wait()
    ...     scan = imgloc.simulate(core.site("curved").features.grid, 1, seed=1)[0]
    ...     found = core.which(scan)
    >>> ready, found.map, found.value.best.verdict
    (True, 'curved', 'unique')
    """

    def __init__(
        self,
        maps: Maps | None = None,
        options: Options | None = None,
        *,
        tracking: Tracking | None = None,
        background: bool = False,
        clock: Clock = time.time,
        prepared: Callable[[str, Site], object] | None = None,
    ) -> None:
        self.options, self.tracking = options or Options(), tracking or Tracking()
        self._clock, self._prepared = clock, prepared
        self._line, self._closed = Line(), False
        self._entries = dict[str, _Entry]()
        self._changed = threading.Condition()  # entries, the queue of those to prepare
        self._queue = deque[tuple[str, _Entry]]()
        self._preparing: threading.Thread | None = None
        self._index: tuple[tuple[_Entry, ...], MapIndex] | None = None
        self._robots = list[Robot]()
        self._eras = itertools.count(1)
        given = {} if maps is None else maps if isinstance(maps, Mapping) else {ALONE: maps}
        for name, made in given.items():
            self._put(name, made, background=background)
        if not background:
            self._make_index()
        self._own = self.robot()
        _OPEN.add(self)

    # Maps.

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the maps, in the order given."""
        return tuple(self._entries)

    @property
    def ready(self) -> bool:
        """True if every map is prepared: no later answer has to make anything of a map."""
        entries = tuple(self._entries.values())
        prepared = bool(entries) and all(entry.site is not None for entry in entries)
        indexed = not self._compared() or self._indexed() is not None
        return not self._closed and prepared and indexed

    @property
    def errors(self) -> Mapping[str, Exception]:
        """Errors of the maps that cannot be used, by name."""
        entries = tuple(self._entries.items())
        return MappingProxyType({n: e.error for n, e in entries if e.error is not None})

    def state(self, name: str) -> str:
        """State of a map: ``ready``, ``preparing`` or ``failed``."""
        return self._entry(name)[1].state

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the preparation ends, at most `timeout` seconds; return `ready`."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or not self._preparing, timeout)
        return self.ready

    def site(self, name: str | None = None, timeout: float | None = None) -> Site:
        """Wait for a map and return it; by default the only map.

        Raises
        ------
        ConfigError
            If no map has this name, or there are several maps and no name is given.
        Dropped
            If the map is not prepared within `timeout` seconds.
        ImglocError
            The error of a map that failed.
        """
        found = self._entry(name)[0]
        with self._changed:
            self._changed.wait_for(
                lambda: self._closed or self._entry(found)[1].state != PREPARING, timeout
            )
        if not self._closed and self.state(found) == PREPARING:
            raise Dropped("late")
        return self._ready(found)[1]

    def put(
        self, name: str, made: MapLike | Maker, *, background: bool = True, compared: bool = True
    ) -> None:
        """Add a map, or replace the map of this name; its robots are reset.

        Parameters
        ----------
        name : str
        made : OccupancyGrid, MapFeatures, Site or callable
        background : bool
            Prepare it in a thread. Otherwise it is ready on return, and an error changes nothing.
        compared : bool
            :meth:`which` compares this map with the others.
        """
        self._put(name, made, background=background, compared=compared)
        if not background:
            self._make_index()

    def _put(
        self, name: str, made: MapLike | Maker, *, background: bool, compared: bool = True
    ) -> None:
        if self._closed:
            raise Dropped("closed")
        entry = _Entry(made, next(self._eras), compared)
        if not background:
            self._prepare(name, entry)
            if entry.error is not None:
                raise entry.error
        with self._changed:
            self._entries[name] = entry
            if background:
                self._queue.append((name, entry))
                if self._preparing is None:
                    self._preparing = threading.Thread(
                        target=self._prepare_all, name="imgloc maps", daemon=True
                    )
                    self._preparing.start()
            self._changed.notify_all()
        self._replaced(name)

    def drop(self, name: str) -> None:
        """Forget a map."""
        with self._changed:
            del self._entries[self._entry(name)[0]]
            self._changed.notify_all()
        self._make_index()
        self._replaced(name)

    # Answers.

    @property
    def waiting(self) -> int:
        """Number of scans that wait."""
        return self._line.waiting

    @property
    def busy(self) -> bool:
        """True if a scan is being looked at."""
        return self._line.busy

    @property
    def dropped(self) -> int:
        """Number of scans of all sources dropped so far."""
        return self._line.dropped

    def localize(
        self,
        scan: LaserScan,
        map: str | None = None,
        options: Options | None = None,
        *,
        known: Known | None = None,
        source: Hashable = None,
        timeout: float | None = None,
    ) -> Answer[Localization]:
        """Find every pose that fits a scan: :func:`imgloc.localize`.

        Parameters
        ----------
        scan : LaserScan
            Mounted, cut and scaled by the caller.
        map : str, optional
            Name of the map; the call waits until it is prepared. By default the only map.
        options : Options, optional
            Used instead of the localizer's own; the calibration of the map is joined to them.
        known : Known, optional
            Poses that the sensor may have, joined to the prior of the options.
        source : hashable
            One scan of each source waits.
        timeout : float, optional
            Seconds after which the call raises :class:`Dropped`.
        """
        until = _until(timeout)
        self.site(map, _left(until))
        asked = self.localize_soon(scan, map, options, known=known, source=source)
        return _wait_for(asked, until)

    def localize_soon(
        self,
        scan: LaserScan,
        map: str | None = None,
        options: Options | None = None,
        *,
        known: Known | None = None,
        source: Hashable = None,
        at: Site | None = None,
    ) -> "Future[Answer[Localization]]":
        """Return a future of :meth:`localize` at once; Dropped if the map is not prepared yet.

        `at` is the map itself, if the caller has looked for the name before.
        """
        expect(scan, LaserScan, "scan")
        name = self._entry(map)[0] if at is None else str(map)
        if at is None:
            self._ready(name)
        key = Key("localize", source)

        def work(waited: float) -> Answer[Localization]:
            begin = time.perf_counter()
            era, site = 0, at
            if site is None:
                entry, site = self._ready(name)
                era = entry.era
            how = site.options(options or self.options)
            if known is not None:
                how = replace(how, prior=how.prior & prior_of(known, site.features.grid))
            found = localize(site.features, scan, how)
            return self._answer(found, name, scan, key, waited, begin, era)

        return self._line.put(key, work)

    def which(
        self,
        scan: LaserScan,
        *,
        sure: float = NAMED,
        known: Known | None = None,
        source: Hashable = None,
        timeout: float | None = None,
    ) -> Answer[Chosen]:
        """Say from which of the maps a scan is, by the method fused: :func:`imgloc.which`.

        Parameters
        ----------
        scan : LaserScan
        sure : float
            Probability that a map needs to be named.
        known : Known, optional
            Heading and clearance of the sensor, valid in any map.
        source, timeout : hashable, float
            See :meth:`localize`. The call waits until all maps to compare are prepared.
        """
        until = _until(timeout)
        for name in self._compared():
            self.site(name, _left(until))
        return _wait_for(self.which_soon(scan, sure=sure, known=known, source=source), until)

    def which_soon(
        self,
        scan: LaserScan,
        *,
        sure: float = NAMED,
        known: Known | None = None,
        source: Hashable = None,
    ) -> "Future[Answer[Chosen]]":
        """Return a future of :meth:`which` at once; Dropped if a map is not prepared yet."""
        expect(scan, LaserScan, "scan")
        known = known or Known()
        if known.near is not None or known.hints:
            raise ConfigError(
                "`near` belongs to one map; expected `heading` or `clearance`, for any map"
            )
        self._all()
        key = Key("which", source)

        def work(waited: float) -> Answer[Chosen]:
            begin = time.perf_counter()
            entries, index = self._all()
            found = self._choose(scan, entries, index, sure, known)
            named = found.choice.verdict if found.best is not None else None
            era = max(entry.era for entry in entries.values())
            return self._answer(found, named, scan, key, waited, begin, era)

        return self._line.put(key, work)

    def soon(self, work: Callable[[], T], source: Hashable = None) -> "Future[T]":
        """Do something in the thread that computes; one work of each source waits."""
        return self._line.put(Key("soon", source), lambda _: work())

    def update(
        self,
        scan: LaserScan,
        odometry: FloatArray | None,
        *,
        source: Hashable = None,
        timeout: float | None = None,
    ) -> Answer[Moment]:
        """Follow the localizer's own robot by a scan: :meth:`Robot.update`."""
        return self._own.update(scan, odometry, source=source, timeout=timeout)

    def update_soon(
        self, scan: LaserScan, odometry: FloatArray | None, *, source: Hashable = None
    ) -> "Future[Answer[Moment]]":
        """Return a future of :meth:`update` at once."""
        return self._own.update_soon(scan, odometry, source=source)

    def start_at(
        self, pose: Pose2D, deviation: tuple[float, float] = DEVIATION, map: str | None = None
    ) -> None:
        """Set the pose of the localizer's own robot: :meth:`Robot.start_at`."""
        self._own.start_at(pose, deviation, map)

    def reset(self, map: str | None = None) -> None:
        """Forget the localizer's own robot: :meth:`Robot.reset`."""
        self._own.reset(map)

    def robot(
        self,
        map: str | None = None,
        tracking: Tracking | None = None,
        options: Options | None = None,
        clock: Clock | None = None,
    ) -> "Robot":
        """Return one more robot with a belief of its own; :meth:`Robot.end` removes it."""
        robot = Robot(self, map, tracking or self.tracking, options, clock or self._clock)
        self._robots.append(robot)
        return robot

    def close(self, *, wait: bool = False) -> None:
        """Drop all scans that wait and take no more; the scan under way is finished.

        Parameters
        ----------
        wait : bool
            Return once the scan and the map under way are finished.
        """
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            preparing = self._preparing
        self._line.close(wait=wait)
        if wait and preparing is not None:
            preparing.join()

    def __enter__(self) -> "Localizer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Inside.

    def _entry(self, name: str | None) -> tuple[str, _Entry]:
        """A map by its name; a ConfigError that names those that there are."""
        entries = dict(self._entries)
        if name is None and len(entries) == 1:
            return next(iter(entries.items()))
        if name is None or name not in entries:
            got = "no name" if name is None else repr(name)
            listed = ", ".join(entries) or "a map to be added first, there is none"
            raise ConfigError(f"`map`: got {got}, expected {listed}")
        return name, entries[name]

    def _ready(self, name: str | None) -> tuple[_Entry, Site]:
        """A prepared map; raises its error, or Dropped, if it is not prepared."""
        if self._closed:
            raise Dropped("closed")
        entry = self._entry(name)[1]
        if entry.error is not None:
            raise entry.error.with_traceback(None)
        if entry.site is None:
            raise Dropped("preparing")
        return entry, entry.site

    def _all(self) -> tuple[dict[str, _Entry], MapIndex]:
        """The maps to compare and their index; raises Dropped if one is not prepared."""
        entries, index = self._compared(), self._indexed()
        if not entries:
            self._entry(None)
        for name in entries:
            self._ready(name)
        if index is None:
            raise Dropped("preparing")
        return entries, index

    def _compared(self) -> dict[str, _Entry]:
        """The maps that :meth:`which` compares."""
        return {name: entry for name, entry in dict(self._entries).items() if entry.compared}

    def _indexed(self) -> MapIndex | None:
        """The index of the maps to compare; None if it has not been made for these."""
        index = self._index
        these = tuple(self._compared().values())
        return None if index is None or index[0] != these else index[1]

    def _make_index(self) -> None:
        """Make the index of the maps to compare, once all of them are prepared."""
        with self._changed:
            entries = self._compared()
            if entries and self._indexed() is not None:
                return
            if not entries or any(entry.site is None for entry in entries.values()):
                self._index = None
                return
            index = index_of({name: _site(entry).features for name, entry in entries.items()})
            _ = index.tiles
            self._index = tuple(entries.values()), index

    def _choose(
        self, scan: LaserScan, entries: Mapping[str, _Entry], index: MapIndex, sure: float,
        known: Known,
    ) -> Chosen:  # fmt: skip
        base = replace(
            OPTIONS, threads=self.options.threads, memory_budget=self.options.memory_budget
        )
        scales = [_site(entries[name]).shared.scale for name in index.names]
        coarse = replace(base, prior=Prior(None, known.heading))
        bounds = partial(bounds_of, index, scales, options=coarse)

        @contextmanager
        def open_map(name: str) -> Iterator[Opened | None]:
            site = _site(entries[name])
            prior = prior_of(known, site.features.grid)
            how = site.options(replace(base, prior=prior))
            yield None if leaves_none(prior, site.features) else (site.features, how)

        (fits,) = search([scan], index.names, bounds, open_map)
        if not fits:
            raise ConfigError("`clearance`: no map has a free place so far from its walls")
        ruled_out = len(index.names) - len(fits)
        return Chosen(choose(fits, base.trust, sure=sure, ruled_out=ruled_out), fits)

    def _answer(
        self, value: T, name: str | None, scan: LaserScan, key: Key, waited: float, begin: float,
        era: int, clock: Clock | None = None,
    ) -> Answer[T]:  # fmt: skip
        took = time.perf_counter() - begin
        age = (clock or self._clock)() - scan.stamp
        dropped = self._line.counts[key]
        return Answer(value, name, scan.stamp, age, 1e3 * waited, 1e3 * took, dropped, era)

    def _replaced(self, name: str) -> None:
        for robot in tuple(self._robots):
            if robot.map in (name, None):
                robot.reset()

    def _prepare(self, name: str, entry: _Entry) -> None:
        try:
            site = site_of(entry.made, name)
            warm(site, self.options, self.tracking)
            if self._prepared is not None:
                self._prepared(name, site)
        except Exception as error:  # raised where the map is asked for
            entry.error = error
        else:
            entry.made = entry.site = site

    def _prepare_all(self) -> None:
        while True:
            with self._changed:
                if not self._queue or self._closed:
                    try:
                        if not self._closed:
                            self._make_index()
                    finally:
                        self._preparing = None
                        self._changed.notify_all()
                    return
                name, entry = self._queue.popleft()
            if self._entries.get(name) is entry:
                self._prepare(name, entry)
            with self._changed:
                self._changed.notify_all()


_OPEN = weakref.WeakSet[Localizer]()


@atexit.register
def _end_all() -> None:
    # The process aborts if a thread is inside OpenCV when the interpreter ends.
    for core in tuple(_OPEN):
        core.close(wait=True)


class Robot:
    """A robot in one of the maps of a :class:`Localizer`, made by :meth:`Localizer.robot`.

    Its answers are the moments of a :class:`~imgloc.filters.follow.Follower`.
    """

    def __init__(
        self, core: Localizer, map: str | None, tracking: Tracking, options: Options | None,
        clock: Clock,
    ) -> None:  # fmt: skip
        self.map = map  #: name of the map where it is; None means the only map
        self.tracking = tracking
        self._core, self._options, self._clock = core, options, clock
        self._lock = threading.RLock()
        self._follower: Follower | None = None
        self._start: tuple[Pose2D, tuple[float, float]] | None = None
        self.era = 0  #: number of resets

    def update(
        self,
        scan: LaserScan,
        odometry: FloatArray | None,
        *,
        source: Hashable = None,
        timeout: float | None = None,
    ) -> Answer[Moment]:
        """Take a scan and return what is believed of the pose now.

        Parameters
        ----------
        scan : LaserScan
            With its stamp, if known; with its `laser` and `T_base_laser`, if the robot has several.
        odometry : (3,) array, optional
            Pose x, y [m], theta [rad] of the robot in the odometry's frame at the stamp. Without
            any, the motion is found by the scans alone.
        source : hashable
            One scan of each waits; by default of each laser. A text is the name of the laser, if
            the scan has none.
        timeout : float, optional
            Seconds after which the call raises Dropped. The belief still takes a scan that is
            being looked at.

        Raises
        ------
        Dropped
            ``replaced``, ``reset``, ``late``; ``old``, if the stamp lies before that of the last
            scan of this laser; or ``ahead``, if the stamp leaps more than a second ahead of the
            clock. The second stamp in a row that leaps counts.
        ScanError
            If the odometry is not finite, or leaps more than 1000 km between two scans.
        """
        until = _until(timeout)
        self._core.site(self.map, _left(until))
        return _wait_for(self.update_soon(scan, odometry, source=source), until)

    def update_soon(
        self, scan: LaserScan, odometry: FloatArray | None, *, source: Hashable = None
    ) -> "Future[Answer[Moment]]":
        """Return a future of :meth:`update` at once; Dropped if the map is not prepared yet."""
        expect(scan, LaserScan, "scan")
        self._core._ready(self.map)
        if not scan.laser and isinstance(source, str):
            scan = replace(scan, laser=source)
        key, era = Key(self, scan.laser if source is None else source), self.era

        def work(waited: float) -> Answer[Moment]:
            begin = time.perf_counter()
            with self._lock:
                if self.era != era:
                    raise Dropped("reset")
                name, follower = self._following()
            judged = follower.judge(scan, scan.stamp, self._clock())
            if judged in (OLD, AHEAD):
                self._core._line.count(key)
                raise Dropped(judged)
            moment = follower.step(scan, odometry)
            with self._lock:
                if self.era != era:
                    self._core._line.count(key)
                    raise Dropped("reset")
            return self._core._answer(moment, name, scan, key, waited, begin, era, self._clock)

        return self._core._line.put(key, work, scan.stamp)

    def start_at(
        self, pose: Pose2D, deviation: tuple[float, float] = DEVIATION, map: str | None = None
    ) -> None:
        """Forget all but a pose, map frame, with its standard deviations in metres and radians.

        A pose outside of the map is a ConfigError, and nothing is forgotten.
        """
        name = self.map if map is None else map
        site = self._core._ready(name)[1]
        start_of("pose", pose, deviation, site.features)
        with self._lock:
            self.reset(map)
            self._start = pose, deviation

    def reset(self, map: str | None = None) -> None:
        """Forget everything; with a name, go to that map.

        It returns at once: scans that wait or are being looked at are dropped.
        """
        if map is not None:
            self._core._entry(map)
        with self._lock:
            self.era += 1
            self._follower = self._start = None
            self.map = self.map if map is None else map
        self._core._line.clear(self)

    def end(self) -> None:
        """Remove it from the localizer."""
        self.reset()
        self._core._line.forget(self)
        if self in self._core._robots:
            self._core._robots.remove(self)

    def _following(self) -> tuple[str, Follower]:
        """Name of the map, and the follower in it."""
        name = self._core._entry(self.map)[0]
        if self._follower is None:
            site = self._core._ready(name)[1]
            how = site.options(self._options or self._core.options)
            self._follower = self.tracking.follower(site.features, how, "update")
            if self._start is not None:
                self._follower.place(*self._start)
        return name, self._follower


def _site(entry: _Entry) -> Site:
    assert entry.site is not None
    return entry.site


def _until(timeout: float | None) -> float | None:
    return None if timeout is None else time.monotonic() + timeout


def _left(until: float | None) -> float | None:
    return None if until is None else max(0.0, until - time.monotonic())


def _wait_for(asked: "Future[T]", until: float | None) -> T:
    try:
        return asked.result(_left(until))
    except Late:
        asked.cancel()
        raise Dropped("late") from None
