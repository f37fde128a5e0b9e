"""The guide as pages: what ships with the package, rendered when it is asked for and never fetched from elsewhere.

Markdown by markdown-it, formulas as MathML, the gallery's notebooks with what their cells printed and drew, the
public faces of `softsensor` and `daq` by pdoc. Addresses are the files' places among `daq.shared_files`, so that
links between them hold here, in the sources and on disk alike. (2026-11-22: on demand rather than at build time,
because the reference is read from the installed code, which a build has not got.)
"""

from __future__ import annotations

import html
import json
import posixpath
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import urljoin, urlsplit

from daq.shared import shared_files

FOLDERS = ("gallery", "guide", "mappings", "presses", "resins", "samples")
"""Of what is shipped, shown; the runbook stands beside them."""
REFERENCE = ("softsensor", "daq")
_LINK = re.compile(r"""href=["'](?!https?:|data:|mailto:|#)([^"'#]*)""")
_SHELL = Path(__file__).parent / "page" / "guide.html"
_STATIC = ("icon.svg", "style.css")
"""What pages load from beside them."""


@cache
def guide_page(path: str) -> str | None:
    """Return a page of the guide as HTML, by its address below ``guide/``; None where there is none."""
    depth = "../" * path.count("/")
    if path == "":
        return _page("Guide and reference", _contents(), depth)
    if path.startswith("reference/"):
        return _reference(path)
    file = _shown(path)
    if file is None:
        return None
    if file.is_dir():
        return _page(
            file.name, f"<h1>{file.name}</h1>{_links([(f'{path}/{p.name}', p.name) for p in _files(file)])}", ""
        )
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".md":
        return _page(_title(text), _markdown(text, path), depth)
    if file.suffix == ".ipynb":
        return _page(_notebook_title(file), _notebook(text, path), depth)
    return _page(file.name, f"<h1>{html.escape(file.name)}</h1><pre>{html.escape(text)}</pre>", depth)


def guide_files() -> dict[str, str]:
    """Return every page of the guide, gallery and reference by the name of a file, to be read without a server.

    Links lead from file to file; begin with ``index.html``.
    """
    pages: dict[str, str] = {}
    waiting = {""}
    while waiting:
        path = waiting.pop()
        if (page := guide_page(path)) is not None:
            pages[path] = page
            waiting |= {to for link in _LINK.findall(page) if (to := _leads_to(path, link)) not in pages}
    drawn = {_file(path): _among_files(path, page, pages) for path, page in pages.items()}
    return drawn | {name: (_SHELL.parent / name).read_text(encoding="utf-8") for name in _STATIC}


def _leads_to(path: str, link: str) -> str:
    """Return which page a page's link leads to; the first one where it leaves the guide."""
    target = urljoin(f"/guide/{path}", link)
    return target.removeprefix("/guide/") if target.startswith("/guide/") else ""


def _file(path: str) -> str:
    """Return the file of a page: browsers take for one only what is called so."""
    return "index.html" if path == "" else path if path.endswith(".html") else f"{path}.html"


def _among_files(path: str, page: str, pages: Mapping[str, str]) -> str:
    folder = posixpath.dirname(path) or "."

    def filed(link: re.Match[str]) -> str:
        to, name = _leads_to(path, link[1]), posixpath.basename(link[1])
        target = name if name in _STATIC else _file(to if to in pages else "")
        return f'href="{posixpath.relpath(target, folder)}'

    return _LINK.sub(filed, page)


def _shown(path: str) -> Path | None:
    """Return the file or folder at an address, None where the guide does not show it."""
    root = shared_files().resolve()
    file = (root / path).resolve()
    inside = file.relative_to(root).parts if root in file.parents else ("",)
    known = (inside[0] in FOLDERS or inside == ("RUNBOOK.md",)) and "/".join(inside) == path
    return file if known and file.exists() else None


def _files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.is_file())


def _links(entries: Sequence[tuple[str, str]]) -> str:
    return "<ul>" + "".join(f'<li><a href="{at}">{html.escape(text)}</a></li>' for at, text in entries) + "</ul>"


def _page(title: str, body: str, depth: str) -> str:
    return Template(_SHELL.read_text(encoding="utf-8")).substitute(
        title=html.escape(title), body=body, guide=depth or "./", root=f"{depth}../"
    )


def _contents() -> str:
    root = shared_files()
    guide = [
        (f"guide/{p.name}", _title(p.read_text(encoding="utf-8"))) for p in sorted((root / "guide").glob("*.md"))
    ]
    gallery = [(f"gallery/{p.name}", _notebook_title(p)) for p in sorted((root / "gallery").glob("*.ipynb"))]
    reference = [(f"reference/{name}.html", f"import {name}") for name in REFERENCE]
    sections = {
        "Guide": [*guide, ("RUNBOOK.md", "Runbook")],
        "Gallery: notebooks that run from sample data": gallery,
        "Reference of the Python packages": reference,
    }
    lists = "".join(f"<h2>{head}</h2>{_links(of)}" for head, of in sections.items())
    return f"<h1>Guide and reference</h1>{lists}"


def _title(text: str) -> str:
    return text.split("\n", 1)[0].lstrip("# ").strip()


def _notebook_title(file: Path) -> str:
    cell = json.loads(file.read_text(encoding="utf-8"))["cells"][0]
    return _title("".join(cell["source"]))


@cache
def _reader() -> Any:
    from latex2mathml.converter import convert
    from markdown_it import MarkdownIt
    from mdit_py_plugins.anchors import anchors_plugin
    from mdit_py_plugins.dollarmath import dollarmath_plugin

    def formula(text: str, options: Mapping[str, bool]) -> str:
        return str(convert(text, display="block" if options["display_mode"] else "inline"))

    def number(label: str) -> str:
        return f'<a class="eqno" href="#{label}">({label})</a>'

    reader = MarkdownIt("commonmark", {"highlight": _coloured}).enable("table")
    return reader.use(dollarmath_plugin, renderer=formula, label_renderer=number).use(anchors_plugin, max_level=3)


def _markdown(text: str, path: str) -> str:
    """Render Markdown, pictures within it; a link to what the guide does not show (a source) is left as text."""

    def kept(link: re.Match[str]) -> str:
        target = urlsplit(urljoin(path, link[1]))
        return link[0] if target.netloc or _shown(target.path) else link[2]

    def drawn(picture: re.Match[str]) -> str:
        file = shared_files() / urljoin(path, picture[1])
        return f'src="data:image/png;base64,{b64encode(file.read_bytes()).decode()}"'

    rendered = re.sub(r'src="([^":]*\.png)"', drawn, str(_reader().render(text)))
    return re.sub(r'<a href="([^"]*)">(.*?)</a>', kept, rendered, flags=re.S)


def _coloured(source: str, language: str, _: str = "") -> str:
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import get_lexer_by_name
    from pygments.util import ClassNotFound

    try:
        lexer = get_lexer_by_name(language)
    except ClassNotFound:
        return ""
    coloured = highlight(source, lexer, HtmlFormatter(noclasses=True, nowrap=True, style="xcode"))
    return str(coloured)


def _notebook(text: str, path: str) -> str:
    parts = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(_markdown(source, path))
        else:
            parts.append(f"<pre><code>{_coloured(source, 'python')}</code></pre>")
            parts += [_output(output) for output in cell["outputs"]]
    return "\n".join(parts)


def _output(output: Mapping[str, Any]) -> str:
    if output["output_type"] == "stream":
        return f'<pre class="said">{html.escape("".join(output["text"]))}</pre>'
    data = output.get("data", {})
    if "image/png" in data:
        drawn = "".join(data["image/png"]).strip()
        return f'<img alt="What the cell above draws" src="data:image/png;base64,{drawn}">'
    if "text/html" in data:
        return f'<div class="said">{"".join(data["text/html"])}</div>'
    return f'<pre class="said">{html.escape("".join(data.get("text/plain", "")))}</pre>'


def _reference(path: str) -> str | None:
    name = path.removeprefix("reference/").removesuffix(".html")
    if name not in (*REFERENCE, "index"):
        return None
    if name == "index":
        return _page("Guide and reference", _contents().replace('href="', 'href="../'), "../")
    import pdoc.doc
    import pdoc.render

    modules = {}
    for known in REFERENCE:
        module = import_module(known)
        for public in module.__all__:
            getattr(module, public)
        modules[known] = pdoc.doc.Module(module)
        for shown in modules[known].classes:
            _take_in(shown)
    pdoc.render.configure(docformat="numpy", search=False, show_source=False, footer_text="Kerntemp")
    return _FORMULA.sub(_drawn_formula, str(pdoc.render.html_module(modules[name], modules)))


def _take_in(shown: Any) -> None:
    """Let what a public class has from a class within the packages stand among its own: nothing else shows it."""
    for member in shown.members.values():
        if member.taken_from[0].partition(".")[0] in REFERENCE:
            member.taken_from = (shown.modulename, member.qualname)


_FORMULA = re.compile(r"\$\$([^$]+)\$\$")


def _drawn_formula(found: re.Match[str]) -> str:
    """Return a formula of a docstring as MathML, as those of the guide are."""
    from latex2mathml.converter import convert

    return str(convert(html.unescape(found[1]), display="block"))
