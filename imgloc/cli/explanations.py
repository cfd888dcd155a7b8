"""The page that `imgloc localize --explain` writes."""

import math
from pathlib import Path

from imgloc import __version__
from imgloc.cli.answers import difference
from imgloc.explain import explain
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import base_of
from imgloc.io.files import write_text_atomic
from imgloc.model import LaserScan, Localization, Pose2D
from imgloc.options import Options
from imgloc.report.explain import render_explanation
from imgloc.report.explain_numbers import describe


def write_explanation(
    path: Path,
    features: MapFeatures,
    scan: LaserScan,
    answer: Localization,
    options: Options,
    *,
    title: str,
    truth: Pose2D | None = None,
    mount: Pose2D | None = None,
    force: bool = False,
) -> None:
    """Write why a scan was answered as it was, as one HTML file.

    Parameters
    ----------
    path : path
    features, scan, answer, options
        As of :func:`imgloc.explain.explain`.
    title : str
    truth : Pose2D, optional
        True pose of the sensor in the map frame, to state the error.
    mount : Pose2D, optional
        Pose of the sensor on the robot, to state the robot's.
    force : bool
        Replace a file that exists.

    Raises
    ------
    OutputError
        If it exists (without `force`) or cannot be written.
    """
    facts = []
    if answer.pose is not None and mount is not None:
        facts.append(("Pose of the robot", describe(base_of(answer.pose, mount))))
    if truth is not None:
        facts.append(("True pose of the sensor", describe(truth)))
    if answer.pose is not None and truth is not None:
        away, turned = difference(answer.pose, truth)
        facts.append(("Error", f"{away:.3f} m, {math.degrees(turned):.2f}°"))
    page = render_explanation(explain(features, scan, answer, options), title, facts, __version__)
    write_text_atomic(path, page, force=force)
