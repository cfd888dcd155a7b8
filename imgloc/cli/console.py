"""Shared by the commands: output, progress, and the end of a run that fails.

Standard output carries results only. Everything else, logs, progress, errors, goes to standard
error.
"""

import contextlib
import errno
import logging
import os
import re
import shlex
import shutil
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import typer
from typer.core import TyperGroup

from imgloc.cli.typed import Shares, taking
from imgloc.errors import STDERR, ConfigError, ImglocError, OutputError, as_options, printable

LOG = logging.getLogger("imgloc")
FAILED_ROWS, NOT_UNIQUE = 5, 6  # exit codes: of a batch or folder, and under --strict
INTERRUPTED = 128 + 2  # as a shell reports a process that SIGINT ended
PIPE_CLOSED = 128 + 13  # and SIGPIPE
LACKS = "imgloc.lacks"
"""Where a context has the options that its command lacks, and what to do instead."""


_SECTIONS = {
    "First steps": ("demo", "inspect", "localize", "track", "open", "convert"),
    "Robots and services": ("node", "serve"),
    "Folders": ("batch", "report", "export", "which"),
    "Maps": ("map", "atlas", "simulate", "sample", "cache"),
    "Measure": ("evaluate", "calibrate"),
}

_SWITCHES, _ENDS = ("--verbose", "-v", "--debug", "--version"), ("--", "--ros-args")


class Subgroup(Shares, TyperGroup):
    """Commands below one word."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words: wherever they stand, those of a command are behind it."""
        end = next((k for k, word in enumerate(args) if word in _ENDS), len(args))
        first = [word for word in args[:end] if word in _SWITCHES and not ctx.parent]
        words = [word for word in args[:end] if word not in first]
        there = [k for k, word in enumerate(words) if word in self.commands]
        commands: list[Any] = [self.commands[words[k]] for k in there]
        lacking = taking(self, ctx).union(*(taking(command, ctx) for command in commands))
        at = [k for k in there if not k or words[k - 1] not in lacking]  # others are values
        if there and not at:
            ctx.fail(f"Option {words[there[0] - 1]!r} requires an argument.")
        own = {name for param in self.get_params(ctx) for name in param.opts}
        lost = [w for w in words if w[:2] == "--" and w.partition("=")[0] not in own]
        if ctx.parent and not at and lost:
            rest = "" if self.invoke_without_command else ": expected one of its commands before it"
            raise ConfigError(f"{lost[0]}: is no option of {ctx.command_path}{rest}")
        k = at[0] if at else 0
        words = [*words[k : k + 1], *words[:k], *words[k + 1 :]]
        return super().parse_args(ctx, [*first, *words, *args[end:]])

    def format_commands(self, _: Any, formatter: Any) -> None:
        """Write the commands in groups, each with its first sentence, whole."""
        rest = [name for name in self.commands if name not in sum(_SECTIONS.values(), ())]
        for title, names in [*_SECTIONS.items(), ("Commands", rest)]:
            there = [(name, self.commands[name]) for name in names if name in self.commands]
            if there:
                with formatter.section(title):
                    formatter.write_dl([(name, _sentence(one.help or "")) for name, one in there])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command; a file, or a word of another group, is told what would do."""
        word, below = args[0], getattr(self.commands.get("map"), "commands", {})
        if word not in self.commands:
            path = shlex.quote(word)
            if word in below:
                raise ConfigError(f"imgloc {word}: expected imgloc map {word}")
            if re.search(r"[./]", word) and not word.startswith("-"):
                wanted = "inspect" if below else f"{ctx.info_name} check"
                raise ConfigError(
                    f"{word}: expected a command before a file: imgloc {wanted} {path}"
                )
        return super().resolve_command(ctx, args)


def _sentence(text: str) -> str:
    """The first sentence of a text."""
    return re.split(r"(?<=\.)\s", " ".join(text.split()) + " ")[0]


class Group(Subgroup):
    """All commands, with one end for every way in which one can fail."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command; what it raises becomes one line and a typer.Exit with the exit code."""
        debug = ctx.params.get("debug", False)
        lacks = ctx.meta.setdefault(LACKS, {})
        configure(verbose=ctx.params.get("verbose", False), lacks=lacks)
        try:
            result = super().invoke(ctx)
            _flush()
        except KeyboardInterrupt:
            say("interrupted")
            raise typer.Exit(INTERRUPTED) from None
        except BrokenPipeError:  # `| head` has seen enough
            _drop_stdout()
            raise typer.Exit(PIPE_CLOSED) from None
        except Exception as e:
            if isinstance(e, typer.Exit | typer.Abort) or hasattr(e, "show"):
                raise  # the last is a usage error, which Typer prints itself
            if debug:
                print(printable(traceback.format_exc()), file=sys.stderr, flush=True)
            message = instead(" ".join(str(e).split()), lacks)
            if isinstance(e, ImglocError):
                say(f"error: {message}")
            elif isinstance(e, MemoryError):
                less = "a smaller map, a larger --cell or fewer --threads need less"
                say(f"error: out of memory; {less}")
            else:
                say(f"internal error: {type(e).__name__}: {message} (a defect; see --debug)")
            raise typer.Exit(e.exit_code if isinstance(e, ImglocError) else 1) from None
        return result


def instead(message: str, lacks: Mapping[str, str]) -> str:
    """A message, and what to do instead of an option in it that the command does not have.

    Options of another command, which is named before them, are as they should be.

    Examples
    --------
    >>> instead("pass `topic`, one of /a (6)", {"--topic": "imgloc convert has it"})
    'pass --topic, one of /a (6); this command has no --topic: imgloc convert has it'
    >>> instead("try imgloc calibrate MAP `force=True`", {"--force": "rm"})
    'try imgloc calibrate MAP --force'
    """
    text = as_options(message)
    own = re.findall(r"--[a-z-]+", re.sub(r"\bimgloc [a-z][^.,;:\n]*", "", text))
    lacking = next((option for option in own if option in lacks), "")
    if not lacking or lacks[lacking] in text:
        return text
    between = "\n" if "\n" in text else "; "
    return f"{text}{between}this command has no {lacking}: {lacks[lacking]}"


class _Lines(logging.Formatter):
    """Log records as lines that a terminal may have."""

    lacks: Mapping[str, str]

    def format(self, record: logging.LogRecord) -> str:
        return printable(instead(super().format(record), self.lacks))


def configure(*, verbose: bool, lacks: Mapping[str, str]) -> None:
    """Log to standard error: warnings, and each step if `verbose`.

    `lacks` are options that the command does not have, and what to do instead.
    """
    handler = logging.StreamHandler()  # of this run's stderr
    handler.setFormatter(lines := _Lines("imgloc: %(message)s"))
    lines.lacks = lacks
    said = set[str]()  # a map that is read twice has one word of warning

    def first(record: logging.LogRecord) -> bool:
        text = record.getMessage()
        again = record.levelno >= logging.WARNING and text in said
        said.add(text)
        return not again

    handler.addFilter(first)
    LOG.handlers[:] = [handler]
    LOG.propagate = False
    LOG.setLevel(logging.INFO if verbose else logging.WARNING)


def emit(text: str) -> None:
    """Write a piece of the result to standard output, at once.

    It is an OutputError if that cannot take it, for another reason than a closed pipe.
    """
    try:
        print(printable(text, keep="\n\t\x7f"))  # the last is as it is in JSON
        _flush()
    except OSError as e:
        if e.errno == errno.EPIPE:
            raise
        _drop_stdout()
        raise OutputError(f"standard output: cannot be written: {e.strerror}") from None


def width() -> int | None:
    """Columns of the terminal that the result goes to; None if it goes elsewhere."""
    return shutil.get_terminal_size().columns if is_terminal(sys.stdout) else None


def say(message: str) -> None:
    """Write one line to standard error."""
    with STDERR, contextlib.suppress(OSError):
        print(f"imgloc: {printable(as_options(message))}", file=sys.stderr, flush=True)


def is_terminal(stream: Any) -> bool:
    """Return whether a stream of this program leads to a terminal."""
    return stream is not None and bool(stream.isatty())


@contextlib.contextmanager
def progress(title: str, total: int, *, lines: bool = True) -> Iterator[Callable[..., None]]:
    """Show a progress bar on standard error, if that is a terminal.

    What it yields is to be called after each of `total` steps, with a note if there is one to
    show. If each of several writes `lines` of the result to a terminal, those are progress enough.
    """
    crowded = lines and total != 1 and is_terminal(sys.stdout)
    if not is_terminal(sys.stderr) or crowded or LOG.isEnabledFor(logging.INFO):
        yield lambda *_, **__: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Remaining(),
        TextColumn("{task.fields[note]}")
    )  # fmt: skip
    # Without the redirection: results go to stdout, where they belong.
    to = Console(stderr=True)
    with Progress(*columns, console=to, transient=True, redirect_stdout=False) as bar:
        task = bar.add_task(title, total=total if total > 1 else None, note="")

        def advance(note: str = "") -> None:
            bar.update(task, advance=1, note=note)

        yield advance


def _flush() -> None:
    if sys.stdout is not None:
        sys.stdout.flush()


def _drop_stdout() -> None:
    """Let what is still in the buffer go nowhere: Python flushes it once more at its end."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, sys.stdout.fileno())
        os.close(sink)
