"""`imgloc cache`: the prepared maps that are kept for the next time."""

from typing import Annotated

import typer

from imgloc.cli import options as opt
from imgloc.cli.command import Only
from imgloc.cli.console import emit, say
from imgloc.io.files import display

_MIB = 1 << 20


Folder = Annotated[opt.Kept, Only("cache")]


def cache(context: typer.Context, kept: Folder, as_json: opt.AsJson = False) -> None:
    """Show where prepared maps are kept, how many there are and what they take.

    Examples
    --------
    imgloc cache
    imgloc cache --json
    imgloc cache clear
    """
    if context.invoked_subcommand is not None:
        return
    from imgloc.io.cache import cache_info
    from imgloc.model import to_json

    info = cache_info(kept.cache)
    if as_json:
        emit(to_json({**info._asdict(), "folder": display(info.folder)}))
        return
    emit(f"folder   {display(info.folder)}")
    emit(f"entries  {info.entries:,}")
    emit(f"size     {info.bytes / _MIB:,.1f} MiB, at most {info.limit / _MIB:,.0f} MiB")


def clear(kept: Folder) -> None:
    """Remove all prepared maps; they are prepared anew when they are needed.

    Examples
    --------
    imgloc cache clear
    """
    from imgloc.io.cache import cache_info, clear_cache

    before, removed = cache_info(kept.cache), clear_cache(kept.cache)
    freed = before.bytes - cache_info(kept.cache).bytes
    say(f"removed {removed:,} files, {freed / _MIB:,.1f} MiB")
