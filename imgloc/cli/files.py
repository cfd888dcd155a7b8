"""Files that the commands read and write: bundled maps by name, results over nothing else."""

import contextlib
from collections.abc import Iterable
from pathlib import Path

from imgloc.errors import ConfigError, MapError, OutputError


def find_map(path: str | Path) -> Path:
    """The file of a bundled map that is called by its name, or `path` itself.

    Examples
    --------
    >>> find_map("curved").name, find_map("office").name
    ('curved.yaml', 'office')
    """
    path = Path(path)
    if path.name != str(path) or path.suffix or path.exists():
        return path
    from imgloc.io.maps import bundled_maps

    with contextlib.suppress(MapError):
        bundled = bundled_maps() / f"{path}.yaml"
        return bundled if bundled.is_file() else path
    return path


def files_of(map_path: Path) -> list[Path]:
    """The files that a map is read from: its YAML and the image that this names, or an image."""
    from imgloc.io.maps import YAML_ENDINGS
    from imgloc.io.mapyaml import load_map_yaml

    files = [map_path]
    if map_path.suffix.lower() in YAML_ENDINGS:
        with contextlib.suppress(MapError):  # said when the map is loaded
            files.append(load_map_yaml(map_path).image)
    return files


def check_target(path: Path, ending: str, *, force: bool, inputs: Iterable[Path] = ()) -> None:
    """Refuse an output file before the work that it is to hold.

    Parameters
    ----------
    path : Path
    ending : str
        That its name must have.
    force : bool
        An existing file may be replaced, but for those among `inputs`.
    inputs : iterable of Path
        What the command reads.

    Raises
    ------
    ConfigError
        If it is not named `ending`.
    OutputError
        If it exists and `force` is not given, if the command reads it, or there is no such folder.
    """
    from imgloc.io.files import display, refuse_existing

    if path.suffix.lower() != ending:
        raise ConfigError(f"{display(path)}: expected a name that ends in {ending}")
    if not path.parent.is_dir():
        raise OutputError(f"{display(path)}: there is no folder {display(path.parent)}")
    if not force:
        refuse_existing(path)
    for source in inputs:
        with contextlib.suppress(OSError):
            if path.samefile(source):
                raise OutputError(
                    f"{display(path)}: is read by this command and will not be overwritten, not "
                    "even with --force; expected another name"
                )
