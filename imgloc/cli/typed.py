"""Words of the command line stay words: whoever declares an option reads its value.

Options of the program are in the help and the completion of the commands that notice them.

Recent versions of Typer let Pydantic read them, whose import takes as long as a whole help text.
"""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

_WORDS = (str, Path, list[str], list[Path])


class _AsTyped:
    """Makes of the words that were typed for a parameter these words."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self.make = make

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value that was typed; an option that was not typed has None or ()."""
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        if param.type_descriptor.annotation in _WORDS:
            return value
        return self.make().coerce(value, param=param, ctx=ctx)


class Noticing:
    """A command, or commands below one word, that notices options of the program."""

    def get_params(self, ctx: Any) -> Any:
        """The options of its own, and that for help."""
        return as_typed(super().get_params(ctx))  # type: ignore[misc]

    def of_program(self, ctx: Any) -> list[Any]:
        """The options of the program that the command notices."""
        names = getattr(ctx.command.callback, "of_program", ())
        return [p for p in ctx.find_root().command.params if p.opts[0] in names and ctx.parent]

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Complete a word, of the options of the program, too."""
        found: list[Any] = super().shell_complete(ctx, incomplete)  # type: ignore[misc]
        root, ours = ctx.find_root(), {name for p in self.of_program(ctx) for name in p.opts}
        more = root.command.shell_complete(root, incomplete) if ours else []
        return [*found, *(item for item in more if item.value in ours)]


def as_typed(params: Sequence[Any]) -> Sequence[Any]:
    """The options of a command, which leave words as they were typed."""
    for param in params:
        # A method of theirs only where Typer asks Pydantic.
        make = getattr(type(param), "get_runtime_param", None)
        if make is not None:
            param.get_runtime_param = partial(_AsTyped, partial(make, param))
    return params
