"""A batch on a Dask cluster: the same function, called elsewhere (needs ``imgloc[cluster]``).

On each thread of the cluster's workers an item runs in a process of its own, see
:mod:`imgloc.runs.workers`: what kills or hangs it is told, as on one machine, and kills no worker.
"""

import contextlib
import logging
import socket
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from typing import Any, NamedTuple

from imgloc.__about__ import __version__
from imgloc.errors import ConfigError, OutputError
from imgloc.features.budget import default_budget
from imgloc.runs.workers import LOST, call_in_child

LOCAL = "local"
_TALKERS = ("distributed.client", "tornado.application")  # of a lost cluster, in many lines
_WAIT = 30.0  # seconds for the scheduler, and for its first worker


class ClusterExecutor(Executor):
    """A client's executor, whose tasks have limits; see :class:`imgloc.runs.workers.Supervised`."""

    def __init__(
        self, client: Any, timeout: float | None, memory_limit: int | None, share: int | None = None
    ) -> None:
        self._inner = client.get_executor(pure=False)
        self._limits = timeout, memory_limit
        self.memory_share = share  #: bytes that an item may take if a job does not say

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have a worker of the cluster call a function, which it can import.

        OutputError if the cluster is gone.
        """
        from distributed.client import ClosedClientError

        try:
            future: Future[Any] = self._inner.submit(
                call_in_child, *self._limits, fn, *args, **kwargs
            )
        except (ClosedClientError, OSError):
            raise OutputError(LOST) from None
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more tasks; with `cancel_futures` drop those that have not begun."""
        self._inner.shutdown(wait=wait and not cancel_futures)


@contextlib.contextmanager
def cluster(
    address: str, *, workers: int | None = None, timeout: float | None = None,
    memory_limit: int | None = None,
) -> Iterator[Executor]:  # fmt: skip
    """Give an executor on a cluster that runs, or on one of this machine for as long as it is used.

    Parameters
    ----------
    address : str
        Of the scheduler, as ``tcp://host:8786``, or ``local``.
    workers : int, optional
        Of a local one; by default as many as there are processors.
    timeout, memory_limit : float and int, optional
        Of each task, see :class:`imgloc.runs.workers.Supervisor`.

    Raises
    ------
    ConfigError
        If Dask is not installed, the cluster does not answer, or its workers have another version.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise ConfigError("`dask`: needs Dask; install it with: pip install 'imgloc[cluster]'") \
            from None  # fmt: skip
    with contextlib.ExitStack() as stack:
        for name in _TALKERS:
            logger = logging.getLogger(name)
            stack.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)
        try:
            if address == LOCAL:
                # Without an address its pages take a port of their own, and of all interfaces.
                here = LocalCluster(
                    n_workers=workers, threads_per_worker=1, memory_limit=0,
                    dashboard_address="127.0.0.1:0",
                )  # fmt: skip
                client = stack.enter_context(Client(stack.enter_context(here)))
            else:
                client = stack.enter_context(Client(address, timeout=_WAIT))
            client.wait_for_workers(1, timeout=_WAIT)
        except (OSError, ValueError, TimeoutError) as e:
            why = " ".join(str(e).split()) or type(e).__name__
            raise ConfigError(f"`dask`: no cluster with a worker at {address}: {why}") from None
        try:
            versions = set(client.run(version).values())
        except Exception as e:
            why = f"{type(e).__name__}: {e}"
            raise ConfigError(f"`dask`: imgloc does not run on the workers: {why}") from None
        if versions != {__version__}:
            found = ", ".join(sorted(versions))
            raise ConfigError(f"`dask`: the workers have imgloc {found}, expected {__version__}")
        share = memory_share(client.run(Machine.here).values())
        executor = ClusterExecutor(client, timeout, memory_limit, share)
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)


class Machine(NamedTuple):
    """The machine of a worker of the cluster."""

    host: str
    threads: int
    limit: int  #: bytes that the worker was given, 0 if it may take any
    budget: int  #: bytes that its machine has to give, for all its workers

    @classmethod
    def here(cls, dask_worker: Any) -> "Machine":
        """That of a worker; Dask passes the worker by this name."""
        limit = dask_worker.memory_manager.memory_limit or 0
        return cls(socket.gethostname(), dask_worker.state.nthreads, limit, default_budget())


def memory_share(workers: Iterable[Machine]) -> int:
    """Bytes for each thread of any worker: threads of one machine share what there is.

    Examples
    --------
    >>> memory_share([Machine("a", 2, 0, 800), Machine("a", 2, 0, 800), Machine("b", 1, 300, 900)])
    200
    """
    workers, threads = list(workers), Counter[str]()
    for worker in workers:
        threads[worker.host] += worker.threads
    shares = [worker.budget // threads[worker.host] for worker in workers]
    return min(shares + [worker.limit // worker.threads for worker in workers if worker.limit])


def version() -> str:
    """The version of imgloc where this is called."""
    return __version__
