"""A command is a function whose parameters are options; Typer is given what they declare.

A parameter is an option itself, annotated as the fields of :mod:`imgloc.options` are, or a
dataclass of such fields: each field with an :class:`~imgloc.ranges.Option` becomes an option, and
the command gets the dataclass. ``Annotated[Options, Only("method", "top")]`` takes some fields,
``Annotated[Sensor, Without("mount")]`` all others. A parameter ``given: Given`` gets the names of
the options that were typed, ``typed: Typed`` their words.
"""

import contextlib
import functools
import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints, is_typeddict

import typer
from typer.core import TyperCommand

from imgloc import ranges
from imgloc.cli.console import LACKS
from imgloc.cli.typed import SHARED, Shares, taking
from imgloc.errors import ConfigError
from imgloc.ranges import Declared, OneOf, Option, declaration, declared, help_of
from imgloc.texts import WITH_COMMAS

#: Options that a command does not have, and what to do instead.
GONE: Mapping[str, str] = {
    **dict.fromkeys(
        ("resolution", "origin", "mode", "occupied-thresh", "free-thresh", "negate", "no-negate",
         "semantics"),
        "imgloc map check MAP with it and with --write YAML makes a YAML that has it"),
    "allow-lossy": "the same image as a PNG needs none",
    **dict.fromkeys(("max-bad", "straighten", "height", "odom", "odometry", "topic",
                     "range-scale", "range-max", "sensor", "flipped", "scans-index", "sample"),
                    "imgloc convert LOG scans.npz with it makes a file that needs none"),
    **dict.fromkeys(("near", "sd", "clearance", "thinner", "bent", "max-speed", "max-turn-deg",
                     "theta-step-deg", "cell"), "imgloc localize has it"),
    "fov-deg": "imgloc convert LOG scans.npz with it makes such a file, as imgloc simulate does",
    "threads": "imgloc localize has it, imgloc batch has --workers",
    "memory-budget": "imgloc localize has it, imgloc batch has --memory-limit",
    "force": "nothing would be written over; imgloc batch has --resume",
    **dict.fromkeys(("json", "cache", "no-cache"), "this command would not notice it"),
    **dict.fromkeys(("rays", "sigma", "outliers", "dropped"),
                    "imgloc simulate has it, and writes a file of scans"),
}  # fmt: skip
# How hints about files begin, and the parameters of commands that read some.
_READ = (
    ("imgloc convert", "scans", ("scans", "scans_path", "scans_paths", "log", "files", "port")),
    ("imgloc map", "map", ("maps", "map_path", "maps_dir", "files", "a_path")),
)
#: Options that come first in the help, as many as :data:`_FIRST` of them.
USUAL = (
    "--out", "--json", "--picture", "--explain", "--tum", "--start", "--scans-index", "--near",
    "--sensor", "--flipped", "--range-max", "--resolution", "--force",
)  # fmt: skip
_FIRST, _FEW = 10, 16  # usual options; options of a command that needs no groups
_PANELS = {
    "Options": "Search", "Known": "Known of the pose", "Drawn": "Search", "Mounting": "Scans",
    "Logs": "Scans", "Chosen": "Scans", "MapImages": "Map image", "Sensor": "Simulated laser",
    "Followed": "Filter", "Settings": "Options",
    **dict.fromkeys(("Written", "Resources", "Kept"), "Program"),
}  # fmt: skip
_CONTEXT = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
Given = frozenset[str]  #: names of the options that were typed, as they are written
Typed = dict[str, list[str]]  #: their words, name and values, as another command takes them


class Only:
    """Fields of a dataclass that a command has as options; the others keep their defaults."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def takes(self, name: str) -> bool:
        """Return whether the command has an option for the field."""
        return name in self.names


class Without(Only):
    """Fields of a dataclass that a command has no options for: these keep their defaults."""

    def takes(self, name: str) -> bool:
        """Return whether the command has an option for the field."""
        return name not in self.names


class Command(Shares, TyperCommand):
    """A command whose help has groups, and which knows what else to do for some options."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, the usual options, and the others by what they are about."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        params = [(param, param.get_help_record(ctx)) for param in self.get_params(ctx)]
        shown = [(param, record) for param, record in params if record is not None]
        own = {name: record for param, record in shown for name in param.opts}
        first = [own[name] for name in USUAL if name in own][:_FIRST]
        for param, record in shown:
            panel = getattr(param, "rich_help_panel", None)
            if param.param_type_name == "argument":
                groups["Arguments"].append(record)
            elif record not in first:
                title = "Options" if len(shown) <= _FEW else panel or "More options"
                groups.setdefault(title, []).append(record)
        groups["Options"] = first + groups["Options"]
        more = groups.pop("More options", [])
        for title, records in [*groups.items(), ("More options", more)]:
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line; an option of other commands is a ConfigError with a hint."""
        own = {name for p in self.get_params(ctx) for name in (*p.opts, *p.secondary_opts)}
        read = {p.opts[0].lstrip("-") for p in self.params}
        vain = {begins: f"it reads no {what}" for begins, what, by in _READ if read.isdisjoint(by)}
        lacking = {f"--{name}": vain.get(" ".join(hint.split()[:2]), hint)
                   for name, hint in GONE.items() if f"--{name}" not in own}  # fmt: skip
        ctx.meta.setdefault(LACKS, {}).update(lacking)
        words = args[: args.index("--")] if "--" in args else args
        for word in words:
            old = word.partition("=")[0]
            if old in lacking:
                raise ConfigError(f"{old}: is no option here; {lacking[old]}")
            if old[:1] == "-" and old.lstrip("-") in ("output", "o") and old not in own:
                also = ", and --picture FILE draws them" if "--picture" in own else ""
                where = f"results go to standard output: > FILE keeps them, --json as JSON{also}"
                raise ConfigError(f"{old}: {'expected --out' if '--out' in own else where}")
        for word, value in pairwise(words):
            if word in taking(self, ctx) and value.partition("=")[0] in own:
                ctx.fail(f"Option {word!r} requires an argument.")
        return super().parse_args(ctx, args)


@dataclass(frozen=True)
class _Part:
    """A parameter of a command, and the options that it is made of."""

    name: str
    fields: tuple[Declared, ...]
    kind: Any = None  #: a dataclass or TypedDict; None for an option of its own

    def make(self, values: dict[str, Any]) -> Any:
        """The argument of the command, made of the values that were typed."""
        if self.kind is not None:
            return self.kind(**values)
        return values.get(self.name, self.fields[0].default)


def command(function: Callable[..., None], *kinds: Any) -> Callable[..., None]:
    """Make a command of a function: what Typer is to call, with the options that it declares.

    The program has the options of these classes: see :func:`with_options_of_program`.
    """
    every = (field for kind in kinds for field in declared(kind) if field.option)
    ours = {field.option: f"_{field.name}" for field in every}
    hints = get_type_hints(function, include_extras=True)
    parts, parameters, aside = list[_Part](), list[inspect.Parameter](), dict[str, Any]()
    for parameter in inspect.signature(function).parameters.values():
        hint = hints[parameter.name]
        if hint in (Given, Typed, typer.Context):
            aside[parameter.name] = hint
            continue
        part = _part(parameter, hint)
        parts.append(part)
        parameters += [_parameter(part, f) for f in part.fields if f.option not in ours]
    flags = {(_kind_name(p), f.name): f.flag for p in parts for f in p.fields}
    context = [name for name, hint in aside.items() if hint is typer.Context]
    noticed = {f.flag for p in parts for f in p.fields if f.option in ours}
    parameters.append(_CONTEXT)

    @functools.wraps(function)
    def run(**raw: Any) -> None:
        values: dict[str, Any] = dict.fromkeys(context, raw[_CONTEXT.name])
        typed = Typed()
        raw |= raw[_CONTEXT.name].meta.get(SHARED, {})
        with _flags_for(flags):
            for part in parts:
                said = [(f, raw[ours.get(f.option, _key(part, f))]) for f in part.fields]
                # Older versions of Typer have a tuple of several.
                texts = [(f, [*text] if isinstance(text, tuple) else text) for f, text in said]
                there = [(field, text) for field, text in texts if text not in (None, [])]
                typed |= {field.flag: _words_of(field, text) for field, text in there}
                values[part.name] = part.make({f.name: value_of(f, text) for f, text in there})
            values |= {name: Given(typed) for name, hint in aside.items() if hint == Given}
            values |= {name: typed for name, hint in aside.items() if hint == Typed}
            function(**values)

    _sign(run, parameters, noticed)
    return run


def with_options_of_program(function: Callable[..., None], *kinds: Any) -> Callable[..., None]:
    """Return what takes the options of a function and of these classes, for all commands."""
    own = list(inspect.signature(function).parameters.values())
    some = [(_Part("", (), kind), field) for kind in kinds for field in declared(kind)]
    fields = [(part, field) for part, field in some if field.option]

    def run(**_: Any) -> None: ...

    parameters = [*own, *(_parameter(*one) for one in fields)]
    _sign(run, parameters, {field.flag for _, field in fields})
    return run


def _sign(run: Any, parameters: Sequence[inspect.Parameter], of_program: set[str]) -> None:
    """Give a function what Typer reads; options `of_program` are told apart by :class:`Shares`."""
    run.__signature__ = inspect.Signature(parameters)
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    run.of_program = of_program


def _words_of(field: Declared, text: Any) -> list[str]:
    """An option that was typed, in words; of an argument there are none."""
    if isinstance(text, bool):
        names = field.option.names if field.option else ()
        return [field.flag if text else names[0].partition("/")[2]]
    values = text if isinstance(text, list) else [text]
    return [w for value in values for w in (field.flag, str(value)) if field.flag[:1] == "-"]


def value_of(field: Declared, text: Any) -> Any:
    """The value of an option that was typed; a ConfigError, by its name, if it is none."""
    option = field.option
    try:
        if not isinstance(text, list):
            return text if isinstance(text, bool) else ranges.value_of(field, text)
        if get_args(field.kind) == (Path,) and "" in text:
            raise ConfigError("got nothing, expected a path")
        if option is not None and option.joined:
            return ranges.value_of(field, ",".join(text))
        items = map(Path, text) if get_args(field.kind) == (Path,) else text
        return [option.parse(one) if option and option.parse else one for one in items]
    except ConfigError as error:
        said = re.sub(r"^[A-Z]\w+\.\w+: ", "", str(error))  # of a dataclass made of one option
        if said.endswith(WITH_COMMAS) and option is not None and option.metavar:
            said += f": {option.metavar}"
        raise ConfigError(f"{field.flag}: {said}") from None


def _part(parameter: inspect.Parameter, hint: Any) -> _Part:
    """Read the declaration of a parameter."""
    kind, notes = hint, list[Any]()
    if get_origin(hint) is Annotated:
        kind, *notes = get_args(hint)
    if (
        isinstance(kind, type)
        and (is_dataclass(kind) or is_typeddict(kind))
        and not any(isinstance(note, Option) for note in notes)
    ):
        only = next((note for note in notes if isinstance(note, Only)), Without())
        some = (field for field in declared(kind) if field.option and only.takes(field.name))
        return _Part(parameter.name, tuple(some), kind)
    default = MISSING if parameter.default is parameter.empty else parameter.default
    return _Part(parameter.name, (declaration(parameter.name, hint, default),))


def _key(part: _Part, field: Declared) -> str:
    return field.name if part.kind is None else f"{part.name}_{field.name}"


def _kind_name(part: _Part) -> str:
    return "" if part.kind is None else str(part.kind.__name__)


def _parameter(part: _Part, field: Declared) -> inspect.Parameter:
    """An option as Typer is given it: its name and help; values are read here."""
    option = field.option
    if option is None:
        raise TypeError(f"{part.name}.{field.name} has no Option in its annotation")
    kind: Any = bool if field.kind is bool else Path if field.kind is Path else str
    if get_origin(field.kind) is list:
        kind = list[Path] if get_args(field.kind) == (Path,) else list[str]
    elif option.joined:
        kind = list[str]
    names = [name for name in option.names if name.startswith("-")]
    about: dict[str, Any] = {"help": help_of(field), "show_default": False}
    about["rich_help_panel"] = _PANELS.get(_kind_name(part))
    default = ... if field.default is MISSING else None
    if isinstance(field.limit, OneOf):
        known = field.limit.names
        about["autocompletion"] = lambda incomplete: [n for n in known if n.startswith(incomplete)]
    if option.names and not names:
        made = typer.Argument(default, metavar=field.flag, **about)
    else:
        made = typer.Option(default, *(names or [field.flag]), metavar=field.metavar, **about)
    return inspect.Parameter(
        _key(part, field), inspect.Parameter.KEYWORD_ONLY, default=made,
        annotation=kind if default is ... else kind | None
    )  # fmt: skip


@contextlib.contextmanager
def _flags_for(flags: Mapping[tuple[str, str], str]) -> Iterator[None]:
    """Errors that name a field of a dataclass name the option instead."""
    try:
        yield
    except ConfigError as error:
        found = re.match(r"(\w+)\.(\w+)(?:\[\d+\])?: ", str(error))
        flag = flags.get((found[1], found[2])) if found else None
        if found is None or flag is None:
            raise
        raise ConfigError(f"{flag}: {str(error)[found.end() :]}") from None
