"""What may be wrong with scans that fit a map nowhere, or at many places."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from imgloc.cli.console import LOG

if TYPE_CHECKING:
    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.model import LaserScan
    from imgloc.options import Options

MIRRORED = 3
"""Doubtful scans that are looked at mirrored."""


def hint_at_mirrored(
    doubtful: Sequence["LaserScan"], features: "MapFeatures", options: "Options", *, flipped: bool
) -> None:
    """Say so if all of some doubtful scans would fit at one place if they were mirrored."""
    from imgloc.pipeline import localize

    if all(localize(features, scan.flipped, options).verdict == "unique" for scan in doubtful):
        LOG.warning(
            "scans like these fit at one place if they are mirrored: is the sensor upside down? "
            "%s --flipped",
            "Leave out" if flipped else "Try",
        )
