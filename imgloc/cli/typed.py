"""The parameters of a command, those that the program has for all commands among them.

Words of the command line stay words: whoever declares an option reads its value. Recent versions
of Typer let Pydantic read them, whose import takes as long as a whole help text.
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


def as_typed(params: Sequence[Any]) -> Sequence[Any]:
    """The options of a command, which leave words as they were typed."""
    for param in params:
        # A method of theirs only where Typer asks Pydantic.
        make = getattr(type(param), "get_runtime_param", None)
        if make is not None:
            param.get_runtime_param = partial(_AsTyped, partial(make, param))
    return params


SHARED = "imgloc.shared"  # where a context has the texts of options of the program


def taking(command: Any, ctx: Any) -> set[str]:
    """The names of the options of a command after which a value stands."""
    options = [p for p in command.get_params(ctx) if p.param_type_name == "option"]
    return {name for p in options if not (p.is_flag or p.count) for name in p.opts}


class Shares:
    """A command that takes options which are declared once, at the program."""

    def shared(self, ctx: Any) -> list[Any]:
        """The options of the program that this command takes, or that the program has for all."""
        names = getattr(getattr(self, "callback", None), "of_program", ())
        return [p for p in ctx.find_root().command.params if p.opts[0] in names]

    def get_params(self, ctx: Any) -> Any:
        """The options: its own, those of the program that it takes, and that for help."""
        own = super().get_params(ctx)  # type: ignore[misc]
        return as_typed([*own[:-1], *(self.shared(ctx) if ctx.parent else ()), *own[-1:]])

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line; Typer does not know the options that the program has."""
        rest: list[str] = super().parse_args(ctx, args)  # type: ignore[misc]
        ctx.meta[SHARED] = {p.name: ctx.params.pop(p.name) for p in self.shared(ctx)}
        return rest
