"""Notebook cards: valid HTML, alternative text of pictures, text without matplotlib."""

from __future__ import annotations

import base64
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics._checks import Budget
from nlosoptics.runs.plan import Plan, Stage, plan
from nlosoptics.transient import TransientCapture, Volume, VolumeImage, wall_grid

VOID = {"img", "br", "hr"}
MOST = 100_000  # bytes


class Page(HTMLParser):
    """Reads HTML, and refuses tags that do not close in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.images, self.cells = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert not [name for name, value in attrs if value is None]
        if tag == "img":
            self.images.append(dict(attrs))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.cells.append(data)


@pytest.fixture
def wave():
    return psf.Wavefront.from_zernike(
        {4: 1e-7}, wavelength=6e-7, pupil_radius=5e-3, image_distance=0.05
    )


@pytest.fixture
def spread(wave):
    return psf.point_spread(wave, shape=32)


@pytest.fixture
def capture():
    light = np.random.default_rng(0).exponential(size=(20, 4, 4))
    return TransientCapture(
        H=light, laser_points=(0, 0, 0), sensor_points=wall_grid(1.0, 4), delta_t=0.1
    )


def checked(noun):
    """The page of a noun with one picture, which is no blank sheet."""
    image = pytest.importorskip("PIL.Image")
    text = noun._repr_html_()
    assert len(text.encode()) < MOST
    # what the notebook decides
    assert not re.search(r"background|[^a-z]color:(?!inherit)", text)
    page = Page(text)
    (picture,) = page.images
    assert len(picture["alt"]) > 20
    head, data = picture["src"].split(",")
    assert head == "data:image/png;base64"
    pixels = np.asarray(image.open(BytesIO(base64.b64decode(data))).convert("RGB"))
    _, counts = np.unique(pixels.reshape(-1, 3), axis=0, return_counts=True)
    assert counts.max() < 0.97 * counts.sum()
    return page


def test_scene_shows_its_sketch_and_figures(flat_scene):
    pytest.importorskip("matplotlib")
    page = checked(flat_scene)
    assert {"Scene", "632.8 nm, 5 mW", "FlatWall", "picture, 0.3 x 0.3 m"} <= set(page.cells)
    assert {"64 x 64 pixels of 576 µm", "50.6 mm at F/2.03"} <= set(page.cells)


def test_wavefront_shows_aberration_pupil_light_and_nodes(wave):
    pytest.importorskip("matplotlib")
    page = checked(wave)
    # defocus' coefficient is its rms
    assert {"0.167 waves rms, 100 nm, without tilt", "5 mm radius, F/5"} <= set(page.cells)
    assert {"600 nm, 100 % of a clear disc", "24 x 96, polar"} <= set(page.cells)


def test_reconstruction_shows_status_score_and_seconds():
    pytest.importorskip("matplotlib")
    pytest.importorskip("torch")
    from nlosoptics.inverse import Reconstruction

    found = Reconstruction(
        object=np.eye(8),
        physical_parameters={"gain": 12.5, "coefficients": np.zeros(3)},
        status="unconverged",
        score=1.25,
        history={"residual": np.ones(7)},
        seconds=3.5,
    )
    page = checked(found)
    assert {"unconverged", "1.25", "iterations", "7", "3.5", "gain", "12.5"} <= set(page.cells)
    assert "coefficients" not in page.cells
    retrieved = checked(replace(found, history={"fourier_error": np.ones(4)}))
    assert {"agreement of halves", "restarts", "4"} <= set(retrieved.cells)
    assert "iterations" not in retrieved.cells


@pytest.mark.thorough
def test_capture_and_volume_show_their_sizes(capture):
    pytest.importorskip("matplotlib")
    assert {"20 of 100 mm, 0 to 2 m", "4 x 4", "one point"} <= set(checked(capture).cells)
    axis = np.linspace(0.5, 1.0, 6)
    image = VolumeImage(
        intensity=np.random.default_rng(0).random((6, 6, 6)),
        volume=Volume(axis, axis, axis),
        method="fk_migration",
    )
    assert {"fk_migration", "0.5 to 1, 6 planes"} <= set(checked(image).cells)


def test_plan_is_a_table_of_all_stages(flat_scene):
    made = plan(flat_scene)
    page = Page(made._repr_html_())
    for stage in (*made.stages, *made.skipped):
        assert {stage.name, stage.reason} <= set(page.cells)
    assert page.cells.count("skipped") == len(made.skipped)
    assert page.images == []


@pytest.mark.thorough
def test_text_is_escaped(spread):
    pytest.importorskip("matplotlib")
    page = checked(replace(spread, reason="<b>1 & 2", method='"<script>'))
    assert {"<b>1 & 2", '"<script>'} <= set(page.cells)
    stage = Stage(name="<i>", runs=False, reason="a < b")
    budget = Budget(memory=1e9, seconds=1.0)
    made = Plan(stages=(), skipped=(stage,), tol=0.1, waves=0.0, exit_pupil=None, budget=budget)
    assert {"<i>", "a < b"} <= set(Page(made._repr_html_()).cells)


BUILD = """
import sys
{before}
import numpy as np
from nlosoptics import Scene, plan, psf
scene = Scene.load({path!r}).resized(16)
wave = psf.Wavefront.from_zernike(
    {{4: 1e-7}}, wavelength=6e-7, pupil_radius=5e-3, image_distance=0.05
)
spread = psf.point_spread(wave, shape=16)
for noun in (scene, plan(scene), spread):
    print(noun._repr_html_())
print([name for name in ("torch", "matplotlib.pyplot") if sys.modules.get(name)])
"""


def shown_by(before, examples):
    code = BUILD.format(before=before, path=str(examples / "scenes" / "letter_flat.toml"))
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    *text, loaded = answer.stdout.strip().split("\n")
    return "\n".join(text), loaded


@pytest.mark.thorough
def test_text_stands_in_for_pictures_without_matplotlib(examples):
    text, _ = shown_by("sys.modules['matplotlib'] = None", examples)
    page = Page(text)
    assert page.images == []
    assert text.count("<pre>") == 2
    assert text.count("pip install &#x27;nlosoptics[views]&#x27;") == 2
    assert "of the peak" in text
    assert "632.8 nm" in text
