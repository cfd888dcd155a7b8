"""`imgloc cache`: the prepared maps that are kept for the next time."""

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import emit, say
from imgloc.io.files import display

_MIB = 1 << 20


def cache(context: typer.Context, as_json: opt.AsJson = False) -> None:
    """Show where prepared maps are kept, how many there are and what they take."""
    if context.invoked_subcommand is not None:
        return
    from imgloc.io.cache import cache_info
    from imgloc.model import to_json

    info = cache_info()
    if as_json:
        emit(to_json({**info._asdict(), "folder": display(info.folder)}))
        return
    emit(f"folder   {display(info.folder)}")
    emit(f"entries  {info.entries:,}")
    emit(f"size     {info.bytes / _MIB:,.1f} MiB, at most {info.limit / _MIB:,.0f} MiB")


def clear() -> None:
    """Remove all prepared maps; they are prepared anew when they are needed."""
    from imgloc.io.cache import cache_info, clear_cache

    before, removed = cache_info(), clear_cache()
    freed = before.bytes - cache_info().bytes
    say(f"removed {removed:,} files, {freed / _MIB:,.1f} MiB")
