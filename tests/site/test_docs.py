"""The documentation: its code runs, what it names is there, and its generated pages are whole."""

from __future__ import annotations

import importlib
import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from nlosoptics.scene import OrenNayar

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(
    path
    for path in DOCS.rglob("*.md")
    if not {"_generated", "gallery"} & {*path.relative_to(DOCS).parts}
)


@pytest.fixture
def extension(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], ModuleType]]:
    """Import a file of the documentation's own, by its name."""
    monkeypatch.syspath_prepend(str(DOCS / "_ext"))
    monkeypatch.syspath_prepend(str(DOCS))
    before = set(sys.modules)
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if Path(getattr(sys.modules[name], "__file__", None) or "").is_relative_to(DOCS):
            del sys.modules[name]


@pytest.mark.thorough
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_code_runs(page: Path, tmp_path: Path, extension: Callable[[str], ModuleType]) -> None:
    """Commands and Python in the order of the page, as the site shows their outputs."""
    for _ in extension("outputs").blocks(page.read_text(), tmp_path):
        pass


def test_study_of_the_page_gains_by_light(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code_blocks: Callable[[Path, str], list[str]]
) -> None:
    """A fit that is not told of the wall's diffuse light gets worse with more light."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(code_blocks(DOCS / "howto" / "run_a_study.md", "python")[0], names)
    dim, bright = (
        [row["correlation"] for row in names["rows"] if row["power"] == power]
        for power in (0.5e-3, 5e-3)
    )
    assert min(bright) > max(dim) > 0.99


def test_every_block_has_a_language_that_is_run_or_known() -> None:
    """A block in a language of another name would be passed over."""
    known = {"python", "console", "toml", "json", "text"}
    known |= {"toctree", "contents", "include", "eval-rst", "glossary", "image", "raw"}
    for page in PAGES:
        found = re.findall(r"^```\{?([\w-]*)", page.read_text(), re.MULTILINE)
        assert set(found[::2]) <= known, page


def test_commands_name_files_that_are_there() -> None:
    listed = [
        (page, word)
        for page in [*PAGES, *(DOCS / "_ext" / "performance").glob("*.py")]
        for word in re.findall(r"\b(?:benchmarks|examples|tests)/[\w/.-]+\w", page.read_text())
    ]
    assert len(listed) > 50
    assert [(page, word) for page, word in listed if not (ROOT / word).exists()] == []


def test_tests_that_pages_name_are_there() -> None:
    """``tests/x/test_y.py::test_z``, or ``::test_z`` alone for the file named last."""
    named = 0
    for page in PAGES:
        file = ""
        for path, test in re.findall(r"`(tests/[\w/]+\.py)?::(\w+)`", page.read_text()):
            file = path or file
            source = (ROOT / file).read_text()
            assert re.search(rf"^def {test}\(", source, re.MULTILINE), (page, file, test)
            named += 1
    assert named > 30


def test_material_models_that_pages_name_exist() -> None:
    page = ROOT / "docs" / "theory" / "image.md"
    named = set(re.findall(r'`model="([\w-]+)"`', page.read_text()))
    assert {OrenNayar(0.5, 0.3, model=name).model for name in named} == named == {"fit", "full"}


def test_every_reference_is_held_by_a_test(extension: Callable[[str], ModuleType]) -> None:
    page = extension("validation_page")
    assert {path.name for path in (ROOT / "tests" / "truths").glob("*.json")} == set(page.TITLES)
    text = page.text()
    for path in (ROOT / "tests" / "truths").glob("*.json"):
        for name in page.references(path):
            assert f"| {name.replace('_', ' ')} |" in text
    rows = [{"formula": "", "source": "", "tolerance": ""}]
    with pytest.raises(LookupError, match="which no test reads"):
        page.reference_table({"a": rows, "unread": rows}, {"tests/test_x.py": "a"})


@pytest.mark.thorough
def test_every_benchmark_is_on_the_page(
    extension: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = extension("performance")
    page.pages(tmp_path)
    text = (tmp_path / "performance.md").read_text()
    sections = re.split(r"^### ", text, flags=re.MULTILINE)[1:]
    assert len(sections) == sum(map(len, page.ROOMS.values())) == text.count("$ ")
    assert all("\n| --- |" in section for section in sections)
    for picture in re.findall(r"\(_generated/([\w.]+)\)", text):
        assert (tmp_path / picture).stat().st_size > 10_000
    monkeypatch.setitem(page.ROOMS, "Ray tracing", page.ROOMS["Ray tracing"][1:])
    with pytest.raises(LookupError, match=r"differ in \['traces\.json'\]"):
        page.pages(tmp_path)


def test_templates_of_the_tables(extension: Callable[[str], ModuleType]) -> None:
    """Words apply from left to right; only a name with a question mark may be missing."""
    cells = extension("performance.cells")
    row = {"share": 0.12345, "bytes": [2**20, 2**21], "label": "11 modes, 1 modes, 1 processes"}
    for template, text in (
        ("{share:percent .3g} %", "12.3 %"),
        ("{bytes:last MiB n}", "2"),
        ("{label}", "11 modes, 1 mode, 1 process"),
        ("{gone?:time}", ""),
    ):
        assert cells.fill(template, row) == text
    with pytest.raises(KeyError, match="gone"):
        cells.fill("{gone:time}", row)


def test_site_is_whole(extension: Callable[[str], ModuleType], tmp_path: Path) -> None:
    """The walk over the built site sees what is wrong; a site that is there has nothing wrong."""
    check = extension("check_site")
    (tmp_path / "a.html").write_text('<h1 id="top">A</h1><a href="b.html#there">b</a>')
    (tmp_path / "b.html").write_text('<p id="there"><a href="a.html">a</a>')
    assert check.faults(tmp_path) == []
    (tmp_path / "style.css").write_text("p { background: url('https://x.org/x.png') }")
    (tmp_path / "c.html").write_text(
        '<a href="gone.html">x</a><a href="a.html#gone">x</a><img src="a.html">'
        '<script src="//x.org/x.js"></script><a href="https://x.org">may lead away</a>'
    )
    assert check.faults(tmp_path) == [
        "c.html: picture a.html has no alt text",
        "c.html: fetches //x.org/x.js",
        "c.html: gone.html is not there",
        "c.html: a.html#gone has no such anchor",
        "style.css: fetches https://x.org/x.png",
    ]
    built = ROOT / "out" / "docs"
    if built.is_dir():
        assert check.faults(built) == []


def test_notebooks_are_the_pages_whose_code_is_run(
    extension: Callable[[str], ModuleType],
) -> None:
    """The notebooks hold the code of the doors; `python docs/notebooks.py` writes them."""
    fence = extension("outputs").FENCE
    for path, text in extension("notebooks").texts().items():
        assert path.read_text() == text, path
        cells = json.loads(text)["cells"]
        code = "".join(cell["source"] for cell in cells if cell["cell_type"] == "code")
        page = (DOCS / "doors" / f"{path.stem}.md").read_text()
        blocks = [code for language, code in fence.findall(page) if language != "toml"]
        plain = re.sub(r"[\s\\>]|^\$ ", "", "".join(blocks), flags=re.MULTILINE)
        assert re.sub(r"[\s\\>!]", "", code) == plain.replace("!", "")
        links = re.findall(r"\]\((\.\./[^)#]*)", "".join(c["source"] for c in cells))
        assert [link for link in links if not (path.parent / link).exists()] == []
