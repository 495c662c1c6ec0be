"""The page that computes in the browser: its numbers are those of the library."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from nlosoptics import limits
from nlosoptics.imaging import WallTransport
from nlosoptics.scene import Camera, FlatWall, Lambert, Laser, PlanarObject, Scene

pytestmark = pytest.mark.thorough
SCRIPT = Path(__file__).parents[2] / "docs" / "_static" / "live.js"


@pytest.fixture
def live(page, tmp_path):
    """The page's functions, called with an expression in JavaScript."""
    file = tmp_path / "live.html"
    file.write_text(f"<script>{SCRIPT.read_text()}\nwindow.LIVE = LIVE</script>")
    page.open(file)
    return lambda text: page.driver.execute_script(f"return {text}")


@pytest.mark.parametrize(
    ("x", "y", "z", "radius"), [(0.05, -0.1, 0.45, 0.08), (-0.2, 0.0, 0.7, 0.15)]
)
def test_operator_is_the_transport_of_the_library(live, x, y, z, radius):
    angles = 2 * np.pi * np.arange(256) / 256
    rim = [(x + radius * np.cos(a), y + radius * np.sin(a), z) for a in angles]
    faces = [[256, i, (i + 1) % 256] for i in range(256)]
    disc = trimesh.Trimesh([*rim, (x, y, z)], faces, process=False)
    scene = Scene(
        laser=Laser(
            wavelength=633e-9, power=1.0, beam_diameter=1e-3, position=(2, 0, 1), aim=(0, 0, 0)
        ),
        wall=FlatWall(size=(0.8, 0.8)),
        wall_material=Lambert(0.6),
        hidden=PlanarObject(np.ones((16, 16)), 0.6, position=(0, 0, 1.0)),
        # from far away, so that each pixel sees an equal part of the wall
        camera=Camera(
            position=(0, 0, 40),
            aim=(0, 0, 0),
            focal_length=1 / (1 / 40 + 0.8 / 40 / (4096 * 9e-6)),
            focus_distance=40.0,
            stop_diameter=1e-3,
            binning=128,
        ),
        occluders=(disc,),
    )
    expected = WallTransport(scene, cells=(16, 16), source="luminous").matrix
    text = f"Array.from(LIVE.operator({{x: {x}, y: {y}, z: {z}, radius: {radius}}}).A)"
    # the library's columns are seen from the wall, and its camera does not see behind the disc
    expected, found = (
        expected.reshape(1024, 16, 16)[:, :, ::-1],
        np.reshape(live(text), (1024, 16, 16)),
    )
    across = 0.8 * ((np.arange(32) + 0.5) / 32 - 0.5)
    beside = (np.hypot(across - x, -across[:, None] - y) > radius + 0.03).ravel()
    picture = np.random.default_rng(0).random((16, 16))
    light, true = ((a * picture).sum(axis=(1, 2))[beside] for a in (found, expected))
    assert np.std(true) > 0.05 * np.mean(true)
    # the disc's rim is straight within a quarter of a cell, less its mean sagitta
    assert light / light.mean() == pytest.approx(true / true.mean(), abs=1e-3)


def test_answer_is_the_minimum_of_tikhonov(live):
    rng = np.random.default_rng(1)
    A, y = rng.random((7, 4)), rng.random(7)
    found = live(f"Array.from(LIVE.solve({A.ravel().tolist()}, {y.tolist()}, 0.3))")
    assert found == pytest.approx(np.linalg.solve(A.T @ A + 0.3 * np.eye(4), A.T @ y), rel=1e-10)


def test_facets_pass_what_the_library_says(live):
    frequency = np.array([0.5, 2.0, 7.0])
    found = [live(f"LIVE.modulation(0.02, {f})") for f in frequency]
    assert found == pytest.approx(limits.lobe_relay_transfer(frequency, 1.0, 0.02), rel=1e-12)


def test_more_light_and_more_shadow_show_more(live):
    """Of the letter: past a disc, with less light, and without the disc; and by few facets."""

    def seen(kind, truth, call):
        return live(f"LIVE.correlation(LIVE.{call}.answer, LIVE.letter(LIVE.{truth}))")

    disc = "{x: 0, y: 0, z: 0.45, radius: 0.08}"
    bright, dim = (seen("matt", "CELLS", f"matt({disc}, {n})") for n in (1e6, 1e2))
    aside = seen("matt", "CELLS", "matt({x: 5, y: 0, z: 0.45, radius: 0.08}, 1e6)")
    smooth, rough = (seen("glossy", "FINE", f"glossy({s}, 1e5)") for s in (0.005, 0.1))
    assert bright > 0.9 > dim + 0.1
    assert aside < 0.6
    assert smooth > 0.9 > rough


def test_disc_and_room_follow_the_arrow_keys(page, tmp_path):
    text = SCRIPT.parents[1].joinpath("live.md").read_text()
    file = tmp_path / "live.html"
    file.write_text(
        f"<script>{SCRIPT.read_text()}</script>{text[text.index('<div') :].split('```')[0]}"
    )
    page.open(file)
    press = (
        "document.querySelector(`[name=${arguments[0]}]`)"
        ".dispatchEvent(new KeyboardEvent('keydown', {key: arguments[1]}))"
    )
    for name in ("board", "space"):
        page.driver.execute_script(press, name, "ArrowRight")
    style = page.driver.find_element("name", "space").get_attribute("style")
    found = dict(part.split(":") for part in style.replace(" ", "").rstrip(";").split(";"))
    assert (found["--x"], found["--across"], found["--radius"]) == ("0.02", "-45deg", "0.08")
    assert page.driver.find_element("name", "disc").get_attribute("cx") == "104"
