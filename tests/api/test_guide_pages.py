"""The guide from the running server: every link leads somewhere, formulas are drawn, all of it from here."""

from __future__ import annotations

import posixpath
import re
from html import unescape
from urllib.parse import unquote, urljoin, urlsplit

import pytest

import daq
import softsensor
from api.cli import main
from api.guide import guide_files, guide_page

SOURCES = re.compile(r"""(?:src|href)=["']([^"'#]+)""")
LINKS, PLACES = re.compile(r"""href=["']([^"']*)["']"""), re.compile(r"""\b(?:id|name)=["']([^"']*)["']""")
LOADED = re.compile(r"""(?:src=["']|<link[^>]*href=["']|url\(["']?|@import ["'])(?!data:)([^"')]+)""")


@pytest.fixture(scope="module")
def pages(client):
    """Every page that is reached from the first by links, by address."""
    found, waiting = {}, ["/guide/"]
    while waiting:
        at = waiting.pop()
        answer = client.get(at)
        assert answer.status_code == 200, at
        found[at] = answer.text
        for link in SOURCES.findall(answer.text):
            target = urlsplit(urljoin(at, link))
            new = not target.netloc and target.path.startswith("/guide/") and target.path not in [*found, *waiting]
            if new and target.path != "/guide/":
                waiting.append(target.path)
    return found


def test_guide_gallery_and_reference_are_all_reached_from_the_first_page(pages):
    shared = daq.shared_files()
    wanted = [f"/guide/guide/{p.name}" for p in (shared / "guide").glob("*.md")]
    wanted += [f"/guide/gallery/{p.name}" for p in (shared / "gallery").glob("*.ipynb")]
    assert not {*wanted, "/guide/RUNBOOK.md", "/guide/reference/softsensor.html"} - set(pages)


def test_nothing_of_a_page_is_loaded_from_another_host(pages):
    loaded = {link for text in pages.values() for link in LOADED.findall(text) if re.match(r"(https?:)?//", link)}
    assert loaded == set()


def test_every_equation_is_drawn_and_none_is_left_as_text(pages):
    text = pages["/guide/guide/nomenclature.md"]
    assert text.count("<math") >= 30
    for number in range(1, 16):
        assert f"({number})" in text
    assert "$" not in re.sub(r"<(code|pre)\b.*?</\1>", "", text, flags=re.S)
    assert "merror" not in text
    assert "<math" in pages["/guide/gallery/own_effect.ipynb"]


def test_formulas_of_the_reference_are_drawn(pages):
    text = pages["/guide/reference/softsensor.html"]
    assert (
        text.count("<math")
        == sum((getattr(softsensor, name).__doc__ or "").count("$$") // 2 for name in softsensor.__all__)
        > 2
    )
    assert "$$" not in text
    assert "merror" not in text


def test_every_link_of_the_guide_leads_to_a_page_and_to_a_place_on_it():
    files = guide_files()
    places = {name: {unescape(found) for found in PLACES.findall(text)} for name, text in files.items()}
    broken = set()
    for name, text in files.items():
        for link in map(unescape, LINKS.findall(text)):
            page, _, place = link.partition("#")
            to = posixpath.normpath(posixpath.join(posixpath.dirname(name), unquote(page))) if page else name
            if re.match(r"[a-z]+:", link):
                continue
            if to not in files or (place and unquote(place) not in places[to]):
                broken.add((name, link))
    assert broken == set()


def test_the_reference_shows_what_a_public_class_has_from_one_that_is_not(pages):
    text = pages["/guide/reference/softsensor.html"]
    for name in ("SteamLimit.most_kPa", "SteamLimit.foreseen", "LiveSensor.forecast", "LiveSensor.look_ahead"):
        assert f'id="{name}"' in text, name


@pytest.mark.parametrize("package", [softsensor, daq])
def test_the_reference_holds_every_public_name_with_its_words(pages, package):
    text = pages[f"/guide/reference/{package.__name__}.html"]
    for name in package.__all__:
        assert f'id="{name}"' in text, name
        first = getattr(package, name).__doc__.split("\n")[0].split("`")[0].split("'")[0]
        assert first in text, name


def test_a_notebook_shows_what_its_cells_printed_and_drew(pages):
    text = pages["/guide/gallery/hidden_cause.ipynb"]
    assert "moisture_evaporation" in text
    assert 'src="data:image/png;base64,' in text


@pytest.mark.parametrize("path", ["nothing", "../pyproject.toml", "gallery/../../pyproject.toml", "systemd/x"])
def test_only_what_is_part_of_the_guide_is_shown(client, path):
    assert guide_page(path) is None
    assert client.get(f"/guide/{path}").status_code == 404


def test_the_guide_is_written_as_files_whose_links_all_lead_to_one(pages, tmp_path, capsys):
    folder = tmp_path / "to read"
    assert main(["guide", str(folder)]) == 0
    assert str(folder / "index.html") in capsys.readouterr().out
    files = {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}
    assert len(files) >= len(pages)
    for name in files:
        if name.endswith(".html"):
            text = (folder / name).read_text(encoding="utf-8")
            ours = [link for link in SOURCES.findall(text) if not re.match(r"[a-z]+:", link)]
            assert {urljoin(name, link) for link in ours} <= files, name
    assert main(["guide", str(folder)]) == 2
    assert "name a new folder" in capsys.readouterr().err
