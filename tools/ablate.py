"""What does each step of the recipe earn? Answers with one step off, beside answers as they are.

    python -m tools.ablate --sets ../data/*/map.yaml --pieces ablation --out page.md
    python -m tools.ablate parts adapt --sets ../data/*/map.yaml -n 10

A step is off where a number of ``numbers.json`` is another one, or one function does nothing; each
runs in a process of its own. Scans are recorded beside the maps or simulated in the bundled worlds;
some are disturbed as in :mod:`tools.trust.disturb`, and some are from no place of the map. With
--pieces DIR each step that was measured stays there, and is not measured again.
"""

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from imgloc.errors import ConfigError
from tools.vary import change

# What decides answers is imported in `measure`, once the numbers are those of the step.


@dataclass(frozen=True)
class Step:
    """A step of the recipe, and how it is switched off."""

    what: str  #: that happens instead
    numbers: Mapping[str, Any] = field(default_factory=dict)  #: other values, SI units
    #: functions, or values, to put in place of others, by module and name
    instead: Mapping[str, Any] = field(default_factory=dict)
    weighs: bool = False  #: the search is the same, only what is made of it changes


def _same_poses(poses: Any, *_: Any) -> Any:
    return poses


def _all_stand(poses: Any, *_: Any) -> Any:
    return np.ones(len(poses), bool)


def _best_of_maxima(poses: Any, _: Any, best: Any, **__: Any) -> Any:
    return poses[best].copy(), np.zeros((len(best), 3, 3))


def _no_room(xy: Any, _: Any) -> Any:
    return np.full(len(xy), -np.inf)


def _each_pays(told: Any, own: Any, _: Any) -> Any:
    return np.logaddexp(told, own).sum(axis=1)


def _no_blocks(A: Any, *_: Any) -> Any:
    return np.zeros(A.shape[1:])


def _alone(residual: Any, *_: Any) -> Any:
    return np.ones(len(residual))


def _any_number(trust: Any, misfit: float, _: int = 100, cell: float = 0.0) -> Any:
    from imgloc.model import Temperature

    strain = trust.strain * max(0.0, misfit)
    return Temperature(trust.temperature, strain, 1.0, max(1.0, cell / trust.fine))


_OFF = 1e-6  # metres: a kernel so narrow moves no pose
STEPS: Mapping[str, Step] = {
    "squares": Step("each ray is a reading", {"FusedOptions.place": 1e-4}),
    "few rays": Step("the first look takes 180 readings", {"FusedOptions.few_rays": 180}),
    "skip": Step("all levels take all of the few rays", {"FusedOptions.skip": 1}),
    "levels": Step("each level keeps a quarter", {"FusedOptions.keep": (375, 1000, 1000, 4000)}),
    "refine first": Step("none of the few readings", instead={"search.refine.FIRST_LOOK": (_OFF,)}),
    "refine first twice": Step("one width, 0.1 m", instead={"search.refine.FIRST_LOOK": (0.1,)}),
    "refine again": Step("none with all readings", instead={"search.refine.SECOND_LOOK": (_OFF,)}),
    "refine again twice": Step("one width, 0.05 m", instead={"search.refine.SECOND_LOOK": (0.05,)}),
    "standing": Step(
        "poses may be where no sensor can", instead={"search.priors.standing": _same_poses}
    ),
    "second look": Step("of 20 places, not 80", {"FusedOptions.second_look": 20}),
    "closer": Step("one pose for each place", {"FusedOptions.closer": 1}),
    "twins": Step("places are 0.02 m wide", {"FusedOptions.twins": (0.02, 0.0122)}),
    "parts": Step("the whole scan alone proposes", {"FusedOptions.unfit": 1e6}),
    "visibility": Step("walls are no obstacle", {"EvidenceModel.absent": 1.0}),
    "displaced": Step("a wall is where it is drawn", {"EvidenceModel.displaced": 1e-4}),
    "margin": Step("none but half a cell", {"EvidenceModel.margin": 0.0}),
    "wide sigma": Step("0.05 m alone", {"EvidenceModel.sigmas": (0.05,)}),
    "sharp sigma": Step("0.2 m alone", {"EvidenceModel.sigmas": (0.2,)}),
    "mean of maxima": Step(
        "the best of them", instead={"search.hypotheses.centres": _best_of_maxima}
    ),
    "standing again": Step("means may be in walls", instead={"search.priors.stands": _all_stand}),
    "adapt": Step("no error is shared", {"FusedOptions.strained": 1e6}),
    "thick": Step("thick walls are as drawn", {"adapt.drawn": (1e3, 0.5, 0.1, 0.1, 0.5)}),
    "floor": Step("no reading ends on the floor", {"floor.least": 2.0}),
    "scale": Step("only walls are adapted", {"FusedOptions.most_scaled": 1.0}),
    "scales": Step("the scale begins at 1", {"adapt.scales": (1.0,)}),
    "thickness": Step("walls get thinner by one cell at most", {"adapt.thinner": 1}),
    "rounds": Step("one more search, not three", {"pipeline.rounds": 1}),
    "room": Step(
        "nothing is expected of an empty room", instead={"search.background.best_room": _no_room},
        weighs=True,
    ),
    "things": Step("nothing is a thing of its own", {"rescore.price": 1e6}, weighs=True),
    "goes on": Step(
        "each piece of a thing pays",
        instead={f"search.{room}.by_things": _each_pays for room in ("rescore", "background")},
        weighs=True,
    ),
    "pieces": Step("pieces are not counted", {"weigh.pieces": 0.0}, weighs=True),
    "price": Step("what is found is free", {"adapt.against": (0.0, 0.0)}, weighs=True),
    "strain": Step("misfit does not count", {"Trust.strain": 0.0}, weighs=True),
    "number": Step(
        "readings are not counted", instead={"options.Trust.temperature_at": _any_number},
        weighs=True,
    ),
    "fine": Step("the cell of the map does not count", {"Trust.fine": 1e6}, weighs=True),
    "evidence": Step("fit does not count", {"Trust.elsewhere": (-3.0, 0.0, 0.0)}, weighs=True),
    "poses": Step("poses do not count", {"Trust.elsewhere": (-1.0, -0.6, 0.0)}, weighs=True),
    "most": Step("evidence has no bound", {"Trust.most": 1e6}, weighs=True),
    "jackknife": Step(
        "covariances without blocks", instead={"search.covariance._jackknife": _no_blocks},
        weighs=True,
    ),
    "sharing": Step(
        "neighbours err each on its own", instead={"search.covariance.sharing": _alone}, weighs=True
    ),
    "drawn": Step("the face of a drawn wall is not known", {"distance.drawn": (1.0, 1.1)}),
    "cell": Step("covariances without a share of the cell", {"covariance.walls": 0.0}, weighs=True),
    "spread": Step("covariances without maxima", {"faces.maxima": 0.0}, weighs=True),
}  # fmt: skip
BASE = "as it is"
RIGHT = (0.5, 10.0)  # metres, degrees
AWAY = ("room on no map", "the same, clearance known", "another building")


@dataclass(frozen=True)
class Asked:
    """One scan, and what became of it."""

    name: str  #: of its set
    condition: str
    right: bool  #: the first hypothesis
    listed: bool  #: one of the hypotheses
    verdict: str
    inside: bool | None  #: the true pose is in the 95 % region, if it is unique and right
    ms: float  #: of the processor


@dataclass(frozen=True)
class Asking:
    """What is asked of each step."""

    sets: tuple[str, ...]
    worlds: tuple[str, ...]
    n: int
    seed: int
    range_max: float


def measure(name: str, asking: Asking, pieces: Path) -> None:
    """Answer all scans with a step off, and keep what became of them in a file of `pieces`.

    In a process of its own, which has not imported what decides answers.
    """
    step = STEPS.get(name, Step(""))
    for key, value in step.numbers.items():
        change(key, value)
    for target, function in step.instead.items():
        home, _, attribute = target.rpartition(".")
        module, _, kind = home.rpartition(".") if home.endswith("Trust") else (home, "", "")
        found: Any = import_module(f"imgloc.{module}")
        setattr(getattr(found, kind) if kind else found, attribute, function)
    import cv2

    cv2.setNumThreads(1)
    rows = [asdict(row) for row in _answers(asking, step.weighs, name == BASE, pieces)]
    from imgloc.io.files import write_text_atomic

    write_text_atomic(_piece(pieces, name), json.dumps(rows), force=True)


def _piece(pieces: Path, name: str) -> Path:
    return pieces / f"{name.replace(' ', '_')}.json"


def _answers(asking: Asking, weighs: bool, keep: bool, pieces: Path) -> Iterator[Asked]:
    """The answers of all scans, with the searches that were kept if only weighing changes."""
    import pickle
    import time

    from imgloc import pipeline
    from imgloc.geometry import pose_errors, poses_of
    from imgloc.model import Pose2D
    from imgloc.options import Options
    from imgloc.search.priors import prior_of
    from tools.trust.precision import REGION, TRUTH, difference, squared

    stored, file = list[Any](), pieces / "searches.pickle"
    search: Any = pipeline.find_adapted_modes
    if weighs:
        stored = pickle.loads(file.read_bytes())  # noqa: S301 that this command has written
        search = lambda *_: stored.pop(0)  # noqa: E731
    elif keep:

        def search(*given: Any, _search: Any = search) -> Any:
            stored.append(_search(*given))
            return stored[-1]

    pipeline.find_adapted_modes = search
    for name, condition, features, scan, pose, known in _cases(asking):
        options = Options(prior=prior_of(known, features.grid))
        start = time.process_time()
        answer = pipeline.localize(features, scan, options)
        ms = 1e3 * (time.process_time() - start)
        if pose is None or not answer.hypotheses:
            yield Asked(name, condition, False, False, answer.verdict, None, ms)
            continue
        poses = poses_of(answer.hypotheses)
        errors = pose_errors(poses, Pose2D(*pose))
        near = np.all(errors <= (RIGHT[0], np.deg2rad(RIGHT[1])), axis=1)
        inside = None
        if near[0] and answer.verdict == "unique":
            wide = answer.hypotheses[0].covariance + np.diag(np.square(TRUTH))
            inside = squared(difference(poses[0], pose), wide) <= REGION
        yield Asked(name, condition, bool(near[0]), bool(near.any()), answer.verdict, inside, ms)
    if keep:
        file.write_bytes(pickle.dumps(stored))


def _cases(asking: Asking) -> Iterator[tuple[str, str, Any, Any, Any, Any]]:
    """Set, condition, map, scan, true pose (None: it is not of the map) and what is known.

    Each set has all conditions but undisturbed ones in turns: every third, with a tenth of the
    scans.
    """
    from imgloc.geometry import transform_poses
    from imgloc.options import Known
    from imgloc.pipeline import prepare
    from tools.recorded import in_world, recorded_sets
    from tools.trust.disturb import MAPS, PRIORS, ROOMS, SCANS, unmapped
    from tools.trust.fit import mapped

    n, seed = asking.n, asking.seed
    paths = map(Path, asking.sets)
    homes = recorded_sets(paths, n, seed, asking.range_max)
    homes += [(world, *in_world(world, n, seed)) for world in asking.worlds]
    some, nothing = max(1, n // 10), Known()
    hostile = [*list(SCANS)[1:], *list(MAPS)[1:]]
    for at, (name, grid, scans) in enumerate(homes):
        plain = prepare(grid, name)
        for scan, pose in scans.with_poses():
            yield name, "undisturbed", plain, scan, pose, nothing
        for condition in hostile[at % 3 :: 3]:
            features = plain
            if condition in MAPS:
                changed = MAPS[condition](grid, np.random.default_rng((seed, at)))
                features = prepare(changed, name)
            for k, (scan, pose) in enumerate(scans.take(range(min(some, len(scans)))).with_poses()):
                there = pose if mapped(features.grid, pose) else None
                if condition in SCANS:
                    scan = SCANS[condition](scan, np.random.default_rng((seed, k)))
                yield name, condition, features, scan, there, nothing
        rng = np.random.default_rng((seed, at))
        free = np.argwhere(plain.standable)
        for k, room in enumerate(ROOMS):
            cell = rng.choice(free)
            pose = np.append((cell[::-1] + 0.5) * grid.resolution, rng.uniform(-np.pi, np.pi))
            pose = transform_poses(grid.origin, pose[None])[0]
            scan = unmapped(room, np.random.default_rng((seed, at)), np.pi * (1 + at % 2))
            yield name, AWAY[0], plain, scan, None, nothing
            if k == at % len(ROOMS):
                known = PRIORS["clearance of 0.3 m known"](pose)
                yield name, AWAY[1], plain, scan, None, known
        others = [s for other, _, s in homes if other[:5] != name[:5]]  # alike: of one building
        for other in others[at % 4 :: 4]:
            yield name, AWAY[2], plain, other.scans[0], None, nothing


def table(rows: Mapping[str, Sequence[Asked]]) -> str:
    """What became of the scans by step, as Markdown; `rows` has the answers as they are, too."""
    from tools.script import table_lines

    def line(name: str, some: Sequence[Asked]) -> tuple[object, ...]:
        base = rows[BASE]
        home = [r for r in some if r.condition == "undisturbed"]
        worse = [r for r in some if r.condition not in ("undisturbed", *AWAY)]
        away = [r for r in some if r.condition in AWAY]
        lost = sum(b.right and not r.right for b, r in zip(base, some, strict=True))
        won = sum(r.right and not b.right for b, r in zip(base, some, strict=True))
        regions = [r.inside for r in some if r.inside is not None]
        times = sorted(r.ms for r in home)
        what = STEPS[name].what if name in STEPS else ""
        fast = name in STEPS and STEPS[name].weighs
        ms = "" if fast else f"{times[len(times) // 2]:.0f}"
        return (
            name, what, *_counts(home), *_counts(worse), f"-{lost} +{won}",
            sum(r.verdict == "no-match" for r in away), sum(r.verdict == "unique" for r in away),
            f"{sum(regions) / max(1, len(regions)):.3f}", ms,
        )  # fmt: skip

    count = dict.fromkeys(("home", "worse", "away"), 0)
    for r in rows[BASE]:
        kind = (
            "home" if r.condition == "undisturbed" else "away" if r.condition in AWAY else "worse"
        )
        count[kind] += 1
    head = (
        f"step off | instead | of {count['home']}: right | listed | unique | wrong "
        f"| of {count['worse']} disturbed: right | listed | unique | wrong | lost, won "
        f"| of {count['away']} elsewhere: no-match | unique | in 95 % region | ms"
    )
    return "\n".join(table_lines(head, [line(name, some) for name, some in rows.items()]))


def _counts(some: Sequence[Asked]) -> tuple[int, int, int, int]:
    """Right first, right in the list, unique, and unique but wrong."""
    unique = [r for r in some if r.verdict == "unique"]
    wrong = sum(not r.right for r in unique)
    return sum(r.right for r in some), sum(r.listed for r in some), len(unique), wrong


def page(rows: Mapping[str, Sequence[Asked]], asking: Asking, command: str, date: str) -> str:
    """The measured page."""
    names = list(dict.fromkeys(r.name for r in rows[BASE]))
    known = ("undisturbed", *AWAY)
    conditions = [c for c in dict.fromkeys(r.condition for r in rows[BASE]) if c not in known]
    return f"""# The steps of the recipe, one by one, {date}

`{command}`: one step is off, all others are as they are. Scans: {asking.n} of each of
{", ".join(names)};
{max(1, asking.n // 10)} of every third of these for each disturbance: {", ".join(conditions)};
and scans from elsewhere: {", ".join(AWAY)}. Recorded scans are cut at {asking.range_max:g} m.

Right is within {RIGHT[0]:g} m and {RIGHT[1]:g} degrees; *wrong* is `unique` and not right.
*Lost, won* counts scans whose first answer is right only with the step, and only without it.
The region is that of unique and right answers; true poses are allowed 3 cm and 0.4 degrees.
Milliseconds are of one processor, the median of undisturbed scans, on a busy machine.

{table(rows)}
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure what is not there yet, print; return the exit code."""
    from tools.script import at_least_one, ended, one_of, parser_of

    parser = parser_of("tools.ablate", __doc__, seed=11)
    parser.add_argument("steps", nargs="*", help=f"of: {', '.join(STEPS)} (default: all)")
    parser.add_argument("--sets", nargs="*", default=[], help="maps with a scans.npz beside them")
    parser.add_argument("--worlds", default="double_wall,visibility,large,curved,corridor")
    parser.add_argument("-n", type=int, default=30, help="scans of each (default: 30)")
    parser.add_argument("--range-max", type=float, default=20.0, help="of recorded scans, metres")
    parser.add_argument(
        "--pieces",
        type=Path,
        help="folder that keeps each step's answers, of one state of the code",
    )
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, help="page to write; NAME-YYYY-MM-DD.md has its date")
    parser.add_argument("--force", action="store_true", help="overwrite --out")
    given = parser.parse_args(arguments)
    worlds = tuple(filter(None, given.worlds.split(",")))
    asking = Asking(tuple(given.sets), worlds, given.n, given.seed, given.range_max)

    def work() -> int:
        from tempfile import TemporaryDirectory

        from imgloc.io.files import write_text_atomic

        at_least_one(n=given.n, workers=given.workers)
        one_of(given.steps, STEPS)
        with TemporaryDirectory(prefix="imgloc-") as made:
            pieces = given.pieces or Path(made)
            pieces.mkdir(parents=True, exist_ok=True)
            rows = _all_rows([BASE, *(given.steps or STEPS)], asking, pieces, given.workers)
        if given.out is None:
            print(table(rows))
        else:
            date = "-".join(given.out.stem.split("-")[-3:])
            sets = ",".join(Path(name).parent.name for name in given.sets)
            command = f"python -m tools.ablate -n {given.n} --seed {given.seed}"
            command += f" --sets .../{{{sets}}}/map.yaml" if sets else ""
            text = page(rows, asking, command, date)
            write_text_atomic(given.out, text, force=given.force)
        return 0

    return ended("ablate", work)


def _all_rows(
    names: Sequence[str], asking: Asking, pieces: Path, workers: int
) -> dict[str, list[Asked]]:
    """The answers of each step, those as they are first: of the others some need their searches."""
    about = pieces / "asked.json"
    now = json.dumps(asdict(asking))
    if not about.exists():
        about.write_text(now, "utf-8")
    elif about.read_text("utf-8") != now:
        raise ConfigError(f"--pieces: {pieces} holds answers to other scans, expected another one")
    spawn = get_context("spawn")
    for some in (names[:1], names[1:]):
        with spawn.Pool(workers, maxtasksperchild=1) as pool:
            todo = [name for name in some if not _piece(pieces, name).exists()]
            pool.starmap(measure, [(name, asking, pieces) for name in todo], chunksize=1)
    return {
        name: [Asked(**row) for row in json.loads(_piece(pieces, name).read_text("utf-8"))]
        for name in names
    }


if __name__ == "__main__":
    sys.exit(main())
