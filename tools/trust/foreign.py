"""Is imgloc sure only of what a map explains? Scans that are on no map, or on half of one.

Rooms that are on no map, other buildings, other floors of the same building, mirrored plans, and
maps that lack one half. Floors are drawn by :mod:`tools.plans.drawing`: they share outer walls and
corridor, and have other rooms.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imgloc import (
    LaserScan,
    Localization,
    OccupancyGrid,
    Options,
    Pose2D,
    ScanSet,
    Sensor,
    localize,
    prepare,
    simulate,
)
from imgloc.choice.choose import OPTIONS, choose, fit
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import centre_of, transform_poses
from imgloc.model import FloatArray
from imgloc.options import Known
from imgloc.search.priors import leaves_none, prior_of
from tools.plans.drawing import building, true_world
from tools.script import table_lines
from tools.trust.disturb import MAPS, PRIORS, ROOMS, SCANS, half_of, unmapped
from tools.trust.reliability import Judged, judge_answer, reliability

FLOORS = 4
"""Floors of each building."""
CELL, FINE = 0.05, 0.01
"""Metres: cells of a floor's map, and of the floor on which its scans are simulated."""
WITHOUT, UNDISTURBED = "nothing known", "undisturbed"
Place = tuple[str, OccupancyGrid, ScanSet]
"""The name of a map, the map, and scans whose poses in it are known."""


@dataclass(frozen=True)
class Asked:
    """A scan that a map is asked for."""

    row: str  #: of the table
    building: str  #: whose map it is
    scan: LaserScan
    pose: FloatArray | None  #: (3,) the true one, map frame; None if the scan is not of this map
    prior: str = WITHOUT  #: what is known of the pose: one of :data:`PRIORS`
    known: Known = field(default_factory=Known)


Questions = Iterator[tuple[OccupancyGrid, list[Asked]]]
"""Maps, and the scans that each is asked for."""


def at_home(
    places: Iterable[Place], changes: Sequence[str] = (UNDISTURBED,), seed: int = 0
) -> Questions:
    """Scans after each of some changes, of :data:`SCANS`, and every fourth on each half of its map.

    Those on halves are undisturbed.
    """
    for name, grid, scans in places:
        pairs = list(scans.with_poses())
        disturbed = [
            (row, name, SCANS[row](scan, np.random.default_rng((seed, k))), pose, pose)
            for row in changes
            for k, (scan, pose) in enumerate(pairs)
        ]
        yield grid, [asked for some in disturbed for asked in with_priors(*some)]
        for side in range(4):
            halves = [("half the map", name, *pair, pair[1]) for pair in pairs[side::4]]
            yield half_of(grid, side), [asked for some in halves for asked in with_priors(*some)]


def rooms_and_others(
    grids: Mapping[str, OccupancyGrid],
    others: Mapping[str, Sequence[LaserScan]],
    n: int,
    seed: int,
    same: Mapping[str, str],
) -> Questions:
    """On each map `n` scans of each simple room, and `n` of `others`, which are other buildings'.

    `same` names the building of a map if it is not called as that is.
    """
    for k, (name, grid) in enumerate(grids.items()):
        rng = np.random.default_rng((seed, k))
        home = same.get(name, name)
        away = [s for of, scans in others.items() if same.get(of, of) != home for s in scans]
        some = [away[i] for i in rng.permutation(len(away))[:n]]
        yield grid, elsewhere(home, grid, some, n, (seed, k), rng)


def elsewhere(
    building: str, grid: OccupancyGrid, foreign: Sequence[LaserScan], n: int,
    seed: tuple[int, ...], rng: np.random.Generator,
) -> list[Asked]:  # fmt: skip
    """Scans that are not of a map: `foreign` ones, and `n` of each simple room.

    `rng` draws places of the map, of which each is asked with priors, too.
    """
    asked = [("another building", scan) for scan in foreign]
    for j, room in enumerate(ROOMS):
        for i in range(n):
            drawn = unmapped(room, np.random.default_rng((*seed, j, i)), np.pi * (1 + i % 2))
            asked.append((room, drawn))
    free, some = np.argwhere(prepare(grid).standable), list[Asked]()
    for row, scan in asked:
        local = np.append(centre_of(rng.choice(free)[None], grid.resolution)[0], 0)
        local[2] = rng.uniform(-np.pi, np.pi)
        at = transform_poses(grid.origin, local[None])[0]
        some += with_priors(row, building, scan, None, at)
    return some


def disturbed(
    building: str, grid: OccupancyGrid, scans: ScanSet, few: int | None, seed: int
) -> Questions:
    """Every scan of a set as it is; the first `few` disturbed, with priors, on disturbed maps."""
    pairs = list(scans.with_poses())
    home = [Asked(UNDISTURBED, building, *pair) for pair in pairs]
    for row, change in SCANS.items():
        for i, (scan, pose) in enumerate(pairs[:few] if row != UNDISTURBED else ()):
            other = change(scan, np.random.default_rng((seed, i)))
            home.append(Asked(row, building, other, pose))
    for row, known in PRIORS.items():
        home += [Asked(row, building, *pair, known=known(pair[1])) for pair in pairs[:few]]
    yield grid, home
    for k, (row, change_map) in enumerate(MAPS.items()):
        if row != UNDISTURBED:
            changed = change_map(grid, np.random.default_rng((seed, k)))
            yield changed, [Asked(row, building, *pair) for pair in pairs[:few]]


def with_priors(
    row: str, building: str, scan: LaserScan, pose: FloatArray | None, at: FloatArray
) -> Iterator[Asked]:
    """A question without a prior, and with each of :data:`PRIORS` around `at` (3,), map frame."""
    yield Asked(row, building, scan, pose)
    for name, known in PRIORS.items():
        yield Asked(row, building, scan, pose, name, known(at))


def floors_of(seed: int, n: int) -> list[Place]:
    """The floors of a building, with `n` scans of each: half of them see all around."""
    out = []
    for floor in range(FLOORS):
        b = building(seed, floor=floor)
        world = true_world(b, FINE)
        sets = [
            simulate(world, m, 100 * seed + floor, Sensor(fov=fov, rays=361, range_max=20.0), world)
            for fov, m in ((np.pi, n - n // 2), (2 * np.pi, n // 2))
            if m
        ]
        poses = np.concatenate([np.asarray(some.poses) for some in sets])
        scans = ScanSet(tuple(s for some in sets for s in some.scans), poses=poses)
        out.append((f"building {seed}", true_world(b, CELL), scans))
    return out


def on_other_floors(floors: Sequence[Place]) -> Questions:
    """Scans on the map of their floor, of the next one, and on their own map mirrored."""
    for k, (name, grid, own) in enumerate(floors):
        other = floors[k - 1][2]
        some = [Asked("own floor", name, *pair) for pair in own.with_poses()]
        for scan, pose in other.with_poses():
            some += with_priors("another floor", name, scan, None, pose)
        yield grid, some
        flipped = replace(grid, occupied=grid.occupied[:, ::-1], free=grid.free[:, ::-1])
        yield flipped, [Asked("mirrored plan", name, scan, None) for scan in own.scans]


@dataclass(frozen=True)
class Told:
    """The answer to a question."""

    asked: Asked
    judged: Judged
    wrong: bool  #: ``unique``, though the scan is not of the map, or at another place


def answers(questions: Questions, advance: Callable[[], object] = lambda: None) -> Iterator[Told]:
    """Ask each map for its scans; `advance` is called after each."""
    for grid, some in questions:
        features = prepare(grid)
        for asked in some:
            options = Options(prior=prior_of(asked.known, grid))
            if leaves_none(options.prior, features):
                continue  # what is known of a place elsewhere may be in the walls of this map
            yield told(asked, localize(features, asked.scan, options))
            advance()


def told(asked: Asked, answer: Localization) -> Told:
    """An answer, compared with the truth."""
    if asked.pose is not None:
        found = judge_answer(answer, Pose2D(*asked.pose))
        return Told(asked, found, found.wrong)
    found = judge_answer(answer, Pose2D(1e6, 1e6))
    return Told(asked, found, found.verdict == "unique")


def foreign_table(all_told: Sequence[Told]) -> str:
    """A Markdown table, a line for each row and prior."""
    lines = []
    for row, prior in dict.fromkeys((t.asked.row, t.asked.prior) for t in all_told):
        some = [t for t in all_told if (t.asked.row, t.asked.prior) == (row, prior)]
        verdicts = Counter(t.judged.verdict for t in some)
        first = sum(bool(t.judged.right[:1].any()) for t in some)
        wrong = sum(t.wrong for t in some)
        error = reliability([t.judged for t in some])[1]
        counts = (verdicts["unique"], f"{wrong} ({100 * wrong / len(some):.1f} %)")
        rest = (verdicts["ambiguous"], verdicts["no-match"], f"{error:.3f}")
        lines.append((row, prior, len(some), first, *counts, *rest))
    head = "scans | known | number | first right | unique | wrong | ambiguous | no-match | calib."
    return "\n".join(table_lines(head, lines))


def name_floors(
    floors: Sequence[Place], advance: Callable[[], object] = lambda: None
) -> Iterator[tuple[str, str]]:
    """What `which` names for scans of a building's floors: with the true floor, and without it.

    Each is ``right``, ``wrong``, or the verdict that names no map.
    """
    maps: list[MapFeatures] = [prepare(grid) for _, grid, _ in floors]
    for own, (_, _, scans) in enumerate(floors):
        for scan in scans.scans:
            fits = {str(k): fit(features, scan, OPTIONS) for k, features in enumerate(maps)}
            verdicts = []
            for some in (fits, {name: f for name, f in fits.items() if name != str(own)}):
                verdict = choose(some).verdict
                verdict = "right" if verdict == str(own) else verdict
                verdicts.append("wrong" if verdict in fits else verdict)
            yield verdicts[0], verdicts[1]
            advance()


def naming_table(verdicts: Sequence[tuple[str, str]]) -> str:
    """A Markdown table of what :func:`name_floors` says."""
    lines = []
    words = ("right", "wrong", "undecided", "none")
    for k, which in enumerate(("with", "without")):
        count = Counter(pair[k] for pair in verdicts)
        shares = (f"{count[w]} ({100 * count[w] / len(verdicts):.1f} %)" for w in words)
        lines.append((f"floors {which} the true one", len(verdicts), *shares))
    head = f"which | scans | {' | '.join(words)}"
    return "\n".join(table_lines(head, lines))
