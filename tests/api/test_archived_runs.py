"""REST, Python and files answer of archived runs as of others, and say plainly what they cannot read."""

from pathlib import Path

import numpy as np
from sqlalchemy import select, update

import daq
from api.cli import main
from daq.store import schema
from daq.store.schema import SCAN
from tests.api.conftest import STARTED

PRESS_FILE = str(Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml")
RUN = "lab-2026-03-04-01"
SCANS = "scans?press=lab&from=2026-03-04T07:00:00Z&to=2026-03-04T08:00:00Z&points=60"
PATHS = (
    f"runs/{RUN}",
    f"runs/{RUN}/samples",
    f"runs/{RUN}/samples?columns=top_1,core_1&from=5&to=20&max_points=50",
    f"runs/{RUN}/samples?format=csv",
    f"runs/{RUN}/samples?format=parquet",
    f"runs/{RUN}/estimates",
    f"runs/{RUN}/fit",
    SCANS,
)


def asked(client):
    return {path: client.get(f"/api/v1/{path}").content for path in PATHS}


def exported(store, folder):
    assert main(["export", RUN, "--out", str(folder / "run.csv"), "--store", str(store.database.path)]) == 0
    return (folder / "run.csv").read_bytes()


def test_a_damaged_header_costs_its_own_run_alone_in_every_list_and_health_names_it(
    store, client, tmp_path, capsys
):
    url = str(store.database.path)
    with store.database.writing() as connection:
        row = schema.RUN.c.run == RUN
        kept = connection.execute(select(schema.RUN.c.header_toml).where(row)).scalar_one()
        connection.execute(update(schema.RUN).where(row).values(header_toml=kept.replace("=", "= =", 1)))
    try:
        for path in (
            "runs",
            "search",
            "search?sort=-rmse_K",
            "search?q=lab",
            "coefficients",
            "press",
            "nights",
        ):
            answer = client.get(f"/api/v1/{path}")
            if path in ("runs", "search"):
                by_run = {item["run"]: item for item in answer.json()["items"]}
                assert set(by_run) == {record.run for record in store.runs().items}
                assert [run for run, item in by_run.items() if item["damage"]] == [RUN]
                assert by_run[RUN]["damage_said"]["code"] == "of-run"
            assert (path, answer.status_code) == (path, 200)
        health = client.get("/api/v1/health").json()
        (alarm,) = [one for one in health["alarms"] if "damaged in store" in one or "is damaged" in one]
        assert RUN in alarm
        assert url in alarm
        for path in ("", "/samples", "/estimates", "/fit", "/verdict", "/figure.svg"):
            answer = client.get(f"/api/v1/runs/{RUN}{path}")
            assert (path, answer.status_code) == (path, 503)
            assert "kerntemp backup --restore" in answer.json()["detail"]
        assert client.get("/api/v1/runs/nobody").status_code == 404
        assert client.get("/api/v1/press").status_code == 200
        assert main(["export", "--store", url]) == 0
        out, err = capsys.readouterr()
        assert [line.split("\t")[2] for line in out.splitlines() if line.startswith(RUN)] == ["damaged"]
        assert sum(line.startswith("lab-") for line in out.splitlines()) >= 3
        assert f"kerntemp: run {RUN}: its header is damaged" in err
        assert main(["export", RUN, "--out", str(tmp_path / "x.csv"), "--store", url]) == 2
        assert "kerntemp backup --restore" in capsys.readouterr().err
        with daq.open_store(url) as tables:
            runs = tables.runs()
            assert set(runs.index) >= {RUN, "lab-2026-03-04-02"}
            assert runs["damage"].dropna().index.tolist() == [RUN]
            assert len(tables.samples("lab-2026-03-04-02")) > 100
    finally:
        with store.database.writing() as connection:
            connection.execute(update(schema.RUN).where(row).values(header_toml=kept))


def test_a_run_with_a_damaged_scan_is_told_by_every_path_and_command_that_needs_it_and_the_others_answer(
    store, client, tmp_path, capsys
):
    others = client.get("/api/v1/runs/lab-2026-03-04-02/samples").content
    first = store.run_record(RUN).first_scan
    row = update(SCAN).where(SCAN.c.number == first + 40)
    with store.database.writing() as connection:
        kept = connection.execute(select(SCAN.c.readings).where(SCAN.c.number == first + 40)).scalar_one()
        connection.execute(row.values(readings=kept[: len(kept) // 2]))
    try:
        for path in ("samples", "samples?format=csv", "samples?format=parquet", "figure.svg", "simulation"):
            answer = client.get(f"/api/v1/runs/{RUN}/{path}")
            assert (path, answer.status_code) == (path, 503)
            assert answer.headers["content-type"].startswith("application/problem+json")
            problem = answer.json()
            assert problem["detail_said"]["code"] == "of-run"
            assert f"run {RUN}: scan {first + 40} is damaged" in problem["detail"]
            assert "kerntemp backup --restore" in problem["detail"]
        assert client.get("/api/v1/runs/lab-2026-03-04-02/samples").content == others
        assert client.get("/api/v1/runs").status_code == 200
        assert client.get(f"/api/v1/{SCANS}").status_code == 200
        for command in (["export", RUN, "--out"], ["fit", RUN, "--press", PRESS_FILE, "--json"]):
            assert main([*command, str(tmp_path / "x.csv"), "--store", str(store.database.path)]) == 2
            output = capsys.readouterr().err
            assert output.count("\n") == 1
            for part in (RUN, f"scan {first + 40}", str(store.database.path), "kerntemp backup --restore"):
                assert part in output
            assert not (tmp_path / "x.csv").exists()
    finally:
        with store.database.writing() as connection:
            connection.execute(row.values(readings=kept))


def test_an_archived_run_gives_every_answer_as_before_and_a_lost_file_is_told(store, client, tmp_path, capsys):
    (tmp_path / "before").mkdir()
    (tmp_path / "after").mkdir()
    before, files, table = (
        asked(client),
        exported(store, tmp_path / "before"),
        daq.open_store(store.label).samples(RUN),
    )
    store.use_archive(tmp_path / "archive")
    store.archive_run(RUN)
    assert asked(client) == before
    assert exported(store, tmp_path / "after") == files
    again = daq.open_store(store.label).samples(RUN)
    assert again.equals(table)
    assert np.array_equal(again.index, table.index)
    kept = client.get("/api/v1/health").json()
    assert (kept["store"]["archive"]["runs"], kept["store"]["archive"]["unsound"]) == (1, 0)
    [file] = (tmp_path / "archive").rglob(f"*-{RUN}.parquet")
    file.rename(Path(f"{file}.away"))
    answer = client.get(f"/api/v1/runs/{RUN}/samples")
    assert answer.status_code == 503
    assert "missing; copy it back from a backup of the archive" in answer.json()["detail"]
    assert client.get(f"/api/v1/runs/{RUN}").content == before[f"runs/{RUN}"]
    scans = client.get(f"/api/v1/{SCANS}").json()
    assert scans["scans"][0] == 0
    assert sum(scans["scans"]) > 100  # the other pressings
    assert [(one["run"], one["why_said"]["code"]) for one in scans["unread"]] == [(RUN, "archive-file-missing")]
    assert len(store.check_archive(STARTED.replace(year=2100)).unsound) == 1
    assert any(
        "one file is missing or damaged" in alarm for alarm in client.get("/api/v1/health").json()["alarms"]
    )
    assert "kerntemp_archive_unsound 1.0" in client.get("/metrics").text
    Path(f"{file}.away").rename(file)
    (tmp_path / "archive").rename(tmp_path / "away")
    assert any(
        "archive: missing; mount its disk" in alarm for alarm in client.get("/api/v1/health").json()["alarms"]
    )
    (tmp_path / "away").rename(tmp_path / "archive")
    assert main(["backup", str(tmp_path / "b.sqlite"), "--store", str(store.database.path)]) == 0
    assert f"copy the folder {tmp_path / 'archive'} too" in " ".join(capsys.readouterr().out.split())
    store.recheck_unsound(STARTED.replace(year=2100))
    store.check_archive(STARTED)
    assert asked(client) == before
    assert store.remove_archived("lab", STARTED.replace(year=2100))[0] == 1
    for path in (f"runs/{RUN}/samples", f"runs/{RUN}/estimates", f"runs/{RUN}/figure.svg"):
        answer = client.get(f"/api/v1/{path}")
        assert (path, answer.status_code) == (path, 404)
        assert "its header and its coefficients are kept" in answer.json()["detail"]
    for path in (f"runs/{RUN}", f"runs/{RUN}/fit"):
        assert client.get(f"/api/v1/{path}").content == before[path]
