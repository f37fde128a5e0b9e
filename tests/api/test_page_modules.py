"""The page's modules: their imports run one way, and each file they name is there."""

import re
from graphlib import TopologicalSorter
from pathlib import Path

PAGE = Path(__file__).parents[2] / "api" / "page"
IMPORT = re.compile(r'^import .*? from "(\.[^"]+)";$', re.MULTILINE)


def imports():
    return {
        file: {(file.parent / name).resolve() for name in IMPORT.findall(file.read_text("utf-8"))}
        for file in PAGE.rglob("*.js")
        if "vendor" not in file.parts
    }


def test_no_module_of_the_page_imports_itself_by_way_of_others():
    order = list(TopologicalSorter(imports()).static_order())  # raises CycleError, naming the circle
    assert order.index(PAGE / "words.js") < order.index(PAGE / "app.js")


def test_every_module_the_page_imports_is_there():
    found = imports()
    assert not [name for names in found.values() for name in names if name not in found]
    assert PAGE / "views" / "now.js" in found[PAGE / "app.js"]


def test_the_page_has_no_number_of_the_plant_or_the_charts_of_its_own():
    """What it may call seconds or kelvins is how it draws: what lies together, what is bridged, what shows."""
    named = re.compile(r"^(?:export )?const ([A-Z_]+_(?:C|K|S|RUNS)) = [0-9]", re.MULTILINE)
    own = {name for file in imports() for name in named.findall(file.read_text("utf-8"))}
    assert own == {"BRIDGE_S", "SHOWN_K", "STEP_S", "TOGETHER_S"}
