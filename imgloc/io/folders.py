"""Files in folder trees, and which of them are maps. Linked folders belong to the tree, once."""

import contextlib
import os
from pathlib import Path

from imgloc.errors import ConfigError, ImglocError
from imgloc.io.files import PathLike, display, is_folder
from imgloc.io.images import IMAGE_ENDINGS
from imgloc.io.mapyaml import YAML_ENDINGS, image_named
from imgloc.io.scans import why_no_scans


def files_in(folder: PathLike, aside: PathLike | None = None) -> list[Path]:
    """Files of a tree, in the order of their names, but for those in the folder `aside`.

    A linked folder is looked into under the name of its link, unless it lies in the tree anyway or
    holds it: no file comes twice, and no loop is endless.
    """
    top = Path(os.path.realpath(folder))
    out = None if aside is None else Path(os.path.realpath(aside))
    been, found = {top}, list[Path]()
    for here, folders, names in os.walk(folder, followlinks=True):
        kept = []
        for name in sorted(folders):
            path = Path(here, name)
            real = Path(os.path.realpath(path))
            linked = path.is_symlink() and (real.is_relative_to(top) or top.is_relative_to(real))
            if real == out or real in been or linked:
                continue
            been.add(real)
            kept.append(name)
        folders[:] = kept
        found += [Path(here, name) for name in names]
    return sorted(found)


def find_maps(
    folder: PathLike, *, images: bool = False, aside: PathLike | None = None
) -> list[Path]:
    """Files of the maps in a folder tree, in the order of their names; none is a ConfigError.

    They are map_server YAML files and, if `images` may be maps, images that none of these names.
    Those in the folder `aside` are none, nor is the ``metadata.yaml`` of a recording beside it, nor
    what ``ros2 topic echo`` printed.
    """
    name = display(folder)
    if not is_folder(folder):
        missing = "is no folder" if os.path.lexists(folder) else "no such folder"
        raise ConfigError(f"{name}: {missing}, expected a folder of maps")
    files = files_in(folder, aside)
    # JPEG is not among the endings: photographs of the site may lie about.
    bags = {path.parent for path in files if path.suffix in (".db3", ".mcap")}
    yamls = [path for path in files if path.suffix.lower() in YAML_ENDINGS]
    yamls = [path for path in yamls if path.name != "metadata.yaml" or path.parent not in bags]
    yamls = [path for path in yamls if why_no_scans(path)]
    bare = [path for path in files if path.suffix.lower() in IMAGE_ENDINGS]
    found = yamls
    if images:
        drawn = set()
        for path in yamls:
            with contextlib.suppress(ImglocError):
                drawn.add(os.path.realpath(image_named(path)))
        found = sorted({*yamls, *(path for path in bare if os.path.realpath(path) not in drawn)})
    if not found:
        hint = f"; pass `resolution` to use its {len(bare)} images as maps" if bare else ""
        plans = [path for path in files if path.suffix.lower() in (".dxf", ".svg", ".pdf")]
        hint += f"; `imgloc map plan` makes maps of its {len(plans)} drawings" if plans else ""
        raise ConfigError(f"{name}: no map, expected map_server YAML files (*.yaml){hint}")
    return found
