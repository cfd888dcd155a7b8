"""What the command lines of the scripts share."""

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from imgloc.cli import console
from imgloc.errors import ConfigError, ImglocError, OutputError
from imgloc.io.files import refuse_existing


def parser_of(name: str, about: str | None, seed: int | None = None) -> argparse.ArgumentParser:
    """A parser whose help shows the docstring of a module line by line; with --seed, if any."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(name, description=about, formatter_class=raw)
    if seed is not None:
        said = "of everything random (default: %(default)s)"
        parser.add_argument("--seed", type=int, default=seed, help=said)
    return parser


def ended(name: str, work: Callable[[], int]) -> int:
    """The exit code of some work; an error of imgloc is one line on standard error."""
    try:
        return work()
    except ImglocError as error:
        print(f"{name}: error: {error}", file=sys.stderr)
        return error.exit_code


def at_least_one(**numbers: int) -> None:
    """ConfigError unless each of these numbers is 1 or more."""
    for name, number in numbers.items():
        if number < 1:
            raise ConfigError(f"{name} must be at least 1, got {number}")


def one_of(names: Iterable[str], known: Iterable[str]) -> None:
    """ConfigError unless each of these names is known."""
    known = tuple(known)
    for name in names:
        if name not in known:
            raise ConfigError(f"expected one of {', '.join(known)}, got {name!r}")


def make_folder(folder: Path, files: Iterable[str], *, force: bool) -> None:
    """Make a folder for these files; one that is there is an OutputError now, before any work."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror}") from None
    for name in () if force else files:
        refuse_existing(folder / name)


def progress(title: str, total: int) -> AbstractContextManager[Callable[..., None]]:
    """Show a progress bar on standard error, if that is a terminal.

    What it yields is to be called after each of `total` steps.
    """
    return console.progress(title, total, lines=False)


def take_turns(
    runs: Sequence[Callable[[], object]],
    repeats: int,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[tuple[float, ...], ...]:
    """Seconds of each run, each time; in every other round they come in the opposite order."""
    times: list[list[float]] = [[] for _ in runs]
    for k in range(repeats):
        order = range(len(runs)) if k % 2 == 0 else reversed(range(len(runs)))
        for i in order:
            start = clock()
            runs[i]()
            times[i].append(clock() - start)
    return tuple(map(tuple, times))


def show(lines: Iterable[str]) -> int:
    """Print lines, each as soon as it is there; the exit code of that."""
    for line in lines:
        print(line, flush=True)
    return 0


def table_lines(head: str, rows: Iterable[Iterable[object]], rule: str = "---") -> Iterator[str]:
    r"""The lines of a Markdown table, each as soon as its row is there.

    `head` has the names of the columns with `` | `` between them, `rule` what is below each.

    Examples
    --------
    >>> print(*table_lines("world | S", [("curved", 2.5)], "---:"), sep="\n")
    | world | S |
    |---:|---:|
    | curved | 2.5 |
    """
    yield f"| {head} |"
    yield "|" + f"{rule}|" * (head.count(" | ") + 1)
    for row in rows:
        yield f"| {' | '.join(map(str, row))} |"
