"""A map that is kept ready: everything that an answer needs exists before the first scan."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from imgloc.features.budget import default_budget
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.raycast import cast_rays
from imgloc.filters.follow import Tracking
from imgloc.geometry import centre_of
from imgloc.model import LaserScan, OccupancyGrid
from imgloc.options import FUSED, Calibration, Options, Shared
from imgloc.pipeline import localize, prepare
from imgloc.search.adapt import THINNEST
from imgloc.search.asked import check_options

_RAYS, _REACH = 90, 12.0  # of the scan that is simulated to warm up: rays, metres


@dataclass(frozen=True)
class Site:
    """A map with its calibration.

    Parameters
    ----------
    features : MapFeatures
        Of :func:`imgloc.prepare`.
    calibrations : mapping of str to Calibration
        By method, as :func:`~imgloc.io.calibration.load_calibrations` reads them.
    shared : Shared
        The scale of the readings, and by how many cells walls are drawn too thick.

    Examples
    --------
    >>> wall = np.pad(np.zeros((8, 9), bool), 1, constant_values=True)
    >>> site = Site(prepare(OccupancyGrid(wall, ~wall, 0.1)), shared=Shared(1.02))
    >>> site.options(Options()).shared.scale
    1.02
    """

    features: MapFeatures
    calibrations: Mapping[str, Calibration] = field(default_factory=dict)
    shared: Shared = field(default_factory=Shared)

    def options(self, options: Options) -> Options:
        """The options with the calibration of this map; values that the options set stay."""
        calibration = options.calibration or self.calibrations.get(options.method)
        shared = self.shared if options.shared == Shared() else options.shared
        return replace(options, calibration=calibration, shared=shared)


MapLike = OccupancyGrid | MapFeatures | Site
Maker = Callable[[], MapLike]


def site_of(made: MapLike | Maker, name: str) -> Site:
    """The map as a site; a MapError if it has no walls or no free cells."""
    if not isinstance(made, MapLike) and callable(made):
        made = made()
    if isinstance(made, Site):
        return made
    return Site(made if isinstance(made, MapFeatures) else prepare(made, name, ready=False))


def warm(site: Site, options: Options, tracking: Tracking) -> None:
    """Make everything that the first answer, or the first step of a filter, would make of a map.

    Raises
    ------
    ConfigError
        If the options cannot be used in this map.
    """
    features, options = site.features, replace(site.options(options), time_budget=None)
    check_options(features, options)
    for there in _levels(features, options):
        _ = there.field, there.walls, there.standable, there.pyramid
    free = np.argwhere(features.grid.free)
    x, y = centre_of(free[len(free) // 2], features.grid.resolution)
    angles = np.linspace(-np.pi, np.pi, _RAYS, endpoint=False)
    ranges = cast_rays(features.walls, [x, y], angles, _REACH, features.grid.resolution)
    scan = LaserScan(ranges.astype(np.float64), angles, range_max=_REACH)
    localize(features, scan, options)
    robot = tracking.follower(features, options)
    for way in (0.0, 2 * tracking.every.metres):
        robot.step(scan, np.array([way, 0.0, 0.0]))


def _levels(features: MapFeatures, options: Options) -> list[MapFeatures]:
    """The map, and the map with thinner walls, as thin as the search or the memory allows."""
    need, levels = max(map(features.bytes_for, {FUSED, options.method})), [features]
    budget = options.memory_budget or default_budget()
    most = max(options.shared.thinner, THINNEST if features.peels else 0)
    for cells in range(1, most + 1):
        if (len(levels) + 1) * need > budget:
            break
        if (there := features.thinner(cells)) is levels[-1]:
            break
        levels.append(there)
    return levels
