"""Words of the command line stay words: whoever declares an option reads its value.

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


def as_typed(params: Sequence[Any]) -> Sequence[Any]:
    """The options of a command, which leave words as they were typed."""
    for param in params:
        # A method of theirs only where Typer asks Pydantic.
        make = getattr(type(param), "get_runtime_param", None)
        if make is not None:
            param.get_runtime_param = partial(_AsTyped, partial(make, param))
    return params
