"""From weighed poses to an answer: masses, a verdict, hypotheses in the map frame."""

from dataclasses import replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import in_map_frame
from imgloc.likelihoods.posterior import entropy
from imgloc.model import LaserScan, Localization
from imgloc.options import Options, log_share
from imgloc.search.asked import effective
from imgloc.search.hypotheses import as_hypotheses
from imgloc.search.priors import on_lattice
from imgloc.search.protection import protection
from imgloc.search.trust import judge
from imgloc.search.weigh import Weighed


def answered(
    features: MapFeatures, scan: LaserScan, found: Weighed, options: Options, ms: float
) -> Localization:
    """Make the answer for a scan whose poses have been weighed.

    `features` are those of the map, `found` has its poses in the grid frame. The answer has them in
    the map frame. `ms` is the wall time of the search, milliseconds.
    """
    volume, net = log_volume(features, options), found.evidence.net
    elsewhere = options.trust.mass_elsewhere(net, volume) if len(found.poses) else 1.0
    mass = (1 - elsewhere) * found.share
    alone = (1 - elsewhere) * found.alone
    weighed = options.prior.weights is not None or bool(options.prior.hints)
    verdict, checks = judge(
        scan.directions, mass, elsewhere, options.trust, found.complete,
        alone=float(alone[0]) if weighed and len(alone) else None,
    )  # fmt: skip
    arrays = (found.poses, found.log_likelihood, mass, found.covariance)
    listed = as_hypotheses(*(array[: options.listed(found.share)] for array in arrays))
    hypotheses = tuple(in_map_frame(h, features.grid.info) for h in listed)
    whole = np.append(mass, elsewhere) if len(mass) else mass
    # The posterior of a stack also has mass between its modes.
    spread = (1 - elsewhere) * max(0.0, 1 - float(found.share.sum())) if len(mass) else 0.0
    return Localization(
        hypotheses=hypotheses,
        verdict=verdict,
        entropy=entropy(whole) if found.entropy is None else found.entropy,
        explained=found.explained,
        counts=scan.counts,
        timings_ms={"localize": ms},
        parameters=effective(options, features),
        complete=found.complete,
        elsewhere=elsewhere,
        evidence=replace(
            found.evidence,
            log_volume=volume,
            checks=checks,
            found=len(mass),
            listed=len(hypotheses),
            unlisted=float(mass[len(hypotheses) :].sum()) + spread,
        ),
        T_base_laser=scan.T_base_laser,
        scan=scan.digest,
        # A search that was cut short may have missed the place: no radius holds it.
        protection=protection(
            found.poses,
            np.maximum(mass, alone),  # weights may be wrong: no radius is smaller by them
            found.covariance,
            elsewhere if found.complete else 1.0,
            farthest=features.grid.diagonal,
        ),
    )


def log_volume(features: MapFeatures, options: Options) -> float:
    """Logarithm of the volume of a hypothesis, as a share of that of all poses in the prior.

    All hypotheses have that of the poses that refinement takes for one. Their covariances are no
    measure of it: a bad fit is a wide one, and would count as many poses that fit.
    """
    prior, same = options.prior, options.fused.same
    cells = int(np.count_nonzero(on_lattice(prior, features.free, features.factor)))
    turn = np.pi if prior.heading is None else float(np.clip(prior.heading[1], same[1], np.pi))
    space = max(1, cells) * features.lattice.resolution**2 * 2 * turn
    return log_share(same, space)
