"""Loading what a long-running process is made of."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def loading() -> Iterator[None]:
    """Leave what is imported here out of the search for what has become unreachable, now and later.

    Modules stay: looking through those that are there again and again was an eighth of the processor time in which
    `serve` and `sense` are imported (0.94 and 0.99 s, 0.82 and 0.87 s without, 2026-11-30), and costs later too.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
