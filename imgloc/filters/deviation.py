"""Deviation of a trajectory from the true one: APE and RPE as the program evo defines them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgloc.filters.follow import Moment
from imgloc.filters.motion import increments
from imgloc.geometry import pose_errors
from imgloc.model import FloatArray, IntArray

_APART = 0.01  # seconds between two stamps that are of one moment, as evo has it


@dataclass(frozen=True)
class Deviation:
    """Errors of the unique poses of a robot whose true poses are known; nothing is aligned.

    Examples
    --------
    >>> truth = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    >>> found = deviation(truth + [[0, 0.1, 0], [0, 0.1, 0], [0, 0.3, 0]], truth)
    >>> found.ape.round(3).tolist(), found.rpe.round(3).tolist()
    ([0.1, 0.1, 0.3], [0.0, 0.2])
    >>> found.words
    'APE of 3 unique poses: rmse 0.191 m, mean 0.167 m, max 0.300 m, rmse 0.00 deg; RPE from pose \
to pose: rmse 0.141 m, mean 0.100 m, max 0.200 m'
    """

    ape: FloatArray  #: (N,) distance of each pose from the true one, metres
    turn: FloatArray  #: (N,) angle between them, radians
    #: (N - 1,) distance between the motion to the next pose and the true motion, metres
    rpe: FloatArray
    which: IntArray  #: (N,) indices of the poses
    known: tuple[int, int] = (0, 0)  #: how many poses there were, and how many true ones

    @property
    def words(self) -> str:
        """RMSE, mean and maximum, in words."""
        if not len(self.ape):
            found, true = self.known
            return (
                f"no errors: {found:,} poses are unique and {true:,} true poses are known, but "
                "never both of one scan"
            )
        said = f"APE of {len(self.ape):,} unique poses: {_said(self.ape)}, rmse "
        said += f"{np.degrees(_rmse(self.turn)):.2f} deg"
        return said + (f"; RPE from pose to pose: {_said(self.rpe)}" if len(self.rpe) else "")


def deviation(poses: FloatArray, truth: FloatArray) -> Deviation:
    """Compare poses (N, 3) with true poses (N, 3), NaN where one is not known.

    The relative error is that of evo with a delta of one frame: from each pose to the next one that
    is known, in the frame of the first.
    """
    found, true = (np.isfinite(some).all(axis=1) for some in (poses, truth))
    which = np.flatnonzero(found & true)
    a, b = poses[which], truth[which]
    moved, meant = increments(a), increments(b)
    (metres, radians), (step, _) = pose_errors(a, b).T, pose_errors(moved, meant).T
    return Deviation(metres, radians, step, which, (int(found.sum()), int(true.sum())))


def deviation_of(moments: Sequence[Moment], truth: FloatArray) -> Deviation:
    """Compare the unique poses of moments with true poses (N, 3) of the robot, one for each."""
    nothing = (np.nan, np.nan, np.nan)
    poses = [nothing if m.pose is None else (m.pose.x, m.pose.y, m.pose.theta) for m in moments]
    return deviation(np.array(poses).reshape(-1, 3), truth)


def at_stamps(stamps: FloatArray, known: FloatArray, poses: FloatArray) -> FloatArray:
    """The poses (M, 3) of the `known` stamps (M,) nearest to `stamps` (N,): (N, 3), else NaN.

    Stamps that are more than 0.01 s apart are of two moments, as evo has it.

    Examples
    --------
    >>> at_stamps(np.array([1.0, 2.0]), np.array([0.5, 1.004]), np.array([[9, 9, 9], [1, 2, 0]]))
    array([[ 1.,  2.,  0.],
           [nan, nan, nan]])
    """
    after = np.clip(np.searchsorted(known, stamps), 1, max(1, len(known) - 1))
    before = after - 1
    after = np.minimum(after, len(known) - 1)
    nearest = np.where(stamps - known[before] <= known[after] - stamps, before, after)
    near = np.abs(known[nearest] - stamps) <= _APART
    return np.where(near[:, None], poses[nearest], np.nan)


def _said(errors: FloatArray) -> str:
    return f"rmse {_rmse(errors):.3f} m, mean {errors.mean():.3f} m, max {errors.max():.3f} m"


def _rmse(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))
