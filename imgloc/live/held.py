"""Things that clients have sent and will ask about again: at most so many.

Each has an id that nobody can guess, so that it belongs to the client that sent it. Of the client
that has sent most, what was not used for longest makes room.

>>> held = Held(2)
>>> ids = [held.put(text)[0] for text in "ab"]
>>> held.get(ids[0]), held.put("c")[1] == (ids[1],)
('a', True)
"""

import math
import secrets
from collections import Counter, OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

from imgloc.live.problems import Refused

T = TypeVar("T")
ID_BYTES = 16  #: of an id


class Held(Generic[T]):
    """A cache by id, bounded by count and weight; all methods are safe in threads.

    What is `used` is not dropped; else what was not asked for longest is.
    """

    def __init__(
        self, most: int, weight: float = math.inf, what: str = "upload",
        used: Callable[[str], object] = lambda _: False,
    ) -> None:  # fmt: skip
        self._most, self._weight, self._what, self._used = most, weight, what, used
        self._things: OrderedDict[str, tuple[T, int, str]] = OrderedDict()
        self._lock = Lock()

    def put(self, thing: T, weight: int = 0, client: str = "") -> tuple[str, tuple[str, ...]]:
        """Hold a thing; return its id, and those that had to go. Refused if none of these may."""
        with self._lock:
            left = OrderedDict(self._things)
            while left and (
                len(left) >= self._most
                or weight + sum(held[1] for held in left.values()) > self._weight
            ):
                idle = {id_: held[2] for id_, held in left.items() if not self._used(id_)}
                if not idle:
                    raise Refused("busy", f"each {self._what} that is held is in use", retry=5)
                counts = Counter([*(held[2] for held in left.values()), client])
                del left[max(idle, key=lambda id_: counts[idle[id_]])]
            gone = tuple(self._things.keys() - left.keys())
            self._things, id_ = left, secrets.token_hex(ID_BYTES)
            self._things[id_] = thing, weight, client
        return id_, gone

    def get(self, id_: str, *, drop: bool = False) -> T:
        """The thing of that id, which is forgotten on demand; refused if there is none any more."""
        with self._lock:
            if id_ not in self._things:
                hint = "it was never sent, or had to make room; send it again"
                raise Refused("not-found", f"no {self._what} {id_[:100]!r}: {hint}")
            self._things.move_to_end(id_)
            return (self._things.pop(id_) if drop else self._things[id_])[0]

    def __contains__(self, id_: str) -> bool:
        return id_ in self._things

    def __len__(self) -> int:
        return len(self._things)
