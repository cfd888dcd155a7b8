"""A progress bar for the scripts."""

from collections.abc import Callable
from contextlib import AbstractContextManager

from imgloc.cli import console


def progress(title: str, total: int) -> AbstractContextManager[Callable[..., None]]:
    """Show a progress bar on standard error, if that is a terminal.

    What it yields is to be called after each of `total` steps.
    """
    return console.progress(title, total, lines=False)
