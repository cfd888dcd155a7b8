"""Pictures of maps, features, likelihoods and answers, as (H, W, 3) uint8 BGR arrays.

Everything comes in the grid frame; :mod:`imgloc.draw.canvas` turns it upside up.
"""

from imgloc.draw.answers import draw_hypotheses, draw_likelihood
from imgloc.draw.features import draw_field, draw_surface, draw_visibility
from imgloc.draw.maps import draw_map
from imgloc.draw.mosaic import mosaic

__all__ = [
    "draw_field",
    "draw_hypotheses",
    "draw_likelihood",
    "draw_map",
    "draw_surface",
    "draw_visibility",
    "mosaic",
]
