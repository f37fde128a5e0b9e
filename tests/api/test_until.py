"""`--until`: a run ends at a moment, at a temperature or at an event, each run at its own if asked."""

import numpy as np
import pytest

from api.commands.until import shortened
from daq.given import DoubtWarning
from daq.press.press_file import parse_press
from daq.records import InputError, Run
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from softsensor.face.ends import End

PRESS = parse_press(press_toml())
TIMES = np.arange(0.0, 50.0, 0.5)


def _run(name="r", rise=1.0):
    columns = {"bottom_1": 20.0 + rise * TIMES, "bottom_2": np.full(len(TIMES), np.nan), "top_1": 400.0 - TIMES}
    return Run(name, {}, TIMES, columns, texts={"quality": ("",) * len(TIMES)})


def test_run_ends_with_the_row_of_a_moment():
    (cut,) = shortened([_run()], PRESS, ["12.5"])
    assert cut.time_s[-1] == 12.5
    assert {len(v) for v in (*cut.columns.values(), *cut.texts.values())} == {26}


def test_run_ends_before_the_first_row_that_is_as_hot():
    (cut,) = shortened([_run()], PRESS, ["bottom_*=30"])
    assert cut.columns["bottom_1"][-1] == 29.5
    with pytest.warns(DoubtWarning, match="^--until bottom_1=900 does not come in a, b: nothing is left out"):
        assert len(shortened([_run("a"), _run("b")], PRESS, ["bottom_1=900"])[0].time_s) == len(TIMES)


def test_run_ends_at_an_event_of_the_press():
    run, truth = make_campaign(1, 1, plan=Plan(rate_hz=2.0, closed_column=True))[0]
    (cut,) = shortened([run], PRESS, ["opened"])
    assert cut.time_s[-1] == pytest.approx(truth.moments.opened_s, abs=0.6)
    with pytest.warns(DoubtWarning, match="removed does not come"):
        assert len(shortened([run], PRESS, ["removed"])[0].time_s) == len(run.time_s)


def test_what_is_said_of_one_run_goes_before_what_is_said_of_all_and_the_first_end_counts():
    runs = [_run("a"), _run("b", rise=4.0), _run("c")]
    a, b, c = shortened(runs, PRESS, ["20", "bottom_1=60", "c:30"])
    assert (a.time_s[-1], b.time_s[-1], c.time_s[-1]) == (20.0, 9.5, 30.0)


@pytest.mark.parametrize(
    ("until", "message"),
    [
        ("-50", r"--until -50 leaves 0 of 100 rows"),
        ("lunch", r"--until lunch: give seconds \(900\)"),
        ("=30", "--until =30: give seconds"),
        ("nan", "--until nan: give seconds"),
        ("x_1=30", "--until names column 'x_1'; the run has bottom_1"),
        ("z:30", "--until z:30: no run 'z' is given; runs are r"),
        ("bottom_1=10", "leaves 0 of 100 rows"),
    ],
)
def test_end_that_cannot_be_read_or_leaves_nothing_is_refused(until, message):
    with pytest.raises(InputError, match=message):
        shortened([_run()], PRESS, [until])


def test_name_of_a_run_may_hold_colons():
    assert End.of("2026-03-04T10:00:closed") == End("2026-03-04T10:00:closed", "2026-03-04T10:00", event="closed")
