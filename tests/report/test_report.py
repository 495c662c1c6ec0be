"""HTML report of a run: structure, agreement with the folder, behaviour in a browser."""

from __future__ import annotations

import base64
import errno
import importlib.resources
import io
import json
import re
import shlex
import shutil
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from nlosoptics import cli, limits, report, views
from nlosoptics._html import tag
from nlosoptics.errors import MissingExtraError
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
    return report.page(run, interactive=False)


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


def test_structure(text):
    outline = Outline(text)
    assert [a["id"] for a in outline.named("section")] == SECTIONS
    assert [a["href"] for a in outline.named("a")] == [f"#{name}" for name in SECTIONS]
    levels = [int(name[1]) for name, _ in outline.elements if re.fullmatch("h[1-6]", name)]
    assert levels.count(1) == 1
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert all(a["alt"] for a in outline.named("img"))
    assert len(outline.named("img")) == len(outline.named("figure")) == 6
    assert len(outline.named("figcaption")) == 6
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


def test_text_of_files_is_escaped(run, copy):
    title = report.page(run, interactive=False).split("<title>")[1].split("</title>")[0]
    assert title.startswith("&lt;script&gt;alert(1)&lt;b&gt; &amp; &#x27;x&#x27;")
    bad = "<img src=x onerror=alert(1)>"
    record = json.loads((copy / "result.json").read_text())
    record["plan"]["skipped"][0]["reason"] = record["command_line"] = bad
    record["figures"]["point_spread_reason"] = record["versions"]["numpy"] = bad
    record["figures"]["stop"] = record["figures"]["reconstruction_status"] = bad
    edited(copy, **record)
    (copy / "scene.toml").write_text(f"# {bad}</pre>")
    page = report.page(copy, interactive=False)
    assert "<img src=x" not in page
    assert page.count("&lt;img src=x onerror=alert(1)&gt;") >= 7
    Outline(page)


def test_tells_what_the_record_says(run, text):
    record = json.loads((run / "result.json").read_text())
    words = told(text)
    figures = record["figures"]
    for stage in record["plan"]["stages"] + record["plan"]["skipped"]:
        assert f"{stage['name']} {stage['reason']}" in words
    for stage in record["plan"]["stages"]:
        assert stage["error"] in words
    for name, version in record["versions"].items():
        assert f"{name} {version}" in words
    for name in record["files"]:
        assert name in words
    assert figures["point_spread_reason"] in words
    assert figures["point_spread_regime"]["rms"] == pytest.approx(
        figures["aberration_rms_waves"], rel=0.02
    )
    assert f"Aberration, rms {number(figures['point_spread_regime']['rms'])} waves" in words
    assert f"truth: {number(figures['correlation_with_truth'], 4)}." in words
    assert "The reconstruction converged." in words
    assert record["scene_sha256"] in words
    assert record["command_line"] in words
    assert "seed 3, tol 0.001" in words
    assert record["finished"][:10] in words
    assert " ".join((run / "scene.toml").read_text().split()) in words


def test_truth_and_reconstruction_say_their_size_on_the_object(run, text):
    scene = Scene.load(run / "scene.toml")
    pixel = 1e3 * limits.object_scale(scene) * scene.camera.image_pitch
    rows, columns = (n * pixel for n in scene.camera.shape)
    size = f"{number(columns)} × {number(rows)} mm on the object."
    assert told(text).count(size) == 2


def test_each_accuracy_stands_beside_its_time(run, text):
    record = json.loads((run / "result.json").read_text())
    table = text.split("Accuracy and run time of each stage")[1].split("</table>")[0]
    words = told(f"<table><caption>{table}</table>")
    error = plain(number(record["figures"]["errors"]["point spread"], 2))
    took = record["seconds"]["point spread"]
    assert f"point spread {took:.2f} {error} of the peak 0.001 of the peak" in words
    assert f"whole run {record['seconds']['total']:.2f}" in words
    widths = [float(width) for width in re.findall(r"width: ([\d.]+)%", table)]
    stages = [value for name, value in record["seconds"].items() if name != "total"]
    # one decimal is written
    assert widths == pytest.approx([100 * s / max(stages) for s in stages], abs=0.051)


def embedded(text: str, alt: str) -> np.ndarray:
    """Grey values of the page's picture with such a text."""
    found = [a["src"] for a in Outline(text).named("img") if alt in (a["alt"] or "")]
    assert len(found) == 1
    data = base64.b64decode(str(found[0]).removeprefix("data:image/png;base64,"))
    return np.asarray(Image.open(io.BytesIO(data))).astype(float)


def test_pictures_are_the_arrays(run, text):
    with np.load(run / "image.npz") as image, np.load(run / "reconstruction.npz") as found:
        electrons, truth, made = image["electrons"], image["ideal"], found["object"]
    span = electrons.max() - electrons.min()
    for alt, values in (
        ("Camera image", (electrons - electrons.min()) / span),
        ("without blur", truth[:, ::-1] / truth.max()),
        ("Reconstructed", made[:, ::-1] / max(1.0, made.max())),
    ):
        # half a grey level
        assert embedded(text, alt) == pytest.approx(255 * np.clip(values, 0, 1), abs=0.501)


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


def test_large_pictures_are_drawn_as_means(copy):
    with np.load(copy / "image.npz") as held:
        values = dict(held)
    for name in ("electrons", "ideal"):
        values[name] = np.kron(values[name], np.ones((32, 32)))
    np.savez(copy / "image.npz", **values)
    page = report.page(copy, interactive=False)
    assert embedded(page, "Camera image").shape == (1024, 1024)
    assert "2048 × 2048 pixels, drawn as means of 2 × 2." in told(page)
    assert len(page) < 8e6


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
    assert "gain" in words.split("Fitted parameters")[1]
    assert f"{shlex.join(map(str, command))}" in words
    # a new run takes the page away: it told of the one before
    assert call(*command) == 0
    assert not Path("taken/report.html").exists()
    assert call(*command) == 0
    edited(Path("taken"), status="running", figures={}, files=["result.json", "preview.png"])
    assert "is still running or was killed" in told(report.page("taken"))
    assert "Object so far." in report.page("taken")


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
    assert call("phasor", "letter.hdf5") == 0
    page = report.page("letter", interactive=False)
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


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ("missing", ["nowhere", "missing"]),
        ("file", ["result.json", "no folder"]),
        ("empty", ["holds no result.json"]),
        ("not JSON", ["result.json", "JSON"]),
        ("other program", ["program", "nlosoptics"]),
        ("not a number", ["figures.f_number", "finite"]),
        ("no number", ["seconds.total", "number"]),
        ("no command", ["command", "required"]),
        ("not a picture", ["scene.png", "no PNG"]),
        ("not an array", ["image.npz", "cannot be read"]),
        ("lacks an array", ["image.npz", "pitch"]),
        ("other suffix", ["scene.toml", ".html"]),
        ("no place", ["nowhere", "no folder"]),
        ("a folder", ["x.html", "is a folder"]),
    ],
)
def test_what_is_no_run_is_refused(change, named, copy, capsys):
    folder, options = copy, []
    record = json.loads((copy / "result.json").read_text())
    if change == "missing":
        folder = copy / "nowhere"
    elif change == "file":
        folder = copy / "result.json"
    elif change == "empty":
        (copy / "result.json").unlink()
    elif change == "not JSON":
        (copy / "result.json").write_text("{")
    elif change == "other program":
        edited(copy, program="other")
    elif change == "not a number":
        edited(copy, figures=record["figures"] | {"f_number": float("nan")})
    elif change == "no number":
        edited(copy, seconds={"total": "long"})
    elif change == "no command":
        del record["command"]
        (copy / "result.json").write_text(json.dumps(record))
    elif change == "not a picture":
        (copy / "scene.png").write_bytes(b"GIF")
    elif change == "not an array":
        (copy / "image.npz").write_bytes(b"GIF")
    elif change == "lacks an array":
        np.savez(copy / "image.npz", electrons=np.ones((2, 2)), exposure=1.0)
    elif change == "other suffix":
        options = ["--out", copy / "scene.toml"]
    elif change == "no place":
        options = ["--out", copy / "nowhere" / "x.html"]
    else:
        (copy / "x.html").mkdir()
        options = ["--out", copy / "x.html"]
    before = {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()}
    assert call("report", folder, "--no-3d", *options) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    for word in named:
        assert word in err
    assert {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()} == before


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
    assert "No object was reconstructed." in told(report.page(copy, interactive=False))


def test_page_elsewhere_leaves_the_folder_alone(copy):
    before = {p: p.read_bytes() for p in copy.iterdir()}
    assert call("report", copy, "--no-3d", "--out", copy.parent / "x.html") == 0
    assert {p: p.read_bytes() for p in copy.iterdir()} == before
    page = (copy.parent / "x.html").read_text(encoding="utf-8")
    assert page == report.page(copy, interactive=False)


def test_page_is_written_whole_or_not_at_all(copy, monkeypatch, capsys):
    (copy / "report.html").write_text("old")
    before = sorted(copy.iterdir())

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "disk full")

    monkeypatch.setattr(Path, "replace", full)
    assert call("report", copy, "--no-3d", "--out", copy.parent / "x.html") == 2
    assert "disk full" in capsys.readouterr().err
    assert call("report", copy, "--no-3d") == 2
    assert sorted(copy.iterdir()) == before
    assert (copy / "report.html").read_text() == "old"
    assert sorted(p.name for p in copy.parent.iterdir()) == ["copy"]


def refusing(reason: str) -> Any:
    """A function that lacks a package."""

    def refuse(*_: object, **__: object) -> None:
        raise MissingExtraError(reason)

    return refuse


def test_a_moved_folder_keeps_its_view(run, copy):
    page = report.page(copy)
    assert len(Outline(page).named("iframe")) == 1
    assert "left out:" not in page
    held, moved = (Scene.load(folder / "scene.toml") for folder in (run, copy))
    np.testing.assert_array_equal(moved.hidden.reflectance, held.hidden.reflectance)


def test_what_cannot_be_drawn_is_told(copy, monkeypatch):
    monkeypatch.setattr(views, "save", refusing("no OpenGL"))
    outline = Outline(report.page(copy))
    (frame,) = outline.named("iframe")
    assert "<canvas" in frame["srcdoc"] or "THREE" in frame["srcdoc"]
    assert "because this machine cannot render it" in plain(" ".join(outline.words))
    monkeypatch.setattr(views, "ray_paths", refusing("pyvista is not installed <here>"))
    page = report.page(copy)
    assert "left out: pyvista is not installed &lt;here&gt;." in page
    assert "<iframe" not in page
    (copy / "hidden_image.png").unlink()
    words = told(report.page(copy))
    assert "hidden_image.png" in words.split("left out:")[1].split("From above")[0]


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


@pytest.fixture(scope="module")
def shown(page: Any, run: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The page in a browser, in three dimensions where that can be drawn."""
    file = tmp_path_factory.mktemp("shown") / "report.html"
    file.write_text(report.page(run), encoding="utf-8")
    page.open(file)
    return page


@pytest.fixture
def looked_at(shown: Any) -> Any:
    """The page in a window of 1000 pixels, light, on top."""
    emulate(shown, 1000, 700, "light")
    shown.driver.execute_script("scrollTo(0, 0)")
    return shown


def emulate(page: Any, width: int, height: int, scheme: str, media: str = "screen") -> None:
    """Show a page on a screen of a size, in light or dark."""
    page.driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500},
    )
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    page.driver.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"media": media, "features": features}
    )


def test_turns_in_three_dimensions_and_asks_for_nothing(looked_at):
    page = looked_at
    frame = page.driver.find_element("css selector", "iframe")
    page.driver.execute_script("arguments[0].scrollIntoView()", frame)
    page.driver.switch_to.frame(frame)
    assert page.wait("document.body.dataset.ready") == "yes"
    page.driver.switch_to.default_content()
    before = page.picture()
    page.drag("iframe", 120, 40)
    changed = (abs(page.picture().astype(float) - before) > 30.0).any(axis=2)
    # what is drawn covers some tenths of the window, and its lines move
    assert changed.mean() > 0.02
    assert page.complaints() == []
    assert page.requests() == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_serious_is_in_the_way_of_anyone(scheme, looked_at):
    axe = importlib.resources.files(pytest.importorskip("axe_core_python")) / "axe.min.js"
    emulate(looked_at, 1000, 700, scheme)
    looked_at.driver.set_script_timeout(200)
    looked_at.driver.execute_script(axe.read_text(encoding="utf-8"))
    found = looked_at.driver.execute_async_script(
        "axe.run(document, {iframes: false}).then(arguments[arguments.length - 1])"
    )
    assert "color-contrast" in {rule["id"] for rule in found["passes"]}
    serious = [
        (rule["id"], [node["html"] for node in rule["nodes"]])
        for rule in found["violations"]
        if rule["impact"] in ("serious", "critical")
    ]
    assert serious == []


@pytest.mark.parametrize("width", [320, 390, 700, 1000, 1600])
def test_page_is_no_wider_than_its_window(width, looked_at):
    emulate(looked_at, width, 844, "light")
    wide = "document.documentElement.scrollWidth"
    assert looked_at.driver.execute_script(f"return {wide}") <= width
    # what is wider scrolls by itself, and a keyboard reaches it
    for box in looked_at.driver.find_elements("css selector", ".wide, pre"):
        assert box.get_attribute("tabindex") == "0"


@pytest.mark.parametrize(("width", "inches"), [(320, 3.2), (830, 3.2), (850, 10.5), (1600, 10.5)])
def test_sketch_fits_its_window_and_can_be_read(width, inches, looked_at):
    emulate(looked_at, width, 844, "light")
    # narrow windows have the views one above the other
    way = "<" if inches == 3.2 else ">"
    sketch = "document.querySelector('.sketch img')"
    looked_at.wait(f"{sketch}.naturalWidth {way} {sketch}.naturalHeight")
    drawn, room = looked_at.driver.execute_script(
        f"return [{sketch}.clientWidth, {sketch}.closest('figure').clientWidth]"
    )
    assert drawn <= room
    # labels of 10 points, a point being 1/72 of the picture's inch
    assert 10.0 / 72.0 * drawn / inches >= 9.9


def test_dark_is_dark(looked_at):
    light = looked_at.picture()
    emulate(looked_at, 1000, 700, "dark")
    dark = looked_at.picture()
    assert np.median(light) > 240
    assert np.median(dark) < 40


def test_prints(looked_at):
    pdf = looked_at.driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    data = base64.b64decode(pdf["data"])
    assert data.startswith(b"%PDF-")
    pages = len(re.findall(rb"/Type\s*/Page\b", data))
    assert 3 <= pages <= 14
    emulate(looked_at, 1000, 700, "light", media="print")
    seen = looked_at.driver.execute_script(
        "const shown = name => [...document.querySelectorAll(name)]"
        ".map(e => getComputedStyle(e).display !== 'none');"
        "return {frames: shown('iframe'), stills: shown('.still'),"
        " cut: [...document.querySelectorAll('pre')].map(e => e.scrollHeight > e.clientHeight)}"
    )
    assert not any(seen["frames"]), json.dumps(seen)
    assert all(seen["stills"])
    assert seen["cut"] == [False]
