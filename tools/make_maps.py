"""Draw the bundled maps: the worlds of imgloc.simulation.worlds at 10 cm per cell.

The files in maps/ are made by this and by nothing else; a test compares them. Run it after
a change of a world:

    python -m tools.make_maps            # into maps/, beside this folder
"""

from pathlib import Path

from imgloc.io.maps import save_map
from imgloc.simulation.worlds import WORLDS, render
from tools.script import parser_of

RESOLUTION = 0.1
"""Side of a cell of the bundled maps, metres: the paper's."""


def make_maps(folder: Path) -> list[Path]:
    """Write every bundled world as PNG and YAML, over what is there; the paths of the YAML files.

    The folder is made if it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, world in WORLDS.items():
        path = folder / f"{name}.yaml"
        save_map(path, render(world(), RESOLUTION), force=True)
        paths.append(path)
    return paths


def main() -> None:
    """Parse the command line and write the files."""
    parser = parser_of("tools.make_maps", __doc__)
    beside = Path(__file__).resolve().parents[1] / "maps"
    parser.add_argument("--out", type=Path, default=beside, help="folder (default: maps/)")
    arguments = parser.parse_args()
    for path in make_maps(arguments.out):
        print(path)


if __name__ == "__main__":
    main()
