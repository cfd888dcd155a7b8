"""The command ``imgloc``, and ``python -m imgloc``: however early it is interrupted."""

import sys
from pathlib import Path

if not __package__:  # run as a file: its folder hides modules of the standard library
    sys.path[:] = [str(Path(__file__).resolve().parents[1]), *sys.path[1:]]


def main() -> None:
    """Run the command line; Ctrl-C while it is being loaded ends it as any other does."""
    try:
        from imgloc.cli.app import main as command_line

        command_line()
    except KeyboardInterrupt:
        print("imgloc: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
