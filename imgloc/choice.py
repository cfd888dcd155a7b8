"""Which of some maps is a scan from? Evidence that is comparable across maps of any size.

The evidence of a map is the mean of the scan's likelihood over all poses in it: eq. 12's
``1 / V`` in front of an integral that is, mode by mode, the height of a Gaussian times its
volume. A large map has more places that fit by chance, and pays for them with its V.

How well a scan may fit a building that is not among the maps is seen from them: at best two are of
its building, so that the third best fits by chance. The best of many that do leads the third by as
much as the best of few: upper spacings of a tail that is about exponential do not depend on them.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.files import display
from imgloc.model import LaserScan, Localization, plain
from imgloc.options import FUSED, FusedOptions, Options, Trust
from imgloc.pipeline import localize
from imgloc.search.hypotheses import masses

OPTIONS = Options(top=20, fused=FusedOptions(strained=float("inf")))
"""Evidence is summed over the modes that are listed. No map is bent to fit: any would gain."""
LEAD = 0.4
"""Nats per reading by which an unknown building may fit better than the third best map.
Chosen on 475 scans simulated in the bundled worlds and 84 recorded ones, with and without their own
map: with less, more wrong maps are named, with more, more scans lose their own."""
LUCK = 20.0
"""Log-evidence that an unknown building does not exceed, nats: of these scans one in forty did.
Maps that fit better are alike, and a scan of one of them is not from none."""
FEW = 5
"""Of fewer maps than this, one is named only if the scan is ``unique`` in it: too few to tell what
fits by chance, and of chance there are mostly several places."""
NO_MAP = ("none", "undecided", "invalid")  #: verdicts that name no map


@dataclass(frozen=True)
class Choice:
    """Probabilities of the maps."""

    #: the name of a map, ``none``, ``undecided``, or ``invalid``: the scan has too few readings to
    #: say anything, and no probability is known (NaN)
    verdict: str
    probability: Mapping[str, float]  #: of each map, best first; with `none` they sum to 1
    #: that the scan is from none of them: it fits badly, or no better than it may fit any map
    none: float
    log_evidence: Mapping[str, float]  #: nats, relative to the best map's
    temperature: float  #: common to all maps: that of the one that fits best

    def as_row(self, fits: Mapping[str, Localization], index: int = 0) -> dict[str, Any]:
        """The row of the scan `index` of a file, as `imgloc which --json` writes it.

        `fits` are those that were compared: each map has its pose in the row.
        """
        maps = [
            {
                "map": name,
                "probability": share,
                "log_evidence": self.log_evidence.get(name),
                "misfit": fits[name].evidence.misfit,
                "verdict": fits[name].verdict,
                "pose": fits[name].pose,
                "explained": fits[name].explained,
            }
            for name, share in self.probability.items()
        ]
        about = {"verdict": self.verdict, "none": self.none, "temperature": self.temperature}
        return dict(plain({"index": index, **about, "maps": maps}))


def which(
    maps: Mapping[str, MapFeatures], scan: LaserScan, options: Options | None = None
) -> Choice:
    """Say from which of some maps a scan is: one of them, none, or undecided.

    Parameters
    ----------
    maps : mapping of str to MapFeatures
    scan : LaserScan
    options : Options, optional
        Of the method ``fused``; evidence is summed over the `top` modes.

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
    options = options or OPTIONS
    return choose({name: fit(features, scan, options) for name, features in maps.items()})


def fit(features: MapFeatures, scan: LaserScan, options: Options = OPTIONS) -> Localization:
    """Locate a scan in one of the maps, by ``fused`` alone."""
    if options.method != FUSED:  # the values of votes have no common scale
        raise ConfigError(f"maps are compared by the method {FUSED}, got {options.method}")
    return localize(features, scan, options)


def choose(
    fits: Mapping[str, Localization], trust: Trust | None = None, *, sure: float = 0.5
) -> Choice:
    """Compare maps by how a scan fits them; all maps are equally likely beforehand.

    `fits` are those of :func:`fit` in each map, at least one; `sure` is the probability that a map
    needs to be the verdict.

    Examples
    --------
    >>> from imgloc.model import Evidence, Hypothesis, Pose2D
    >>> def made(score):
    ...     pose = Hypothesis(Pose2D(0.0, 0.0), score, 1.0, np.eye(3))
    ...     fit, volume = 1.5 - score / 100, np.array([-9.0])
    ...     evidence = Evidence(100, 1.5, fit, gained=9.0, log_volume=volume)
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
        return Choice("invalid", dict.fromkeys(fits, unknown), unknown, {}, trust.temperature)
    found = [f for f in fits.values() if f.hypotheses]
    if not found:
        return Choice("none", dict.fromkeys(fits, 0.0), 1.0, {}, trust.temperature)
    best = min(found, key=lambda f: f.evidence.misfit)
    said = best.evidence
    temperature = trust.temperature_at(said.misfit, said.readings).value
    evidence = {name: log_evidence(f, temperature) for name, f in fits.items()}
    top = max(evidence.values())
    order = sorted(evidence, key=lambda name: (-evidence[name], name))
    weights = np.exp([evidence[name] - top for name in order])
    lead = LEAD * said.readings / temperature
    other = np.exp(unknown_evidence(list(evidence.values()), lead) - top)
    # The chance of being elsewhere counts twins in one map; twins in two maps are no less twins.
    share = masses(np.array([h.log_likelihood for h in best.hypotheses]), temperature)
    elsewhere = trust.mass_elsewhere(said.gained, float(share[0]))
    weights *= (1 - elsewhere) / (weights.sum() + other)
    none = float(1 - weights.sum())
    probability = dict(zip(order, weights.tolist(), strict=True))
    known = len(fits) >= FEW or fits[order[0]].verdict == "unique"
    verdict = order[0] if known and probability[order[0]] >= sure else "undecided"
    relative = {name: evidence[name] - top for name in order}
    return Choice("none" if none > 0.5 else verdict, probability, none, relative, temperature)


def log_evidence(answer: Localization, temperature: float) -> float:
    """Logarithm of the mean likelihood over the poses of a map, nats; -inf without a mode."""
    if not answer.hypotheses:
        return float("-inf")
    # The modes of the tempered likelihood are wider by the root of the temperature.
    score = np.array([h.log_likelihood for h in answer.hypotheses])
    terms = score / temperature + answer.evidence.log_volume + 1.5 * np.log(temperature)
    return float(np.logaddexp.reduce(terms))


def unknown_evidence(evidence: Sequence[float], lead: float) -> float:
    """Log-evidence of a building that is not among the maps, see the module's head.

    It leads the third best `evidence`, but is at most :data:`LUCK`; all in nats. With fewer than
    three maps it is -inf: nothing follows from two.

    Examples
    --------
    >>> unknown_evidence([-9.0, 31.0, -12.0, -8.0], 6.0), unknown_evidence([31.0, -9.0], 6.0)
    (-3.0, -inf)
    """
    third = sorted(evidence)[-3] if len(evidence) > 2 else float("-inf")
    return min(third + lead, LUCK)


def find_maps(folder: Path) -> list[Path]:
    """YAML files of maps in a folder and below, in order of their names; none is a ConfigError."""
    if not folder.is_dir():
        raise ConfigError(f"{display(folder)}: expected a folder of maps")
    paths = sorted({*folder.rglob("*.yaml"), *folder.rglob("*.yml")})
    if not paths:
        raise ConfigError(f"{display(folder)}: no map, expected map_server YAML files (*.yaml)")
    return paths


def names_of(paths: Iterable[Path], folder: Path) -> list[str]:
    """Names of maps in a folder, each other than all others and than the verdicts without a map.

    Examples
    --------
    >>> names_of([Path("a/attic.yaml"), Path("a/cellar/map.yaml")], Path("a"))
    ['attic', 'cellar']
    >>> names_of([Path("a/b.yaml"), Path("a/b/map.yaml"), Path("a/none.yaml")], Path("a"))
    ['b.yaml', 'b/map.yaml', 'none.yaml']
    """
    full = [path.relative_to(folder) for path in paths]
    # a/map.yaml is called after its folder
    inner = [path.stem == "map" and path.parent != Path() for path in full]
    short = [p.parent if i else p.with_suffix("") for p, i in zip(full, inner, strict=True)]
    taken = Counter([*(name.as_posix() for name in short), *NO_MAP])
    pairs = zip(full, short, strict=True)
    names = [(p if taken[name.as_posix()] > 1 else name).as_posix() for p, name in pairs]
    return names if len(set(names)) == len(names) else [path.as_posix() for path in full]
