"""Rooms as files: PNG, glTF and a web page; and what happens where nothing can be rendered."""

from __future__ import annotations

import html
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

#: VTK's own switch to a kind of window that this machine may not have: it then ends by SIGSEGV.
MADE_BLIND = ("VTK_DEFAULT_OPENGL_WINDOW", "vtkOSOpenGLRenderWindow")


@pytest.fixture
def renders():
    """Skip where this machine cannot render."""
    try:
        views.rendering_works()
    except MissingExtraError as error:
        pytest.skip(str(error))


@pytest.fixture
def blind(monkeypatch):
    """A machine on which VTK crashes."""
    monkeypatch.setattr(stages, "TRIAL", "import os\nos.kill(os.getpid(), 11)")
    stages._trial.cache_clear()
    yield
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
    import trimesh

    views.save(room, tmp_path / "room.glb")
    found = trimesh.load(tmp_path / "room.glb")
    assert {"relay wall", "hidden object", "lens", "ray paths", "floor grid"} <= set(found.geometry)
    wall = found.geometry["relay wall"]
    assert wall.bounds[:, :2] == pytest.approx(np.array([(-0.8, -0.5), (0.8, 0.5)]))
    assert np.abs(wall.vertices[:, 2]).max() == pytest.approx(1e-4, rel=0.05)
    # triangles face the room, into which the wall's normal points
    assert wall.face_normals[:, 2].min() > 0.99
    legs = found.geometry["ray paths"]
    drawn = room.actors["ray paths"].mapper.dataset
    assert np.asarray(legs.bounds).ravel() == pytest.approx(
        np.array(drawn.bounds).reshape(3, 2).T.ravel(), abs=1e-6
    )
    assert len(legs.vertices) == 2 * drawn.n_cells  # trimesh joins the pairs into one line


def test_glb_has_the_colours_that_are_rendered(tmp_path):
    """Of cells, of points, of a surface; glTF counts light, so middle grey is 0.216."""
    plotter = pv.Plotter(off_screen=True)
    segments = pv.line_segments_from_points(np.arange(12.0).reshape(4, 3))
    segments.cell_data["n"] = [0.0, 1.0]
    grey = {"cmap": "gray", "show_scalar_bar": False}
    plotter.add_mesh(segments, scalars="n", name="of cells", **grey)
    triangle = pv.Triangle([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    triangle.point_data["m"] = [0.0, 1.0, 1.0]
    plotter.add_mesh(triangle, scalars="m", name="of points", **grey)
    square = pv.Plane(i_resolution=2, j_resolution=1)
    square.cell_data["k"] = [0.0, 1.0]
    plotter.add_mesh(square, scalars="k", name="of faces", **grey)
    plotter.add_mesh(pv.Sphere(), color="#808080", opacity=0.25, name="plain")
    plotter.add_mesh(pv.Cube(), color="red", name="hidden").visibility = False
    content = _Read(views_glb(plotter))
    assert set(content.meshes) == {"of cells", "of points", "of faces", "plain"}
    assert content.array("of cells", "COLOR_0")[:, 0] / 65535 == pytest.approx([0, 0, 1, 1])
    assert content.array("of points", "COLOR_0")[:, 0] / 65535 == pytest.approx([0, 1, 1])
    shades = content.array("of faces", "COLOR_0")[:, 0] / 65535
    places = content.array("of faces", "POSITION")
    assert shades.tolist() == [0.0] * 6 + [1.0] * 6
    assert places[shades == 0.0, 0].max() == places[shades == 1.0, 0].min() == 0.0
    material = content.material("plain")
    # ((128/255 + 0.055)/1.055)^2.4
    assert material["pbrMetallicRoughness"]["baseColorFactor"] == pytest.approx(
        [0.21586] * 3 + [0.25], abs=1e-5
    )
    assert material["alphaMode"] == "BLEND"


def views_glb(plotter):
    """Bytes of the file."""
    from nlosoptics.views.gltf import glb

    return glb(plotter)


class _Read:
    """The least reader of the format, by its specification."""

    def __init__(self, content):
        import json
        import struct

        magic, version, length = struct.unpack("<4sII", content[:12])
        assert (magic, version, length) == (b"glTF", 2, len(content))
        size = struct.unpack("<I", content[12:16])[0]
        self.text = json.loads(content[20 : 20 + size])
        self.body = content[28 + size :]
        self.meshes = {
            node["name"]: self.text["meshes"][node["mesh"]]["primitives"]
            for node in self.text["nodes"]
            if "mesh" in node
        }

    def material(self, name):
        return self.text["materials"][self.meshes[name][0]["material"]]

    def array(self, name, attribute):
        entry = self.text["accessors"][self.meshes[name][0]["attributes"][attribute]]
        view = self.text["bufferViews"][entry["bufferView"]]
        kind = {5126: "<f4", 5123: "<u2"}[entry["componentType"]]
        width = {"VEC2": 2, "VEC3": 3, "VEC4": 4}[entry["type"]]
        assert view["byteOffset"] % 4 == 0
        part = self.body[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        return np.frombuffer(part, kind).reshape(entry["count"], width)


def test_page_turns_in_a_browser_and_asks_for_nothing(room, page, tmp_path):
    """Rendered without a network, in silence; a drag, a key and the button change the picture."""
    path = tmp_path / "room.html"
    views.save(room, path)
    assert path.stat().st_size < 5e6
    page.open(path)
    assert page.wait("document.body.dataset.ready") == "yes"
    first = page.picture()
    assert colours(first) > 100
    page.drag("#view canvas", 120, 20)
    dragged = page.picture()
    # the room, a few hundredths of the window, moves all over
    assert np.mean(np.any(first != dragged, axis=2)) > 0.02
    page.driver.execute_script("document.getElementById('back').click()")
    back = page.picture()
    assert np.mean(np.any(first != back, axis=2)) < 0.002
    page.driver.find_element("css selector", "#view").send_keys("\ue012")  # arrow left
    assert np.mean(np.any(back != page.picture(), axis=2)) > 0.02
    assert page.complaints() == []
    assert page.requests() == []


def test_page_on_a_phone_has_no_sideways_scroll(room, page, tmp_path):
    views.save(room, tmp_path / "room.html")
    page.driver.set_window_size(500, 800)
    try:
        page.open(tmp_path / "room.html")
        page.wait("document.body.dataset.ready")
        wide = page.driver.execute_script(
            "return [document.documentElement.scrollWidth, window.innerWidth]"
        )
        assert wide[0] <= wide[1]
        assert colours(page.picture()) > 100
    finally:
        page.driver.set_window_size(1000, 700)


def test_page_tells_in_words_what_the_picture_shows(room):
    text = views.html_page(room)
    label = html.unescape(re.search(r'aria-label="([^"]*)"', text)[1])
    for said in ("relay wall, slopes up to 2.5 mrad", "path length from the source (m): 0 to"):
        assert said in label
    assert '<html lang="en">' in text
    assert "<title>Light paths from the laser" in text
    bar = text.split('<div class="bar">')[1].split("</div></div>")[0]
    ticks = [float(tick) for tick in re.findall(r"<span>([^<]*)</span>", bar)]
    high = room.actors["ray paths"].mapper.scalar_range[1]
    # three digits
    assert ticks == pytest.approx(np.linspace(0, high, 5), rel=5e-3)
    # no address that a browser would load: only namespaces and comments
    assert not re.findall(r"(?:src|href)=[\"'](?!data:)", text)


def test_names_cannot_break_the_page(flat_scene):
    plotter = pv.Plotter(off_screen=True, title="</title><script>alert(1)</script>")
    plotter.add_mesh(pv.Sphere(), name="</script>")
    text = views.html_page(plotter)
    assert "<script>alert" not in text
    assert text.count("</script>") == 2


def test_page_without_trimeshs_viewer_is_refused_in_one_line(room, monkeypatch):
    from nlosoptics.views import pages

    monkeypatch.setattr(pages, "LAST", "something else")
    with pytest.raises(MissingExtraError, match="trimesh lacks the viewer"):
        views.html_page(room)


def test_a_crash_is_told_and_other_formats_work(room, blind, tmp_path):
    for call in (views.rendering_works, lambda: views.save(room, tmp_path / "room.png")):
        with pytest.raises(MissingExtraError, match=r"SIGSEGV\); .* libegl1") as told:
            call()
        assert "\n" not in str(told.value)
    assert not list(tmp_path.iterdir())
    views.save(room, tmp_path / "room.glb")
    views.save(room, tmp_path / "room.html")
    with pytest.raises(MissingExtraError, match="no display"):
        views.window()


def test_vtk_itself_crashes_where_its_window_is_missing(monkeypatch):
    """The real trial, on a machine that lacks OSMesa; elsewhere it must pass."""
    monkeypatch.setenv(*MADE_BLIND)
    stages._trial.cache_clear()
    try:
        kind, fault = stages._trial()
    finally:
        stages._trial.cache_clear()
    assert (kind in stages.HIDDEN) != ("SIGSEGV" in fault or "SIGABRT" in fault)


@pytest.mark.parametrize(
    ("trial", "said"),
    [("raise ImportError('libX11.so.6')", "ImportError: libX11.so.6"), ("exit(3)", "code 3")],
)
def test_other_faults_are_told(monkeypatch, trial, said):
    monkeypatch.setattr(stages, "TRIAL", trial)
    stages._trial.cache_clear()
    try:
        with pytest.raises(MissingExtraError, match=said):
            views.rendering_works()
    finally:
        stages._trial.cache_clear()


def test_the_trial_is_made_once(monkeypatch):
    stages._trial.cache_clear()
    monkeypatch.setattr(stages, "TRIAL", "print('vtkEGLRenderWindow')")
    calls = []
    run = subprocess.run
    monkeypatch.setattr(
        stages.subprocess, "run", lambda *a, **k: (calls.append(a), run(*a, **k))[1]
    )
    try:
        views.rendering_works()
        views.rendering_works()
    finally:
        stages._trial.cache_clear()
    assert len(calls) == 1


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
    with pytest.raises(SceneError, match="there is no folder"):
        views.save(room, tmp_path / "missing" / "room.glb")
    assert [p.name for p in tmp_path.iterdir()] == ["room.glb"]
    assert target.read_bytes() == b"before"
    views.save(room, target)
    assert target.read_bytes()[:4] == b"glTF"


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
