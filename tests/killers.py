"""What the tests of batches have workers do: work, die, hang."""

import os
import signal
import time
from concurrent.futures import Executor, Future


def double(value):
    return 2 * value


def die(number):
    os.kill(os.getpid(), number)
    time.sleep(60)


def leave(code):
    os._exit(code)


def hang(seconds=600.0):
    time.sleep(seconds)


def fail(message):
    raise LookupError(message)


def swallow(megabytes):
    return len(b"x" * (megabytes << 20))


def stumble(data, folder):
    """Read what is not empty; else a defect of the kind that the folder's only file is named by."""
    if not data:
        kind = next(folder.glob("planted-*")).name.removeprefix("planted-")
        {
            "key": lambda: {}["gone"],
            "hang": hang,
            "die": lambda: die(signal.SIGSEGV),
            "swallow": lambda: swallow(150),
        }[kind]()


def process(_):
    return os.getpid()


def sabotaged(item, job, means):
    """The work of a batch, but for the scans that are called after what is to happen."""
    if "sigkill" in item.scans:
        die(signal.SIGKILL)
    if "sigsegv" in item.scans:
        die(signal.SIGSEGV)
    if "hang" in item.scans:
        hang()
    from imgloc.runs.batch import work

    return work(item, job, means)


class Saboteur(Executor):
    """Hands sabotaged work to one pool, and what hangs to another with little patience."""

    def __init__(self, pool, impatient):
        self.pool, self.impatient = pool, impatient

    def submit(self, fn, /, *args, **kwargs) -> Future:
        assert fn.__name__ == "work"
        pool = self.impatient if "hang" in args[0].scans else self.pool
        return pool.submit(sabotaged, *args, **kwargs)

    def shutdown(self, wait=True, *, cancel_futures=False):
        for pool in (self.pool, self.impatient):
            pool.shutdown(wait, cancel_futures=cancel_futures)


def complain(words, to=2):
    """Say something to standard error, or output, and end."""
    os.write(to, words.encode())
    os._exit(3)
