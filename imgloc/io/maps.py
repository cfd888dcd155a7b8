"""Map files to :class:`~imgloc.model.OccupancyGrid` and back.

What the greys of an image mean follows Nav2 (map_io) or ROS 1 (map_server); `imgloc map check`
counts the cells that they read differently.

>>> from tempfile import TemporaryDirectory
>>> grid = load_map(bundled_maps() / "double_wall.yaml")
>>> with TemporaryDirectory() as folder:
...     save_map(f"{folder}/copy.yaml", grid).name
...     bool((load_map(f"{folder}/copy.yaml").occupied == grid.occupied).all())
'copy.png'
True
"""

import contextlib
import logging
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from imgloc.errors import ConfigError, MapError
from imgloc.io.files import (
    OTHERS,
    PathLike,
    display,
    is_file,
    is_there,
    neighbour_hint,
    open_regular,
    refuse_existing,
    write_bytes_atomic,
    write_text_atomic,
)
from imgloc.io.images import MAX_PIXELS, ImageSize, MapImage, decode_image, encode_png, read_image
from imgloc.io.mapyaml import (
    MODES,
    RESOLUTION_RANGE,
    SEMANTICS,
    YAML_ENDINGS,
    MapYaml,
    load_map_yaml,
    parse_map_yaml,
)
from imgloc.io.remote import is_address, local
from imgloc.model import BoolArray, OccupancyGrid, Pose2D
from imgloc.options import Reading

if TYPE_CHECKING:
    from typing_extensions import Unpack

_LOG = logging.getLogger("imgloc")
_THRESHOLDS: dict[str, Any] = {"occupied_thresh": 0.65, "free_thresh": 0.196}
_MOVABLE = 230  # grey level of what may stand there or not: free by these thresholds
_DEFAULTS = _THRESHOLDS | {"mode": "trinary", "semantics": "nav2", "negate": False}
_POSE = "[x, y, yaw] in metres and radians"
_NEEDED = {"resolution": "metres per cell, as 0.05", "origin": _POSE}
UNKNOWN = -1
_FRAME = ("origin", "resolution", "negate", "mode")  # what another YAML may have otherwise
_BESIDE = 64  # YAMLs in the folder of an image that are looked at

# Bytes that were measured to be taken at most: per pixel, as it is decoded and read as occupied
# or free; per byte of the file, whose samples may be written as text; and for tables of greys.
_GREY, _COLOURED, _TEXT, _TABLES = 7, 26, 4, 6 << 20


@dataclass(frozen=True)
class MapSettings:
    """Settings to read an image as a map: its YAML, overridden by options, with defaults."""

    image: Path
    resolution: float
    origin: Pose2D
    mode: str
    semantics: str
    negate: bool
    occupied_thresh: float
    free_thresh: float
    yaml: MapYaml | None = None  #: None for a bare image


def load_map(
    path: PathLike, *, allow_lossy: bool = False, **reading: "Unpack[Reading]"
) -> OccupancyGrid:
    """Load a map, be it without walls or free cells; :func:`require_usable` refuses such.

    Parameters
    ----------
    path : path
        A map_server YAML (the image is found relative to it), or an image; then
        `resolution` is needed, as it is never guessed. Or the name of a bundled map: ``large``.
    allow_lossy : bool
        Accept JPEG and lossy WebP.
    resolution : float, optional
        Metres per cell, 0.001 to 10; overrides the YAML, as do the next ones.
    origin : Pose2D or (x, y, yaw), optional
        Pose of the lower-left corner in the map frame, m and rad; (0, 0, 0) for an image.
    mode : {'trinary', 'scale', 'raw'}, optional
        Default trinary; see :func:`occupancy`.
    semantics : {'nav2', 'ros1'}, optional
        Whose reading of thresholds and transparency; default nav2. A YAML may have this key, too.
    occupied_thresh, free_thresh : float, optional
        Occupancies, ``0 <= free_thresh < occupied_thresh <= 1``; default 0.65 and 0.196.
    negate : bool, optional
        White is occupied; default False.
    max_pixels : int
        Larger images are refused before they are decoded; default 128,000,000.

    Returns
    -------
    OccupancyGrid
        Row 0 is the lowest y: the image is turned over here, once.

    Raises
    ------
    MapError, ConfigError
        A file is missing, damaged, too large or contradicts itself; an argument is out of range.
    """
    settings = resolve_settings(named_map(local(path, MapError)), **reading)
    if said := other_frame(settings):
        _LOG.warning("%s: %s", display(settings.image), said)
    for slip in settings.yaml.slips if settings.yaml else ():
        _LOG.warning("%s: %s: not a key of map_server, ignored", display(path), slip)
    most = reading.get("max_pixels", MAX_PIXELS)
    image = read_image(settings.image, max_pixels=most, allow_lossy=allow_lossy)
    grid = grid_of(image, settings)
    if trap := unknown_as_free(image, settings, grid):
        said = GREY_205.format(trap=trap, **vars(settings))
        _LOG.warning("%s: %s", display(path), said)
    return grid


def map_of_bytes(
    image: bytes, yaml: bytes | None, name: str, *, allow_lossy: bool = False,
    **reading: "Unpack[Reading]",
) -> OccupancyGrid:  # fmt: skip
    r"""Make a map of the contents of its files, as :func:`load_map`; no file is opened.

    Parameters
    ----------
    image, yaml : bytes
        Whatever path the YAML names, it is this image. Without a YAML a `resolution` is needed.
    name : str
        What error messages call the map.

    Examples
    --------
    >>> grid = map_of_bytes(b"P2\n2 1\n255\n0 254\n", None, "upload", resolution=0.5)
    >>> grid.occupied.tolist(), grid.free.tolist()
    ([[True, False]], [[False, True]])
    """
    given, file = _given(reading), Path(name)
    if yaml is not None:
        written = parse_map_yaml(yaml, file, given)
    elif "resolution" in given:
        written = MapYaml(file, file, origin=Pose2D(0.0, 0.0, 0.0))
    else:
        hint = "expected metres per cell, or the map's YAML"
        raise MapError(f"{name}: resolution: missing, {hint}")
    settings = _settings(written, given, name, bare=yaml is None)
    most = reading.get("max_pixels", MAX_PIXELS)
    return grid_of(decode_image(image, name, max_pixels=most, allow_lossy=allow_lossy), settings)


OTHER_FRAME = (
    "{yaml}, which is of this image, is ignored: {differs}; poses are in another frame, or walls "
    "are read otherwise; give {yaml} instead, or the same values"
)


def yamls_of(image: Path) -> Iterator[MapYaml]:
    """The map YAMLs in the folder of an image that name it, that of the same name first."""
    with contextlib.suppress(OSError):
        beside = [p for p in image.parent.iterdir() if p.suffix.lower() in YAML_ENDINGS]
        for path in sorted(beside, key=lambda p: (p.stem != image.stem, p.name))[:_BESIDE]:
            with contextlib.suppress(MapError, OSError):
                if (said := load_map_yaml(path)).image.samefile(image):
                    yield said


def other_frame(settings: MapSettings) -> str:
    """Say of a bare image that a YAML beside it, which is not read, has it otherwise; or nothing.

    Nothing is said either if one of several has it as it is taken to be.
    """
    texts = list[str]()
    for said in yamls_of(settings.image) if settings.yaml is None else ():
        with contextlib.suppress(MapError):
            theirs = _settings(said, {}, "", bare=False)
            values = [(k, *(_plainly(getattr(s, k)) for s in (theirs, settings))) for k in _FRAME]
            found = [
                f"{k} {there} there, {here} here" for k, there, here in values if there != here
            ]
            if not found:
                return ""
            name = display(said.path.name)
            texts.append(OTHER_FRAME.format(yaml=name, differs=", ".join(found)))
    return texts[0] if texts else ""


def _plainly(value: object) -> str:
    if isinstance(value, Pose2D):
        return f"[{value.x:g}, {value.y:g}, {value.theta:g}]"
    return f"{value:g}" if isinstance(value, float) else str(value).lower()


GREY_205 = (
    "{trap:,} cells of grey 205, map_saver's unknown, count as free because of mode {mode} and "
    "free_thresh {free_thresh:g}; trinary and 0.196 keep them unknown"
)
_MUCH, _PEAK = 200, 10  # one cell in so many; so many times as often as the greys beside it


def unknown_as_free(image: MapImage, settings: MapSettings, grid: OccupancyGrid) -> int:
    """Cells of map_saver's grey for unknown that are read as free, counted if many are.

    Grey 205 is an occupancy of 0.196, just above map_saver's own free_thresh.
    """
    if settings.mode == "raw" or settings.negate or settings.free_thresh < 1 - 205.5 / 255:
        return 0
    upright = image.pixels[::-1]  # row 0 at the bottom as in the grid; alpha aside
    sums, channels = channel_sum(upright[:, :, :3] if image.channels > 1 else upright)
    full = image.white * channels
    greys = np.round(np.arange(full + 1) * (255 / full))
    ends = np.searchsorted(greys, np.arange(204, 208)).tolist()  # comparing is faster than a table
    some, *beside = ((sums >= ends[k]) & (sums < ends[k + 1]) for k in (1, 0, 2))
    found = np.count_nonzero(some)
    if _MUCH * found <= sums.size or found <= _PEAK * max(map(np.count_nonzero, beside)):
        return 0  # a few cells, or one grey among many of a map of probabilities
    return int(np.count_nonzero(some & grid.free))


SWAPPED = (
    "free space is as thin as walls, and walls are as wide as rooms: black and white look "
    "swapped; where `negate=True` was passed leave it out, where the YAML has negate: 1 or true "
    "try `negate=False`, else `negate=True` with `occupied_thresh=0.9`"
)
SLIP = "the map is {wide:,.0f} x {high:,.0f} m: is this in centimetres? Try `resolution={metres:g}`"
_THICK = 0.3  # metres, half of what no wall is as thick as


def load_bytes(size: ImageSize) -> int:
    """Peak of :func:`load_map`, with the map itself, bytes; see :func:`~.images.image_size`."""
    pixel = _GREY if size.grey else _COLOURED
    return pixel * size.width * size.height + _TEXT * size.file_bytes + _TABLES


def reading_of(path: Path, reading: Reading) -> Reading:
    """Settings by which one of several maps is read: its YAML, if any, knows its frame best."""
    out = reading.copy()
    if path.suffix.lower() in YAML_ENDINGS:
        out.pop("resolution", None)
        out.pop("origin", None)
    return out


def looks_swapped(grid: OccupancyGrid) -> bool:
    """Return whether black and white are swapped: free space thin as walls, walls wide as rooms.

    Examples
    --------
    >>> room = np.pad(np.zeros((60, 80), bool), 2, constant_values=True)
    >>> [looks_swapped(OccupancyGrid(wall, ~wall, 0.1)) for wall in (room, ~room)]
    [False, True]
    """
    kernel = np.ones((2 * max(1, round(_THICK / grid.resolution)) + 1,) * 2, np.uint8)

    def wide(mask: BoolArray) -> float:
        inner = cv2.erode(mask.view(np.uint8), kernel)
        return float(np.count_nonzero(inner)) / max(1, int(np.count_nonzero(mask)))

    return bool(grid.free.any()) and wide(grid.free) < 0.05 and wide(grid.occupied) > 0.3


DRAWN = (
    "nothing is unknown, and all around is free: a floor plan? Then its text, furniture and door "
    "swings count as walls; imgloc map plan turns the plan into a map"
)


def looks_drawn(grid: OccupancyGrid) -> bool:
    """True of a map drawn on paper: nothing is unknown but the edges of lines, the margin free.

    Examples
    --------
    >>> plan = np.pad(np.zeros((60, 80), bool), 2, constant_values=True)
    >>> around = np.pad(plan, 9)
    >>> [looks_drawn(OccupancyGrid(wall, ~wall, 0.1)) for wall in (plan, around)]
    [False, True]
    """
    edge = np.concatenate((grid.free[0], grid.free[-1], grid.free[:, 0], grid.free[:, -1]))
    return lacks_unknown(grid) and bool(edge.mean() > 0.8)


def lacks_unknown(grid: OccupancyGrid) -> bool:
    """Return whether next to nothing is unknown but the soft edges of what is drawn."""
    inner = cv2.erode(grid.unknown.view(np.uint8), np.ones((3, 3), np.uint8))
    return float(np.count_nonzero(inner)) < 0.005 * inner.size


def require_usable(grid: OccupancyGrid, name: str) -> None:
    """Raise MapError if `grid` has no occupied or no free cell: nothing can be localized."""
    for what, found in (("occupied", grid.occupied.any()), ("free", grid.free.any())):
        if not found:
            hint = "look at the greys with 'imgloc map check', and at mode, negate, the thresholds"
            none = f"none of its {grid.occupied.size:,} cells is {what}"
            raise MapError(f"{name}: {none}, expected walls and free space; {hint}")


def save_map(path_yaml: PathLike, grid: OccupancyGrid, *, force: bool = False) -> Path:
    """Write `grid` as a map_server YAML, and as a PNG of the same stem whose path is returned.

    Parameters
    ----------
    path_yaml : path
        ConfigError if it does not end in ``.yaml`` or ``.yml``; OutputError if not written.
    grid : OccupancyGrid
        Occupied is written as 0, free as 254, unknown as 205, as by map_saver. What is movable is
        230, which map_server takes for free, and the key `movable` of the YAML.
    force : bool
        Overwrite files that exist, otherwise an OutputError.
    """
    target = Path(path_yaml)
    if target.suffix.lower() not in YAML_ENDINGS:
        raise ConfigError(f"{display(path_yaml)}: expected a name that ends in .yaml")
    png = target.with_suffix(".png")
    for file in () if force else (target, png):
        refuse_existing(file)
    frame = float(grid.resolution), grid.origin
    known = None if grid.movable is None else MapYaml(target, png, movable=_MOVABLE)
    text = yaml_text(MapSettings(png, *frame, **_DEFAULTS, yaml=known), target.parent)
    write_bytes_atomic(png, map_png(grid), force=force)
    write_text_atomic(target, text, force=force)
    return png


def map_png(grid: OccupancyGrid) -> bytes:
    """A map as map_saver writes its PNG: occupied 0, free 254, unknown 205; movable 230."""
    pixels = np.full(grid.occupied.shape, 205, np.uint8)
    pixels[grid.free] = 254
    pixels[grid.furnished.occupied] = _MOVABLE
    pixels[grid.occupied] = 0
    return encode_png(pixels[::-1])


def yaml_text(settings: MapSettings, folder: Path) -> str:
    """The YAML, for a file in a folder, by which map_server reads an image with these settings."""
    said = {
        "image": Path(os.path.relpath(settings.image, folder)).as_posix(),
        "resolution": settings.resolution,
        "origin": list(settings.origin),
        "negate": int(settings.negate),
        "occupied_thresh": settings.occupied_thresh,
        "free_thresh": settings.free_thresh,
        "mode": settings.mode,
        **({} if settings.semantics == SEMANTICS[0] else {"semantics": settings.semantics}),
    }
    if settings.yaml is not None and settings.yaml.movable is not None:
        said["movable"] = settings.yaml.movable
    return str(yaml.safe_dump(said, sort_keys=False, allow_unicode=True))


def bundled_maps() -> Path:
    """Folder of the maps that come with imgloc; MapError if the installation lacks them."""
    package = Path(str(files("imgloc")))
    for folder in (package / "maps", package.parent / "maps"):  # of a wheel, of a checkout
        if (folder / "double_wall.yaml").is_file():
            return folder
    raise MapError(f"{package / 'maps'}: the bundled maps are missing; reinstall imgloc")


def named_map(path: PathLike) -> Path:
    """The file of the bundled map that is called by its name, or `path` itself.

    Examples
    --------
    >>> named_map("large").name, named_map("cellar").name, named_map("large.png").name
    ('large.yaml', 'cellar', 'large.png')
    """
    found = Path(path)
    if found.name != str(path) or found.suffix or is_there(found):
        return found
    try:
        bundled = bundled_maps() / f"{path}.yaml"
    except MapError:
        return found
    return bundled if is_file(bundled) else found


def resolve_settings(path: PathLike, **reading: "Unpack[Reading]") -> MapSettings:
    """Combine a map's YAML, if `path` is one, with options of `load_map` (which win), defaults."""
    if strange := reading.keys() - Reading.__annotations__.keys():
        raise TypeError(f"unexpected arguments: {', '.join(sorted(strange))}")
    given, name, file = _given(reading), display(path), Path(path)
    said = load_map_yaml(path, given) if file.suffix.lower() in YAML_ENDINGS else None
    if said is None:
        os.close(open_regular(path, MapError, "map YAML or image"))
        if hint := OTHERS["maps"].get(file.suffix.lower()):
            raise MapError(f"{name}: is no map: {hint}")
        if "resolution" not in given:
            read_image(path, allow_lossy=True)  # what cannot be has another remedy
            hint = ", expected metres per cell; pass `resolution`, or the map's YAML"
            for beside in yamls_of(file):
                hint = f"; give {display(beside.path)} instead of the image, or pass `resolution`"
                break
            raise MapError(f"{name}: resolution: missing{hint}")
    else:
        try:
            os.close(open_regular(said.image, MapError, "map image"))
        except MapError as e:
            *_, there = re.split(r"[/\\]", str(said.image))
            hint = neighbour_hint(file.parent / there) if said.image.parent != file.parent else ""
            if is_file(file.parent / there):
                hint = f"; {display(there)} lies beside the YAML: write 'image: {display(there)}'"
            if is_file(slashed := Path(str(said.image).replace("\\", "/"))):
                hint = f"; write 'image: {display(os.path.relpath(slashed, file.parent))}'"
            if is_address(os.path.relpath(said.image, file.parent)):
                hint += "" if hint else "; it is an address: download it first"
            raise MapError(f"{e}; {name} names it as its image{hint}") from None
    written = said or MapYaml(file, file, origin=Pose2D(0.0, 0.0, 0.0))
    return _settings(written, given, name, bare=said is None)


def _settings(written: MapYaml, given: dict[str, Any], name: str, *, bare: bool) -> MapSettings:
    """The contents of a YAML under what is given, with defaults; a `bare` image has none."""
    used = _DEFAULTS | {k: v for k, v in vars(written).items() if v is not None} | given
    for key, expected in _NEEDED.items():
        if key not in used:
            raise MapError(f"{name}: {key}: missing, expected {expected}; or pass `{key}`")
    low, high, origin = used["free_thresh"], used["occupied_thresh"], used["origin"]
    if not 0 <= low < high <= 1:
        found = f"{name}: free_thresh {low} and occupied_thresh {high}"
        error = ConfigError if given.keys() & _THRESHOLDS.keys() else MapError
        expected = "expected 0 <= free_thresh < occupied_thresh <= 1"
        raise error(f"{found}, {expected}; or pass `free_thresh` and `occupied_thresh`")
    return MapSettings(
        image=written.image,
        resolution=float(used["resolution"]),
        origin=origin if isinstance(origin, Pose2D) else Pose2D(*map(float, origin)),
        yaml=None if bare else written,
        **{key: used[key] for key in _DEFAULTS},
    )


def _given(reading: Reading) -> dict[str, Any]:
    """The options that are given; ConfigError for one that is out of its range."""
    given: dict[str, Any] = {key: value for key, value in reading.items() if value is not None}
    low, high = RESOLUTION_RANGE
    resolution, origin = given.get("resolution", low), given.get("origin", (0, 0, 0))
    if not low <= resolution <= high:
        raise ConfigError(f"`resolution`: got {resolution}, expected metres, {low} to {high:g}")
    for key, known in (("mode", MODES), ("semantics", SEMANTICS)):
        if given.get(key, known[0]) not in known:
            raise ConfigError(f"`{key}`: got {given[key]!r}, expected one of {', '.join(known)}")
    if given.get("max_pixels", 1) < 1:
        raise ConfigError(f"max_pixels: got {given['max_pixels']}, expected at least 1")
    numbers = [0.0] * 3 if isinstance(origin, Pose2D) else [float(v) for v in origin]
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise ConfigError(f"`origin`: got {numbers}, expected x, y, yaw in metres and radians")
    return given


def grid_of(image: MapImage, settings: MapSettings) -> OccupancyGrid:
    """Read the pixels of `image` by the settings; see :func:`load_map`."""
    values = np.ascontiguousarray(occupancy(image, settings)[::-1])
    # As in AMCL, 100 is a wall, 0 is free, and what lies between is unknown; but raw values are
    # occupancies in per cent, and the thresholds have not been spent on them.
    low, high = 0, 100
    if settings.mode == "raw":
        low = math.floor(100 * settings.free_thresh)
        high = math.ceil(100 * settings.occupied_thresh)
    free = (values >= 0) & (values <= low)
    occupied = values >= high
    occupied.flags.writeable = free.flags.writeable = False  # nobody else has them: no copies
    movable = None
    if settings.yaml is not None and settings.yaml.movable is not None:
        sums, channels = channel_sum(image.pixels)
        movable = (sums == settings.yaml.movable * channels)[::-1] & free
    return OccupancyGrid(occupied, free, settings.resolution, settings.origin, movable)


def occupancy(image: MapImage, settings: MapSettings) -> npt.NDArray[np.int8]:
    r"""Occupancy of every pixel, as map_server would publish it: 0 free, 100 occupied, -1 unknown.

    With ``occ = (white - mean of the channels) / white`` (its complement under `negate`):

    ============================ ===================================== =======================
    \                            ``nav2`` (map_io)                     ``ros1`` (map_server)
    ============================ ===================================== =======================
    occupied / free              occ >= / <= its threshold             occ > / < its threshold
    trinary, transparent pixel   unknown                               alpha is averaged in as
                                                                       a colour channel
    scale, between, r in (0, 1)  round(100 r); transparent: unknown    1 + 98 r; unknown only if
                                                                       alpha is 0
    raw                          the sample itself, above 100 unknown  same, after `negate`
    ============================ ===================================== =======================

    Colours are averaged, not weighed as luma: a pure green wall (0, 255, 0) is as dark as
    ``85`` for ROS and occupied, where luma would make it unknown.

    Examples
    --------
    >>> image = MapImage(np.array([[0, 205, 254]], np.uint8), 255, "png")
    >>> settings = MapSettings(Path(), 0.05, Pose2D(0, 0), "trinary", "nav2", False, 0.65, 0.196)
    >>> occupancy(image, settings).tolist()
    [[100, -1, 0]]
    """
    pixels, white, mode = image.pixels, image.white, settings.mode
    low, high, ros1 = settings.free_thresh, settings.occupied_thresh, settings.semantics == "ros1"
    clear = image.channels == 4 and not (ros1 and mode == "trinary")
    sums, channels = channel_sum(pixels[:, :, :3] if clear else pixels)
    # Everything depends on the sum of the channels alone: decide once per possible sum.
    full = channels * white
    levels = np.arange(full + 1, dtype=np.float64)
    if mode == "raw":
        stored = np.floor((full - levels if settings.negate and ros1 else levels) / channels)
        table = np.where(stored <= 100, stored, UNKNOWN).astype(np.int8)
    else:
        occ = levels / full if settings.negate else (full - levels) / full
        table = np.full(occ.shape, UNKNOWN, np.int8)
        if mode == "scale":
            r = np.clip((occ - low) / (high - low), 0.0, 1.0)
            # ROS 1 stores the double in a signed byte: truncation.
            table[:] = 1 + 98 * r if ros1 else np.round(100 * r)
        table[occ > high if ros1 else occ >= high] = 100
        table[occ < low if ros1 else occ <= low] = 0
    values: npt.NDArray[np.int8] = table[sums]
    if image.channels == 4 and mode != "raw":
        alpha = pixels[:, :, 3]
        if not ros1:
            values[alpha < white] = UNKNOWN
        elif mode == "scale":
            values[(alpha == 0) & (values != 0) & (values != 100)] = UNKNOWN
    return values


def channel_sum(pixels: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], int]:
    """Sum over the channels of (H, W) or (H, W, C) samples, and C."""
    if pixels.ndim == 2:
        return pixels, 1
    wide = np.uint32 if pixels.dtype == np.uint16 else np.uint16
    return pixels.sum(axis=2, dtype=wide), int(pixels.shape[2])
