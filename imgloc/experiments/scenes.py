"""What Figs. 1, 2, 4 and 5 show: a world, a pose in it, a scan, and each method's stack."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from imgloc.experiments.paper_trials import CELL, stack_of
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import compose, uniform_thetas
from imgloc.model import FloatArray, LaserScan, Likelihood, OrientedPoints, Pose2D
from imgloc.simulate import simulate
from imgloc.worlds import NICHES, WORLDS, render

ANGLES = np.deg2rad(np.arange(-90, 91))
"""Of the sensor of Sec. VI: 181 rays over 180 degrees."""
_REACH = 60.0  # metres; farther than any wall


@dataclass(frozen=True)
class Setting:
    """Where a figure's scan is taken, and which stacks are computed.

    Parameters
    ----------
    world : str
    truth : Pose2D
        Grid frame.
    steps : tuple of (str, float)
        Methods with the step of their headings in degrees; in the order of the panels.
    angles : (N,) float array
        Of the rays.
    sigma : float
        Of the kernel that blurs the map, metres.
    seed : int
        Of the noise.
    """

    world: str
    truth: Pose2D
    steps: tuple[tuple[str, float], ...]
    angles: FloatArray
    sigma: float = 0.05
    seed: int = 1


@dataclass(frozen=True)
class Scene:
    """A setting, computed.

    Parameters
    ----------
    truth : Pose2D
    features : MapFeatures
    points : OrientedPoints
        Of the scan, sensor frame.
    stacks : tuple of (str, Likelihood)
        Each with what its caption says.
    """

    truth: Pose2D
    features: MapFeatures
    points: OrientedPoints
    stacks: tuple[tuple[str, Likelihood], ...]


_FINE = (("cbml", 6.0), ("cbml-o", 6.0), ("ght", 12.0), ("ght-v", 12.0))
_WIDE = (("cbml", 30.0), ("cbml-o", 30.0), ("ght", 30.0), ("ght-v", 30.0))
SETTINGS: Mapping[str, Setting] = MappingProxyType(
    {
        "fig1": Setting(
            "double_wall",
            compose(Pose2D(*NICHES[0]), Pose2D(1.65, 0.05, float(np.deg2rad(198)))),
            _FINE,
            ANGLES,
        ),
        "fig2": Setting("visibility", Pose2D(4.35, 6.55, np.pi / 2), _FINE, ANGLES, seed=2),
        # All headings but the true one are left out: this is about a false maximum beside it.
        "fig4": Setting(
            "large",
            Pose2D(22.05, 25.05, 0.0),
            (("cbml", 360.0), ("cbml-o", 360.0)),
            ANGLES[45:-45],
            sigma=0.25,
            seed=3,
        ),
        "fig5": Setting(
            "large",
            Pose2D(12.0, 20.0, float(np.deg2rad(15))),
            (*_WIDE, ("cbml", 3.0), ("cbml-o", 3.0)),
            ANGLES,
            seed=4,
        ),
    }
)
"""The settings of the figures; that they show what the paper says is tested."""


def scene(name: str, *, threads: int = 1, advance: Callable[[], None] = lambda: None) -> Scene:
    """Compute what a figure shows.

    Parameters
    ----------
    name : str
        Of :data:`SETTINGS`.
    threads : int
    advance : callable
        Called after each stack.
    """
    setting = SETTINGS[name]
    truth, world = setting.truth, WORLDS[setting.world]()
    grid = render(world, CELL)
    features = MapFeatures(grid, cell=CELL, sigma=setting.sigma, horizon=_REACH, threads=threads)
    ranges = simulate(
        render(world, 0.01), [(truth.x, truth.y, truth.theta)], setting.angles,
        seed=setting.seed, range_max=_REACH,
    )[0]  # fmt: skip
    scan = LaserScan(ranges, setting.angles, range_max=_REACH)
    stacks = []
    for method, step in setting.steps:
        thetas = uniform_thetas(np.deg2rad(step))
        values = stack_of(method, features, scan, thetas, threads)
        caption = (
            f"{method.upper()}, {step:g} deg" if step < 360 else f"{method.upper()}, true heading"
        )
        stacks.append((caption, Likelihood(values, thetas, features.lattice, method)))
        advance()
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    return Scene(truth, features, points, tuple(stacks))
