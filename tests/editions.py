"""Two editions of every campaign: CI runs the small one, ``python -m tests.campaigns`` the whole one."""

import os
from typing import TypeVar

T = TypeVar("T")
WHOLE = "KERNTEMP_CAMPAIGN"


def edition(small: T, whole: T) -> T:
    """Return what this run of the tests is to take: the whole where KERNTEMP_CAMPAIGN says so."""
    return whole if os.environ.get(WHOLE) == "whole" else small
