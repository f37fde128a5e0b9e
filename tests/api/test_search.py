"""Finding runs: by words, bounds, verdict; in any order; with the core's own numbers."""

from __future__ import annotations

import httpx
import numpy as np
import pytest

KNOWN = {"lab-2026-03-04-01": ("glossy film, batch 7", 300.0), "lab-2026-03-04-02": ("matt film", 350.0)}


@pytest.fixture(scope="module")
def found(store, client):
    for run, (remark, pressure) in KNOWN.items():
        store.annotate_run(run, {"remark": remark, "setting.pressure_N_cm2": pressure}, "test")
    store.annotate_run("lab-2026-03-04-02", {"panel.verdict": "blister"}, "test")

    def ask(*where: str, **query: object) -> list[str]:
        answer = client.get("/api/v1/search", params={**query, "where": list(where)})
        assert answer.status_code == 200, answer.text
        return [item["run"].removeprefix("lab-2026-03-04-") for item in answer.json()["items"]]

    return ask


def test_words_are_found_in_remark_header_and_verdict_and_all_must_occur(found):
    assert found(q="film") == ["02", "01"]
    assert found(q="FILM batch") == ["01"]
    assert found(q="blister") == found(verdict="blister") == ["02"]
    assert found(q="film scrap") == []


def test_a_verdict_is_found_by_what_the_page_calls_it_in_its_language(found, store, client):
    called = {"good": "gut", "blister": "BLASE", "undercured": "nicht ausgehärtet", "scrap": "Ausschuss"}
    for verdict, german in called.items():
        store.annotate_run("lab-2026-03-04-03", {"panel.verdict": verdict}, "test")
        assert "03" in found(q=german, language="de")
        assert "03" in found(q=verdict, language="de")
        assert "03" in found(q=verdict, language="en")
        assert "03" not in found(q=german, language="en")
    store.annotate_run("lab-2026-03-04-03", {"panel.verdict": None}, "test")
    assert "03" not in found(q="Ausschuss", language="de")
    answer = client.get("/api/v1/search", params={"language": "xx"})
    assert answer.status_code == 404
    assert "de" in answer.json()["detail"]


def test_bounds_hold_for_header_keys_and_for_the_core_at_opening(found, client, campaign):
    assert found("setting.pressure_N_cm2>320") == ["02"]
    assert found("setting.pressure_N_cm2>320", "setting.pressure_N_cm2<=349") == []
    runs = client.get("/api/v1/search", params={"q": "film"}).json()["items"]
    for item, (run, truth) in zip(reversed(runs), campaign, strict=False):
        opened = truth.moments.opened_s
        before = run.time_s <= opened
        core = float(np.asarray(truth.core_C)[before][-1])
        assert item["numbers"]["core_at_opening_C"] == pytest.approx(core, abs=0.05)
        assert item["numbers"]["core_peak_C"] == pytest.approx(float(np.max(truth.core_C)), abs=1e-6)
        assert item["numbers"]["band_at_opening_K"] == pytest.approx(3.2)
    middle = sum(item["numbers"]["core_at_opening_C"] for item in runs) / 2
    hotter = max(runs, key=lambda item: item["numbers"]["core_at_opening_C"])["run"]
    assert found(f"core_at_opening_C>{middle}", q="film") == [hotter.removeprefix("lab-2026-03-04-")]


def test_a_bound_on_a_number_that_no_run_has_is_refused_and_not_taken_for_one_that_no_run_meets(found, client):
    for name in ("rmse", "panel.thicknes_mm", "h_pp"):
        answer = client.get("/api/v1/search", params={"where": f"{name}>0"})
        assert answer.status_code == 422
        assert f"'{name}'" in answer.json()["detail"]
        assert "panel.thickness_mm" in answer.json()["detail"]
    assert found("core_at_opening_C>900") == []
    assert found("rmse>0", q="no such film") == []


def test_a_number_that_runs_may_have_and_none_has_finds_nothing_and_is_named(found, client):
    asked = ["panel.moisture_percent<9", "setting.own_number>1", "panel.thickness_mm>1"]
    answer = client.get("/api/v1/search", params={"where": asked})
    assert answer.status_code == 200, answer.text
    assert answer.json()["items"] == []
    assert answer.json()["lacking"] == ["panel.moisture_percent", "setting.own_number"]
    assert client.get("/api/v1/search", params={"where": "core_at_opening_C>900"}).json()["lacking"] == []


def test_runs_come_in_the_order_asked_for_and_those_without_the_number_last(found):
    assert found(sort="setting.pressure_N_cm2", q="film") == ["01", "02"]
    assert found(sort="-setting.pressure_N_cm2", q="film") == ["02", "01"]
    assert found(sort="core_at_opening_C")[-1] == "03"  # still pressed


def test_a_coefficient_is_a_number_of_runs_that_determine_it(found, store, client):
    warned = {"code": "fit-not-described-check", "arguments": {}}
    kept = {run: store.fit(run) for run in ("lab-2026-03-04-01", "lab-2026-03-04-02")}
    for run, value, warnings in (("01", 700.0, []), ("02", 400.0, [warned])):
        coefficients = {
            "h_pp_c": {"value": value, "identifiable": True},
            "h_ap": {"value": 20.0, "identifiable": False},
        }
        fit = {"run": f"lab-2026-03-04-{run}", "coefficients": coefficients, "rmse_K": 0.3}
        store.put_fit(fit["run"], fit | {"warnings_said": warnings}, "")
    assert found("h_pp_c>1", q="film") == found("h_pp_c<=700", "rmse_K<1", q="film") == ["01"]
    assert found("h_ap>1", q="film") == []
    assert found(sort="h_pp_c", q="film") == ["01", "02"]
    (one,) = client.get("/api/v1/search", params={"q": "batch"}).json()["items"]
    assert (one["numbers"]["h_pp_c"], "h_ap" in one["numbers"]) == (700.0, False)
    for run, fit in kept.items():
        if fit is not None:
            store.put_fit(run, fit, "")


def test_pages_follow_one_another(found, client):
    first = client.get("/api/v1/search", params={"limit": 1, "sort": "setting.pressure_N_cm2"}).json()
    second = client.get(
        "/api/v1/search", params={"limit": 1, "sort": "setting.pressure_N_cm2", "cursor": first["next_cursor"]}
    ).json()
    assert first["items"][0]["run"] != second["items"][0]["run"]


@pytest.mark.parametrize(
    ("query", "says"),
    [
        ({"where": "hot"}, "core_at_opening_C>=95"),
        ({"where": "core_at_opening_C>٩"}, "core_at_opening_C>=95"),
        ({"sort": "nothing"}, "core_peak_C"),
    ],
)
def test_what_cannot_be_looked_for_is_refused_with_what_can(client: httpx.Client, query, says):
    answer = client.get("/api/v1/search", params=query)
    assert answer.status_code == 422
    assert says in answer.json()["detail"]
