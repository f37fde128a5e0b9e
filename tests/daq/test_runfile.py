"""Run files: what is written comes back, what is wrong is named by line and column."""

import csv
import string
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.files.frames import frame_of
from daq.files.qualities import QualitySpan, quality_text, spans_of
from daq.files.run_file import read_run, write_run
from daq.press.header import check_header
from daq.records import InputError, Quality, Run

ROOT = Path(__file__).resolve().parents[2]
GOOD = """# run = "2026-03-04-07"
# panel.material = "MDF"
# panel.thickness_mm = 16.0
# setting.platen_temperature_C = 200
time_s,platen_top,top_1,bottom_1,closed
0.0,199.8,20.8,20.9,0
0.5,199.7,,21.9,0
1.1,199.1,61.25,24.0,1
"""


def mistypes_none(key):
    """Tell whether a header takes a key: one like `remark` but for a letter is refused, rightly."""
    try:
        check_header({key: None}, "here")
    except InputError:
        return False
    return True


key = st.text(string.ascii_letters + '._- µ°"\\', min_size=1, max_size=12).filter(mistypes_none)
keys = st.lists(key, max_size=5, unique=True)
values = st.recursive(
    st.text(max_size=20).filter(lambda t: t.encode("utf-8", "ignore").decode() == t)
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.booleans()
    | st.datetimes(timezones=st.just(UTC)),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=4,
)
names = st.lists(
    st.text(string.ascii_letters + string.digits + '_@. ,"µ', min_size=1, max_size=8).filter(
        lambda t: t == t.strip() and t not in ("time_s", "closed", "quality")
    ),
    min_size=1,
    max_size=4,
    unique=True,
)
cells = st.floats(allow_infinity=False, allow_nan=True, width=64)


@st.composite
def runs(draw):
    rows = draw(st.integers(1, 6))
    times = sorted(draw(st.sets(st.floats(-1e6, 1e6), min_size=rows, max_size=rows)))
    columns = {name: np.array(draw(st.lists(cells, min_size=rows, max_size=rows))) for name in draw(names)}
    columns["closed"] = np.array(draw(st.lists(st.sampled_from([0.0, 1.0, np.nan]), min_size=rows, max_size=rows)))
    header = {key: draw(values) for key in draw(keys) if key != "run"}
    qualities = st.dictionaries(st.sampled_from(["*", *columns]), st.sampled_from(Quality), max_size=3)
    faults = draw(st.lists(qualities, min_size=rows, max_size=rows))
    for row, named in enumerate(faults):
        for name in columns:
            if not named.get(name, named.get("*", Quality.GOOD)).usable:
                columns[name][row] = np.nan
    texts = {"quality": tuple(quality_text(named) for named in faults)} if any(faults) else {}
    name = draw(st.text(string.ascii_letters, min_size=1))
    return Run(name, header, np.array(times), columns, texts=texts)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@given(run=runs())
@settings(max_examples=150, deadline=None)
def test_reading_undoes_writing_to_the_last_bit(run, suffix):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"x{suffix}"
        write_run(run, path)
        back = read_run(path)
        assert list(Path(folder).iterdir()) == [path]
    assert back.name == run.name
    assert dict(back.header) == {**run.header, "run": run.name}
    assert list(back.columns) == list(run.columns)
    assert back.time_s.tobytes() == run.time_s.tobytes()
    for name, column in run.columns.items():
        np.testing.assert_array_equal(back.columns[name], column)
    assert back.texts == run.texts


def test_what_a_file_calls_unusable_is_not_used(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(
        "time_s,top_1,quality,top_2\n0,1,top_2=stale,2\n1,3,,4\n2,5,*=simulated,6\n3,7,*=over top_1=good,8\n"
    )
    run = read_run(path)
    np.testing.assert_array_equal(run.columns["top_1"], [1, 3, 5, 7])
    np.testing.assert_array_equal(run.columns["top_2"], [np.nan, 4, 6, np.nan])
    assert list(spans_of(run)) == [
        QualitySpan("*", Quality.SIMULATED, 2.0, 2.0, 1),
        QualitySpan("*", Quality.OVER, 3.0, 3.0, 1),
        QualitySpan("top_1", Quality.GOOD, 3.0, 3.0, 1),
        QualitySpan("top_2", Quality.STALE, 0.0, 0.0, 1),
    ]


@pytest.mark.parametrize("cells", ["good,,fine", "1,2,3", "T=200 steady,,", "x = 3,,"])
def test_another_column_of_that_name_is_kept_as_it_is(tmp_path, cells):
    path = tmp_path / "run.csv"
    path.write_text("time_s,quality,top_1\n" + "".join(f"{i},{c},5\n" for i, c in enumerate(cells.split(","))))
    run = read_run(path)
    write_run(run, tmp_path / "again.csv")
    again = read_run(tmp_path / "again.csv")
    assert run.columns["top_1"].tolist() == [5, 5, 5]
    assert not list(spans_of(run))
    assert ("quality" in run.texts) != ("quality" in run.columns)
    assert again.texts == run.texts
    assert list(again.columns) in (["quality", "top_1"], ["top_1"])


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("top_1=ajar", "'ajar' is no quality; they are good, open, over, "),
        ("top_9=open", "names column 'top_9', which is not there"),
        ("top_1=open;platen_top=stale", "write column=quality, with one blank between two of them"),
        ("top_1=open  platen_top=stale", "write column=quality, with one blank"),
        ("broken", "write column=quality"),
    ],
)
def test_a_quality_that_cannot_be_read_is_refused_by_line_and_column(tmp_path, cell, message):
    texts = ("", "top_1=open", cell)
    rows = "".join(f"{i},200,20,{text}\n" for i, text in enumerate(texts))
    (tmp_path / "x.csv").write_text("time_s,platen_top,top_1,quality\n" + rows)
    with pytest.raises(InputError, match=f"line 4: column quality: '{cell}'.*{message}"):
        read_run(tmp_path / "x.csv")
    table = {"time_s": [0.0, 1.0, 2.0], "platen_top": [200.0] * 3, "top_1": [20.0] * 3, "quality": texts}
    pq.write_table(pa.table(table), tmp_path / "x.parquet")
    with pytest.raises(InputError, match=f"row 3: column quality: '{cell}'.*{message}"):
        read_run(tmp_path / "x.parquet")


@pytest.mark.parametrize("quality", ["top_1=open", "", "fine"])
@pytest.mark.parametrize("damaged", ["2,200", "2,200,20,,,", "2"])
def test_a_row_with_a_wrong_number_of_cells_is_named_whatever_else_the_file_says(tmp_path, quality, damaged):
    path = tmp_path / "x.csv"
    path.write_text(
        f"time_s,platen_top,top_1,quality\n0,200,20,{quality}\n1,200,20,{quality}\n{damaged}\n3,1,1,\n"
    )
    with pytest.raises(InputError, match=f"line 4: {damaged.count(',') + 1} cells?, but the header row has 4"):
        read_run(path)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_words_of_several_lines_and_times_of_day_beside_a_row_are_kept(tmp_path, suffix):
    texts = {
        "note": ("door\nopen", "", 'said "go"\r\n, then', "x\ry"),
        "utc": ("2026-03-04T07:00:00Z", "2026-03-04T07:00:01Z", "", ""),
        "clock": ("7:00", "", "7:01", "7:02"),
    }
    run = Run("x", {"run": "x"}, np.arange(4.0), {"top_1": np.arange(4.0)}, texts=texts)
    write_run(run, tmp_path / f"x{suffix}")
    back = read_run(tmp_path / f"x{suffix}")
    assert back.texts == texts
    assert back.columns["top_1"].tolist() == [0, 1, 2, 3]


def test_lines_are_counted_where_a_cell_holds_several(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text('time_s,top_1,note\n0,1,"a\nb"\n\n0,1,c\n')
    with pytest.raises(InputError, match=r"line 5: time_s = 0\.0 does not rise \(line 2: 0\.0\)"):
        read_run(path)
    path.write_text('time_s,top_1,note\n0,1,"a\nb"\n1,hot,c\n2,3,\n')
    with pytest.raises(InputError, match=r"line 4: column top_1: 'hot' is not a number"):
        read_run(path)
    path.write_text('time_s,top_1,note\n0,1,a\n1,2,"b\n2,3,\n')
    with pytest.raises(InputError, match=r"line 3: .*check its quotation marks"):
        read_run(path)


@pytest.mark.parametrize("value", [1e308, 1e6, -300.0, -273.15])
def test_what_is_no_temperature_is_refused_where_only_one_can_stand(tmp_path, value):
    load = np.array([1e6, 1e7])
    run = Run("x", {}, np.array([-5.0, 0.0]), {"top_1": np.array([20.0, value]), "load_N": load})
    for suffix, place in ((".csv", "line 4"), (".parquet", "row 2")):
        path = tmp_path / f"x{suffix}"
        write_run(run, path)
        assert read_run(path, ["core_*"]).time_s.tolist() == [-5.0, 0.0]
        with pytest.raises(InputError, match=f"{place}: column top_1: .* is no temperature; must lie"):
            read_run(path, ["top_*", "core_*"])


def test_a_run_file_gives_header_columns_and_missing_values(tmp_path):
    path = tmp_path / "some.csv"
    path.write_text(GOOD)
    run = read_run(path)
    assert run.name == "2026-03-04-07"
    assert run.header["panel.thickness_mm"] == 16.0
    assert run.setting("platen_temperature_C") == 200.0
    assert list(run.columns) == ["platen_top", "top_1", "bottom_1", "closed"]
    assert run.time_s.tolist() == [0.0, 0.5, 1.1]
    assert np.isnan(run.columns["top_1"][1])
    assert run.columns["closed"].tolist() == [0, 0, 1]
    assert run.source == str(path)


def test_the_name_is_the_file_stem_where_the_header_is_silent(tmp_path):
    path = tmp_path / "night-shift.csv"
    path.write_text("time_s,top_1\n0,1\n1,2\n")
    assert read_run(path).name == "night-shift"


def test_windows_line_ends_byte_order_mark_plus_signs_and_empty_lines_are_accepted(tmp_path):
    path = tmp_path / "w.csv"
    path.write_bytes(
        b"\xef\xbb\xbf" + GOOD.replace("61.25", "+61.25").replace("\n", "\r\n").encode() + b"\r\n\r\n"
    )
    run = read_run(path)
    assert run.columns["top_1"][2] == 61.25
    assert len(run.time_s) == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("0.5,199.7", "-0.5,199.7"), r"line 7: time_s = -0.5 does not rise \(line 6: 0.0\)"),
        (("0.5,199.7", "0.0,199.7"), r"line 7: time_s = 0.0 does not rise"),
        (("0.5,199.7", ",199.7"), r"line 7: column time_s: the time is missing"),
        (("61.25", "hot"), r"line 8: column top_1: 'hot' is not a number"),
        (("61.25", "inf"), r"line 8: column top_1: 'inf' is not a number"),
        (("61.25", "61,25"), r"line 8: 6 cells, but the header row has 5 columns"),
        (("199.7,,21.9,0", "199.7,,21.9"), r"line 7: 4 cells, but the header row has 5 columns"),
        (("24.0,1", "24.0,2"), r"line 8: column closed: '?2'? must be 0 \(open\) or 1 \(closed\)"),
        (("24.0,1", "24.0,yes"), r"line 8: column closed: 'yes' is not a number"),
        (("time_s,", "time,"), r"line 5: column time_s is missing; found time, platen_top"),
        (("bottom_1", "top_1"), r"line 5: column 'top_1' occurs twice \(columns 3 and 4\)"),
        (("bottom_1", ""), r"line 5: column 4 has no usable name"),
        (('"MDF"', "MDF"), r"line 2: '# panel.material = MDF' is not 'key = value' in TOML"),
        (('# panel.material = "MDF"', "# [panel]"), r"line 2: '# \[panel\]': sections are not read"),
        (("# panel.material = ", "# just some words "), r"line 2: .* is not 'key = value' in TOML"),
        (("panel.thickness_mm", "panel.material"), r"line 3: header key panel.material is given twice"),
        (("time_s,platen_top,top_1,bottom_1,closed\n", ""), r"line 5: the header row is missing"),
        ((GOOD, ""), "the file is empty"),
        ((GOOD[GOOD.index("0.0,") :], ""), r"line 5: no rows follow the header row"),
        ((GOOD[GOOD.index("time_s,") :], ""), r"line 5: the header row is missing"),
        ((",", ";"), r"line 5: cells are not separated by commas"),
        (("platen_top,", "platen_top\rx,"), r"line 5: .*check its quotation marks and line ends"),
    ],
)
def test_a_faulty_run_file_is_refused_by_line_and_column(tmp_path, change, message):
    path = tmp_path / "bad.csv"
    path.write_text(GOOD.replace(*change))
    with pytest.raises(InputError, match=message) as caught:
        read_run(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_line_number_counts_empty_lines_too(tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text("time_s,top_1\n0,1\n\n\n0,2\n")
    with pytest.raises(InputError, match=r"line 5: time_s = 0\.0 does not rise"):
        read_run(path)


def test_bytes_that_are_no_utf_8_are_refused_by_line(tmp_path):
    path = tmp_path / "latin.csv"
    path.write_bytes('# panel.material = "Süß"\ntime_s,top_1\n0,1\n'.encode("latin-1"))
    with pytest.raises(InputError, match="line 1: not UTF-8"):
        read_run(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_run(tmp_path / "none.csv")
    with pytest.raises(InputError, match="cannot read"):
        read_run(tmp_path)


def test_a_parquet_file_cut_short_is_refused(tmp_path):
    path = tmp_path / "x.parquet"
    write_run(Run("x", {}, np.arange(50.0), {"top_1": np.arange(50.0)}), path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match="not a readable Parquet file"):
        read_run(path)


@pytest.mark.parametrize("place", ["column", "key", "value"])
def test_a_parquet_file_with_a_wrong_bit_in_a_name_is_refused(tmp_path, place):
    path = tmp_path / "x.parquet"
    header = {"key": {b"thick\xffess": b"1"}, "value": {b"thickness": b"\xb3"}}.get(place, {})
    pq.write_table(pa.table({"time_s": [0.0, 1.0], "top_1": [1.0, 2.0]}).replace_schema_metadata(header), path)
    if place == "column":
        path.write_bytes(path.read_bytes().replace(b"top_1", b"t\xb3p_1"))
    with pytest.raises(InputError, match="not a readable Parquet file"):
        read_run(path)


@pytest.mark.parametrize(
    ("place", "stated"),
    [("file", -1), ("file", 1), ("file", 30), ("file", 41), ("file", 60), ("row group", 0), ("row group", 30)],
)
def test_a_parquet_file_that_states_another_number_of_rows_than_it_holds_is_refused(tmp_path, place, stated):
    """What memory held before, as another run's columns, stood in the rows that were not there."""
    path = tmp_path / "x.parquet"
    pq.write_table(pa.table({"time_s": np.arange(40.0), "top_1": np.full(40, 20.0)}), path)
    content = bytearray(path.read_bytes())
    footer = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    rows = b"\x16\x50"  # 40, as a field in Thrift's compact protocol
    at = content.index(rows, footer) if place == "file" else content.rindex(rows)
    content[at + 1] = 2 * stated if stated >= 0 else 1  # zigzag
    path.write_bytes(content)
    counted = place == "file" and stated > 0
    with pytest.raises(InputError, match=f"40 rows where {stated} are stated" if counted else "not a readable"):
        read_run(path)


def test_a_parquet_file_of_pandas_with_a_wrong_bit_in_what_it_says_of_its_index_is_refused(tmp_path):
    path = tmp_path / "x.parquet"
    rows = pd.date_range("2026-03-04", periods=2, freq="s", tz="UTC", name="t")
    pd.DataFrame({"top_1": [20.0, 21.0], "note": pd.Categorical(["a", "b"])}, rows).to_parquet(path)
    path.write_bytes(path.read_bytes().replace(b'"column_indexes"', b'#column_indexes"'))
    with pytest.raises(InputError, match="not a readable Parquet file"):
        read_run(path)


def test_a_parquet_file_of_pandas_that_states_another_number_of_rows_than_its_index_has_is_refused(tmp_path):
    path = tmp_path / "x.parquet"
    rows = pd.date_range("2026-03-04", periods=40, freq="s", tz="UTC", name="t")
    pd.DataFrame({"note": pd.Categorical(["a", "b"] * 20)}, rows).to_parquet(path)
    content = bytearray(path.read_bytes())
    content[content.rindex(b"\x16\x50") + 1] = 0
    path.write_bytes(content)
    with pytest.raises(InputError, match="0 rows where 40 are stated"):
        read_run(path)


def test_parquet_written_elsewhere_with_plain_text_metadata_integers_and_nulls_is_read(tmp_path):
    path = tmp_path / "x.parquet"
    table = pa.table({"time_s": [0, 1, 2], "top_1": [20.0, None, 22.0], "closed": [False, True, True]})
    pq.write_table(
        table.replace_schema_metadata({"panel.material": "MDF", "panel.thickness_mm": "16.0", "pandas": "{}"}),
        path,
    )
    run = read_run(path)
    assert dict(run.header) == {"panel.material": "MDF", "panel.thickness_mm": 16.0}
    assert np.isnan(run.columns["top_1"][1])
    assert run.columns["closed"].tolist() == [0, 1, 1]


def test_parquet_faults_are_named_by_row_and_column(tmp_path):
    path = tmp_path / "x.parquet"
    pq.write_table(pa.table({"time_s": [0.0, 2.0, 1.0]}), path)
    with pytest.raises(InputError, match=r"row 3: time_s = 1.0 does not rise"):
        read_run(path)
    pq.write_table(pa.table({"time_s": [0.0], "closed": [b"no"]}), path)
    with pytest.raises(InputError, match=r"column closed: .*is not a number"):
        read_run(path)


def test_a_run_that_no_file_can_hold_is_not_written(tmp_path):
    path = tmp_path / "x.csv"
    with pytest.raises(InputError, match="does not rise"):
        write_run(Run("x", {}, np.array([1.0, 0.0]), {}), path)
    with pytest.raises(InputError, match="infinite"):
        write_run(Run("x", {}, np.array([0.0]), {"a": np.array([np.inf])}), path)
    with pytest.raises(InputError, match="holds text, numbers"):
        write_run(Run("x", {"a": object()}, np.array([0.0]), {}), path)
    assert list(tmp_path.iterdir()) == []


def test_header_times_keep_their_zone(tmp_path):
    started = datetime(2026, 3, 4, 7, 15, tzinfo=UTC)
    write_run(Run("x", {"started_utc": started}, np.array([0.0]), {}), tmp_path / "x.csv")
    assert read_run(tmp_path / "x.csv").header["started_utc"] == started


@pytest.mark.benchmark
def test_reading_three_thousand_rows(tmp_path):
    rng = np.random.default_rng(1)
    columns = {f"top_{i}": np.round(rng.normal(100, 30, 3000), 1) for i in range(16)}
    write_run(Run("x", {"panel.material": "MDF"}, np.arange(3000) / 10, columns), tmp_path / "x.csv")
    began = time.perf_counter()
    for _ in range(20):
        read_run(tmp_path / "x.csv")
    print(f"3000 rows of 17 cells: {(time.perf_counter() - began) / 20 * 1e3:.1f} ms")


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_column_of_remarks_is_kept_and_used_by_nothing(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text('time_s,a,remark,b\n0,1,"ok, fine",2\n1,3,,4\n')
    run = read_run(path)
    assert list(run.columns) == ["a", "b"]
    assert run.texts == {"remark": ("ok, fine", "")}
    copy = tmp_path / f"copy{suffix}"
    write_run(run, copy)
    assert read_run(copy).texts == run.texts
    assert read_run(copy).columns["b"].tolist() == [2.0, 4.0]


def test_text_among_numbers_is_refused_by_line(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time_s,a,b\n0,1,x\n1,lost,y\n")
    with pytest.raises(InputError, match="line 3: column a: 'lost' is not a number"):
        read_run(path)


@pytest.mark.parametrize("column", ["time_s", "top_1", "quality"])
def test_a_parquet_file_with_one_wrong_bit_is_refused_by_column(tmp_path, column):
    path = tmp_path / "x.parquet"
    texts = {"quality": ("top_1=simulated", "") * 25}
    write_run(Run("x", {}, np.arange(50.0) * 0.7, {"top_1": np.arange(50.0) / 7.0}, texts=texts), path)
    sound = path.read_bytes()
    place = pq.ParquetFile(path).metadata.row_group(0).column(["time_s", "top_1", "quality"].index(column))
    middle = (place.dictionary_page_offset or place.data_page_offset) + place.total_compressed_size // 2
    path.write_bytes(sound[:middle] + bytes([sound[middle] ^ 1]) + sound[middle + 1 :])
    with pytest.raises(InputError, match=f"column {column}: not a readable Parquet file"):
        read_run(path)


@pytest.mark.parametrize("cell", ["٢١", "２１", "2١", "१"])
def test_digits_of_another_script_are_no_numbers_and_no_remark_either(tmp_path, cell):
    path = tmp_path / "x.csv"
    path.write_text(f"time_s,top_1\n0,{cell}\n1,{cell}\n")
    with pytest.raises(InputError, match=f"line 2: column top_1: '{cell}' is not a number"):
        read_run(path)


@pytest.mark.parametrize("text", ["=2+3", "+2", "-x", "@cmd", "\t=1", "'=2", "''=2", "'tis", "steady", ""])
def test_a_text_that_a_spreadsheet_would_compute_is_written_behind_an_apostrophe_and_read_back_the_same(
    tmp_path, text
):
    run = Run("x", {"run": "x", "remark": f"a,{text};{text}"}, np.arange(2.0), {"top_1": np.arange(2.0)})
    run = replace(run, texts={"note": (text, "fine"), "=SUM(A1)": ("a", "b")})
    write_run(run, tmp_path / "x.csv")
    with (tmp_path / "x.csv").open(newline="", encoding="utf-8") as file:
        cells = [cell for row in csv.reader(file) for cell in row]
    assert not [cell for cell in cells if cell.startswith(("=", "@", "+", "\t"))]
    back = read_run(tmp_path / "x.csv")
    assert (back.texts, back.header) == (run.texts, run.header)


READS = """
import resource, sys
from pathlib import Path
from daq.files.run_file import read_run
import daq.press.press_file
warm = read_run(Path(sys.argv[1]))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
run = read_run(Path(sys.argv[2]))
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(after - before, len(run.time_s), len(run.columns))
"""


@pytest.mark.campaign
@pytest.mark.skipif(sys.platform != "linux", reason="kilobytes of the system's own count")
@pytest.mark.parametrize("kind", ["numbers", "remarks", "parquet"])
def test_reading_a_long_run_takes_little_more_memory_than_the_run(tmp_path, kind):
    rows = 300_000
    values = np.random.default_rng(1).normal(100.0, 20.0, (15, rows)).round(2)
    columns = {f"top_{i + 1}": column for i, column in enumerate(values)}
    texts = {"note": ("calm",) * rows} if kind == "remarks" else {}
    path = tmp_path / ("x.parquet" if kind == "parquet" else "x.csv")
    write_run(Run("x", {}, np.arange(rows) / 10, columns, texts=texts), path)
    small = tmp_path / f"small{path.suffix}"
    write_run(Run("s", {}, np.arange(3.0), {"top_1": np.arange(3.0)}, texts={k: ("a",) * 3 for k in texts}), small)
    done = subprocess.run(
        [sys.executable, "-c", READS, small, path], capture_output=True, text=True, check=True, cwd=ROOT
    )
    grown_kb, *shape = (int(part) for part in done.stdout.split())
    assert shape == [rows, 15]
    assert grown_kb * 1024 < 2.2 * 16 * 8 * rows


MAPS = """
import resource, sys
from pathlib import Path
from daq.files.mapping import read_foreign, read_mapping
from daq.store import open_store
mapped = read_mapping(Path(sys.argv[1]))
def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
def grown(path, store):
    marks = [peak()]
    run = read_foreign(path, mapped, ["top_*"])
    marks.append(peak())
    store.import_run(run, "lab")
    return marks[1] - marks[0], peak() - marks[1], len(run.time_s), len(run.columns)
with open_store(sys.argv[4]) as store:
    grown(Path(sys.argv[2]), store)
    print(*grown(Path(sys.argv[3]), store))
"""


@pytest.mark.campaign
@pytest.mark.skipif(sys.platform != "linux", reason="kilobytes of the system's own count")
def test_a_mapped_file_is_read_and_imported_in_pieces(tmp_path):
    """Of 10 million rows of five columns: 0.4 GB are the run's own numbers, 8 bytes a cell."""
    rows, names = 200_000, [f"top_{i}" for i in range(1, 5)]
    (tmp_path / "map.toml").write_text(
        '[time]\ncolumn = "s"\n' + "".join(f'[[column]]\nfrom = "{name}"\nto = "{name}"\n' for name in names)
    )
    for name, count in (("small", 3), ("long", rows)):
        lines = (f"{i / 10},{20 + i % 90},21.5,{i % 70},{100 + i % 7}.25\n" for i in range(count))
        (tmp_path / f"{name}.csv").write_text(",".join(["s", *names]) + "\n" + "".join(lines))
    places = [tmp_path / name for name in ("map.toml", "small.csv", "long.csv", "store.sqlite")]
    done = subprocess.run(
        [sys.executable, "-c", MAPS, *places], capture_output=True, text=True, check=True, cwd=ROOT
    )
    read_kb, imported_kb, *shape = (int(part) for part in done.stdout.split())
    assert shape == [rows, 4]
    assert read_kb * 1024 < 2.2 * 5 * 8 * rows
    assert imported_kb < 40_000


def test_a_table_that_pandas_wrote_as_parquet_keeps_its_header(tmp_path):
    header = {"run": "r-1", "panel.thickness_mm": 8.0}
    run = Run("r-1", header, np.array([0.0, 1.0]), {"top_1": np.array([20.0, 21.0])})
    frame_of(run).to_parquet(tmp_path / "other.parquet")

    back = read_run(tmp_path / "other.parquet")
    assert (back.name, dict(back.header)) == ("r-1", dict(run.header))
    assert back.columns["top_1"].tolist() == [20.0, 21.0]


@pytest.mark.parametrize("attrs", ["", "{", "[1]", "[" * 100_000, '{"a": ' + "9" * 5000 + "}"])
def test_attributes_of_a_table_that_are_no_header_are_no_header(tmp_path, attrs):
    table = pa.table({"time_s": [0.0, 1.0], "top_1": [20.0, 21.0]})
    pq.write_table(table.replace_schema_metadata({"PANDAS_ATTRS": attrs}), tmp_path / "x.parquet")
    assert dict(read_run(tmp_path / "x.parquet").header) == {}


def test_a_run_prints_on_one_screen():
    header = {f"note.key_{i}": "word " * 200 for i in range(60)}
    columns = {f"channel_{i}": np.zeros(10_000) for i in range(500)}
    text = repr(Run("r-1", header, np.arange(10_000.0), columns))
    assert text.startswith("Run r-1: 10000 scans, 0 to 9999 s")
    assert len(text.splitlines()) <= 25
    assert max(map(len, text.splitlines())) <= 300
