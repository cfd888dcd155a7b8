"""Processes that may die: a pool in which a worker that is killed, or hangs, costs its task alone.

Executors of the standard library lose everything that waits when one worker is killed, and one
that shares a queue can be killed while it holds the queue's lock. Here each worker is a program of
its own, with pipes that nobody else holds, and a thread that looks after it. It needs neither a
fork nor an importable main module, and it may run within a worker of a cluster.

Pebble's pool (5.2, spawned) ends what hangs and survives what dies, but its workers outlive a
program that is killed, it fails where the main module is not guarded, and a daemon, as Dask's
workers are, may not start it. Groups of tasks, a limit of memory and a worker's last words would
still be written here: it would replace about a third of this file, and break three tests.

>>> with Supervised(1) as pool:
...     pool.submit(divmod, 17, 5).result()
(3, 2)
"""

import contextlib
import importlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
_START = (
    "import pickle, sys; sys.path[:], *about = pickle.load(sys.stdin.buffer); "
    "from imgloc.runs.workers import serve; serve(*about)"
)
# There are as many workers as processors.
_ONE_THREAD = dict.fromkeys(
    ("OPENCV_FOR_THREADS_NUM", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1"
)
_IDLE = 600.0  # seconds without a task after which a worker goes: a cluster keeps them
LOST = "the cluster is lost; what is done is kept, `resume=True` goes on"
"""What is said when workers elsewhere do not answer any more: it is no answer of an item."""
_TOLD = 400  # characters of what a worker that died has said last


class CrashError(Exception):
    """The worker of a task has ended in the middle of it."""

    def __init__(self, code: int | None, last_words: str = "") -> None:
        super().__init__(code, last_words)
        self.code = code  #: exit code; None if it is not known
        self.last_words = last_words  #: what it wrote to standard error

    @property
    def signal(self) -> int | None:
        """Number of the signal that ended it, if one did."""
        return -self.code if self.code is not None and self.code < 0 else None

    def __str__(self) -> str:
        if self.signal is None:
            return f"the worker ended with the exit code {self.code}" if self.code else "it is lost"
        try:
            name = signal.Signals(self.signal).name
        except ValueError:
            name = f"signal {self.signal}"
        return f"the worker was ended by {name}"


class OverdueError(Exception):
    """A task took longer than it may; its worker was ended."""

    def __init__(self, seconds: float) -> None:
        super().__init__(seconds)
        self.seconds = seconds

    def __str__(self) -> str:
        return f"took more than {self.seconds:g} s"


class Supervisor:
    """One worker: a process that is started when it is needed, and again when it has died.

    A task may take `timeout` seconds, and a worker `memory_limit` bytes beside what it has with the
    module of its first task (where the system can limit that); None is without a limit.
    """

    def __init__(self, timeout: float | None = None, memory_limit: int | None = None) -> None:
        self.timeout, self.memory_limit = timeout, memory_limit
        self._process: subprocess.Popen[bytes] | None = None
        self._late = self._over = False
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  (lives as long as this)

    def run(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a function there; what it raises is raised here, or CrashError, or OverdueError."""
        task = pickle.dumps((function, args, kwargs))
        if self._process is None or self._process.poll() is not None:
            self.start(getattr(function, "__module__", __name__))
        process, self._late = self._process, False
        assert process is not None
        assert process.stdin is not None
        assert process.stdout is not None
        watch = threading.Timer(self.timeout or 0.0, self._too_late)
        watch.daemon = True
        if self.timeout is not None:
            watch.start()
        try:
            process.stdin.write(task)
            process.stdin.flush()
            done, value = pickle.load(process.stdout)  # noqa: S301  (of our own process)
        except (EOFError, OSError, ValueError, pickle.UnpicklingError):
            code = self.stop()
            if self._late:
                raise OverdueError(self.timeout or 0.0) from None
            raise CrashError(code, self._last_words()) from None
        finally:
            watch.cancel()
        if not done:
            raise value
        result: T = value
        return result

    def stop(self) -> int | None:
        """End the process, whatever it does; return its exit code."""
        process, self._process = self._process, None
        if process is None:
            return None
        for pipe in (process.stdin, process.stdout):  # without them it ends by itself
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()
        try:
            return process.wait(1.0)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait()

    def close(self) -> None:
        """End the process for good."""
        self.stop()
        self._said.close()

    def kill(self, *, for_good: bool = False) -> None:
        """End the process from another thread than that which runs tasks."""
        self._over |= for_good
        process = self._process
        if process is not None:
            with contextlib.suppress(OSError):
                process.kill()

    def _too_late(self) -> None:
        self._late = True
        self.kill()

    def start(self, module: str) -> None:
        """Start the process, and have it import a module; CrashError if it ends."""
        self.stop()
        self._said.seek(0)
        self._said.truncate()
        self._process = subprocess.Popen(  # noqa: S603  (our own interpreter)
            [sys.executable, "-c", _START],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env=os.environ | _ONE_THREAD,
        )
        if self._over:  # said while it started
            self.kill()
        try:
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            pickle.dump((sys.path, module, self.memory_limit), self._process.stdin)
            self._process.stdin.flush()
            pickle.load(self._process.stdout)  # noqa: S301  (it is ready: its time begins)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise CrashError(self.stop(), self._last_words()) from None

    def _last_words(self) -> str:
        self._said.seek(0)
        text = self._said.read().decode("utf-8", "backslashreplace")
        return " ".join(text.split())[-_TOLD:]


class Supervised(Executor):
    """A pool of such workers.

    A task whose worker dies raises :class:`CrashError`, one that takes too long
    :class:`OverdueError`; no other task notices. A worker takes tasks with the `group` (an
    attribute of their first argument) that it had before, or one that no other worker has, as long
    as there are any. There are no more workers than tasks; but the first one starts at once, if the
    `module` of its tasks is known.
    """

    def __init__(
        self, workers: int, *, timeout: float | None = None, memory_limit: int | None = None,
        module: str | None = None,
    ) -> None:  # fmt: skip
        self._tasks: deque[tuple[Future[Any], Callable[..., Any], Any, Any]] = deque()
        self._more = threading.Condition()
        self._closed, self._module = False, module
        self._groups: dict[int, object] = {}
        self._workers, self._limits = max(1, workers), (timeout, memory_limit)
        self._open = 0  # tasks that are not done
        self._supervisors: list[Supervisor] = []
        self._threads: list[threading.Thread] = []
        if module is not None:
            self._hire()

    def _hire(self) -> None:
        """Add a worker."""
        supervisor = Supervisor(*self._limits)
        arguments = len(self._threads), supervisor
        thread = threading.Thread(target=self._look_after, args=arguments, daemon=True)
        self._supervisors.append(supervisor)
        self._threads.append(thread)
        thread.start()

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        """Have a worker call a function, which it can import, with arguments that are pickled."""
        future: Future[T] = Future()
        with self._more:
            if self._closed:
                raise RuntimeError("the pool is closed")
            self._tasks.append((future, fn, args, kwargs))
            self._open += 1
            if len(self._threads) < min(self._workers, self._open):
                self._hire()
            self._more.notify()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more tasks; with `cancel_futures` end those that run, too."""
        with self._more:
            self._closed = True
            if cancel_futures:
                for future, *_ in self._tasks:
                    future.cancel()
                self._tasks.clear()
                for supervisor in self._supervisors:
                    supervisor.kill(for_good=True)
            self._more.notify_all()
        if wait:
            for thread in self._threads:
                thread.join()

    def _next(self, worker: int) -> tuple[Future[Any], Callable[..., Any], Any, Any] | None:
        """The task for a worker; None when there will be no more."""
        with self._more:
            while not self._tasks:
                if self._closed:
                    return None
                self._groups.pop(worker, None)
                self._more.wait()
            groups = [getattr(args[0], "group", None) if args else None for _, _, args, _ in
                      self._tasks]  # fmt: skip
            mine = self._groups.get(worker)
            others = {group for k, group in self._groups.items() if k != worker}
            free = (k for k, group in enumerate(groups) if group not in others)
            at = groups.index(mine) if mine in groups else next(free, 0)
            self._groups[worker] = groups[at]
            task = self._tasks[at]
            del self._tasks[at]
            return task

    def _look_after(self, worker: int, supervisor: Supervisor) -> None:
        if worker == 0 and self._module is not None:
            with contextlib.suppress(CrashError, OSError):  # the first task will say
                supervisor.start(self._module)
        while (task := self._next(worker)) is not None:
            future, function, args, kwargs = task
            if not future.set_running_or_notify_cancel():
                continue
            tell: Callable[[Any], None] = future.set_result
            try:
                value = supervisor.run(function, *args, **kwargs)
            except BaseException as error:
                tell, value = future.set_exception, error
            with self._more:
                self._open -= 1
            tell(value)
        supervisor.close()


def serve(module: str, memory_limit: int | None) -> None:
    """Be the process of a :class:`Supervisor`: call what comes in, send back what comes out.

    What is called is of this module; importing it is neither of the first task's time nor memory.
    """
    source, sink = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what a library prints is no result
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interrupt means
    tasks: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def receive() -> None:
        with contextlib.suppress(Exception):
            while True:
                tasks.put(pickle.load(source))  # noqa: S301  (of our own parent)
        os._exit(1)  # it has gone, be it killed

    threading.Thread(target=receive, daemon=True).start()
    with contextlib.suppress(Exception):  # the task will say
        importlib.import_module(module)
    limit_memory(memory_limit)
    answer = pickle.dumps("ready")
    while True:
        sink.write(answer)
        sink.flush()
        try:
            function, args, kwargs = tasks.get(timeout=_IDLE)
        except queue.Empty:
            os._exit(0)
        try:
            answer = pickle.dumps((True, function(*args, **kwargs)))
        except Exception as error:
            answer = _packed(error)


def _packed(error: Exception) -> bytes:
    """An exception as an answer, be it one that cannot be pickled."""
    with contextlib.suppress(Exception):
        data = pickle.dumps((False, error))
        pickle.loads(data)  # noqa: S301
        return data
    return pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}")))


def limit_memory(more: int | None) -> None:
    """Let this process take so many bytes more than it has; then there is a MemoryError."""
    if more is None:
        return
    with contextlib.suppress(ImportError, OSError, ValueError, IndexError):
        import resource

        with open("/proc/self/statm") as file:  # noqa: PTH123
            held = int(file.read().split()[5]) * resource.getpagesize()
        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (held + more, most))


_HERE = threading.local()


def call_in_child(
    timeout: float | None, memory_limit: int | None, function: Callable[..., T], /, *args: Any
) -> T:
    """Call a function in a worker that belongs to this thread: what a cluster is given."""
    supervisor: Supervisor | None = getattr(_HERE, "supervisor", None)
    if supervisor is None:
        supervisor = _HERE.supervisor = Supervisor()
    if supervisor.memory_limit != memory_limit:
        supervisor.stop()
    supervisor.timeout, supervisor.memory_limit = timeout, memory_limit
    return supervisor.run(function, *args)
