"""Errors that nobody foresaw, raised at a chosen call in a chosen thread."""

import inspect
import threading
import time
from collections import defaultdict

ONCE = {"__init__", "start", "close", "join", "main", "record", "expect", "later_key", "stop", "retire"}
"""Called when a process begins or ends, not while it works."""


class Injected(Exception):
    """What nobody foresaw."""


def name_of(call):
    """Return the name of the kind of error that one call in one thread raises, its own."""
    return f"Injected_{abs(hash(call))}"


class Injector:
    """Wraps every function of some modules; raises once where and in which thread it is told to."""

    def __init__(self, monkeypatch, modules):
        self.seen = defaultdict(set)
        self.armed, self.raised, self.lock = set(), None, threading.Lock()
        for module in modules:
            for owner in (module, *(c for _, c in inspect.getmembers(module, inspect.isclass))):
                if owner is module or owner.__module__ == module.__name__:
                    for name, value in list(vars(owner).items()):
                        own = inspect.isfunction(value) and value.__module__ == module.__name__
                        if own and name not in ONCE and not inspect.isgeneratorfunction(value):
                            label = f"{module.__name__}.{value.__qualname__}"
                            monkeypatch.setattr(owner, name, self.wrapped(label, value))

    def wrapped(self, label, function):
        def wrapper(*words, **options):
            thread = threading.current_thread().name.split()[0]
            self.seen[thread].add(label)
            with self.lock:
                mine = (thread, label) in self.armed
                if mine:
                    self.armed, self.raised = set(), (thread, label)
            if mine:
                raise type(name_of((thread, label)), (Injected,), {})(label)
            return function(*words, **options)

        return wrapper

    def first_called(self, calls, longest_s):
        """Raise at whichever of the calls comes first; return it, None if none came in time."""
        with self.lock:
            self.armed, self.raised = set(calls), None
        deadline = time.monotonic() + longest_s
        while not self.raised and time.monotonic() < deadline:
            time.sleep(0.005)
        with self.lock:
            self.armed = set()
        return self.raised
