"""What one scan says of some poses: the only place where filters touch the recipe of one scan.

Poses are those of the robot, on which each scan says where its sensor sits: scans of several lasers
are scored one after the other, each from where its own rays start. Of a scan that does not say it,
robot and sensor are one.
"""

from dataclasses import dataclass

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings, one_per_place
from imgloc.filters.motion import compose_poses, invert_poses
from imgloc.model import FloatArray, LaserScan, Pose2D
from imgloc.options import Options
from imgloc.pipeline import Modes, find_modes, score_poses, weigh
from imgloc.search.refine import refine

_SETTLE = (0.2, 0.1, 0.05)  # widths of the kernel, metres


@dataclass(frozen=True)
class View:
    """A scan, as poses (C, 3) of the robot, C > 0, grid frame, are asked about it."""

    readings: Readings  #: those that a search scores poses by
    mount: FloatArray  #: (3,) pose of the sensor on the robot

    def sensor(self, poses: FloatArray) -> FloatArray:
        """Where the sensor is if the robot is at the poses."""
        return compose_poses(poses, self.mount)

    def robot(self, poses: FloatArray) -> FloatArray:
        """Where the robot is if its sensor is at the poses."""
        return compose_poses(poses, invert_poses(self.mount))


def view_of(scan: LaserScan, options: Options) -> View:
    """The scan, made ready for the functions below."""
    m = scan.T_base_laser or Pose2D(0.0, 0.0)
    readings = one_per_place(scan, options.fused.place).spread(options.fused.rays)
    return View(readings, np.array([m.x, m.y, m.theta]))


@dataclass(frozen=True)
class Sight:
    """Poses by one scan, in the order in which they were asked for."""

    poses: FloatArray  #: (C, 3), grid frame
    log_likelihood: FloatArray  #: (C,) nats, divided by the temperature of the scan
    covariance: FloatArray  #: (C, 3, 3) of the readings' noise around each
    misfit: FloatArray  #: (C,) nats per reading that are lacking to a perfect fit
    gained: float  #: nats, tempered, by which the best one beats a building on no map


def sight(features: MapFeatures, view: View, poses: FloatArray, options: Options) -> Sight:
    """Score poses as they are."""
    seen, at = view.readings, view.sensor(poses)
    scores = score_poses(features, seen, at, options)
    order = np.argsort(-scores.log_likelihood, kind="stable")
    found = weigh(features, Modes(at[order], scores.select(order), seen), options)
    back = np.argsort(order, kind="stable")
    score = found.log_likelihood[back]
    misfit = options.fused.model.best - score / len(seen)
    covariance = np.tile(np.diag([0.5, 0.5, 0.25]) ** 2, (len(poses), 1, 1))
    covariance[order[: len(found.covariance)]] = found.covariance
    lever = np.tile(np.eye(3), (len(poses), 1, 1))  # a sensor that turns moves the robot
    lever[:, 0, 2], lever[:, 1, 2] = (at - poses)[:, 1], (poses - at)[:, 0]
    covariance = lever @ covariance @ lever.transpose(0, 2, 1)
    log = score / found.temperature.value
    return Sight(poses, log, covariance, misfit, found.gained)


def settled(features: MapFeatures, view: View, poses: FloatArray) -> FloatArray:
    """The poses moved to where the scan fits best around them, by half a metre at most."""
    at = refine(view.sensor(poses), view.readings.xy, features.field, sigmas=_SETTLE)
    return view.robot(at)


def search(features: MapFeatures, scan: LaserScan, options: Options) -> FloatArray:
    """All separated poses (M, 3) of the **sensor** that one scan allows, grid frame, best first."""
    return find_modes(features, scan, options).poses


def misfit_at(features: MapFeatures, view: View, poses: FloatArray, options: Options) -> float:
    """Least misfit of poses as they are, nats per reading."""
    scores = score_poses(features, view.readings, view.sensor(poses), options)
    return options.fused.model.best - float(scores.log_likelihood.max()) / len(view.readings)


def misfit_near(features: MapFeatures, view: View, poses: FloatArray, options: Options) -> float:
    """Least misfit of poses once they have settled, nats per reading."""
    return misfit_at(features, view, settled(features, view, poses), options)
