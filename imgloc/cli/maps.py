"""`imgloc map`: what is in a map, what may be wrong with it, what it looks like."""

import json
import math
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imgloc.cli.console import emit, quiet_libraries, say
from imgloc.cli.files import check_target, files_of
from imgloc.cli.options import (
    AllowLossy,
    AsJson,
    Force,
    MapPath,
    MemoryBudget,
    Reading,
    console,
    reading,
    with_options,
)
from imgloc.cli.values import check_range, numbers
from imgloc.errors import ConfigError, MapError

if TYPE_CHECKING:
    from imgloc.draw.canvas import Picture
    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.io.mapcheck import MapReport


class Subject(StrEnum):
    """What `imgloc map show` draws."""

    MAP = "map"
    BMAP = "bmap"
    VMAP = "vmap"
    SURFACE = "surface"
    VISIBILITY = "visibility"
    DISTANCE = "distance"


@with_options(reading, console)
def check(
    map_path: MapPath,
    reading: Reading,
    as_json: AsJson = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with 3 if there is any warning.")
    ] = False,
    memory_budget: MemoryBudget = None,
) -> None:
    """Report what is in a map, and what is likely to be wrong with it.

    A map without walls or without free space is reported, not refused; a file that cannot be read
    exits with 3.
    """
    from imgloc.cli.budgets import check_image
    from imgloc.features.budget import check_bytes
    from imgloc.io.mapcheck import check_map

    check_image(map_path, reading, memory_budget, check_bytes)
    with quiet_libraries():
        report = check_map(map_path, **reading)
    emit(json.dumps(_as_row(report), allow_nan=False) if as_json else _as_text(report))
    if strict and report.warnings:
        raise typer.Exit(MapError.exit_code)


def _as_row(report: "MapReport") -> dict[str, Any]:
    """Return the report as JSON knows it."""
    width, height = report.size
    origin = report.origin
    return {
        **{key: getattr(report, key) for key in ("path", "image", "kind", "width", "height")},
        "resolution": report.resolution,
        "size": {"width": width, "height": height},
        "free_area": report.area,
        "origin": {"x": origin.x, "y": origin.y, "theta": origin.theta},
        **{key: getattr(report, key) for key in ("mode", "semantics", "negate")},
        "occupied_thresh": report.occupied_thresh,
        "free_thresh": report.free_thresh,
        "shares": report.shares,
        "greys": [{"value": value, "cells": cells} for value, cells in report.greys],
        "grey_levels": report.grey_levels,
        "semantics_differ": report.semantics_differ,
        "warnings": [{"code": w.code, "text": w.text} for w in report.warnings],
    }


def _as_text(report: "MapReport") -> str:
    width, height = report.size
    o = report.origin
    shares = ", ".join(f"{key} {100 * share:.1f} %" for key, share in report.shares.items())
    greys = ", ".join(f"{value:g} ({cells:,})" for value, cells in report.greys)
    more = report.grey_levels - len(report.greys)
    lines = [
        report.path,
        f"  image       {report.image} ({report.kind})",
        f"  cells       {report.width:,} x {report.height:,} of {report.resolution:g} m: "
        f"{width:.1f} x {height:.1f} m, {report.area:.1f} m2 free",
        f"  origin      x {o.x:g} m, y {o.y:g} m, yaw {math.degrees(o.theta):.2f} deg",
        f"  read as     {report.mode}, {report.semantics}, negate {report.negate}, "
        f"occupied_thresh {report.occupied_thresh:g}, free_thresh {report.free_thresh:g}",
        f"  classes     {shares}",
        f"  greys       {greys}" + (f" and {more:,} more" if more else ""),
        f"  nav2/ros1   {report.semantics_differ:,} cells are read differently",
        f"  warnings    {len(report.warnings) or 'none'}",
    ]
    return "\n".join(lines + [f"    {w}" for w in report.warnings])


@with_options(reading, console)
def show(
    map_path: MapPath,
    out: Annotated[Path, typer.Option(metavar="PNG", help="Picture to write.", show_default=False)],
    reading: Reading,
    what: Annotated[
        Subject,
        typer.Option(
            help="The map as it is read; blurred (bmap); normals, blurred (vmap); surface points "
            "with normals; what one surface point sees; distance to the nearest wall."
        ),
    ] = Subject.MAP,
    at: Annotated[
        Any,
        typer.Option(
            metavar="X,Y",
            parser=numbers(2),
            help="For visibility: near here, metres, map frame. [default: what sees most]",
        ),
    ] = None,
    sigma: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Blur of bmap and vmap, standard deviation, metres. [default: 0.1]",
        ),
    ] = None,
    cell: Annotated[
        float | None, typer.Option(metavar="M", help="Cell of bmap and vmap, metres.")
    ] = None,
    memory_budget: MemoryBudget = None,
    force: Force = False,
    allow_lossy: AllowLossy = False,
) -> None:
    """Draw a map, or what is computed from it, into a PNG."""
    check_target(out, ".png", force=force, inputs=files_of(map_path))
    check_range("--sigma", sigma, 0.001, 100, "metres")
    check_range("--cell", cell, 0.001, 10, "metres")
    if at is not None and what != Subject.VISIBILITY:
        raise ConfigError("--at: only --what visibility is drawn at a point")
    for option, value in (("--sigma", sigma), ("--cell", cell)):
        if value is not None and what not in (Subject.BMAP, Subject.VMAP):
            raise ConfigError(f"{option}: only --what bmap and --what vmap are blurred")
    from imgloc.cli.budgets import check_picture, fixed_budget
    from imgloc.cli.loading import load_grid
    from imgloc.cli.pictures import write_picture
    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.io.files import display
    from imgloc.io.maps import require_usable

    memory_budget = fixed_budget(memory_budget)
    grid = load_grid(map_path, memory_budget, allow_lossy=allow_lossy, **reading)
    features = MapFeatures(grid, cell=cell or grid.resolution, sigma=sigma or 0.1)
    if what != Subject.MAP:
        require_usable(grid, display(map_path))
    check_picture(features, what.value, display(map_path), memory_budget)
    picture = draw_subject(features, what, at)
    write_picture(out, picture, force=force)
    say(f"wrote {display(out)}: {what.value}, {picture.shape[1]} x {picture.shape[0]} pixels")


def draw_subject(
    features: "MapFeatures", what: Subject, at: tuple[float, float] | None
) -> "Picture":
    """Draw a map, or one of its features; what is seen from a point, from the one next to `at`."""
    from imgloc.draw import draw_field, draw_map, draw_surface
    from imgloc.draw.scalars import draw_bmap, draw_distance

    grid, lattice = features.grid, features.lattice
    if what == Subject.MAP:
        return draw_map(grid)
    if what == Subject.BMAP:
        return draw_bmap(features.bmap, lattice)
    if what == Subject.VMAP:
        return draw_field(features.vmap, lattice.resolution)
    if what == Subject.SURFACE:
        return draw_surface(grid, features.surface)
    if what == Subject.DISTANCE:
        return draw_distance(features.walls * grid.resolution, grid.info)
    return _draw_fan(features, at)


def _draw_fan(features: "MapFeatures", at: tuple[float, float] | None) -> "Picture":
    """Draw what one surface point sees: the one nearest to `at`, or the one that sees most."""
    import numpy as np

    from imgloc.draw import draw_visibility
    from imgloc.geometry import cell_of, inside, inverse, transform_points

    grid, surface = features.grid, features.surface
    if len(surface) == 0:
        raise MapError("the map has no surface: no occupied cell borders on a free one")
    reach = math.hypot(*grid.occupied.shape) * grid.resolution
    features = replace(features, horizon=min(features.horizon, reach))
    vis = np.minimum(features.visibility, features.horizon)
    if at is None:
        best = int(np.argmax((np.asarray(vis, dtype=np.float64) ** 2).sum(axis=0)))
    else:
        there = transform_points(inverse(grid.origin), np.array([at]))
        if not inside(cell_of(there, grid.resolution), grid.info).all():
            raise ConfigError(
                f"--at: {at[0]:g},{at[1]:g} is not on the map, expected a point of it"
            )
        best = int(np.argmin(np.hypot(*(surface.xy - there).T)))
    alpha = float(np.nan_to_num(surface.alpha[best]))
    return draw_visibility(
        grid, surface.xy[best], vis[:, best], horizon=features.horizon, alpha=alpha
    )
