"""The Cramer-Rao bound, against derivatives of cast rays by differences."""

import numpy as np
import pytest

from imgloc import MapFeatures, OccupancyGrid
from imgloc.features.raycast import cast_rays
from imgloc.lab.bound import least_covariances


def by_differences(features, pose, angles, reach, sigma):
    def ranges(at):
        return cast_rays(features.walls, at[:2], at[2] + angles, reach, 0.1).astype(float)

    J, smooth = np.empty((len(angles), 3)), np.ones(len(angles), bool)
    for k, step in enumerate((2e-3, 2e-3, 5e-4)):
        moved = np.eye(3)[k] * step
        far, near = ranges(pose + moved), ranges(pose - moved)
        J[:, k] = (far - near) / (2 * step)
        smooth &= np.abs(far + near - 2 * ranges(pose)) < 0.02  # a jump tells nothing
    return np.linalg.inv(J[smooth].T @ J[smooth] / sigma**2)


@pytest.mark.parametrize("pose", [(2.3, 1.9, 0.2), (4.6, 3.1, -2.0), (1.2, 3.4, 1.5)])
def test_the_bound_is_that_of_differences(pose):
    walls = np.pad(np.zeros((40, 60), bool), 2, constant_values=True)
    walls[2:15, 30:33] = True
    features, angles = MapFeatures(OccupancyGrid(walls, ~walls, 0.1)), np.deg2rad(np.arange(360))
    (found,) = least_covariances(features, np.array([pose]), angles, 20.0, 0.02)
    naive = by_differences(features, np.array(pose), angles, 20.0, 0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(found)), np.sqrt(np.diag(naive)), rtol=0.06)


def test_a_corridor_leaves_a_pose_free_along_itself():
    walls = np.zeros((30, 400), bool)
    walls[[5, 25]] = True
    features = MapFeatures(OccupancyGrid(walls, ~walls, 0.1))
    angles = np.deg2rad(np.arange(360))
    (found,) = least_covariances(features, np.array([[20.0, 1.5, 0.0]]), angles, 8.0, 0.02)
    assert np.sqrt(found[0, 0]) > 100 > 0.01 > np.sqrt(found[1, 1])
