"""What may be wrong when scans do not fit a map: tried on the scans, not guessed.

Upside down, other units, a map of another scale: each is one more answer for a few of the scans.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.maps import DRAWN, SWAPPED, looks_drawn, looks_swapped
from imgloc.model import SURE, Evidence, LaserScan
from imgloc.numbers import number
from imgloc.options import Options, Shared
from imgloc.pipeline import localize

Said = Sequence[tuple[str, Evidence]]
"""Of each scan, the verdict and what it rests on."""
# nats per reading; where the best pose lacks less, several places fit as they are
_FITS = number("diagnose.fits")
_TRIED = number("diagnose.tried")  # doubtful scans that are looked at in another way
# By which ranges are off, the likeliest first: millimetres, centimetres, feet; round slips of the
# resolution.
_FACTORS = (0.001, 0.01, 0.5, 2.0, 0.1, 10.0, 0.2, 5.0, 0.25, 4.0, 0.4, 2.5)


@dataclass(frozen=True)
class Doubt:
    """What most likely is wrong, and what mends it."""

    text: str  #: a sentence or two
    short: str  #: the same for a picture
    found: bool = True  #: tried, and it helps; otherwise it is where to look


def is_doubtful(verdict: str, evidence: Evidence) -> bool:
    """Whether a scan fits nowhere, or several places not well.

    Examples
    --------
    >>> is_doubtful("ambiguous", Evidence(misfit=0.1)), is_doubtful("ambiguous", Evidence(misfit=2))
    (False, True)
    """
    return verdict not in SURE or (verdict != "unique" and evidence.misfit >= _FITS)


def doubts(
    features: MapFeatures, scans: Sequence[LaserScan], said: Said, options: Options,
    *, flipped: bool = False, range_scale: float = 1.0,
) -> list[Doubt]:  # fmt: skip
    """Say what most likely keeps most of some scans from being placed, and what mends it.

    Parameters
    ----------
    features, options
        Those of the answers.
    scans, said : sequences of one length
        The scans, and the verdict and evidence of each.
    flipped : bool
        Whether the scans were taken for those of a sensor that hangs upside down.
    range_scale : float
        What their ranges were multiplied by already.

    Returns
    -------
    list of Doubt
        The likeliest cause; none if at least half of the scans fit. And what :func:`bent` says.
    """
    likely = _doubts(features, scans, said, options, flipped, range_scale)
    return [*likely, *bent(said, options.shared, features.grid.resolution)]


def _doubts(
    features: MapFeatures, scans: Sequence[LaserScan], said: Said, options: Options,
    flipped: bool, range_scale: float,
) -> list[Doubt]:  # fmt: skip
    doubtful = [scan for scan, answer in zip(scans, said, strict=True) if is_doubtful(*answer)]
    counts = Counter(verdict for verdict, _ in said)
    if 2 * len(doubtful) <= len(scans):
        return []
    if 2 * counts["invalid"] > len(scans):
        few = _too_few(doubtful)
        short = "millimetres? `range_scale=0.001`" if "milli" in few else "look at `range_max`"
        return [Doubt(few, f"too few readings: {short}")]
    if looks_swapped(features.grid):
        return [Doubt(SWAPPED, "black and white of the map look swapped: `negate=True`")]
    tried = [scan for scan in doubtful if scan.directions][:_TRIED]
    plan = Doubt(f"the map: {DRAWN}", "the map looks like a drawing: imgloc map plan")
    drawn = [plan] if looks_drawn(features.grid) else []

    # Votes find a few places more where nothing fits, which takes longer than all the rest.
    quick = replace(options, fused=replace(options.fused, unfit=np.inf))

    def all_unique(changed: Iterable[LaserScan]) -> bool:
        verdicts = (localize(features, scan, quick).verdict for scan in changed)
        return bool(tried) and all(verdict == "unique" for verdict in verdicts)

    like = "this scan fits" if len(scans) == 1 else "scans like these fit"
    if all_unique(scan.flipped for scan in tried):
        option = "Leave out" if flipped else "Try"
        mirrored = f"{like} at one place if mirrored"
        why = "is the sensor upside down, or the map's image mirrored?"
        text = f"{mirrored}: {why} {option} `flipped=True`"
        return [Doubt(text, "fits if mirrored: `flipped=True`"), *drawn]
    resolution = features.grid.resolution
    for factor in _FACTORS:
        if all_unique(scan.scaled(factor) for scan in tried):
            units = {0.001: "millimetres", 0.01: "centimetres"}.get(factor)
            why = f"are they {units}?" if units else "is the map's resolution right?"
            other = "" if units else f", or `resolution={resolution / factor:g}`"
            fits = f"{like} at one place if ranges are multiplied by {factor:g}"
            text = f"{fits}: {why} Try `range_scale={factor * range_scale:g}`{other}"
            return [Doubt(text, f"fits with ranges x {factor:g}: {why}"), *drawn]
    if drawn or 2 * counts["no-match"] <= len(scans):
        return drawn
    none = "this scan does" if len(scans) == 1 else "most scans do"
    text = (
        f"{none} not fit this map. Look at one with `explain`, and at the map "
        "with imgloc map check; imgloc which tells which of several maps it is from"
    )
    return [Doubt(text, "another map? see imgloc map check, imgloc which", found=False)]


def bent(said: Said, known: Shared, resolution: float) -> list[Doubt]:
    """Say that most scans fit a map only with an error that all readings share, and what helps.

    The list is empty if fewer than half of the scans do, or if the error is `known` already. The
    map's cells are `resolution` metres wide.

    Examples
    --------
    >>> said = [("unique", Evidence(scale=1.05))] * 2 + [("no-match", Evidence(scale=0.97))]
    >>> bent(said, Shared(), 0.05)[0].text[:67]
    'most scans fit this map far better with their ranges multiplied by '
    >>> bent(said[1:], Shared(), 0.05), bent(said, Shared(1.05), 0.05)
    ([], [])
    """
    count, placed = len(said), [evidence for verdict, evidence in said if verdict in SURE]
    scales = [e.scale for e in placed if e.scale != known.scale]
    thinner = [e.thinner for e in placed if e.thinner > 0 and known.thinner == 0]
    if 2 * len(scales) > count:
        factor = float(np.median(scales))
        cells = f"are its cells of {resolution / factor:.4g} m? Then pass `resolution`"
        found = f"their ranges multiplied by {factor:.3f}: {cells}, as poses are in its metres"
        short = f"ranges x {factor:.3f}"
    elif 2 * len(thinner) > count:
        found = short = f"walls that are {np.median(thinner):.2f} m thinner on each side"
    else:
        return []
    which = "this scan fits" if count == 1 else "most scans fit"
    text = (
        f"{which} this map far better with {found}. imgloc calibrate MAP --scans FILE finds "
        "it once for all, which is faster and surer"
    )
    return [Doubt(text, f"fits far better with {short}: imgloc calibrate")]


def _too_few(scans: Sequence[LaserScan]) -> str:
    """Why scans have too few readings, and what to do."""
    found = few_readings(scans)
    if "milli" in found:
        return f"{found} Try `range_scale=0.001`"
    return (
        f"most scans have too few readings to be placed: {found}. Look at range_min and range_max "
        "of the file, and pass `range_max`"
    )


def few_readings(scans: Sequence[LaserScan]) -> str:
    """What the readings are of scans that have too few: probably millimetres, or their counts.

    Examples
    --------
    >>> few_readings([LaserScan([np.nan, 20.0, 3.0], [0.0, 1.0, 2.0], range_max=10.0)])
    'of 3 readings 1 valid, 1 no return, 0 too close, 1 nan'
    """
    ranges = np.concatenate([scan.ranges for scan in scans[:100]])
    limit = max(scan.range_max for scan in scans)
    finite = ranges[np.isfinite(ranges) & (ranges > 0)]
    beyond = finite[finite >= limit]
    if len(beyond) > 0.5 * len(ranges) and np.percentile(beyond, 25) > 5 * limit:
        found = f"most ranges are far beyond range_max (half are above {np.median(finite):g}, "
        return f"{found}range_max is {limit:g}): are they millimetres?"
    total = {key: sum(scan.counts[key] for scan in scans) for key in scans[0].counts}
    unused = ", ".join(f"{n:,} {key.replace('_', ' ')}" for key, n in total.items())
    return f"of {sum(total.values()):,} readings {unused}"
