"""Filters by name."""

from collections.abc import Callable

from imgloc.doors import behind
from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import Filter
from imgloc.filters.evidence import Places
from imgloc.filters.tracker import Tracker
from imgloc.model import LaserScan
from imgloc.options import FILTERS, Options, Seed
from imgloc.ranges import require


def make_filter(
    name: str,
    features: MapFeatures,
    options: Options,
    *,
    seed: int = 0,
    reset_by: str = "ght-v",
    find: Callable[[LaserScan], Places] | None = None,
) -> Filter:
    """Make a filter that has seen nothing yet.

    Parameters
    ----------
    name : str
        One of :data:`imgloc.options.FILTERS`. Any other name raises a ConfigError.
    seed : int
        Seed of the filter's random draws.
    reset_by : str
        Method whose p(x | z) the particle filter draws new particles from.
    find : callable, optional
        Replaces the search: a function of a scan that returns its places, from an earlier search
        for example.
    """
    require(Seed, seed, "seed")
    if name == "tracker":
        return Tracker(features, options, find=find)
    if name not in FILTERS:
        raise ConfigError(f"filter must be one of {', '.join(FILTERS)}, got {name!r}")
    made: Filter
    if name == "grid":
        made = behind("GridFilter")(features, options)
    else:
        how = behind("ParticleOptions")(reset_by=reset_by)
        made = behind("ParticleFilter")(features, options, how, seed=seed)
    return made
