"""What the default method spends where."""

from dataclasses import dataclass, field

import numpy as np

from imgloc.search.rescore import EvidenceModel


@dataclass(frozen=True)
class FusedOptions:
    """What the search spends where.

    Parameters
    ----------
    theta_step : float
        Between the headings of the endpoint correlation, radians.
    keep : tuple of int
        Nodes kept by each level of the endpoint pyramid, finest first; as many as there are.
    skip : int
        All levels of the pyramid but the finest take every `skip`-th of the few rays.
    vote_cell : float
        Cell of the GHT-V votes, metres.
    vote_cells : int
        With more cells than this, headings and all, the votes of a map get larger ones.
    vote_headings : int
        Number of headings of the GHT-V votes.
    vote_peaks : int
        How many peaks of the votes become proposals.
    few_rays, rays : int
        Rays of the first look at all proposals, and of the second at the best.
    second_look, closer : int
        How many places get the second look, and how many poses, which may be of one place: between
        two layers of a wall the score has several maxima.
    twins, same : (float, float)
        Proposals nearer than this, metres and radians, are of one place, and one pose.
    separation : (float, float)
        Two poses nearer than this, metres and radians, are one hypothesis.
    model : EvidenceModel
        The score.
    """

    theta_step: float = float(np.deg2rad(1.0))
    keep: tuple[int, ...] = (3000, 8000, 8000, 16000)
    skip: int = 2
    vote_cell: float = 0.25
    vote_cells: int = 4_000_000
    vote_headings: int = 24
    vote_peaks: int = 100
    few_rays: int = 64
    rays: int = 180
    second_look: int = 80
    closer: int = 40
    twins: tuple[float, float] = (0.1, float(np.deg2rad(3.0)))
    same: tuple[float, float] = (0.02, float(np.deg2rad(0.7)))
    separation: tuple[float, float] = (0.5, float(np.deg2rad(15.0)))
    model: EvidenceModel = field(default_factory=EvidenceModel)
