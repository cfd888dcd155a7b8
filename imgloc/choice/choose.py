"""The choice of the map that a scan is from, by evidence that compares maps of any size.

The evidence of a map is the mean of the scan's likelihood over all poses in it: eq. 12's ``1 / V``
in front of an integral. Each mode contributes the height of its Gaussian times its volume. A large
map has more places that fit by chance, and its larger V makes up for them.

The maps also show how well a scan may fit a building that is not among them. At most two maps are
of the scan's building, so the third best map fits by chance. The best of all chance fits leads that
one by a few nats, and by as much with many maps as with few: the upper spacings of a tail that is
about exponential do not depend on their number.

Only a few of many maps are searched. The coarse levels of a map give a bound on how well the scan
can fit it. The maps of the best bounds are searched first, until no other can overtake the leading
three. This is branch and bound over the folder, with a bound that holds nearly always. A map on
which nothing fits is searched by the whole scan alone; by parts of it, too, once it leads.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from imgloc.choice.folder_index import MapIndex, index_of
from imgloc.errors import ConfigError, expect
from imgloc.features.mapfeatures import MapFeatures
from imgloc.model import LaserScan, Localization, plain
from imgloc.numbers import number
from imgloc.options import FUSED, NAMED, FusedOptions, Options, Trust
from imgloc.pipeline import localize
from imgloc.search.weigh import MODES

OPTIONS = Options(top=MODES, fused=FusedOptions(strained=float("inf")))
"""Options for comparing maps: many modes are listed, because evidence is summed over them.

No shared error is allowed for, because every map would gain by one."""
LEAD: float = number("choose.lead")
"""Nats per reading by which an unknown building may fit better than the third best map."""
LUCK: float = number("choose.luck")
"""Log-evidence, in nats, that an unknown building rarely exceeds: one scan in forty did.

If three maps exceed it, they are alike, and the scan is from one of them."""
FEW = number("choose.few")
"""Number of maps below which a map is named only if the scan is ``unique`` in it.

Fewer maps do not show what fits by chance. A scan that fits by chance mostly fits at several
places."""
FIRST: int = number("choose.first")
"""Number of maps that are searched at first."""
NEXT: int = number("choose.next")
"""Number of further maps to search at a time, while one of the last is among the best three."""
MOST = 2 * FIRST
"""Largest number of maps that are searched."""
Opened = tuple[MapFeatures, Options]  #: a map, and how scans are located in it
NO_MAP = ("none", "undecided", "invalid")  #: verdicts that name no map


@dataclass(frozen=True)
class Choice:
    """Probabilities of the maps."""

    #: the name of a map, ``none``, ``undecided``, or ``invalid`` if the scan has too few readings;
    #: all probabilities are then NaN
    verdict: str
    #: probability that the scan is from each map, best first; with `none` they sum to 1
    probability: Mapping[str, float]
    #: probability that the scan is from none of the maps
    none: float
    log_evidence: Mapping[str, float]  #: nats, relative to the best map's
    temperature: float  #: temperature of the map that fits best, used for all maps
    ruled_out: int = 0  #: number of maps not searched to the end, whose bounds are too low

    def as_row(self, fits: Mapping[str, Localization], index: int = 0) -> dict[str, Any]:
        """The row of the scan `index` of a file, as `imgloc which --json` writes it.

        `fits` are the answers that were compared, by map. The row has the pose in each map.
        """
        maps = [
            {
                "map": name,
                "probability": share,
                "log_evidence": self.log_evidence.get(name),
                "misfit": fits[name].evidence.misfit,
                "verdict": fits[name].verdict,
                "pose": fits[name].best,
                "explained": fits[name].explained,
            }
            for name, share in self.probability.items()
        ]
        names = ("verdict", "none", "temperature", "ruled_out")
        about = {name: getattr(self, name) for name in names}
        return dict(plain({"index": index, **about, "maps": maps}))


def which(
    maps: Mapping[str, MapFeatures], scan: LaserScan, options: Options | None = None
) -> Choice:
    """Choose the map that a scan is from: one of them, none, or undecided.

    Parameters
    ----------
    maps : mapping of str to MapFeatures
        The maps by name, from :func:`imgloc.prepare`.
    scan : LaserScan
        The scan, in the sensor frame.
    options : Options, optional
        Options of the method ``fused``. Evidence is summed over the `top` modes.

    Returns
    -------
    Choice
        The verdict, and the probability of each map.

    Raises
    ------
    ConfigError
        If there are no maps, or the method is another one.

    Examples
    --------
    >>> from imgloc.model import OccupancyGrid
    >>> from imgloc.pipeline import prepare
    >>> wall = np.pad(np.zeros((30, 40), bool), 2, constant_values=True)
    >>> blind = LaserScan(np.full(20, np.inf), np.linspace(0, 3, 20), range_max=9.0)
    >>> which({"hall": prepare(OccupancyGrid(wall, ~wall, 0.1))}, blind).verdict
    'invalid'
    """
    expect(maps, Mapping, "maps")
    options = options or OPTIONS
    bounds = partial(bounds_of, index_of(maps), [1.0] * len(maps), options=options)
    (fits,) = search([scan], maps, bounds, lambda name: nullcontext((maps[name], options)))
    return choose(fits, ruled_out=len(maps) - len(fits))


def bounds_of(
    index: MapIndex, said: Sequence[float], scan: LaserScan, options: Options
) -> dict[str, float]:
    """Bound, for each map by its name, on the share of a scan that can fall on walls, 0..1.

    A map whose calibrated scale `said` has, a factor, is tried with that scale, too.
    """
    bounds, scales = index.bounds(scan, options), np.array(said)
    for scale in np.unique(scales[scales != 1]):
        scaled = index.bounds(scan.scaled(float(scale)), options)
        bounds = np.where(scales == scale, np.maximum(bounds, scaled), bounds)
    return dict(zip(index.names, bounds.tolist(), strict=True))


def fit(features: MapFeatures, scan: LaserScan, options: Options = OPTIONS) -> Localization:
    """Locate a scan in one of the maps, by ``fused`` alone."""
    if options.method != FUSED:  # the values of votes have no common scale
        raise ConfigError(f"maps are compared by the method {FUSED}, got {options.method}")
    return localize(features, scan, options)


def search(
    scans: Sequence[LaserScan], names: Collection[str],
    bounds: Callable[[LaserScan], Mapping[str, float]],
    open_map: Callable[[str], AbstractContextManager[Opened | None]],
    advance: Callable[[], object] = lambda: None,
) -> list[dict[str, Localization]]:  # fmt: skip
    """Locate each scan in the maps that it may be from.

    Parameters
    ----------
    scans : sequence of LaserScan
    names : collection of str
        The maps, by their names.
    bounds : callable
        Returns the bound of each map by its name for a scan, as :func:`bounds_of`. It is not called
        if there are so few maps that all of them are searched.
    open_map : callable
        Takes the name of a map, and returns the map with the options for it; None if the map cannot
        be used. One map at a time is open, for all scans that need it.
    advance : callable
        Called after each answer.

    Returns
    -------
    list of dict of str to Localization
        For each scan its answer in each map that was searched, best bounds first.
    """
    few = at_first(len(names)) == len(names)
    usable = [dict.fromkeys(names, 1.0) if few else dict(bounds(scan)) for scan in scans]
    found: list[dict[str, Localization]] = [{} for _ in scans]
    ended: list[set[str]] = [set() for _ in scans]  # maps that are searched to the end
    while True:
        asked: dict[str, list[int]] = {}
        for k, fits in enumerate(found):
            for name in next_maps(usable[k], fits) or leading(fits) - ended[k]:
                asked.setdefault(name, []).append(k)
        if not asked:
            return [{n: fits[n] for n in best_first(of) if n in fits}
                    for of, fits in zip(usable, found, strict=True)]  # fmt: skip
        for name, these in sorted(asked.items()):
            with open_map(name) as opened:
                for k in these:
                    if opened is None:
                        del usable[k][name]
                        continue
                    features, options = opened
                    if name in found[k] or len(usable[k]) <= 3:
                        ended[k].add(name)
                    else:
                        options = replace(options, fused=replace(options.fused, unfit=np.inf))
                    found[k][name] = fit(features, scans[k], options)
                    advance()


def best_first(bounds: Mapping[str, float]) -> list[str]:
    """Names of maps by falling bound, the order in which they are searched."""
    return sorted(bounds, key=lambda name: (-bounds[name], name))


def next_maps(bounds: Mapping[str, float], fits: Mapping[str, Localization]) -> list[str]:
    """Names of the maps to search next, besides those of `fits`; none if these are enough."""
    order = best_first(bounds)
    rest = [name for name in order if name not in fits]
    if at_first(len(order)) == len(order):
        return rest
    return rest[: _more({name: fits[name] for name in order if name in fits})]


def leading(fits: Mapping[str, Localization]) -> set[str]:
    """Names of the three maps whose evidence is best: two of the building, and one by chance."""
    if not any(f.hypotheses for f in fits.values()):
        return set()
    evidence = _evidence(fits)
    return set(sorted(evidence, key=lambda name: -evidence[name])[:3])


def at_first(count: int) -> int:
    """Number of maps, of so many, that are searched before they are compared.

    The bounds of all take as long as the search of half of them: of few none is left out.
    """
    return count if count <= MOST + 1 else FIRST


def _more(fits: Mapping[str, Localization]) -> int:
    """Number of maps to search after these, which have the best bounds, in their order."""
    if len(fits) < FIRST:
        return FIRST - len(fits)
    if len(fits) >= MOST or not any(f.hypotheses for f in fits.values()):
        return 0
    evidence = [*_evidence(fits).values()]
    return NEXT if max(evidence[-NEXT:]) >= sorted(evidence)[-3] else 0


def choose(
    fits: Mapping[str, Localization], trust: Trust | None = None, *, sure: float = NAMED,
    ruled_out: int = 0,
) -> Choice:  # fmt: skip
    """Compare maps by how a scan fits them; all maps are equally likely beforehand.

    `fits` has the answer of :func:`fit` for each map by name, at least one. `sure` is the
    probability, 0..1, that a map needs to be the verdict. `ruled_out` is the number of further maps
    that were not searched to the end.

    Examples
    --------
    >>> from imgloc.model import Evidence, Hypothesis, Pose2D
    >>> def made(score):
    ...     pose = Hypothesis(Pose2D(0.0, 0.0), score, 1.0, np.eye(3))
    ...     fit = 1.5 - score / 100
    ...     heat = Trust().temperature_at(fit)
    ...     evidence = Evidence(100, 1.5, fit, gained=9.0, log_volume=-9.0, temperature=heat)
    ...     return Localization((pose,), "unique", 0.0, 1.0, evidence=evidence)
    >>> choose({"cellar": made(-150.0), "attic": made(140.0)}).verdict
    'attic'
    >>> choose({"cellar": made(60.0), "attic": made(61.0), "loft": made(58.0)}).verdict
    'none'
    """
    if not fits:
        raise ConfigError("expected at least one map to choose from")
    trust = trust or Trust()
    if all(f.verdict == "invalid" for f in fits.values()):
        unknown = float("nan")
        blank = dict.fromkeys(fits, unknown)
        return Choice("invalid", blank, unknown, {}, trust.temperature, ruled_out)
    if not any(f.hypotheses for f in fits.values()):
        return Choice("none", dict.fromkeys(fits, 0.0), 1.0, {}, trust.temperature, ruled_out)
    best = _best(fits.values())
    said, temperature = best.evidence, best.evidence.temperature.value
    evidence = _evidence(fits)
    top = max(evidence.values())
    order = sorted(evidence, key=lambda name: (-evidence[name], name))
    weights = np.exp([evidence[name] - top for name in order])
    lead = LEAD * said.readings / temperature
    other = np.exp(unknown_evidence(list(evidence.values()), lead) - top)
    # *elsewhere* depends on twins within one map. Twins in two maps count in the same way.
    elsewhere = trust.mass_elsewhere(said.net, said.log_volume)
    weights *= (1 - elsewhere) / (weights.sum() + other)
    none = float(1 - weights.sum())
    probability = dict(zip(order, weights.tolist(), strict=True))
    known = len(fits) + ruled_out >= FEW or fits[order[0]].verdict == "unique"
    verdict = order[0] if known and probability[order[0]] >= sure else "undecided"
    relative = {name: evidence[name] - top for name in order}
    verdict = "none" if none > 0.5 else verdict
    return Choice(verdict, probability, none, relative, temperature, ruled_out)


def _best(fits: Iterable[Localization]) -> Localization:
    """The answer that fits best among those with a pose."""
    return min((f for f in fits if f.hypotheses), key=lambda f: f.evidence.misfit)


def _evidence(fits: Mapping[str, Localization]) -> dict[str, float]:
    """Log-evidence of each map at the temperature of the best one, nats; some map has a pose."""
    temperature = _best(fits.values()).evidence.temperature.value
    return {name: log_evidence(f, temperature) for name, f in fits.items()}


def log_evidence(answer: Localization, temperature: float) -> float:
    """Logarithm of the mean likelihood over the poses of a map, nats; -inf without a mode."""
    if not answer.hypotheses:
        return float("-inf")
    # The modes of a tempered likelihood are wider by the root of the temperature.
    score = np.array([h.log_likelihood for h in answer.hypotheses])
    volume = answer.evidence.log_volume + 1.5 * np.log(temperature)
    return float(np.logaddexp.reduce(score / temperature) + volume)


def unknown_evidence(evidence: Sequence[float], lead: float) -> float:
    """Log-evidence of a building that is not among the maps, nats.

    It is the third best of `evidence` plus `lead`, but at most :data:`LUCK`. With fewer than three
    maps it is -inf, because two maps do not show what fits by chance.

    Examples
    --------
    >>> unknown_evidence([-9.0, 31.0, -12.0, -8.0], 6.0), unknown_evidence([31.0, -9.0], 6.0)
    (-3.0, -inf)
    """
    third = sorted(evidence)[-3] if len(evidence) > 2 else float("-inf")
    return min(third + lead, LUCK)


def names_of(paths: Iterable[Path], folder: Path) -> list[str]:
    """Names of maps in a folder: all different, and none of them a verdict in :data:`NO_MAP`.

    Examples
    --------
    >>> names_of([Path("a/attic.yaml"), Path("a/cellar/map.yaml")], Path("a"))
    ['attic', 'cellar']
    >>> names_of([Path("a/b.yaml"), Path("a/b/map.yaml"), Path("a/none.yaml")], Path("a"))
    ['b.yaml', 'b/map.yaml', 'none.yaml']
    """
    full = [path.relative_to(folder) for path in paths]
    # a/map.yaml is named after its folder
    inner = [path.stem == "map" and path.parent != Path() for path in full]
    short = [p.parent if i else p.with_suffix("") for p, i in zip(full, inner, strict=True)]
    taken = Counter([*(name.as_posix() for name in short), *NO_MAP])
    pairs = zip(full, short, strict=True)
    names = [(p if taken[name.as_posix()] > 1 else name).as_posix() for p, name in pairs]
    return names if len(set(names)) == len(names) else [path.as_posix() for path in full]
