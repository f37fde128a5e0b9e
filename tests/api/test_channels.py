from datetime import UTC, datetime, timedelta

import pytest

from api.answers.channels import channels_now
from daq.records import Channel, Quality, Scan
from daq.store.store import open_store

START = datetime(2026, 3, 4, 7, tzinfo=UTC)


@pytest.fixture
def plant(tmp_path):
    """A store and a hand that writes scans of two channels; the second one breaks where it is told to."""
    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        key = store.register_press("lab", (Channel("top_1"), Channel("top_2")))

        def write(numbers: range, broken: range) -> None:
            scans = [
                Scan(
                    n,
                    START + timedelta(seconds=n),
                    float(n),
                    (20.0, float("nan") if n in broken else 21.0),
                    (Quality.GOOD, Quality.OPEN if n in broken else Quality.GOOD),
                )
                for n in numbers
            ]
            store.append_scans(key, scans)

        yield store, write


def looked_at(store):
    newest = store.newest_scan_number("lab")
    batch = store.scans_after("lab", newest - 1, 1)
    good, broken = channels_now(store, "lab", batch.channels, batch.scans[0], START, {})
    return good, broken


def test_a_broken_wire_keeps_the_time_of_its_last_good_value_and_counts_the_gap(plant):
    store, write = plant
    write(range(60), broken=range(50, 60))
    good, broken = looked_at(store)
    assert (good.last_good_utc, good.gaps_last_hour) == (START + timedelta(seconds=59), 0)
    assert (broken.last_good_utc, broken.gaps_last_hour) == (START + timedelta(seconds=49), 10)
    assert (broken.quality, broken.temperature_C) == ("open", None)


def test_gaps_are_counted_on_from_the_last_look_and_forgotten_after_an_hour(plant):
    store, write = plant
    write(range(60), broken=range(50, 60))
    looked_at(store)
    write(range(60, 120), broken=range(60, 65))
    assert looked_at(store)[1].gaps_last_hour == 15
    write(range(120, 4000), broken=range(0))
    _, mended = looked_at(store)
    assert (mended.last_good_utc, mended.gaps_last_hour) == (START + timedelta(seconds=3999), 0)


def test_a_pressure_and_a_limit_switch_are_told_in_their_own_units_and_not_as_temperatures(tmp_path):
    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        key = store.register_press("lab", (Channel("top_1"), Channel("bar", "bar"), Channel("closed", "")))
        scan = Scan(0, START, 0.0, (20.0, 90.0, 1.0), (Quality.GOOD,) * 3)
        store.append_scans(key, [scan])
        batch = store.scans_after("lab", -1, 1)
        found = channels_now(store, "lab", batch.channels, batch.scans[0], START, {})
    assert [(c.value, c.unit, c.temperature_C) for c in found] == [
        (20.0, "°C", 20.0),
        (90.0, "bar", None),
        (1.0, "", None),
    ]
