"""What clients have sent and will ask about again: at most so many, the one not used longest goes.

>>> held = Held(2)
>>> [held.put(name, name.upper()) for name in ("a", "b")], held.get("a"), held.put("c", "C")
([(), ()], 'A', ('b',))
"""

import threading
from collections import OrderedDict
from typing import Generic, TypeVar

from imgloc.live.problems import Refused

T = TypeVar("T")


class Held(Generic[T]):
    """Things by name, `most` at a time, of `weight` together; all methods are safe in threads."""

    def __init__(self, most: int, weight: int | None = None) -> None:
        self._most, self._weight = most, weight
        self._things: OrderedDict[str, tuple[T, int]] = OrderedDict()
        self._lock = threading.Lock()

    def put(self, name: str, thing: T, weight: int = 0) -> tuple[str, ...]:
        """Hold a thing; return the names of those that had to go."""
        gone: list[str] = []
        with self._lock:
            self._things.pop(name, None)
            self._things[name] = thing, weight
            while len(self._things) > 1 and (len(self._things) > self._most or self._heavy()):
                gone.append(self._things.popitem(last=False)[0])
        return tuple(gone)

    def _heavy(self) -> bool:
        together = sum(weight for _, weight in self._things.values())
        return self._weight is not None and together > self._weight

    def get(self, name: str, what: str = "upload") -> T:
        """The thing of that name; it is refused if there is none, or none any more."""
        with self._lock:
            if name not in self._things:
                hint = "it was never sent, or had to make room; send it again"
                raise Refused("not-found", f"no {what} {name[:100]!r}: {hint}")
            self._things.move_to_end(name)
            return self._things[name][0]

    def drop(self, name: str, what: str = "upload") -> None:
        """Forget the thing of that name."""
        self.get(name, what)
        with self._lock:
            self._things.pop(name, None)

    def __contains__(self, name: str) -> bool:
        return name in self._things
