"""The real service as a process of its own, on a port of this machine that is free."""

import contextlib
import os
import select
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from command import command


@dataclass
class Served:
    """A service that has printed its address."""

    address: str
    process: "subprocess.Popen[str]"

    @property
    def port(self) -> int:
        return int(self.address.rpartition(":")[2])

    @property
    def track(self) -> str:
        return f"ws://127.0.0.1:{self.port}/v1/track"

    def metrics(self) -> str:
        return httpx.get(f"{self.address}/metrics", timeout=60).text

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        """End it by a signal; its exit code, and what it has said."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            _, err = self.process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        return self.process.returncode, err


def memory(one: Served, key: str = "VmRSS") -> float:
    """MiB that a service holds."""
    status = Path(f"/proc/{one.process.pid}/status")
    if not status.exists():
        pytest.skip("needs Linux: a process that knows its memory")
    return next(int(s.split()[1]) for s in status.read_text().splitlines() if key in s) / 1024


def waits(there: Callable[[], object]) -> None:
    """Wait until something is there, for a minute at most."""
    until = time.monotonic() + 60
    while not there():
        assert time.monotonic() < until
        time.sleep(0.02)


@contextlib.contextmanager
def served(*words: object, cwd: Path | None = None, **environment: str) -> Iterator[Served]:
    """Run `imgloc serve`, or another command that prints an address."""
    first = () if words and words[0] == "open" else ("serve", "--port", 0)
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        command([*first, *words]), stdout=pipe, stderr=pipe, text=True, cwd=cwd,
        env={**os.environ, **environment},
    )  # fmt: skip
    line = process.stdout.readline() if select.select([process.stdout], [], [], 60)[0] else ""
    if not line.startswith("http"):
        process.kill()
        raise AssertionError(f"no address: {line!r}, {process.communicate()}")
    one = Served(line.strip(), process)
    try:
        yield one
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
