"""The maps that come with imgloc."""

from importlib.resources import files
from pathlib import Path

from imgloc.errors import MapError


def bundled_maps() -> Path:
    """Folder of the maps that come with imgloc.

    An installed wheel holds them in ``imgloc/maps``; a checkout, and an editable install of
    it, in ``maps`` beside the package.

    Raises
    ------
    MapError
        If the installation lacks them.

    Examples
    --------
    >>> (bundled_maps() / "double_wall.yaml").is_file()
    True
    """
    package = Path(str(files("imgloc")))
    for folder in (package / "maps", package.parent / "maps"):
        if (folder / "double_wall.yaml").is_file():
            return folder
    raise MapError(f"{package / 'maps'}: the bundled maps are missing; reinstall imgloc")
