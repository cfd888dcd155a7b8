"""Inputs to a child process, and what is left of it when it dies or hangs."""

import faulthandler
import hashlib
import logging
import random
import re
import time
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

import imgloc
from imgloc.features.budget import MIB
from imgloc.runs.workers import CrashError, OverdueError, Supervisor
from tools.fuzz.mutate import mutate
from tools.fuzz.targets import BUDGET, Run, Target

SECONDS = 5.0
"""Processor seconds that an input may take."""
MEMORY = BUDGET + 512 * MIB
"""Bytes that it may take beside what the interpreter has with everything imported."""

_PATIENCE = 60.0  # seconds for a sample: what is imported and prepared first takes longer
_BUSY = 12.0  # seconds on a busy machine for a second of the processor
_SHORTER = 30.0  # seconds for making an input shorter
_AT_ONCE = 16  # inputs that are sent together: the time is looked at between
_STACK = ".stack"  # file of a folder: where a child was when it died, or was late
_REFUSED = "refused: "
_GREEDY = "memory: an input took"
_SLOW = "overdue: an input took"
_FRAME = re.compile(r'File "([^"]+)", line (\d+),? in (\S+)')


@dataclass(frozen=True)
class Outcome:
    """What became of an input: accepted, refused, or a finding."""

    place: str  #: of a finding, what it is and where: others of the same place show the same
    text: str = ""  #: traceback or stack, or what imgloc's own error says


@dataclass
class Count:
    """What became of the inputs of a target."""

    name: str
    executions: int = 0
    accepted: int = 0  #: without an error
    findings: int = 0
    seconds: float = 0.0
    inputs: str = ""  #: digest of all of them

    def __str__(self) -> str:
        return (
            f"{self.name:13} {self.executions:9,} executions {self.accepted:9,} accepted "
            f"{self.findings:4} findings {self.seconds:8.1f} s   inputs {self.inputs}"
        )


@cache
def _stack_file(folder: Path) -> IO[str]:
    file = (folder / _STACK).open("w")
    faulthandler.enable(file)
    logging.disable()
    warnings.simplefilter("ignore")
    return file


def _peak() -> int:
    """Bytes that this process has ever had; what getrusage says is also of its parent."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.partition("VmHWM:")[2].split()[0])


def execute(
    run: Run, inputs: Sequence[bytes], folder: Path, limits: tuple[float, int], timeout: float
) -> list[str]:
    """In the child: for each input nothing, what imgloc's own error says, or a traceback."""
    peak, (seconds, memory) = _peak(), limits
    faulthandler.dump_traceback_later(0.9 * timeout, file=_stack_file(folder))
    said = []
    for data in inputs:
        begin = time.process_time()
        try:
            run(data, folder)
            said.append("")
        except imgloc.ImglocError as error:
            said.append(f"{_REFUSED}{error}")
        except BaseException:
            said.append(traceback.format_exc(limit=-30))
        # A reader may take for damage that there is no more memory, having taken all.
        if _peak() - peak > memory:
            said[-1] = f"{_GREEDY} {(_peak() - peak) // MIB} MiB; {said[-1]}"
        peak = _peak()
        if (took := time.process_time() - begin) > seconds:
            said[-1] = f"{_SLOW} {took:.1f} s of the processor; {said[-1]}"
    faulthandler.cancel_dump_traceback_later()
    return said


class Child:
    """A process that executes inputs of a target, and is replaced when it has died."""

    def __init__(self, target: Target, folder: Path, seconds: float, memory: int) -> None:
        self._run, self._folder, self._limits = target.run, folder, (seconds, memory)
        self._supervisor, self._warm = Supervisor(None, 2 * memory), False
        self.samples = target.make(folder)
        self.close = self._supervisor.close

    def run(self, inputs: Sequence[bytes], patience: float = 1.0) -> list[Outcome]:
        """Execute some inputs."""
        if not self._warm:
            self._warm = True
            self._send(self.samples[:1], _PATIENCE)
        try:
            said = self._send(inputs, patience * self._limits[0])
            if any(text.startswith(_GREEDY) or "MemoryError" in text for text in said):
                self._supervisor.stop()  # its peak is that for ever, and it may hold what it took
                self._warm = False
                if len(inputs) > 1:
                    return [self.run([data])[0] for data in inputs]
            return [_outcome(text) for text in said]
        except (CrashError, OverdueError) as error:
            self._warm, late = False, isinstance(error, OverdueError)
            if len(inputs) > 1:  # one of them
                return [self.run([data])[0] for data in inputs]
            if late and patience == 1:  # the machine may be busy: the processor's time decides
                return self.run(inputs, _BUSY)
            stack = (self._folder / _STACK).read_text(errors="replace")
            threads = stack.split("hread 0x")  # the last that was at work, which is not the newest
            stack = next((one for one in reversed(threads) if " in execute" in one), stack)
            file, _, function = [*_places(stack), ("?", "", "?")][0]
            what = "overdue" if late else f"dead ({error})"
            return [Outcome(f"{what}: {file} in {function}", f"{error}\n{stack}")]

    def _send(self, inputs: Sequence[bytes], timeout: float) -> list[str]:
        self._supervisor.timeout = timeout
        run = self._supervisor.run
        return run(execute, self._run, inputs, self._folder, self._limits, timeout)


def _outcome(said: str) -> Outcome:
    if not said or said.startswith(_REFUSED):
        return Outcome("", said)
    file, line, function = [("?", "?", "?"), *_places(said)][-1]
    what = said.split(":")[0] if said.startswith((_GREEDY, _SLOW)) else _last_line(said)
    return Outcome(f"{what}: {file}:{line} in {function}", said)


def _last_line(said: str) -> str:
    return said.rstrip().rpartition("\n")[2].split(":")[0]


def _places(text: str) -> list[tuple[str, str, str]]:
    """File, line and function of each frame of imgloc."""
    home = str(Path(imgloc.__file__).parent)
    found: list[tuple[str, str, str]] = _FRAME.findall(text)
    return [(file[len(home) + 1 :], *rest) for file, *rest in found if file.startswith(home)]  # type: ignore[misc]


def shorter(child: Child, data: bytes, place: str) -> bytes:
    """An input of the same finding without halves, quarters ... that do not matter."""
    end, size = time.monotonic() + _SHORTER, len(data) // 2
    while size:
        at = 0
        while at < len(data) and time.monotonic() < end:
            less = data[:at] + data[at + size :]
            if child.run([less])[0].place == place:
                data = less
            else:
                at += size
        size //= 2
    return data


def fuzz(
    target: Target, out: Path, *, seed: int = 0, runs: int | None = None,
    seconds: float | None = None, limit: float = SECONDS, memory: int = MEMORY,
) -> Count:  # fmt: skip
    """Execute `runs` inputs, or for some `seconds`; findings are files in `out`.

    An input may take `limit` seconds of the processor and `memory` bytes. The seed, the target's
    name and their number decide the inputs. The first ones are the samples, which must be accepted.
    """
    count, begin, digest = Count(target.name), time.monotonic(), hashlib.blake2b(digest_size=6)
    found = set[str]()
    with TemporaryDirectory(prefix="imgloc-fuzz-") as folder:
        child = Child(target, Path(folder), limit, memory)
        samples = child.samples
        while (runs is None or count.executions < runs) and (
            seconds is None or time.monotonic() - begin < seconds
        ):
            first = count.executions
            last = first + _AT_ONCE if runs is None else min(runs, first + _AT_ONCE)
            inputs = [
                samples[k] if k < len(samples)
                else mutate(random.Random(f"{seed} {target.name} {k}"), samples)  # noqa: S311
                for k in range(first, last)
            ]  # fmt: skip
            for k, (data, done) in enumerate(zip(inputs, child.run(inputs), strict=True), first):
                digest.update(data)
                count.accepted += done == Outcome("")
                place = done.place or (f"sample {k}" if k < len(samples) and done.text else "")
                if place and place not in found:
                    found.add(place)
                    data = shorter(child, data, place) if done.place else data
                    which = hashlib.blake2b(place.encode(), digest_size=4).hexdigest()
                    file = out / f"{target.name}-{which}.input"
                    out.mkdir(parents=True, exist_ok=True)
                    file.write_bytes(data)
                    text = f"{place}\n\n{done.text}"
                    file.with_suffix(".txt").write_text(text, errors="replace")
            count.executions = last
        child.close()
    count.findings, count.inputs = len(found), digest.hexdigest()
    count.seconds = time.monotonic() - begin
    return count
