"""A guardian beside every process of pytest: when that ends, in whatever way, what its tests started ends too.

``guard()`` starts it and marks the environment, which every program inherits that a test starts, in whatever
session or under whatever parent it ends up. Children that are only forked bear no mark: they tell their number.
The guardian waits for the end of a pipe, which even SIGKILL brings about. Linux only: it reads /proc.
"""

import contextlib
import os
import secrets
import signal
import subprocess
import sys
from pathlib import Path

MARK = "KERNTEMP_GUARDED_BY"


def guard() -> None:
    """Guard this process from now on."""
    if not Path("/proc/self/environ").exists():
        return
    mark = f"{MARK}_{secrets.token_hex(8)}"
    reading, writing = os.pipe()
    environment = {name: value for name, value in os.environ.items() if not name.startswith(MARK)}
    subprocess.Popen(
        [sys.executable, "-S", "-E", __file__, mark],
        stdin=reading,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # the terminal's Ctrl-C is not meant for it
        env=environment,
    ).returncode = 0  # nobody waits for it: it goes last
    os.close(reading)
    os.environ[mark] = "1"  # its own name, so that a test of tests bears those of both

    def tell() -> None:
        nonlocal writing
        if writing >= 0:  # a child of a child has none
            os.write(writing, f"{os.getpid()} {_begun(os.getpid())}\n".encode())
            os.close(writing)  # or the pipe would not end with pytest
            writing = -1

    os.register_at_fork(after_in_child=tell)


def _begun(number: int) -> str:
    """Return when a process began, which no later one of its number shares; empty where there is none."""
    try:
        return Path(f"/proc/{number}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[19]
    except OSError:
        return ""


def _alive(mark: str, begun_at: dict[int, str]) -> list[int]:
    """Return the processes that bear a mark, and of those told the ones that are still the same."""
    found = [number for number, begun in begun_at.items() if _begun(number) == begun]
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if f"{mark}=".encode() in (place / "environ").read_bytes():
                found.append(int(place.name))
    return [number for number in found if not _zombie(number)]


def _zombie(number: int) -> bool:
    try:
        return Path(f"/proc/{number}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def main() -> None:
    """Wait for the end of pytest, then end what is left, until a look round finds nothing."""
    for ending in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, signal.SIG_IGN)
    begun_at = {int(line.split()[0]): line.split()[1] for line in sys.stdin}
    while left := _alive(sys.argv[1], begun_at):
        for number in left:
            with contextlib.suppress(OSError):
                os.kill(number, signal.SIGKILL)


if __name__ == "__main__":
    main()
