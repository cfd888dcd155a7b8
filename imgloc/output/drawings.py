"""Pictures of a batch, as PNGs: what its workers draw of answers and maps."""

from collections.abc import Mapping
from pathlib import Path

from imgloc.answers.explain import explain, layer_of
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.images import encode_picture
from imgloc.io.maps import load_map
from imgloc.model import LaserScan, Localization, Pose2D
from imgloc.options import TOLERANCES, Options, Reading
from imgloc.output.features import draw_map
from imgloc.output.pages import render_explanation
from imgloc.output.pictures import draw
from imgloc.pose import difference
from imgloc.runs.opening import Drawing


def draw_answer(
    features: MapFeatures, answer: Localization, scan: LaserScan, truth: Pose2D | None,
    options: Options, title: str = "",
) -> dict[str, bytes]:  # fmt: skip
    """The scan over the map at each hypothesis, the likelihood of every place, and the reasons.

    Only an answer that is not unique, or wrong, has a page that explains it ray by ray.
    """
    picture = draw(features.grid, answer, scan, truth=truth, title=title)
    out = {"poses": encode_picture(picture.image)}
    if answer.verdict == "invalid":
        return out
    layer = layer_of(features, scan, options)
    if layer.likelihood is not None:
        picture = draw(features.grid, layer.likelihood, title=title)
        out["likelihood"] = encode_picture(picture.image)
    away = 0.0 if truth is None or answer.best is None else difference(answer.best, truth)[0]
    if answer.verdict != "unique" or away > TOLERANCES[-1].position:
        reason = explain(features, scan, answer, options)
        out["why.html"] = render_explanation(reason, title, truth=truth).encode()
    return out


def draw_checked(path: Path, reading: Reading) -> dict[str, bytes]:
    """A map as it is read."""
    return {"map": encode_picture(draw_map(load_map(path, allow_lossy=True, **reading)).image)}


DRAWINGS: Mapping[str, Drawing] = {"answer": draw_answer, "map": draw_checked}
