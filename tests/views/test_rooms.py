"""Rooms in 3-D: what is drawn, where, in which colours, and bad input."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from nlosoptics import views
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.raytrace import RayPaths, pupil_rays
from nlosoptics.scene import (
    CallableWall,
    ConcaveWall,
    Lambert,
    MeshObject,
    Occluder,
    SpecularMicrofacet,
    SumWall,
    WavyWall,
)
from nlosoptics.transient import Volume, VolumeImage
from nlosoptics.views.rays import LEGS

pv = pytest.importorskip("pyvista")

TITLES = {
    "bounces": "preceding reflections",
    "path_length": "path length from the source (m)",
    "weight": "power of the path (W)",
    "aberration": "wave aberration (waves)",
}


def made_paths() -> RayPaths:
    """Two detected paths, of three and of two reflections, and one that escapes after one."""
    start, lit, card, wall, lens = (
        (0.6, 0.3, 1.1),
        (0.0, 0.0, 0.0),
        (0.4, 0.0, 1.0),
        (-0.2, 0.1, 0.0),
        (-0.6, 0.0, 0.8),
    )
    points = np.array(
        [
            [start, lit, card, wall, lens],
            [start, lit, card, lens, lens],
            [start, lit, (5.0, 5.0, 5.0), (5.0, 5.0, 5.0), (5.0, 5.0, 5.0)],
        ]
    )
    return RayPaths(
        points=points,
        path_length=np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1),
        weight=np.array([1e-12, 4e-12, 1e-9]),
        n_bounces=np.array([3, 2, 1], dtype=np.int32),
        status=np.array([0, 0, 1], dtype=np.int8),
    )


def lines(plotter):
    """The legs that a plotter shows."""
    return plotter.actors["ray paths"].mapper.dataset


def legs(plotter):
    """Ends (n, 2, 3) of the legs."""
    drawn = lines(plotter)
    return np.asarray(drawn.points)[np.asarray(drawn.lines).reshape(-1, 3)[:, 1:]]


def legend(plotter):
    """Names in the legend."""
    box = plotter.legend
    return [box.GetEntryString(row) for row in range(box.GetNumberOfEntries())]


def test_legs_run_from_vertex_to_vertex_and_repeated_ends_are_left_out(flat_scene):
    paths = made_paths()
    plotter = views.ray_paths(paths, flat_scene)
    wanted = [paths.points[0, k : k + 2] for k in range(4)]
    wanted += [paths.points[1, k : k + 2] for k in range(3)]
    # pyvista holds coordinates in single precision
    assert legs(plotter) == pytest.approx(np.array(wanted), abs=1e-6)
    assert np.asarray(lines(plotter)["path"]).tolist() == [0] * 4 + [1] * 3
    assert np.asarray(lines(plotter)["preceding reflections"]).tolist() == [0, 1, 2, 3, 0, 1, 2]


@pytest.mark.thorough
def test_filters_keep_what_they_say(flat_scene):
    paths = made_paths()

    def drawn(**options):
        return np.unique(lines(views.ray_paths(paths, flat_scene, **options))["path"]).tolist()

    assert drawn() == [0, 1]
    assert drawn(only_detected=False) == [0, 1, 2]
    assert drawn(n_bounces=2) == [1]
    assert drawn(n_bounces=1, only_detected=False) == [2]
    assert drawn(most=1) == [1]  # it carries four fifths of the power


@pytest.mark.thorough
def test_of_many_paths_lines_are_as_dense_as_the_light(flat_scene):
    """Paths are drawn in proportion to their power; one that has half of all power is drawn."""
    one = made_paths()
    n = 1000
    many = replace(
        one,
        points=np.repeat(one.points[:1], n, axis=0),
        path_length=np.ones(n),
        weight=np.ones(n),
        n_bounces=np.full(n, 3, dtype=np.int32),
        status=np.zeros(n, dtype=np.int8),
    )
    even = np.unique(lines(views.ray_paths(many, flat_scene, most=100))["path"])
    assert len(even) == 100
    assert np.all(np.diff(even) > 0)
    weight = np.ones(n)
    weight[500] = 1000.0  # half of all power
    uneven = replace(many, weight=weight)
    drawn = np.unique(lines(views.ray_paths(uneven, flat_scene, most=100))["path"])
    assert 500 in drawn
    assert len(drawn) == 100
    rising = replace(many, weight=np.arange(1.0, n + 1))
    drawn = np.unique(lines(views.ray_paths(rising, flat_scene, most=100))["path"])
    # three quarters of the power are in the upper half; four standard deviations of 100 draws
    assert abs(np.count_nonzero(drawn >= n // 2) - 75) <= 4 * np.sqrt(100 * 0.75 * 0.25)
    dark = replace(many, weight=np.zeros(n))
    assert len(np.unique(lines(views.ray_paths(dark, flat_scene, most=100))["path"])) == 100


@pytest.mark.parametrize("colour", ["bounces", "path_length", "weight"])
def test_colours_are_the_quantity_that_the_bar_names(flat_scene, colour):
    paths = made_paths()
    plotter = views.ray_paths(paths, flat_scene, colour=colour)
    mapper = plotter.actors["ray paths"].mapper
    assert list(plotter.scalar_bars.keys()) == [TITLES[colour]]
    values = np.asarray(lines(plotter)[mapper.array_name])
    low, high = mapper.scalar_range
    if colour == "bounces":
        assert values.tolist() == [0, 1, 2, 3, 0, 1, 2]
        assert (low, high) == (-0.5, 3.5)  # so that each whole number has the middle of a step
    elif colour == "path_length":
        # it runs along the path: both ends of every leg, the last at the whole length
        ends = values.reshape(-1, 2)
        assert ends[0, 0] == ends[4, 0] == 0.0
        assert ends[:3, 1] == pytest.approx(ends[1:4, 0])
        assert ends[[3, 6], 1] == pytest.approx(paths.path_length[:2])
        # the scale ends at the first multiple of four steps of two digits that holds all
        step, longest = high / 4, paths.path_length[:2].max()
        assert low == 0.0
        assert float(f"{step:.1e}") == pytest.approx(step, rel=1e-12)
        assert high - 4 * 10 ** (np.floor(np.log10(step)) - 1) < longest <= high
    else:
        assert values == pytest.approx([1e-12] * 4 + [4e-12] * 3)
        assert mapper.lookup_table.log_scale
        assert high == pytest.approx(4e-12)
        assert 0 < low <= 1e-12


@pytest.mark.thorough
def test_aberration_is_that_of_the_ray(flat_scene):
    """Nodes of the wavefront are the detected rays in their order; waves, zero in the middle."""
    paths = pupil_rays(flat_scene, n_rays=64)
    detected = np.flatnonzero(paths.status == 0)
    wave = SimpleNamespace(aberration=1e-7 * np.arange(len(detected)), wavelength=5e-7)
    plotter = views.ray_paths(paths, flat_scene, colour="aberration", wavefront=wave)
    drawn = lines(plotter)
    place = np.searchsorted(detected, np.asarray(drawn["path"]))
    assert np.asarray(drawn["aberration"]) == pytest.approx(0.2 * place)
    low, high = plotter.actors["ray paths"].mapper.scalar_range
    assert -low == high == pytest.approx(0.2 * (len(detected) - 1))
    few = views.ray_paths(paths, flat_scene, colour="aberration", wavefront=wave, most=5)
    place = np.searchsorted(detected, np.asarray(lines(few)["path"]))
    assert np.asarray(lines(few)["aberration"]) == pytest.approx(0.2 * place)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"colour": "red"}, "colour = 'red' is unknown, must be one of bounces, path_length"),
        ({"colour": "aberration"}, "needs wavefront="),
        (
            {
                "colour": "aberration",
                "wavefront": SimpleNamespace(aberration=np.zeros(7), wavelength=1e-6),
            },
            "wavefront has 7 nodes, must have 2 like the detected paths",
        ),
        (
            {
                "colour": "aberration",
                "only_detected": False,
                "wavefront": SimpleNamespace(aberration=np.zeros(2), wavelength=1e-6),
            },
            "paths that miss the detector have no aberration",
        ),
        ({"n_bounces": 7}, "no path has n_bounces = 7; choose from 2, 3"),
        ({"most": 0}, "most = 0 is out of range"),
    ],
)
def test_bad_wishes_are_refused_in_one_line(flat_scene, options, said):
    with pytest.raises(SceneError, match=said) as told:
        views.ray_paths(made_paths(), flat_scene, **options)
    assert "\n" not in str(told.value)


def test_the_room_stands_where_the_scene_says(flat_scene):
    scene = replace(flat_scene, wall=WavyWall(0.01, 0.2, size=(1.4, 1.0)))
    plotter = views.scene_3d(scene)

    def mesh(name):
        return plotter.actors[name].mapper.dataset

    wall = np.asarray(mesh("relay wall").points, dtype=np.float64)
    # single precision of coordinates below 1 m
    assert wall[:, 2] == pytest.approx(scene.wall.height(wall[:, 0], wall[:, 1]), abs=1e-7)
    assert (wall.min(axis=0)[:2], wall.max(axis=0)[:2]) == (
        pytest.approx((-0.7, -0.5)),
        pytest.approx((0.7, 0.5)),
    )
    lens = np.asarray(mesh("lens").points)
    camera = scene.camera
    assert np.linalg.norm(lens - camera.position, axis=1).max() == pytest.approx(0.0125, rel=1e-4)
    assert (lens - camera.position) @ camera.axis == pytest.approx(0, abs=1e-6)
    beam = np.asarray(mesh("laser beam").points)
    # from the laser to the crest of the wave
    middle = np.mean([scene.laser.position, (0.0, 0.0, 0.01)], axis=0)
    assert beam.mean(axis=0) == pytest.approx(middle, abs=1e-6)
    corners = np.asarray(mesh("hidden object").points)
    assert np.sort(corners, axis=0) == pytest.approx(
        np.sort(scene.hidden.corners, axis=0), abs=1e-6
    )
    axis = np.asarray(mesh("optical axis").points)
    assert axis[:, 2].max() <= camera.position[2] + 0.01
    grid = np.asarray(mesh("floor grid").points)
    assert np.unique(grid[:, 1]) == pytest.approx(-0.5)


def test_the_pictures_right_is_on_its_right(flat_scene):
    """Texture coordinates rise along the picture's right and up; row 0 of a texture is on top."""
    letter = np.zeros((4, 4))
    letter[0, 3] = 1.0  # top right as it is read
    scene = replace(flat_scene, hidden=replace(flat_scene.hidden, image=letter))
    actor = views.scene_3d(scene).actors["hidden object"]
    mesh = actor.mapper.dataset
    places = np.asarray(mesh.active_texture_coordinates)
    right, up, _ = scene.hidden.axes
    offset = np.asarray(mesh.points) - scene.hidden.position
    assert np.sign(offset @ right) == pytest.approx(np.sign(places[:, 0] - 0.5))
    assert np.sign(offset @ up) == pytest.approx(np.sign(places[:, 1] - 0.5))
    assert actor.texture.to_array()[0, 3].tolist() == [255, 255, 255]


def test_the_legend_names_what_is_there(flat_scene):
    import trimesh

    assert legend(views.scene_3d(flat_scene)) == [
        "relay wall, flat",
        "laser and its beam",
        "hidden object",
        "camera, lens and optical axis",
        "floor grid, 0.2 m",
    ]
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    scene = replace(
        flat_scene,
        wall=WavyWall(1e-4, 0.25, size=(1.4, 1.0)),
        occluders=(Occluder(box, position=(0.5, 0.1, 1.2)),),
        hidden=MeshObject(box, position=(0.4, 0, 1)),
    )
    plotter = views.scene_3d(scene)
    # 2 pi amplitude / period
    assert "relay wall, slopes up to 2.5 mrad" in legend(plotter)
    assert "occluders" in legend(plotter)
    # no leg of a path passes for one
    assert plotter.actors["occluders"].prop.color.hex_rgb.upper() not in LEGS
    occluder = np.asarray(plotter.actors["occluders"].mapper.dataset.points)
    assert occluder.mean(axis=0) == pytest.approx((0.5, 0.1, 1.2), abs=1e-6)
    fine = replace(flat_scene, wall=WavyWall(1e-7, 2e-3, size=(1.4, 1.0)))
    assert legend(views.scene_3d(fine))[0] == "relay wall, waviness too fine to draw"


@pytest.mark.parametrize(
    "wall",
    [
        ConcaveWall(1.1),  # unbounded: ends at its radius
        SumWall(WavyWall(1e-3, 0.3), WavyWall(1e-3, 0.4, direction=1.0)),
        CallableWall(
            lambda x, y: 0.01 * x * y,
            lambda x, y: (0.01 * y, 0.01 * x),
            max_height=1.0,
            max_curvature=0.01,
        ),
    ],
)
def test_every_kind_of_wall_has_a_surface(flat_scene, wall):
    scene = replace(flat_scene, wall=wall)
    mesh = views.scene_3d(scene).actors["relay wall"].mapper.dataset
    points = np.asarray(mesh.points, dtype=np.float64)
    assert points[:, 2] == pytest.approx(wall.height(points[:, 0], points[:, 1]), abs=1e-6)
    assert mesh.bounds[1] - mesh.bounds[0] > 1.0


def grain(scene):
    """Spread of the wall's shading from texel to texel."""
    shading = views.scene_3d(scene).actors["relay wall"].texture.to_array()
    return float(np.diff(shading[..., 0].astype(float), axis=1).std())


@pytest.mark.thorough
def test_a_rough_wall_looks_rougher_than_a_mirror(flat_scene):
    mirror = replace(flat_scene, wall_material=SpecularMicrofacet(0.9, 0.0))
    satin = replace(flat_scene, wall_material=SpecularMicrofacet(0.9, 0.08))
    matt = replace(flat_scene, wall_material=Lambert(0.7))
    assert grain(mirror) == 0.0
    assert 0.0 < grain(satin) < 0.5 * grain(matt)
    prop = views.scene_3d(mirror).actors["relay wall"].prop
    assert prop.specular > 0.9
    assert views.scene_3d(matt).actors["relay wall"].prop.specular == 0.0


def test_the_plotter_that_goes_in_comes_out_and_shows_each_thing_once(flat_scene):
    plotter = views.scene_3d(flat_scene)
    assert views.scene_3d(flat_scene, plotter=plotter) is plotter
    assert views.ray_paths(made_paths(), flat_scene, plotter=plotter) is plotter
    names = set(plotter.actors)
    entries = legend(plotter)
    again = views.ray_paths(made_paths(), flat_scene, colour="weight", plotter=plotter)
    assert again is plotter
    assert {n for n in plotter.actors if "Addr" not in n} == {n for n in names if "Addr" not in n}
    assert list(plotter.scalar_bars.keys()) == [TITLES["weight"]]
    assert legend(plotter) == entries


def test_everything_is_in_the_picture(flat_scene):
    """What the camera of the picture sees: all corners of the room, within its frame."""
    plotter = views.scene_3d(flat_scene)
    camera = plotter.camera
    toward = np.subtract(camera.focal_point, camera.position)
    toward /= np.linalg.norm(toward)
    right = np.cross(toward, camera.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, toward)
    for name in ("relay wall", "hidden object", "lens", "laser", "floor grid"):
        mesh = plotter.actors[name].mapper.dataset
        away = np.asarray(mesh.points) - camera.position
        depth = away @ toward
        half = np.tan(np.radians(camera.view_angle / 2)) * depth
        wide = plotter.window_size[0] / plotter.window_size[1]
        assert np.all(depth > 0)
        assert np.all(np.abs(away @ up) <= half), name
        assert np.all(np.abs(away @ right) <= wide * half), name
    # from the room, not from behind the wall
    assert camera.position[2] > 1.0


def bright_voxel():
    volume = Volume(np.linspace(-0.5, 0.5, 21), np.linspace(-0.2, 0.2, 9), np.linspace(1, 2, 21))
    points = volume.points
    place = np.array([0.2, 0.1, 1.4])
    light = np.exp(-np.sum((points - place) ** 2, axis=-1) / 0.01)
    return VolumeImage(intensity=light, volume=volume, method="made"), place


def test_the_surface_lies_around_the_bright_voxel():
    """A Gaussian of 1/e radius 0.1 m is at 0.5 of its peak at 0.1 sqrt(ln 2) m."""
    image, place = bright_voxel()
    plotter = views.phasor_volume(image, threshold=0.5)
    points = np.asarray(plotter.actors["hidden scene"].mapper.dataset.points)
    reach = np.linalg.norm(points - place, axis=1)
    # the surface is linear between voxels 0.05 m apart: their sag is (0.05 m)^2/8 times the bend
    assert reach == pytest.approx(np.full(len(reach), 0.1 * np.sqrt(np.log(2))), abs=8e-3)
    mapper = plotter.actors["hidden scene"].mapper
    assert np.asarray(mapper.dataset["z"]) == pytest.approx(points[:, 2])
    assert list(plotter.scalar_bars.keys()) == ["distance from the wall (m)"]
    assert mapper.scalar_range == (1.0, 2.0)
    assert legend(plotter)[:2] == ["surface at 0.5 of the maximum", "volume"]
    assert views.phasor_volume(image, plotter=plotter) is plotter
    assert np.ptp(np.asarray(plotter.actors["volume"].mapper.dataset.points), axis=0) == (
        pytest.approx((1.0, 0.4, 1.0))
    )


def test_volumes_without_a_surface_are_refused():
    image, _ = bright_voxel()
    flat = VolumeImage(
        intensity=np.ones((1, 2, 2)), volume=Volume([0.0, 1.0], [0.0, 1.0], [1.0]), method="made"
    )
    with pytest.raises(SamplingError, match=r"\(1, 2, 2\) voxels .* has no surface"):
        views.phasor_volume(flat)
    dark = replace(image, intensity=np.zeros_like(image.intensity))
    with pytest.raises(SamplingError, match="zero everywhere"):
        views.phasor_volume(dark)
    even = replace(image, intensity=np.ones_like(image.intensity))
    with pytest.raises(SamplingError, match="no voxel is below threshold = 0.25"):
        views.phasor_volume(even)
    with pytest.raises(SceneError, match="threshold = 1 is out of range"):
        views.phasor_volume(image, threshold=1.0)


def test_missing_pyvista_is_told_in_one_line():
    code = (
        "import sys; sys.modules['pyvista'] = None\n"
        "from nlosoptics.views.stages import rendering_works, window\n"
        "for call in (rendering_works, window):\n"
        "    try: call()\n"
        "    except ImportError as error: print(type(error).__name__, error)"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    line = "MissingExtraError pyvista is not installed; run pip install 'nlosoptics[views]'"
    assert [text[: len(line)] for text in answer.stdout.splitlines()] == [line] * 2
