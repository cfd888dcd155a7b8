"""The Cramer-Rao bound: how exact a pose by one scan can be, whatever the method.

A. Censi, On achievable accuracy for range-finder localization, ICRA 2007.
"""

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.raycast import cast_rays
from imgloc.features.scanpoints import Readings
from imgloc.model import FloatArray
from imgloc.search.faces import faces_met

_FACING = 0.1  # cosine: rays that graze a wall more count as if they grazed it so much
_NOTHING = 1e-8  # information that leaves a bound finite, 1/m²


def least_covariances(
    features: MapFeatures, poses: FloatArray, angles: FloatArray, reach: float, sigma: float
) -> FloatArray:
    """Covariance (C, 3, 3) below which no method gets, at poses (C, 3), grid frame: Cramer-Rao.

    A scan of rays at `angles` (N,), radians, which ends at `reach`, metres, has independent noise
    of standard deviation `sigma`, metres, a micrometre or more. With its expected ranges r the
    information of the pose is ``sum_i (dr_i/dx)^T (dr_i/dx) / sigma^2``. Along a corridor the bound
    is some kilometres.

    Examples
    --------
    >>> from imgloc.model import OccupancyGrid
    >>> walls = np.pad(np.zeros((40, 60), bool), 2, constant_values=True)
    >>> features = MapFeatures(OccupancyGrid(walls, ~walls, 0.1))
    >>> rays, at = np.deg2rad(np.arange(0, 360, 2.0)), np.array([[3.2, 2.2, 0.0]])
    >>> (bound,) = least_covariances(features, at, rays, 20.0, 0.02)
    >>> bool(0.001 < np.sqrt(bound[0, 0]) < 0.003)
    True
    """
    out = np.empty((len(poses), 3, 3))
    for k, pose in enumerate(poses):
        r = cast_rays(features.walls, pose[:2], pose[2] + angles, reach, features.grid.resolution)
        seen = Readings(r[np.isfinite(r)].astype(np.float64), angles[np.isfinite(r)])
        met = faces_met(pose[None], seen, features)
        J = met.J[0] / np.maximum(met.facing[0], _FACING)
        out[k] = np.linalg.inv(J @ J.T / np.maximum(sigma, 1e-6) ** 2 + _NOTHING * np.eye(3))
    return out
