"""What answers keep in memory from one question to the next."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

PRESSES = 200
"""Presses of which something is kept: twice what one server has."""


class Kept(Generic[K, V]):
    """Values by key, each worked out once; where there are more than `most`, those asked for longest ago go."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._values: OrderedDict[K, V] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: K, work_out: Callable[[], V]) -> V:
        """Return a value; others wait while it is worked out."""
        return self.renew(key, lambda known: work_out() if known is None else known)

    def renew(self, key: K, work_out: Callable[[V | None], V]) -> V:
        """Return what is made of the value before, None where there is none."""
        with self._lock:
            value = work_out(self._values.get(key))
            self._keep(key, value)
            return value

    def get_all(self, keys: Iterable[K], work_out: Callable[[list[K]], dict[K, V]]) -> dict[K, V]:
        """Return the values there are; those that lack are worked out together, outside the lock."""
        with self._lock:
            known = {key: self._values[key] for key in keys if key in self._values}
        fresh = work_out([key for key in keys if key not in known])
        with self._lock:
            for key, value in (known | fresh).items():
                self._keep(key, value)
        return known | fresh

    def _keep(self, key: K, value: V) -> None:
        self._values[key] = value
        self._values.move_to_end(key)
        while len(self._values) > self.most:
            self._values.popitem(last=False)
