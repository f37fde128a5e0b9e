"""Reference answers: what Kerntemp answers to fixed inputs, written down by one code and held against another's.

::

    python -m tests.reference_answers write DIR [--inputs DIR] [--only fit,rest] [--quick] [--jobs 2]
    python -m tests.reference_answers compare DIR_OLD DIR_NEW [--rtol 1e-6] [--atol 1e-6] [--texts 40]

It uses the contract alone: the command line of the interpreter that runs it (`-m api`), REST over a server on
loopback, and run, press and model files. No module of Kerntemp is imported, so it runs unchanged however they are
moved. The inputs are plain files:

    campaigns/NAME/*.csv, press.toml    runs of the virtual press and of other laboratories
    models/NAME.fit.json, NAME.diagnose.json, coefficients.json    for `predict` and `simulate`
    store/kerntemp.toml, kerntemp.sqlite, ...    a stored week, copied before it is served

The models lie among the inputs so that `predict` and `simulate` do not inherit a change of `fit`.

A number that differs, a number or a file that is gone, a list of another length, an exit status, an instant, and a
name that programs read (a verdict, an effect, a state) end `compare` with status 1. Sentences may change: they are
listed. Keys that only the new answers have are counted. What is not compared, and why, stands in `IGNORED`.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

KINDS = ("fit", "diagnose", "predict", "simulate", "rest")
INPUTS = Path(os.environ.get("KERNTEMP_REFERENCE_INPUTS", "reference-inputs"))
ABOUT = "_about.json"
LONGEST_S = 600.0
"""A command that takes longer is killed and counts as failed. [s]"""
ALONE = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""Linear algebra on one thread: sums then come in one order, and two commands share two cores."""

IGNORED = (
    # (pattern of the file, pattern of the place in it, why)
    (r"(fit|diagnose)/", r"(^|\])(\.)?seconds$", "how long it took"),
    (r"(fit|diagnose)/.*\.model\.json$", r"^version$", "a label of the model file, no answer"),
    (r"rest/health", r"^body\.(utc|version)$", "now; the version installed"),
    (r"rest/health", r"^body\.alarms\[\d+\]$", "say for how many seconds; how many stand is in rest/metrics"),
    (r"rest/", r"\.age_s$", "grows with the clock: the store is as old as its inputs"),
    (r"rest/health", r"^body\.store\.(free_bytes|hours_left|size_bytes)$", "the disk of the day; WAL and pages"),
    (r"rest/metrics", r"^body\.kerntemp_(\w*_age|store_\w*bytes|info|\w*_created)", "ages, disk, version, begin"),
    (r"rest/openapi", r"^body\.version$", "the version installed"),
)
"""All else is compared. `_about.json` (when, how long, by which commit) is not an answer. Of pages (`/`, `/docs`)
only status and type are kept, of a figure its curves' numbers, of the schema paths, methods and parameters."""

NAMES = frozenset(
    {"verdict", "name", "set", "state", "status", "columns", "signal", "run", "press", "kind", "level"}
    | {"material", "unit", "quality", "type"}
)
"""Keys whose one-word texts are read by programs: they must not change."""

INSTANT = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d")
"""Texts that are instants of the stored week: they must not change either."""

SENTENCES = frozenset(
    ("reason", "message", "remark", "warnings", "said", "complained", "alarms", "next_measurement")
)
"""Keys whose texts are for people, however short."""


@dataclass(frozen=True)
class Case:
    """One command, and the files it writes below the folder of its kind."""

    kind: str
    name: str
    words: tuple[str, ...]
    outputs: tuple[tuple[str, str], ...] = ()
    """Option and ending of the file."""
    quick: bool = False


# -------------------------------------------------------------------------------------------------- what is asked


def cases(inputs: Path) -> list[Case]:
    """Return every command, the longest kinds first."""
    folders = sorted(p for p in (inputs / "campaigns").iterdir() if p.is_dir())
    return [*_campaign_cases(folders), *_predict_cases(inputs), *_simulate_cases(inputs)]


def _campaign_cases(folders: Iterable[Path]) -> Iterator[Case]:
    both = (("--json", ".json"), ("--model", ".model.json"))
    for folder in folders:
        words = (*_runs(folder), "--press", str(folder / "press.toml"))
        yield Case("diagnose", folder.name, ("diagnose", *words), both, quick=folder.name == "plain")
        yield Case("fit", folder.name, ("fit", *words), both, quick=folder.name in ("plain", "rig"))
        if folder.name == "conductivity":
            more = ("--shared", "h_ap", "--program", "platen_temperature_C=205")
            yield Case("fit", "conductivity_program", ("fit", *words, *more), both)
        if folder.name == "pine_moist":
            yield Case("diagnose", "pine_moist_until", ("diagnose", *words, "--until", "100"), both)
        if folder.name == "plain":
            more = ("--method", "nelder_mead_then_least_squares", "--averages")
            one = (words[0], "--press", words[-1], *more)
            yield Case("fit", "plain_paper", ("fit", *one), (("--json", ".json"),))


PREDICTED = (
    # campaign, which of its runs, model ("" none), --without, in the quick subset
    ("plain", 1, "", "", True),
    ("plain", 1, "fit", "", True),
    ("plain", 2, "diagnose", "", False),
    ("plain", 1, "fit", "top_*,bottom_*", False),
    ("moisture", 1, "fit", "", False),
    ("moisture", 1, "diagnose", "", True),
    ("moisture", 2, "fit", "top_*,bottom_*", True),
    ("moisture", 3, "fit", "closed", False),
    ("conductivity", 1, "fit", "", False),
    ("conductivity", 2, "diagnose", "", False),
    ("vapour", 1, "diagnose", "", False),
    ("vapour", 2, "fit", "", False),
    ("buildup", 1, "diagnose", "", False),
    ("lag", 1, "fit", "", False),
    ("lag", 2, "diagnose", "", False),
    ("fault", 1, "fit", "", False),
    ("fault", 2, "", "", False),
    ("platen", 1, "diagnose", "bottom_*", False),
    ("platen", 2, "diagnose", "", False),
    ("outside", 1, "diagnose", "", False),
    ("outside", 2, "", "top_1,top_2", False),
    ("pine_moist", 1, "diagnose", "", False),
    ("rig", 1, "fit", "", False),
)
SIMULATED = (
    # campaign, which of its runs, model ("" none, "coefficients" the flat file), in the quick subset
    ("plain", 1, "", True),
    ("plain", 1, "coefficients", True),
    ("plain", 2, "fit", False),
    ("moisture", 1, "fit", False),
    ("moisture", 1, "diagnose", True),
    ("conductivity", 1, "diagnose", False),
    ("vapour", 1, "diagnose", False),
    ("buildup", 1, "diagnose", False),
    ("lag", 1, "diagnose", False),
    ("fault", 1, "fit", False),
    ("platen", 1, "diagnose", False),
    ("outside", 1, "diagnose", False),
    ("rig", 1, "", True),
    ("rig", 2, "diagnose", False),
    ("pine_moist", 1, "diagnose", False),
    ("pine_dry", 1, "fit", False),
)


def _predict_cases(inputs: Path) -> Iterator[Case]:
    for campaign, number, model, without, quick in PREDICTED:
        words = _one_run(inputs, "predict", campaign, number, model)
        hidden = without.replace("*", "").replace(",", "+")
        name = "-".join(filter(None, (campaign, str(number), model or "no_model", hidden and f"without_{hidden}")))
        more = ("--without", without) if without else ()
        yield Case("predict", name, (*words, *more), (("--out", ".csv"),), quick)


def _simulate_cases(inputs: Path) -> Iterator[Case]:
    for campaign, number, model, quick in SIMULATED:
        words = _one_run(inputs, "simulate", campaign, number, model)
        yield Case("simulate", f"{campaign}-{number}-{model or 'no_model'}", words, (("--out", ".csv"),), quick)
    plain = _one_run(inputs, "simulate", "plain", 1, "coefficients")
    out = (("--out", ".csv"),)
    model = str(inputs / "models/plain.fit.json")
    yield Case("simulate", "refused-both", (*plain, "--model", model), out, quick=True)
    yield Case("simulate", "refused-no_file", ("simulate", "none.csv", *plain[2:]), out)
    other = ("--press", str(inputs / "campaigns/rig/press.toml"))
    yield Case("simulate", "refused-other_press", (*plain[:2], *other), out)
    yield Case(
        "simulate", "refused-model_of_other_press", (*plain[:4], "--model", model.replace("plain", "rig")), out
    )


def _runs(folder: Path) -> list[str]:
    return [str(path) for path in sorted(folder.glob("*.csv"))]


def _one_run(inputs: Path, command: str, campaign: str, number: int, model: str) -> tuple[str, ...]:
    folder = inputs / "campaigns" / campaign
    words = (command, _runs(folder)[number - 1], "--press", str(folder / "press.toml"))
    if model == "coefficients":
        return (*words, "--coefficients", str(inputs / "models/coefficients.json"))
    return (*words, "--model", str(inputs / f"models/{campaign}.{model}.json")) if model else words


# ---------------------------------------------------------------------------------------------------------- write


def write(folder: Path, inputs: Path, only: tuple[str, ...], quick: bool, jobs: int) -> int:
    """Write the answers of the code at hand; kinds may be added to a folder later. Returns 1 without a server."""
    before = _about(folder)
    there = [kind for kind in only if (folder / kind).exists()]
    if there or (before["kinds"] and before["quick"] != quick):
        text = f"{', '.join(there)} is there already" if there else "its answers are of the other kind of --quick"
        print(f"{folder}: {text}; give a new folder, so that no old answer stays in it", file=sys.stderr)
        return 2
    folder, inputs = folder.resolve(), inputs.resolve()
    asked = [case for case in cases(inputs) if case.kind in only and (case.quick or not quick)]
    for kind in only:
        (folder / kind).mkdir(parents=True)
    began, took = time.monotonic(), before["took_s"]
    with ThreadPoolExecutor(jobs) as pool:
        answering = pool.submit(_rest, folder / "rest", inputs / "store", quick) if "rest" in only else None
        for name, seconds in pool.map(lambda case: _run(case, folder, inputs), asked):
            took[name] = round(seconds, 2)
        if answering is not None:
            took["rest"] = round(answering.result(), 2)
    written = sorted(p.relative_to(folder).as_posix() for kind in KINDS for p in (folder / kind).glob("*"))
    seconds = round(time.monotonic() - began, 1)
    about = {
        "kinds": [*before["kinds"], *only],
        "quick": quick,
        "files": written,
        "commit": _commit(),
        "seconds": round(before["seconds"] + seconds, 1),
        "took_s": took,
    }
    (folder / ABOUT).write_text(json.dumps(about, indent=1), encoding="utf-8")
    print(f"{len(written)} answers in {folder} after {seconds} s")
    return 1 if "rest" in only and not any(name.startswith("rest/") for name in written) else 0


def _about(folder: Path) -> dict[str, Any]:
    if (folder / ABOUT).is_file():
        written: dict[str, Any] = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
        return written
    return {"kinds": [], "quick": False, "files": [], "seconds": 0.0, "took_s": {}}


def _run(case: Case, folder: Path, inputs: Path) -> tuple[str, float]:
    """Run one command; keep its files, its exit status and what it said."""
    stem = folder / case.kind / case.name
    outputs = [(option, Path(f"{stem}{ending}")) for option, ending in case.outputs]
    words = [*case.words, *(str(word) for pair in outputs for word in pair)]
    began = time.monotonic()
    try:
        done = subprocess.run(
            [sys.executable, "-m", "api", *words],
            capture_output=True,
            text=True,
            encoding="utf-8",
            env=os.environ | ALONE,
            timeout=LONGEST_S,
            check=False,
        )
        status, output, complained = done.returncode, done.stdout, done.stderr
    except subprocess.TimeoutExpired:
        status, output, complained = -1, "", f"killed after {LONGEST_S:g} s"

    def lines(text: str) -> list[str]:
        return text.replace(str(folder), "DIR").replace(str(inputs), "INPUTS").splitlines()

    answer = {"status": status, "said": lines(output), "complained": lines(complained)}
    answer["written"] = sum(path.exists() for _, path in outputs)
    Path(f"{stem}.said.json").write_text(json.dumps(answer, indent=1, ensure_ascii=False), encoding="utf-8")
    seconds = time.monotonic() - began
    print(f"{case.kind:9} {case.name:40} status {status}  {seconds:6.1f} s", flush=True)
    return f"{case.kind}/{case.name}", seconds


def _commit() -> str:
    done = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return done.stdout.strip()


# ----------------------------------------------------------------------------------------------------------- REST


def _rest(folder: Path, store: Path, quick: bool) -> float:
    """Serve a copy of the stored week and keep what every path answers."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="kerntemp-reference-", ignore_cleanup_errors=True) as copy:
        shutil.copytree(store, copy, dirs_exist_ok=True)
        command = [sys.executable, "-m", "api", "serve", "--config", f"{copy}/kerntemp.toml", "--port", "0"]
        with (Path(copy) / "serve.log").open("w+", encoding="utf-8") as log:
            server = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=log, text=True, env=os.environ | ALONE
            )
            watch = threading.Timer(LONGEST_S, server.kill)
            watch.start()
            try:
                line = server.stdout.readline() if server.stdout else ""
                found = re.search(r"http://\S+?(?=/?\s|/?$)", line)
                if found is None:
                    server.kill()
                    server.wait()
                    log.seek(0)
                    print(f"serve did not start: {line} {log.read()[-500:]}", file=sys.stderr)
                    return time.monotonic() - began
                _ask_all(found.group(), folder, quick)
            finally:
                watch.cancel()
                server.terminate()
                server.wait(30)
                if server.stdout:
                    server.stdout.close()
    print(f"rest      {len(list(folder.iterdir()))} paths", flush=True)
    return time.monotonic() - began


def _ask_all(address: str, folder: Path, quick: bool) -> None:
    def ask(name: str, path: str, shown: str = "/api/v1") -> Any:
        answer = _get(address + shown + path)
        kept = {"path": shown + path, **answer}
        text = json.dumps(kept, indent=0, ensure_ascii=False)
        (folder / f"{name}.json").write_text(text, encoding="utf-8")
        return answer["body"]

    _wait_until_ready(address)
    for name in ("health", "press", "channels", "coefficients", "models", "diagnoses", "events"):
        ask(name, f"/{name}")
    runs = ask("runs", "/runs?limit=200")["items"]
    presses = sorted({run["press"] for run in runs})
    chosen = []
    for press in presses:
        own = sorted(run["run"] for run in runs if run["press"] == press)
        chosen += own[:1] if quick else [own[0], own[len(own) // 2], own[-1]]
    for run in chosen:
        _ask_run(ask, run, quick)
    ask("drift", "/coefficients/drift")
    for version in sorted(model["version"] for model in ask("models-again", "/models?limit=200")["items"]):
        ask(f"model-{version}", f"/models/{_quoted(version)}")
    ask("metrics", "/metrics", "")
    ask("openapi", "/openapi.json")
    for name, path in (("page", "/"), ("docs", "/docs")):
        ask(name, path, "")
    for name, path in _FILTERS if not quick else _FILTERS[:3]:
        ask(name, path)
    for press in presses:
        for name in ("press", "channels", "coefficients", "coefficients/drift", "models", "diagnoses", "events"):
            ask(f"{name.replace('/', '_')}-of-{press}", f"/{name}?press={_quoted(press)}")
        cursor, number = "", 0
        while cursor is not None and number < 4:
            number += 1
            page = ask(f"runs-of-{press}-page-{number}", f"/runs?press={_quoted(press)}&limit=4&cursor={cursor}")
            cursor = page["next_cursor"]


_FILTERS = (
    ("refused-no_run", "/runs/none"),
    ("refused-unknown_query", "/runs?colour=red"),
    ("refused-no_model", "/models/none"),
    ("refused-no_number", "/runs/none/samples?from=early"),
    ("refused-page_size", "/runs?limit=0"),
    ("refused-no_path", "/nothing"),
    ("runs-closed", "/runs?status=closed&limit=3"),
    ("runs-open", "/runs?status=open"),
    ("runs-material", "/runs?material=MDF&limit=5"),
    ("runs-no_material", "/runs?material=paper"),
    ("runs-since", "/runs?from=2020-01-01T00:00:00Z&limit=5"),
    ("runs-until", "/runs?to=2020-01-01T00:00:00Z"),
    ("coefficients-page", "/coefficients?limit=3"),
    ("events-alarm", "/events?level=alarm"),
    ("events-warning", "/events?level=warning"),
    ("events-info", "/events?level=info&limit=20"),
    ("diagnoses-page", "/diagnoses?limit=1"),
)


def _ask_run(ask: Any, run: str, quick: bool) -> None:
    of = f"/runs/{_quoted(run)}"
    ask(f"run-{run}", of)
    questions = {
        "samples-part": "/samples?columns=platen_top,top_1,bottom_1&from=10&to=40",
        "samples-few": "/samples?max_points=100",
        "estimates": "/estimates",
        "fit": "/fit",
        "simulation": "/simulation",
        "figure": "/figure.svg",
    }
    if not quick:
        questions |= {
            "samples": "/samples",
            "samples-csv": "/samples?format=csv",
            "samples-parquet": "/samples?format=parquet&columns=top_1,bottom_1&max_points=50",
            "samples-no_column": "/samples?columns=nothing",
            "estimates-part": "/estimates?from=20&to=60&max_points=30",
        }
    for name, path in questions.items():
        ask(f"{name}-{run}", of + path)


def _quoted(word: str) -> str:
    return urllib.parse.quote(word, safe="")


def _wait_until_ready(address: str) -> None:
    for _ in range(240):
        try:
            if _get(f"{address}/api/v1/health")["status"] == 200:
                return
        except OSError:
            pass
        time.sleep(0.25)


def _get(url: str) -> dict[str, Any]:
    """Return status, media type and what of the body is an answer."""
    try:
        with urllib.request.urlopen(url, timeout=120) as reply:
            status, kind, body = reply.status, reply.headers.get_content_type(), reply.read()
    except urllib.error.HTTPError as error:
        status, kind, body = error.code, error.headers.get_content_type(), error.read()
    return {"status": status, "type": kind, "body": _body(url, kind, body)}


def _body(url: str, kind: str, body: bytes) -> Any:
    if url.endswith("/openapi.json"):
        return _outline(json.loads(body))
    if kind.endswith("json"):
        return json.loads(body)
    if "parquet" in kind:
        return _parquet(body)
    text = body.decode("utf-8")
    if kind == "text/csv":
        header = [line for line in text.splitlines() if line.startswith("#")]
        rows = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
        return {"header": _header(header), "columns": _table(rows)}
    if "svg" in kind:
        curves = re.findall(r'\bd="([^"]*)"', text)
        return {"curves": [[float(x) for x in re.findall(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", c)] for c in curves]}
    if url.endswith("/metrics"):
        pairs = (line.rpartition(" ") for line in text.splitlines() if line and not line.startswith("#"))
        return {name: float(value) for name, _, value in pairs}
    return None  # a page for people


def _header(lines: Iterable[str]) -> dict[str, Any]:
    pairs = (line.lstrip("# ").partition(" = ") for line in lines)
    return {key: _cell(value.strip('"')) for key, _, value in pairs}


def _outline(schema: dict[str, Any]) -> dict[str, Any]:
    """Return of an OpenAPI document paths, methods and the names of parameters."""
    paths = {
        path: {
            method: {p["name"]: p["in"] for p in operation.get("parameters", ())}
            for method, operation in methods.items()
            if isinstance(operation, dict)
        }
        for path, methods in schema["paths"].items()
    }
    return {"version": schema["info"]["version"], "paths": paths}


def _parquet(body: bytes) -> dict[str, Any]:
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(io.BytesIO(body))
    return {"columns": table.to_pydict()}


# -------------------------------------------------------------------------------------------------------- compare


@dataclass
class Verdict:
    """What comparing one file found."""

    file: str
    rtol: float
    atol: float
    values: int = 0
    ignored: int = 0
    worst: float = 0.0
    """Of the allowed difference: above 1 is beyond."""
    worst_shown: str = ""
    broken: list[str] = field(default_factory=list)
    texts: list[tuple[str, str, str]] = field(default_factory=list)
    added: list[str] = field(default_factory=list)

    def look(self, old: Any, new: Any, place: str = "", key: str = "") -> None:
        """Compare two values and all that is in them."""
        if any(re.search(f, self.file) and re.search(p, place) for f, p, _ in IGNORED):
            self.ignored += 1
        elif isinstance(old, dict) and isinstance(new, dict):
            self._look_into_table(old, new, place)
        elif isinstance(old, list) and isinstance(new, list):
            self._look_into_list(old, new, place, key)
        elif _is_number(old) and _is_number(new):
            self._look_at_numbers(float(old), float(new), place)
        elif isinstance(old, str) or key in SENTENCES:
            self.values += 1
            if old != new:
                self._text(_short(old), new, place, key)
        else:
            self.values += 1
            if old is not None or new is not None:
                self.broken.append(f"{place}: {_short(old)} -> {_short(new)}")

    def _look_into_table(self, old: dict[str, Any], new: dict[str, Any], place: str) -> None:
        dot = f"{place}." if place else ""
        for key, value in old.items():
            if key in new:
                self.look(value, new[key], dot + key, key)
            elif _is_text(value) or key in SENTENCES:
                self._text(_short(value), "gone", dot + key, key)
            else:
                self.look(value, "gone", dot + key, key)
        self.added += [dot + key for key in new if key not in old]

    def _look_into_list(self, old: list[Any], new: list[Any], place: str, key: str) -> None:
        if len(old) != len(new):
            if key in SENTENCES or (key not in NAMES and all(_is_text(x) for x in old) and old):
                self.texts.append((place, _short(old), _short(new)))
                return
            self.broken.append(f"{place}: {len(old)} entries -> {len(new)}")
        for i, (one, other) in enumerate(zip(old, new, strict=False)):
            self.look(one, other, f"{place}[{i}]", key)

    def _look_at_numbers(self, old: float, new: float, place: str) -> None:
        self.values += 1
        if old == new or (math.isnan(old) and math.isnan(new)):
            return
        apart = abs(old - new)
        excess = apart / max(self.atol + self.rtol * abs(old), 1e-300)
        if not math.isfinite(excess):
            excess = math.inf
        if excess > self.worst:
            relative = apart / abs(old) if old else math.inf
            self.worst = excess
            self.worst_shown = f"{apart:.3g} ({relative:.2g} of it) at {place}: {old!r} -> {new!r}"
        if excess > 1.0:
            self.broken.append(f"{place}: {old!r} -> {new!r}")

    def _text(self, old: str, new: Any, place: str, key: str) -> None:
        if INSTANT.match(old) or (key in NAMES and " " not in old):
            self.broken.append(f"{place}: name {old!r} -> {_short(new)}")
        else:
            self.texts.append((place, old, _short(new)))


def compare(old: Path, new: Path, rtol: float, atol: float, shown: int) -> int:
    """Print one table over all answers; return 1 where an answer is another one."""
    written = {path: json.loads((path / ABOUT).read_text(encoding="utf-8")) for path in (old, new)}
    names = set(written[old]["files"]) if not written[new]["quick"] else set(written[new]["files"])
    names = {name for name in names if name.partition("/")[0] in written[new]["kinds"]}
    if written[old]["quick"]:
        names &= set(written[old]["files"])
    surplus = set(written[new]["files"]) - set(written[old]["files"])
    verdicts = [_compare_file(old, new, name, rtol, atol) for name in sorted(names)]
    before, after = (f"{one} ({written[one]['commit']})" for one in (old, new))
    print(f"old {before}   new {after}   rtol {rtol:g}   atol {atol:g}")
    width = max((len(v.file) for v in verdicts), default=4)
    print(f"{'file':{width}} {'values':>8} {'beyond':>6} {'texts':>5} {'added':>5}  worst difference")
    for v in verdicts:
        mark = "!" if v.broken else " "
        row = f"{v.file:{width}} {v.values:8} {len(v.broken):6} {len(v.texts):5} {len(v.added):5}"
        print(f"{row} {mark}{v.worst_shown or '-'}")
    _print_more(verdicts, shown)
    wrong = [v for v in verdicts if v.broken]
    if left := len(set(written[old]["files"]) - names):
        print(f"{left} files of the old answers were not asked of the new code (--only, --quick)")
    if surplus:
        print(f"{len(surplus)} files only the new answers have: {', '.join(sorted(surplus)[:5])}")
    values, ignored = sum(v.values for v in verdicts), sum(v.ignored for v in verdicts)
    end = f"{len(wrong)} of {len(verdicts)} files DIFFER" if wrong else f"{len(verdicts)} files agree"
    print(f"{end}; {values} values compared, {ignored} ignored")
    return 1 if wrong or not verdicts else 0


def _print_more(verdicts: Iterable[Verdict], shown: int) -> None:
    for v in verdicts:
        if v.broken:
            print(f"\n{v.file}: {len(v.broken)} beyond")
            print("\n".join(f"    {line}" for line in v.broken[:10]))
    changed = Counter((o, n) for v in verdicts for _, o, n in v.texts)
    first: dict[tuple[str, str], str] = {}
    for v in verdicts:
        for place, o, n in v.texts:
            first.setdefault((o, n), f"{v.file} {place}")
    if changed:
        print(f"\n{sum(changed.values())} texts changed, {len(changed)} different ones:")
    for pair, times in changed.most_common(shown):
        print(f"  {times:5} x {_short(pair[0])} -> {_short(pair[1])}   ({first[pair]})")
    added = Counter(re.sub(r"\[\d+\]", "[]", place) for v in verdicts for place in v.added)
    if added:
        print(f"\nadded keys: {', '.join(f'{place} ({n})' for place, n in added.most_common(shown))}")


def _compare_file(old: Path, new: Path, name: str, rtol: float, atol: float) -> Verdict:
    found = Verdict(name, rtol, atol)
    if missing := [str(folder) for folder in (old, new) if not (folder / name).is_file()]:
        found.broken.append(f"missing in {', '.join(missing)}")
        return found
    found.look(_read(old / name), _read(new / name))
    return found


def _read(path: Path) -> Any:
    text = path.read_text(encoding="utf-8")
    return json.loads(text) if path.suffix == ".json" else _table(text)


def _table(text: str) -> dict[str, list[Any]]:
    rows = list(csv.reader(io.StringIO(text)))
    return {name: [_cell(row[i]) for row in rows[1:]] for i, name in enumerate(rows[0])} if rows else {}


def _cell(text: str) -> Any:
    """Return a cell as number or text; an empty one is missing.

    >>> _cell("1.5"), _cell("closed"), _cell("")
    (1.5, 'closed', None)
    """
    if not text:
        return None
    try:
        return float(text)
    except ValueError:
        return text


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float)  # True and False too: `converged`, `valid`


def _is_text(value: Any) -> bool:
    return isinstance(value, str) or (isinstance(value, list) and bool(value) and all(map(_is_text, value)))


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 160 else text[:157] + "..."


def main() -> int:
    """Read the call and do it."""
    parser = argparse.ArgumentParser(prog="python -m tests.reference_answers", description="Reference answers.")
    commands = parser.add_subparsers(dest="command", required=True)
    writing = commands.add_parser("write", help="ask the code at hand")
    writing.add_argument("folder", type=Path)
    writing.add_argument("--inputs", type=Path, default=INPUTS)
    writing.add_argument("--only", default=",".join(KINDS), help="kinds, comma between")
    writing.add_argument("--quick", action="store_true", help="a subset for in between")
    writing.add_argument("--jobs", type=int, default=2, help="commands at once")
    comparing = commands.add_parser("compare", help="hold two sets of answers against each other")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    comparing.add_argument("--rtol", type=float, default=1e-6)
    comparing.add_argument("--atol", type=float, default=1e-6)
    comparing.add_argument("--texts", type=int, default=40, help="how many changed texts to show")
    given = parser.parse_args()
    if given.command == "compare":
        return compare(given.old, given.new, given.rtol, given.atol, given.texts)
    only = tuple(kind for kind in KINDS if kind in given.only.split(","))
    if unknown := set(given.only.split(",")) - set(KINDS):
        parser.error(f"--only {', '.join(sorted(unknown))}: must be of {', '.join(KINDS)}")
    return write(given.folder, given.inputs, only, given.quick, given.jobs)


if __name__ == "__main__":
    sys.exit(main())
