"""What a service under load costs: memory, what is lost, and time over the call in Python.

    python -m tools.load                        # 10,000 requests by four clients
    python -m tools.load --requests 200         # a look
    python -m tools.load --crowd 600            # beside those who mean no good, for ten minutes

It runs `imgloc serve` as a process of its own. First one client asks, and each request is
followed by the same call in this process: the difference of the medians is what HTTP costs. Then
all clients ask at once. Exits with 1 if a request is lost, or the memory grows, after the first
500 requests, by more than --growth MiB. Linux alone tells the memory of a process.

With --crowd, four clients ask for some seconds alone, and then beside :mod:`tools.crowd`. It exits
with 1 if one of their requests is lost, or memory or open files exceed their bounds.
"""

import argparse
import http.client
import http.server
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import imgloc
from imgloc.errors import ConfigError
from imgloc.io.maps import bundled_maps
from imgloc.live.bounds import Bounds
from imgloc.output.rows import scan_row
from tools.crowd import be_there
from tools.script import at_least_one, ended, parser_of

_JSON = {"Content-Type": "application/json"}
_TRIES = 50  # of a request that is refused as busy
_ALONE = 20.0  # seconds
_FILES = 30  # open files besides the connections
_PART = 500  # requests after which memory is to stay, and is looked at again and again


class Ask(NamedTuple):
    """A request: where it goes, and its body."""

    path: str
    body: bytes


def asked(link: http.client.HTTPConnection, ask: Ask) -> int:
    """The status of one request, its answer read; 0 if there was none."""
    try:
        link.request("POST" if ask.body else "GET", ask.path, ask.body, _JSON)
        answer = link.getresponse()
        answer.read()
    except (OSError, http.client.HTTPException):
        link.close()
        return 0
    return answer.status


def resident(pid: int) -> float:
    """MiB of memory that a process holds."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        raise ConfigError("expected Linux, which tells the memory of a process") from None
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def percentiles(seconds: Sequence[float]) -> str:
    """The median and the 99th percentile, in words."""
    ranks = statistics.quantiles(seconds, n=100)
    return f"p50 {1e3 * ranks[49]:.1f} ms, p99 {1e3 * ranks[98]:.1f} ms"


def spent(pid: int) -> float:
    """Seconds of a processor that a process has taken, with all its threads."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def overhead(
    host: str, pid: int, asks: Sequence[Ask], map_path: Path, scans: imgloc.ScanSet, pairs: int
) -> None:
    """Say what a request takes more than the call in Python: by the clock, and of a processor."""
    features, options = imgloc.prepare(imgloc.load_map(map_path)), imgloc.Options()
    link, http_, call = http.client.HTTPConnection(host, timeout=120), list[float](), list[float]()
    imgloc.localize(features, scans[0], options)
    asked(link, asks[0])
    there, here = spent(pid), 0.0
    for k in range(pairs):
        begin = time.perf_counter()
        asked(link, asks[k % len(asks)])
        between, busy = time.perf_counter(), time.process_time()
        imgloc.localize(features, scans[k % len(scans)], options)
        here += time.process_time() - busy
        http_.append(between - begin)
        call.append(time.perf_counter() - between)
    link.close()
    more = 1e3 * (statistics.median(http_) - statistics.median(call))
    there, here = 1e3 * (spent(pid) - there) / pairs, 1e3 * here / pairs
    print(f"one client, {pairs} requests: {percentiles(http_)}; processor {there:.1f} ms each")
    print(f"the call in Python: {percentiles(call)}; processor {here:.1f} ms each")
    print(f"over the call: {more:+.1f} ms at p50, {there - here:+.1f} ms more of a processor")


def run(process: "subprocess.Popen[str]", args: argparse.Namespace) -> int:
    """Load a service that is being started; the exit code."""
    assert process.stdout is not None
    address = process.stdout.readline().strip()
    if not address.startswith("http://"):
        raise ConfigError("imgloc serve has not begun")
    host = address.removeprefix("http://")
    map_path = bundled_maps() / f"{args.map}.yaml"
    scans = imgloc.simulate(imgloc.load_map(map_path), 50, seed=1)
    rows = (json.dumps(scan_row(scans, k)) for k in range(len(scans)))
    asks = [Ask("/v1/localize", row.encode()) for row in rows]
    if args.crowd:
        code = beside_a_crowd(host, process.pid, asks, args)
        begin = time.monotonic()
        process.send_signal(signal.SIGTERM)
        ended_with = process.wait(60)
        print(f"exit code {ended_with} after {time.monotonic() - begin:.1f} s")
        return int(bool(code or ended_with))
    overhead(host, process.pid, asks, map_path, scans, args.pairs)
    if args.near:
        near = [",".join(map(str, pose.tolist())) for _, pose in scans.with_poses()]
        asks = [Ask(f"{a.path}?near={at}", a.body) for a, at in zip(asks, near, strict=True)]
    codes, held, begin = Counter[int](), list[float](), time.perf_counter()
    requests = args.requests
    for left in range(requests, 0, -_PART):
        part = Clients(host, asks, min(_PART, left))
        for thread in part.begin(args.clients):
            thread.join()
        codes += part.codes
        held.append(resident(process.pid))
        done = f"{requests - max(0, left - _PART)} requests"
        times = percentiles(part.seconds) if len(part.seconds) > 1 else ""
        print(f"{args.clients} clients, {done}: {times}; {held[-1]:.1f} MiB", flush=True)
    took, lost, grown = time.perf_counter() - begin, requests - codes[200], held[-1] - held[0]
    print(f"{requests / took:.1f} answers a second; status {dict(codes)}; {lost} without an answer")
    print(f"{grown:+.1f} MiB after the first {_PART} requests")
    process.send_signal(signal.SIGTERM)
    code = process.wait(60)
    print(f"exit code {code}")
    return int(bool(lost) or code != 0 or grown > args.growth)


def probe(host: str, seconds: float) -> tuple[list[float], int]:
    """Ask whether it runs, as an orchestrator does: seconds of each answer, and how many failed."""
    took, wrong, end = list[float](), 0, time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.1)
        begin = time.perf_counter()
        link = http.client.HTTPConnection(host, timeout=60)
        wrong += asked(link, Ask("/healthz", b"")) != 200
        link.close()
        took.append(time.perf_counter() - begin)
    return took, wrong


class Bare(http.server.BaseHTTPRequestHandler):
    """All that it does is to answer ``/healthz``."""

    def do_GET(self) -> None:
        """Answer."""
        self.send_response(200)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def beside_nothing(seconds: float) -> list[float]:
    """Seconds of each answer of a process that only answers :func:`probe`: the machine's own."""
    server = http.server.HTTPServer(("127.0.0.1", 0), Bare)
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        asked = pool.submit(probe, f"127.0.0.1:{server.server_port}", seconds)
        asked.add_done_callback(lambda _: server.shutdown())
        server.serve_forever(0.5)
        return asked.result()[0]


@dataclass
class Clients:
    """What clients see that mean no harm, and somebody who asks whether the service runs."""

    host: str
    asks: Sequence[Ask]
    left: float = float("inf")  #: requests
    seconds: list[float] = field(default_factory=list)
    probes: list[float] = field(default_factory=list)
    bare: list[float] = field(default_factory=list)  #: of a process that does nothing else
    codes: Counter[int] = field(default_factory=Counter)
    memory: float = 0.0
    files: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def take(self) -> int | None:
        """The number of the next request; None when there is none."""
        with self.lock:
            self.left -= 1
            return None if self.left < 0 else len(self.seconds)

    def ask(self) -> None:
        """Be one of the clients: what is busy, or has closed an idle connection, is asked again."""
        link = http.client.HTTPConnection(self.host, timeout=120)
        while (k := self.take()) is not None:
            begin, ask = time.perf_counter(), self.asks[k % len(self.asks)]
            for _ in range(_TRIES):
                self.codes[code := asked(link, ask)] += 1
                if code not in (0, 503):
                    break
                time.sleep(0.1 if code else 0.0)
            else:
                self.codes[-1] += 1
            self.seconds.append(time.perf_counter() - begin)
        link.close()

    def begin(self, clients: int) -> list[threading.Thread]:
        """Let some ask at once."""
        threads = [threading.Thread(target=self.ask) for _ in range(clients)]
        for thread in threads:
            thread.start()
        return threads

    def run(self, pid: int, seconds: float, clients: int) -> None:
        """Ask for some time."""
        # An orchestrator does not wait for the interpreter of these clients: a process of its own.
        with ProcessPoolExecutor(2, get_context("spawn")) as pool:
            list(pool.map(int, "12"))  # they have begun
            asked, end = pool.submit(probe, self.host, seconds), time.monotonic() + seconds
            bare = pool.submit(beside_nothing, seconds)
            threads = self.begin(clients)
            while time.monotonic() < end:
                self.memory = max(self.memory, resident(pid))
                self.files = max(self.files, len(list(Path(f"/proc/{pid}/fd").iterdir())))
                time.sleep(0.2)
            self.left = 0
            for thread in threads:
                thread.join()
            (self.probes, wrong), self.bare = asked.result(), bare.result()
        self.codes[-1] += wrong

    def say(self, what: str) -> None:
        """Print what was seen."""
        lost, again, closed = (self.codes[code] for code in (-1, 503, 0))
        print(f"{what}: {len(self.seconds)} requests, {percentiles(self.seconds)}; {lost} lost, ")
        print(f"  {again} times 503, {closed} times closed and asked again;")
        for name, took in ("healthz", self.probes), ("a process that does nothing else", self.bare):
            print(f"  {name}: {percentiles(took)}, longest {1e3 * max(took):.0f} ms;")
        print(f"  {self.memory:.0f} MiB, {self.files} open files", flush=True)


def beside_a_crowd(host: str, pid: int, asks: Sequence[Ask], args: argparse.Namespace) -> int:
    """Compare what clients see alone with what they see beside a crowd; the exit code."""
    alone, beside = Clients(host, asks), Clients(host, asks)
    alone.run(pid, min(_ALONE, args.crowd), args.clients)
    alone.say("alone")
    there = (host, args.crowd + 2)
    crowd = get_context("spawn").Process(target=be_there, args=there, daemon=True)
    crowd.start()
    time.sleep(2)
    beside.run(pid, args.crowd, args.clients)
    crowd.join(60)
    beside.say("beside a crowd")
    p99 = [statistics.quantiles(one.seconds, n=100)[98] for one in (alone, beside)]
    print(f"p99 beside / alone: {p99[1] / p99[0]:.1f}")
    most = Bounds().connections + _FILES
    return int(beside.codes[-1] > 0 or beside.files > most or beside.memory > args.most)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = parser_of("python -m tools.load", __doc__)
    parser.add_argument("--requests", type=int, default=10_000)
    parser.add_argument("--clients", type=int, default=4)
    parser.add_argument("--pairs", type=int, default=200, help="requests beside a call")
    parser.add_argument("--map", default="visibility", help="name of a bundled map")
    parser.add_argument("--growth", type=float, default=16.0, metavar="MIB")
    parser.add_argument("--crowd", type=float, default=0.0, metavar="SECONDS")
    parser.add_argument("--most", type=float, default=712.0, metavar="MIB", help="beside a crowd")
    near = "each request says where the scan is, within 2 m: a shorter search"
    parser.add_argument("--near", action="store_true", help=near)
    args = parser.parse_args(arguments)

    def work() -> int:
        at_least_one(requests=args.requests, clients=args.clients, pairs=args.pairs - 1)
        command = [sys.executable, "-m", "imgloc", "serve", args.map, "--port", "0"]
        with tempfile.TemporaryFile() as err:
            process = subprocess.Popen(  # noqa: S603 (this very program)
                [*command, "--waiting", "64", "--threads", "1", "--memory-budget", "512M"],
                stdout=subprocess.PIPE,
                stderr=err,
                text=True,
            )
            try:
                return run(process, args)
            finally:
                if process.poll() is None:
                    process.kill()
                process.communicate()

    return ended("load", work)


if __name__ == "__main__":
    sys.exit(main())
