"""The API over PostgreSQL: every list, a change, live events, and requests no database should see."""

from datetime import UTC, datetime

import httpx
import pytest

from daq.records import Channel, Quality, Scan
from daq.store.records import NewRun, RunEnd
from daq.store.store import open_store

CHANNELS = tuple(Channel(n) for n in ("platen_top", "platen_bottom", "top_1", "bottom_1"))


@pytest.fixture
def plant(postgresql_url, make_estimate, make_fit, serve_any):
    """A run with estimates and a fit in a database of its own, and the API over it."""
    with open_store(postgresql_url) as store:
        key = store.register_press("lab", CHANNELS)
        utc = datetime(2026, 3, 4, 7, tzinfo=UTC)
        scans = [Scan(i, utc, float(i), (200.0, 200.0, 20.0 + i, 21.0), (Quality.GOOD,) * 4) for i in range(50)]
        store.append_scans(key, scans, begin=NewRun("lab-1", 0, utc, 0.0, {"panel.material": "MDF"}))
        store.append_estimates("lab", [make_estimate(scan, 25.0) for scan in scans])
        store.append_scans(key, [], end=RunEnd("lab-1", 49, utc))
        store.put_fit("lab-1", make_fit("lab-1", 1), "1")
        store.put_model("lab", "1", {"version": "1", "effects": []}, status="candidate")
        store.put_diagnosis("lab", {"verdict": "no_effect", "effects": []})
        store.beat("record", {"state": "running"})
        with httpx.Client(base_url=serve_any(store), timeout=240) as client:
            yield client


def test_every_list_answers_from_postgresql(plant):
    for path in (
        "press",
        "channels",
        "runs",
        "coefficients",
        "coefficients/drift",
        "models",
        "diagnoses",
        "events",
    ):
        assert set(plant.get(f"/api/v1/{path}").json()) == {"items", "next_cursor"}, path
    health = plant.get("/api/v1/health").json()
    assert health["store"]["kind"] == "PostgreSQL"
    assert health["store"]["size_bytes"] > 10_000
    samples = plant.get("/api/v1/runs/lab-1/samples", params={"columns": "top_1"}).json()
    assert samples["columns"]["top_1"] == [20.0 + i for i in range(50)]
    assert plant.get("/api/v1/runs/lab-1/estimates").json()["rows"] == 50
    assert plant.get("/api/v1/runs/lab-1/samples", params={"format": "parquet"}).content[:4] == b"PAR1"
    assert "kerntemp_scans_total" in plant.get("/metrics").text


def test_changes_are_kept_in_postgresql(plant, tokens):
    writer = {"Authorization": f"Bearer {tokens.create('pg', 'write')}"}
    changed = plant.patch("/api/v1/runs/lab-1", json={"remark": "Grüße ≥ 3"}, headers=writer).json()
    assert (changed["remark"], changed["changes"][0]["who"]) == ("Grüße ≥ 3", "pg")
    assert plant.post("/api/v1/models/1/promote", headers=writer).json()["current"] is True


def test_no_request_makes_postgresql_fail(plant):
    for path, status in {
        "runs/%00": 422,
        "runs?material=%00": 422,
        "runs?cursor=999999999999999999": 200,
        "events?cursor=999999999999999999": 200,
        "runs/lab-1/samples?from=-1e308&to=1e308": 200,
        "runs?from=0001-01-01T00:00:00Z": 200,
        "runs?to=9999-12-31T23:59:59Z": 200,
        "models/%F0%9F%94%A5": 404,
    }.items():
        answer = plant.get(f"/api/v1/{path}")
        assert answer.status_code == status, f"{path}: {answer.text}"
