"""Filters by name."""

from collections.abc import Callable

from imgloc.doors import behind
from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import Filter
from imgloc.filters.evidence import Places
from imgloc.filters.tracker import Tracker, TrackerOptions
from imgloc.model import LaserScan
from imgloc.options import FILTERS, Options


def make_filter(
    name: str,
    features: MapFeatures,
    options: Options,
    *,
    seed: int = 0,
    resets: bool = True,
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
    resets : bool
        Whether the filter starts again from p(x | z) if it is lost.
    reset_by : str
        Method whose p(x | z) the particle filter draws new particles from.
    find : callable, optional
        Replaces the search: a function of a scan that returns its places, from an earlier search
        for example.
    """
    if name == "tracker":
        return Tracker(features, options, TrackerOptions(resets=resets), find)
    if name not in FILTERS:
        raise ConfigError(f"filter must be one of {', '.join(FILTERS)}, got {name!r}")
    made: Filter
    if name == "grid":
        made = behind("GridFilter")(features, options, behind("GridOptions")(resets=resets))
    else:
        how = behind("ParticleOptions")(resets=resets, reset_by=reset_by)
        made = behind("ParticleFilter")(features, options, how, seed=seed)
    return made
