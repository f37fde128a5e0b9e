import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from api.answers.kept import Kept


def test_a_value_many_ask_for_at_once_is_worked_out_once():
    kept, calls, begin = Kept[str, int](4), [], threading.Barrier(8, timeout=20)

    def work_out() -> int:
        calls.append(threading.get_ident())
        return 7

    def ask(_: int) -> int:
        begin.wait()
        return kept.get("a", work_out)

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(ask, range(8))) == [7] * 8
    assert len(calls) == 1


def test_what_was_asked_for_longest_ago_goes_first():
    kept = Kept[str, int](2)
    for key in ("a", "b", "a", "c"):
        kept.get(key, lambda: 1)
    asked: list[str] = []
    kept.get_all(["a", "c"], lambda lacking: asked.extend(lacking) or {})
    kept.get_all(["b", "d"], lambda lacking: asked.extend(lacking) or {"b": 2})
    assert asked == ["b", "d"]
    assert kept.get_all(["b", "c", "a"], lambda lacking: {}) == {"b": 2, "c": 1}


def test_what_could_not_be_worked_out_is_asked_for_again_and_the_value_before_stays():
    kept = Kept[str, int](2)
    kept.get("a", lambda: 1)
    with pytest.raises(ZeroDivisionError):
        kept.renew("a", lambda known: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        kept.get("b", lambda: 1 // 0)
    assert kept.get("b", lambda: 5) == 5
    assert kept.renew("a", lambda known: (known or 0) + 1) == 2
