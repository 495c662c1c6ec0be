"""Rooms as files: PNG, glTF and a web page; and what happens where nothing can be rendered."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from nlosoptics import views
from nlosoptics.errors import MissingExtraError, SceneError
from nlosoptics.raytrace import trace
from nlosoptics.scene import Occluder, WavyWall
from nlosoptics.views import stages

pv = pytest.importorskip("pyvista")


@pytest.fixture
def renders():
    """Skip where this machine cannot render."""
    try:
        stages.rendering_works()
    except MissingExtraError as error:
        pytest.skip(str(error))


@pytest.fixture
def trial(monkeypatch):
    """Replace the program that tries to render."""

    def set_to(program):
        monkeypatch.setattr(stages, "TRIAL", program)
        stages._trial.cache_clear()

    yield set_to
    stages._trial.cache_clear()


@pytest.fixture(scope="module")
def room():
    """A wavy wall with 200 paths."""
    from nlosoptics.scene import Camera, Laser, PlanarObject, Scene

    picture = np.zeros((32, 32))
    picture[6:26, 8:24] = 1.0
    scene = Scene(
        Laser(wavelength=632.8e-9, power=5e-3, beam_diameter=3e-3, position=(0.6, 0.3, 1.1)),
        WavyWall(1e-4, 0.25, size=(1.6, 1.0)),
        PlanarObject(picture, 0.3, position=(0.38, 0.0, 1.0)),
        Camera(
            position=(-0.6, 0.0, 0.8), aim=(-0.16, 0.0, 0.0), focal_length=0.05, stop_diameter=0.025
        ),
    )
    paths = trace(scene, n_rays=256, keep_paths=True)
    return views.ray_paths(paths, scene, colour="path_length", most=200)


def colours(picture):
    """How many colours cover more than a hundred-thousandth of a picture each."""
    _, counts = np.unique(np.asarray(picture).reshape(-1, 3) // 8, axis=0, return_counts=True)
    return int((counts > 1e-5 * counts.sum()).sum())


@pytest.mark.thorough
def test_png_is_no_blank(room, renders, tmp_path):
    from PIL import Image

    views.save(room, tmp_path / "room.png")
    with Image.open(tmp_path / "room.png") as shot:
        picture = np.asarray(shot.convert("RGB"))
    # white paper alone is one; the wall's greys and viridis are hundreds
    assert colours(picture) > 100
    # the room fills the picture: something is drawn in every third of it
    for rows in np.array_split(picture, 3):
        for part in np.array_split(rows, 3, axis=1):
            assert part.min() < 200


def test_glb_is_read_by_another_library_in_world_metres(room, tmp_path):
    views.save(room, tmp_path / "room.glb")
    found = trimesh.load(tmp_path / "room.glb")
    assert {"relay wall", "hidden object", "lens", "ray paths", "floor grid"} <= set(found.geometry)
    wall = found.geometry["relay wall"]
    assert wall.bounds[:, :2] == pytest.approx(np.array([(-0.8, -0.5), (0.8, 0.5)]))
    assert np.abs(wall.vertices[:, 2]).max() == pytest.approx(1e-4, rel=0.05)
    # triangles face the room, into which the wall's normal points
    assert wall.face_normals[:, 2].min() > 0.99
    tubes = found.geometry["ray paths"]
    drawn = np.array(room.actors["ray paths"].mapper.dataset.bounds).reshape(3, 2).T
    # tubes are 1 mm wide and more, in a room of 3 m
    assert tubes.bounds == pytest.approx(drawn, abs=5e-3)


def test_glb_has_the_colours_that_are_rendered():
    """Of lines, of points, of a surface; glTF counts light, so middle grey is 0.216."""
    from nlosoptics.views.room_files import model

    plotter = pv.Plotter(off_screen=True)
    segments = pv.line_segments_from_points(np.arange(12.0).reshape(4, 3))
    segments.cell_data["n"] = [0.0, 1.0]
    grey = {"cmap": "gray", "show_scalar_bar": False}
    plotter.add_mesh(segments, scalars="n", name="lines", **grey)
    triangle = pv.Triangle([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    triangle.point_data["m"] = [0.0, 1.0, 1.0]
    plotter.add_mesh(triangle, scalars="m", name="points", **grey)
    plotter.add_mesh(pv.Sphere(), color="#808080", opacity=0.25, name="plain")
    plotter.add_mesh(pv.Cube(), color="red", name="hidden").visibility = False
    parts = model(plotter).geometry
    assert set(parts) == {"lines", "points", "plain"}
    lines = parts["lines"]
    shades = lines.visual.vertex_attributes["color"][:, 0]
    first = np.linalg.norm(lines.vertices - (1.5, 2.5, 3.5), axis=1) < 3.0
    assert set(shades[first]) == {0}
    assert set(shades[~first]) == {255}
    assert parts["points"].visual.vertex_attributes["color"][:, 0].tolist() == [0, 255, 255]
    material = parts["plain"].visual.material
    # ((128/255 + 0.055)/1.055)^2.4, in 255ths
    assert np.asarray(material.baseColorFactor) == pytest.approx([55, 55, 55, 64], abs=0.5)
    assert material.alphaMode == "BLEND"


@pytest.mark.thorough
def test_page_turns_in_a_browser_and_asks_for_nothing(room, page, tmp_path):
    """Rendered without a network, in silence; a drag changes the picture."""
    path = tmp_path / "room.html"
    views.save(room, path)
    assert path.stat().st_size < 5e6
    page.open(path)
    page.wait("!!(document.querySelector('canvas') && camera)")
    first = page.picture()
    assert colours(first) > 100
    page.drag("canvas", 120, 20)
    # the room, a few hundredths of the window, moves all over
    assert np.mean(np.any(first != page.picture(), axis=2)) > 0.02
    assert page.requests() == []


def test_page_tells_in_words_what_the_picture_shows(room, tmp_path):
    views.save(room, tmp_path / "room.html")
    text = (tmp_path / "room.html").read_text()
    words = re.sub("<[^>]+>", " ", text.partition("<script>")[0])
    assert "Light paths from the laser" in words
    assert "relay wall, slopes up to 2.5 mrad" in words
    high = room.actors["ray paths"].mapper.scalar_range[1]
    assert re.search(rf"path length from the source \(m\): 0 +{high:.3g} ", words)
    assert '<html lang="en">' in text
    assert "$B64GLTF" not in text
    # no address that a browser would load: only namespaces and comments
    assert not re.findall(r"(?:src|href)=[\"'](?!data:)", text)


def test_names_cannot_break_the_page(tmp_path):
    plotter = pv.Plotter(off_screen=True, title="</title><script>alert(1)</script>")
    plotter.add_mesh(pv.Sphere(), name="</script>")
    views.save(plotter, tmp_path / "room.html")
    text = (tmp_path / "room.html").read_text()
    assert "<script>alert" not in text
    assert text.count("</script>") == 1


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("import os\nos.kill(os.getpid(), 11)", r"SIGSEGV\); .* libegl1"),
        ("raise ImportError('libX11.so.6')", r"ImportError: libX11.so.6"),
        ("exit(3)", r"code 3"),
    ],
)
def test_a_fault_of_vtk_is_told_and_other_formats_work(room, trial, program, message, tmp_path):
    trial(program)
    for call in (stages.rendering_works, lambda: views.save(room, tmp_path / "room.png")):
        with pytest.raises(MissingExtraError, match=message) as told:
            call()
        assert "\n" not in str(told.value)
    assert not list(tmp_path.iterdir())
    views.save(room, tmp_path / "room.glb")
    with pytest.raises(MissingExtraError, match="no display"):
        stages.window()


def test_files_appear_whole_or_not_at_all(room, tmp_path, monkeypatch):
    target = tmp_path / "room.glb"
    target.write_bytes(b"before")
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", lambda *_: 1 / 0)
        patched.setattr(Path, "replace", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            views.save(room, target)
    for name, said in (("room.gif", "has the suffix '.gif'"), ("room", "has the suffix ''")):
        with pytest.raises(SceneError, match=f"{said}, must be one of .png, .html"):
            views.save(room, tmp_path / name)
    assert [p.name for p in tmp_path.iterdir()] == ["room.glb"]
    assert target.read_bytes() == b"before"
    views.save(room, target)
    assert target.read_bytes()[:4] == b"glTF"


@pytest.mark.thorough
def test_the_terminal_stays_clean(tmp_path, renders):
    """VTK says on stderr that there is no display; a user is not to see it."""
    code = (
        "import pyvista\nfrom nlosoptics import views\n"
        "from nlosoptics.views.stages import new_plotter\n"
        "plotter = new_plotter('a ball')\nplotter.add_mesh(pyvista.Sphere())\n"
        f"views.save(plotter, {str(tmp_path / 'ball.png')!r})"
    )
    answer = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False
    )
    assert (answer.returncode, answer.stdout, answer.stderr) == (0, "", "")


@pytest.mark.thorough
def test_the_hidden_object_shows_through_an_occluder(renders, flat_scene):
    """A thin partition is put between the viewer and the object."""
    seat = np.array(views.scene_3d(flat_scene).camera.position)
    toward = seat - flat_scene.object_point
    place = flat_scene.object_point + 0.5 * toward / np.linalg.norm(toward)
    occluder = Occluder(trimesh.creation.box((0.8, 0.8, 0.02)), position=tuple(place))
    shots = []
    for left_out in ((), ("hidden object", "object's frame")):
        plotter = views.scene_3d(replace(flat_scene, occluders=(occluder,)))
        plotter.camera.position, plotter.camera.focal_point = tuple(seat), flat_scene.object_point
        plotter.camera.view_angle = 6.0  # the picture holds nothing beyond the partition
        for name in left_out:
            plotter.remove_actor(name, render=False)
        shots.append(plotter.screenshot(None, return_img=True).astype(int))
    changed = np.abs(shots[0] - shots[1]).max(axis=2) > 8
    # the object's picture alone covers thousands of pixels
    assert changed.sum() > 2000
