"""``python -m imgloc``: the command line."""

from imgloc.cli import main

if __name__ == "__main__":
    main()
