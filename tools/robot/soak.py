"""Hours of robots in accelerated time: what goes wrong in the long run, and what it costs.

A robot is switched on, drives, is carried off, goes blind and is switched off, again and again, in
bundled worlds whose furniture and doors have changed, and along recorded logs from other starts. A
localizer that does not notice that it is carried is watched; once that is noticed, somebody sets it
right. At each start one scan checks the remembered pose, as in ``imgloc node --remember``.
"""

import itertools
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from imgloc import ConfigError, Options, ScanSet, localize
from imgloc.filters.watch import AGREES, DISAGREES
from imgloc.live.remember import OUTCOMES, RESTORED, Kept, checked, identity
from imgloc.model import FloatArray
from tools.blackouts import KINDS, blinded
from tools.filters import WRONG, piece
from tools.robot.kill import NEAR
from tools.robot.places import SIMULATED, Place, apart, gone_on, known, simulated
from tools.robot.watch import NOISE, off, opinions

_METRES, _ROUND = 300.0, 1800.0  # of a simulated drive; seconds of robots on it
# Seconds until a robot is switched off, or carried off; seconds that it is blind.
_ON, _BLIND = (15.0, 240.0), (2.0, 30.0)
_CARRIED, _DARK, _MOVED = 0.5, 0.5, 0.3  # chances: each time that it is on, and while it is off


@dataclass
class Soaked:
    """What became of the robots of one place."""

    sums: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    took: list[float] = field(default_factory=list)  #: seconds of a processor for each scan


def live(place: Place, seconds: float, rng: np.random.Generator, so: Soaked) -> Iterator[None]:
    """A robot in one place, for so many seconds; it yields each time that it is switched off."""
    truth, stamps, _ = known(place.log)
    first, until, kept = place.start(_ON[0], rng), so.sums["seconds"] + seconds, None
    if first is None:
        raise ConfigError(f"{place.name}: expected a log of more than {_ON[0]:g} s")
    while first is not None and so.sums["seconds"] < until:
        parts, jump = [range(first, place.after(first, rng.uniform(*_ON)))], None
        there = place.start(_ON[0], rng, truth[parts[0].stop - 1])
        if there is not None and rng.random() < _CARRIED:
            jump = len(parts[0])
            parts.append(range(there, place.after(there, rng.uniform(*_ON))))
        log, at = piece(place.log, *parts), parts[-1].stop - 1
        if rng.random() < _DARK:
            begin, times = int(rng.integers(1, len(log))), known(log)[1]
            end = int(np.searchsorted(times, times[begin] + rng.uniform(*_BLIND)))
            log = blinded(log, range(begin, end), str(rng.choice(list(KINDS))))
        if kept is not None:
            answer = localize(place.features, log[0], Options(threads=1))
            said, pose = checked(kept, answer, kept.identity)
            so.sums[said] += 1
            if said == RESTORED and pose is not None:  # else nobody is told it
                so.sums["restored wrong"] += apart(pose, known(log)[0][0], NEAR)
        kept = drive(place, log, jump, rng, so) or kept
        moved = rng.random() < _MOVED or stamps[at] + _ON[0] > stamps[-1]
        first = place.start(_ON[0], rng) if moved else at
        yield


def drive(
    place: Place, log: ScanSet, jump: int | None, rng: np.random.Generator, so: Soaked
) -> Kept | None:
    """Follow a robot that is carried off at one scan; the last pose that was sure."""
    truth, stamps, _ = known(log)
    told, last, said, noise = truth, None, AGREES, rng.normal(0.0, NOISE, truth.shape)

    def claims() -> Iterator[FloatArray]:
        nonlocal told
        for k in range(len(log)):
            if k == jump:  # the localizer goes on as if nothing had happened
                told = np.concatenate((truth[:k], gone_on(truth[k - 1], truth[k:])))
            yield told[k] + noise[k]

    steps, sums = np.diff(stamps, append=stamps[-1]).tolist(), so.sums
    for k, (found, moment, took) in enumerate(opinions(place.features, log, claims())):
        sums["seconds"], fooled = sums["seconds"] + steps[k], off(told, truth)[k]
        so.took.append(took)
        if moment.pose is not None:
            sums["unique"] += steps[k]
            sums["wrong"] += steps[k] * apart(moment.pose, truth[k], WRONG)
            last = moment.pose, stamps[k]
        if found.said == DISAGREES != said:
            sums["alarms" if fooled else "false"] += 1
        if found.said == DISAGREES and fooled:
            told = truth  # somebody sets it right
        said = found.said
    if jump is not None:
        sums["carried"] += 1
        sums["not noticed"] += told is not truth
    return last and Kept(place.name, identity(place.features.grid), *last)


def soak(seed: int, places: Sequence[Place] = ()) -> Iterator[dict[str, Soaked]]:
    """Robots without end, in each place in turn; what has become of them so far."""
    rows = dict[str, Soaked]()
    for k in itertools.count():
        if places:
            place = places[k % len(places)]
        else:
            name = SIMULATED[k % len(SIMULATED)]
            place = simulated(name, _METRES, seed + 1000 * k, changed=True, rate=1.0)
        so = rows.setdefault(place.name, Soaked())
        for _ in live(place, _ROUND, np.random.default_rng((seed, k)), so):
            yield rows


_COUNTS = ("carried", "not noticed", "alarms", "false", *OUTCOMES, "restored wrong")
HEAD = " | ".join(("place | hours | unique | s unique and wrong", *_COUNTS, "p50, p99 ms"))


def rows_of(rows: Mapping[str, Soaked]) -> Iterator[tuple[object, ...]]:
    """A row a place, and one of all."""
    every = Soaked()
    for so in rows.values():
        every.took += so.took
        for key, value in so.sums.items():
            every.sums[key] += value
    for name, so in {**rows, "all": every}.items():
        seconds, ms = so.sums["seconds"], 1e3 * np.percentile(so.took, (50, 99))
        yield (name, f"{seconds / 3600:.2f}", f"{so.sums['unique'] / seconds:.2f}",
               f"{so.sums['wrong']:.1f}", *(f"{so.sums[c]:g}" for c in _COUNTS),
               f"{ms[0]:.0f}, {ms[1]:.0f}")  # fmt: skip
