"""HTML report of a run: structure, agreement with the folder, behaviour in a browser."""

from __future__ import annotations

import importlib.resources
import json
import re
import shlex
import shutil
from functools import partial
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlosoptics import cli, load_result, report
from nlosoptics._html import tag
from nlosoptics.errors import SceneError
from nlosoptics.report.elements import number, quantity
from nlosoptics.scene import Scene

VOID = {"meta", "img", "source", "br"}
SECTIONS = ["scene", "plan", "spread", "image", "reconstruction", "times", "provenance"]


def call(*words: object) -> int:
    """Exit code of the program."""
    with pytest.raises(SystemExit) as ended:
        cli.main([str(word) for word in words])
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def run(examples: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a small run, named to do harm where names are not escaped."""
    place = tmp_path_factory.mktemp("report")
    shutil.copy(examples / "objects" / "F.png", place)
    scene = Scene.load(examples / "scenes" / "letter_wavy.toml").resized(64)
    scene.save(place / "small.toml")
    text = (place / "small.toml").read_text()
    (place / "small.toml").write_text(re.sub(r'image = ".*"', 'image = "F.png"', text))
    folder = place / "<script>alert(1)<b> & 'x'"
    assert call("run", place / "small.toml", "--seed", 3, "--out", folder) == 0
    return folder


@pytest.fixture
def copy(run: Path, tmp_path: Path) -> Path:
    """Such a folder, away from what the scene was made of, to be changed."""
    return Path(shutil.copytree(run, tmp_path / "copy"))


@pytest.fixture(scope="module")
def text(run: Path) -> str:
    """The page without its view in three dimensions."""
    return report.page(run, computed=False)


def edited(folder: Path, **changes: object) -> None:
    """Change what a folder's record says."""
    path = folder / "result.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


class Outline(HTMLParser):
    """Elements of a page in their order, and whether they close as they open."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, name: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((name, dict(attrs)))
        if name not in VOID:
            self._open.append(name)

    def handle_endtag(self, name: str) -> None:
        assert self._open.pop() == name

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] != "style":
            self.words.append(data)

    def named(self, *tags: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name in tags]


def told(text: str) -> str:
    """All words of a page."""
    return plain(" ".join(Outline(text).words))


def plain(text: str) -> str:
    """Words with single spaces between them, of whatever kind they were."""
    return " ".join(text.split())


@pytest.mark.thorough
def test_structure(text):
    outline = Outline(text)
    assert [a["id"] for a in outline.named("section")] == SECTIONS
    assert [a["href"] for a in outline.named("a")] == [f"#{name}" for name in SECTIONS]
    levels = [int(name[1]) for name, _ in outline.elements if re.fullmatch("h[1-6]", name)]
    assert levels.count(1) == 1
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert all(a["alt"] for a in outline.named("img"))
    assert len(outline.named("img")) == len(outline.named("figure")) == 5
    assert len(outline.named("figcaption")) == 5
    assert all(a["scope"] in ("col", "row") for a in outline.named("th"))
    names = [a["id"] for _, a in outline.elements if "id" in a]
    assert len(names) == len(set(names))


def test_nothing_is_loaded_from_elsewhere(text):
    for _, attributes in Outline(text).elements:
        for name in ("src", "href", "data", "poster", "action", "srcset"):
            assert attributes.get(name, "#").startswith(("data:", "#"))
    assert "url(" not in text
    assert "@import" not in text
    assert "<script" not in text
    policy = Outline(text).named("meta")[-1]["content"]
    assert "default-src 'none'" in policy
    assert "'unsafe-eval'" not in policy


@pytest.mark.thorough
def test_text_of_files_is_escaped(run, copy):
    title = report.page(run, computed=False).split("<title>")[1].split("</title>")[0]
    assert title.startswith("&lt;script&gt;alert(1)&lt;b&gt; &amp; &#x27;x&#x27;")
    bad = "<img src=x onerror=alert(1)>"
    record = json.loads((copy / "result.json").read_text())
    record["command_line"] = record["versions"]["numpy"] = bad
    record["figures"]["reconstruction_status"] = record["finished"] = bad
    edited(copy, **record)
    page = report.page(copy, computed=False)
    assert "<img src=x" not in page
    assert page.count("&lt;img src=x onerror=alert(1)&gt;") >= 4
    Outline(page)


def test_tells_what_the_result_says(run, text):
    record = json.loads((run / "result.json").read_text())
    result = load_result(run)
    words = told(text)
    figures = record["figures"]
    for stage in result.plan.stages:
        assert f"{stage.name} {stage.error}" in words
    for stage in result.plan.skipped:
        assert f"{stage.name} {stage.reason}" in words
    for noun in (result.scene, result.wavefront, result.point_spread, result.image):
        for name, value in noun._figures().rows.items():
            assert plain(f"{name} {value}") in words
    for name, version in record["versions"].items():
        assert f"{name} {version}" in words
    for name in record["files"]:
        assert name in words
    assert f"Correlation with the truth {number(figures['correlation_with_truth'])}" in words
    assert "Reconstruction: converged." in words
    assert record["scene_sha256"] in words
    assert record["command_line"] in words
    assert "seed 3, tol 0.001" in words
    assert record["finished"][:10] in words
    assert " ".join((run / "scene.toml").read_text().split()) in words


def test_each_accuracy_stands_beside_its_time(run, text):
    record = json.loads((run / "result.json").read_text())
    table = text.split("<caption>Run time and error of each stage")[1].split("</table>")[0]
    words = told(f"<table><caption>{table}</table>")
    error = plain(number(record["figures"]["errors"]["point spread"], 2))
    took = record["seconds"]["point spread"]
    assert f"point spread {took:.2f} {error}" in words
    assert f"whole run {record['seconds']['total']:.2f}" in words
    widths = [float(width) for width in re.findall(r"width: ([\d.]+)%", table)]
    stages = [value for name, value in record["seconds"].items() if name != "total"]
    # one decimal is written
    assert widths == pytest.approx([100 * s / max(stages) for s in stages], abs=0.051)


@pytest.mark.thorough
def test_the_command_it_gives_makes_the_run_again(run, text, tmp_path, monkeypatch):
    outline = Outline(text)
    words = " ".join(outline.words).split("To repeat it")[1].split("Versions")[0]
    program, *arguments = shlex.split(words)
    monkeypatch.chdir(run.parent)
    assert program == "nlosoptics"
    assert call(*arguments) == 0
    again = run.parent / f"{run.name}-again"
    for name in ("image.npz", "reconstruction.npz"):
        with np.load(run / name) as first, np.load(again / name) as second:
            key = "electrons" if name == "image.npz" else "object"
            np.testing.assert_array_equal(first[key], second[key])
    shutil.rmtree(again)


@pytest.mark.thorough
def test_folder_of_reconstruct(run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with np.load(run / "image.npz") as image:
        np.save("taken.npy", image["electrons"])
    command = ("reconstruct", "taken.npy", "--scene", run / "scene.toml", "--method", "wiener")
    assert call(*command) == 0
    assert call("report", "taken") == 0
    page = Path("taken/report.html").read_text(encoding="utf-8")
    words = told(page)
    assert [a["id"] for a in Outline(page).named("section")] == [
        "reconstruction",
        "times",
        "provenance",
    ]
    assert "reconstruction from camera images" in words
    assert "Method wiener" in words
    assert "gain" in words.split("Method wiener")[1]
    assert f"{shlex.join(map(str, command))}" in words
    # a new run takes the page away: it told of the one before
    assert call(*command) == 0
    assert not Path("taken/report.html").exists()
    assert call(*command) == 0
    edited(Path("taken"), status="running", figures={}, files=["result.json", "preview.png"])
    assert "Status: running." in told(report.page("taken"))


@pytest.mark.thorough
def test_folder_of_phasor(examples, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("objects/R.png", "scenes/camera_wu2024.toml"):
        shutil.copy(examples / name, tmp_path)
    scene = (examples / "scenes" / "transient_letter.toml").read_text()
    for old, new in (
        ("../objects/R.png", "R.png"),
        ("count = 32", "count = 8"),
        ('delta_t = "1 cm"', 'delta_t = "4 cm"'),
        ("n_bins = 370", "n_bins = 93"),
        ("12.5 cm", "60 cm"),
        ('step = "2 cm"', 'step = "20 cm"'),
    ):
        assert scene.count(old) == 1
        scene = scene.replace(old, new)
    Path("letter.toml").write_text(scene)
    assert call("transient", "letter.toml", "--tol", 0.1) == 0
    assert call("image", "letter.hdf5") == 0
    page = report.page("letter", computed=False)
    words = told(page)
    assert [a["id"] for a in Outline(page).named("section")] == ["volume", "times", "provenance"]
    assert len(Outline(page).named("img")) == 3
    record = json.loads(Path("letter/result.json").read_text())
    place = ", ".join(number(value) for value in record["figures"]["brightest_voxel"])
    assert f"The brightest voxel of the hidden scene is at ({place}) m." in words
    assert "Voxels 5 × 8 × 8" in words
    assert "confocal time gated" in words
    assert record["capture_sha256"] in words
    assert all(note in words for note in record["notes"])


def array_edited(folder: Path, file: str, name: str, change) -> None:
    with np.load(folder / file) as held:
        values = dict(held)
    values[name] = change(values[name])
    np.savez(folder / file, **values)


@pytest.mark.parametrize(
    "edit",
    [
        lambda folder: (folder / "image.npz").unlink(),
        lambda folder: edited(folder, format=99),
        lambda folder: edited(folder, command="phasor"),
        lambda folder: edited(folder, versions=[1]),
        lambda folder: edited(folder, figures=[1]),
        lambda folder: edited(folder, seconds=[1]),
        lambda folder: edited(folder, seconds={"total": "long"}),
        lambda folder: array_edited(folder, "image.npz", "signal", lambda a: a * np.nan),
        lambda folder: array_edited(folder, "image.npz", "signal", lambda a: a[:-3]),
        lambda folder: array_edited(folder, "point_spread.npz", "intensity", lambda a: a * np.nan),
        lambda folder: array_edited(folder, "point_spread.npz", "intensity", lambda a: a[:0]),
        lambda folder: array_edited(folder, "reconstruction.npz", "object", lambda a: a + np.inf),
    ],
)
def test_report_and_load_result_agree_on_edited_folders(edit, copy):
    edit(copy)
    for read in (load_result, partial(report.page, computed=False)):
        with pytest.raises(SceneError):
            read(copy)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ("missing", ["nowhere", "missing"]),
        ("empty", ["holds no result.json"]),
        ("not JSON", ["result.json", "JSON"]),
        ("no command", ["result.json", "command"]),
        ("no number", ["result.json", "seconds"]),
        ("not an array", ["image.npz", "damaged"]),
        ("other suffix", ["scene.toml", ".html"]),
    ],
)
def test_what_is_no_run_is_refused(change, named, copy, capsys):
    folder, options = copy, []
    if change == "missing":
        folder = copy / "nowhere"
    elif change == "empty":
        (copy / "result.json").unlink()
    elif change == "not JSON":
        (copy / "result.json").write_text("{")
    elif change == "no command":
        edited(copy, command="other")
    elif change == "no number":
        edited(copy, seconds={"total": "long"})
    elif change == "not an array":
        (copy / "image.npz").write_bytes(b"GIF")
    else:
        options = ["--out", copy / "scene.toml"]
    before = {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()}
    assert call("report", folder, "--no-3d", *options) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    for word in named:
        assert word in err
    assert {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()} == before


@pytest.mark.thorough
def test_a_run_may_replace_a_folder_that_has_its_page(copy, monkeypatch, capsys):
    monkeypatch.chdir(copy.parent)
    assert call("report", copy, "--no-3d") == 0
    size = (copy / "report.html").stat().st_size
    assert capsys.readouterr().out == f"{copy / 'report.html'}: {size / 1e6:.2g} MB\n"
    files = json.loads((copy / "result.json").read_text())["files"]
    assert files == sorted(p.name for p in copy.iterdir())
    assert call("report", copy, "--no-3d") == 0
    assert json.loads((copy / "result.json").read_text())["files"] == files
    assert call("run", "copy/scene.toml", "--no-reconstruct", "--out", "copy") == 0
    assert not (copy / "report.html").exists()
    assert "No object was reconstructed." in told(report.page(copy, computed=False))


@pytest.mark.parametrize(
    ("value", "digits", "expected"),
    [
        (0.0, 3, "0"),
        (1360.7, 3, "1360"),
        (99999, 3, "100000"),
        (336000, 3, "3.36 × 10⁵"),
        (1.648e-10, 2, "1.6 × 10⁻¹⁰"),
        (-737.2, 3, "−737"),
        (0.99952, 4, "0.9995"),
        (1e-3, 2, "0.001"),
        (9.96e-4, 2, "1 × 10⁻³"),
    ],
)
def test_numbers(value, digits, expected):
    assert plain(number(value, digits)) == expected


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [
        (4.33e-7, "m", "433 nm"),
        (0.0125, "m", "12.5 mm"),
        (0.9999, "s", "1 s"),
        (0.0, "m", "0 m"),
        (3e-18, "m", "3 × 10⁻⁶ pm"),
        (202_000, "B", "202 kB"),
    ],
)
def test_quantities(value, unit, expected):
    assert plain(quantity(value, unit)) == expected


def test_tag_escapes_all_but_html():
    inner = tag("b", "a < b", title='say "x"')
    assert tag("p", inner, "&", None, class_="y", hidden=True, id=None) == (
        '<p class="y" hidden><b title="say &quot;x&quot;">a &lt; b</b>&amp;</p>'
    )


@pytest.mark.thorough
def test_page_in_a_browser(page: Any, run: Path, tmp_path: Path) -> None:
    """It turns, asks for nothing, is no wider than its window, and hinders nobody seriously."""
    file = tmp_path / "report.html"
    file.write_text(report.page(run), encoding="utf-8")
    page.open(file)
    frame = page.driver.find_element("css selector", "iframe")
    page.driver.execute_script("arguments[0].scrollIntoView()", frame)
    page.driver.switch_to.frame(frame)
    page.wait("!!(document.querySelector('canvas') && camera)")
    page.driver.switch_to.default_content()
    before = page.picture()
    page.drag("iframe", 120, 40)
    changed = (abs(page.picture().astype(float) - before) > 30.0).any(axis=2)
    # what is drawn covers some tenths of the window, and its lines move
    assert changed.mean() > 0.02
    assert page.requests() == []
    for width in (320, 1000):
        screen = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 500}
        page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        wide = page.driver.execute_script("return document.documentElement.scrollWidth")
        assert wide <= width
    axe = importlib.resources.files(pytest.importorskip("axe_core_python")) / "axe.min.js"
    page.driver.set_script_timeout(200)
    page.driver.execute_script(axe.read_text(encoding="utf-8"))
    found = page.driver.execute_async_script(
        "axe.run(document, {iframes: false}).then(arguments[arguments.length - 1])"
    )
    serious = [r for r in found["violations"] if r["impact"] in ("serious", "critical")]
    assert serious == []
