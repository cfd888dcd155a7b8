"""Is there a file that imgloc falls over? Hostile input for each of its readers.

    python -m tools.fuzz --seconds 120                       # all targets, 2 minutes in all
    python -m tools.fuzz csv echo --runs 200000 --seed 1     # these, each so many inputs
    python -m tools.fuzz csv --input fuzz/csv-1a2b3c4d.input # one input again

Valid samples are changed at random and read in a child process. What is neither read nor refused
by imgloc's own error, takes more than 5 s of the processor or 512 MiB above the budget, or ends the
interpreter, is a finding: its input, made shorter, and its traceback are kept in --out. The exit
code is 1 then. The same seed gives the same inputs.
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from imgloc.errors import ConfigError
from tools.fuzz.run import MEMORY, SECONDS, Child, fuzz
from tools.fuzz.targets import TARGETS
from tools.script import ended, one_of, parser_of


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, execute, print; return the exit code."""
    parser = parser_of("tools.fuzz", __doc__, seed=0)
    parser.add_argument("targets", nargs="*", help=f"of {', '.join(TARGETS)}; all by default")
    parser.add_argument("--runs", type=int, help="inputs of each target")
    parser.add_argument("--seconds", type=float, help="of all targets together")
    parser.add_argument("--out", type=Path, default=Path("fuzz"), help="folder of findings")
    parser.add_argument("--input", type=Path, help="execute this file alone")
    given = parser.parse_args(arguments)
    names = given.targets or list(TARGETS)

    def work() -> int:
        one_of(names, TARGETS)
        if given.input is not None:
            return _again(names[0], given.input.read_bytes())
        if given.runs is None and given.seconds is None:
            raise ConfigError("expected --runs or --seconds, or both")
        share, findings = given.seconds and given.seconds / len(names), 0
        for name in names:
            count = fuzz(TARGETS[name], given.out, seed=given.seed, runs=given.runs, seconds=share)
            print(count, flush=True)
            findings += count.findings
        return 1 if findings else 0

    return ended("tools.fuzz", work)


def _again(name: str, data: bytes) -> int:
    with TemporaryDirectory(prefix="imgloc-fuzz-") as folder:
        child = Child(TARGETS[name], Path(folder), SECONDS, MEMORY)
        done = child.run([data])[0]
        child.close()
    print(f"{done.place}\n{done.text}".strip() or "accepted")
    return 1 if done.place else 0


if __name__ == "__main__":
    raise SystemExit(main())
