"""Captures of scenes: what becomes of walls, pictures and occluders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.scene import (
    Camera,
    ConcaveWall,
    FacetWall,
    FlatWall,
    Lambert,
    Laser,
    MeshObject,
    Occluder,
    PlanarObject,
    Scene,
    SumMaterial,
    TransientScan,
    WallRoughness,
)
from nlosoptics.transient import Scan, Volume, render, render_scene, wall_grid
from nlosoptics.transient.rendering.scene import cut_out

SCAN = TransientScan(side=2.0, count=3, t_start=1.5, delta_t=0.02, n_bins=120)
LETTER = np.zeros((16, 16))
LETTER[2:14, 3:6] = LETTER[11:14, 6:12] = 1.0  # an L as the eye reads it, row 0 on top


def scene(**changes):
    given = {
        "laser": Laser(
            wavelength=532e-9,
            power=0.1,
            beam_diameter=3e-3,
            position=(-0.5, 0, 0.25),
            aim=(0, 0, 0),
        ),
        "wall": FlatWall(size=(2.0, 2.0)),
        "hidden": PlanarObject(LETTER, 0.8, position=(0.1, 0.0, 1.0), material=Lambert(0.6)),
        "camera": Camera(
            position=(-0.5, 0.0, 0.25), aim=(0, 0, 0), focal_length=0.05, stop_diameter=0.025
        ),
        "wall_material": Lambert(0.8),
        "transient": SCAN,
    }
    return Scene(**{**given, **changes})


def test_white_is_cut_out_where_it_hangs():
    """Area to rounding, and by its centroid the right way round: its foot points to -x, down."""
    picture = scene().hidden
    mesh = cut_out(picture)
    cell = (0.8 / 16) ** 2
    assert mesh.area == pytest.approx(LETTER.sum() * cell, rel=1e-12)
    assert len(mesh.faces) == 4  # two rectangles
    rows, columns = np.nonzero(LETTER)
    right, up, _ = picture.axes
    centre = picture.position + right * 0.8 * ((columns + 0.5) / 16 - 0.5).mean()
    centre = centre + up * 0.8 * (0.5 - (rows + 0.5) / 16).mean()
    middles = mesh.triangles_center * mesh.area_faces[:, None]
    assert middles.sum(axis=0) / mesh.area == pytest.approx(centre, abs=1e-12)
    assert mesh.vertices[:, 2] == pytest.approx(1.0)


def test_fine_pictures_are_cut_coarsely():
    """A disc of 500 pixels in cells of a 64th: area to a cell's width along its edge."""
    y, x = np.mgrid[-1:1:500j, -1:1:500j]
    disc = PlanarObject((x**2 + y**2 < 0.64).astype(float), 1.0, position=(0, 0, 1))
    mesh = cut_out(disc)
    area = np.pi * 0.4**2
    # half of the edge's cells are off by half a cell at random at most
    assert mesh.area == pytest.approx(area, rel=0.01)
    assert len(mesh.faces) < 400


def test_a_scene_is_rendered_as_its_parts_are():
    ours = render_scene(scene(), tol=1e-3)
    mesh = cut_out(scene().hidden)
    bins = {"t_start": 1.5, "delta_t": 0.02, "n_bins": 120}
    same = render(
        [(mesh, Lambert(0.6))],
        Scan(
            laser_points=(0, 0, 0),
            sensor_points=wall_grid(2.0, 3),
            wall_albedo=0.8,
            **bins,
        ),
        max_bounces=3,
        tol=1e-3,
    )
    assert np.array_equal(ours.H, same.H)
    assert ours.laser_origin == (-0.5, 0.0, 0.25)
    assert ours.details["side"] == 2.0
    confocal = render_scene(scene(transient=replace(SCAN, scan="confocal", near=1, far=2, step=1)))
    assert confocal.is_confocal
    assert confocal.details["picture"] == {"near": 1.0, "far": 2.0, "step": 1.0}
    all_of_them = render_scene(scene(transient=replace(SCAN, scan="exhaustive", count=2)))
    assert all_of_them.laser_shape == (2, 2)
    # light goes either way alike
    assert all_of_them.H == pytest.approx(np.moveaxis(all_of_them.H, (3, 4), (1, 2)), rel=1e-9)


@pytest.mark.thorough
def test_the_wall_takes_part_from_five_bounces_on():
    """Light that goes back to the wall on its way adds to the letter's own four and five."""
    many = replace(SCAN, count=2, n_bins=300, max_bounces=5)
    light = render_scene(scene(transient=many), tol_multiple=0.1)
    parts = {n: part.sum() for n, part in light.by_bounce.items()}
    assert sorted(parts) == [3, 4, 5]
    assert parts[4] == 0.0  # a plane sees no light of its own
    # twice as many reflections, each of a part of the light
    assert 0.0 < parts[5] < 0.1 * parts[3]
    first = 1.5 + 0.02 * np.flatnonzero(light.by_bounce[5].sum(axis=(1, 2)))[0]
    assert first > 3.9  # four times the distance of nearly 1 m
    with pytest.raises(SceneError, match="wall.size is missing, with transient.max_bounces = 5"):
        render_scene(scene(transient=many, wall=FlatWall()))


def test_occluders_with_a_material_give_light_too():
    """As further surfaces of `render`, to the last bit."""
    corners = [(0.9, -0.5, 0.3), (0.9, 0.5, 0.3), (0.9, 0.5, 1.3), (0.9, -0.5, 1.3)]
    side = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)
    hidden = scene().hidden
    lit = render_scene(scene(occluders=(Occluder(side, material=Lambert(0.4)),)), tol=1e-2)
    same = render(
        [(cut_out(hidden), hidden.material), (side, Lambert(0.4))],
        Scan(
            laser_points=(0, 0, 0),
            sensor_points=wall_grid(2.0, 3),
            wall_albedo=0.8,
            t_start=1.5,
            delta_t=0.02,
            n_bins=120,
        ),
        max_bounces=3,
        tol=1e-2,
    )
    assert np.array_equal(lit.H, same.H)
    dark = render_scene(scene(occluders=(side,)), tol=1e-2)
    assert (lit.H.sum(axis=0) > 1.2 * dark.H.sum(axis=0)).all()


def test_occluders_take_light_and_give_none():
    plate = trimesh.creation.box(extents=(0.5, 3.0, 0.01))
    plate.apply_translation((-0.35, 0.0, 0.5))
    free, dark = (render_scene(scene(occluders=given)).H for given in ((), (plate,)))
    lost = 1.0 - dark.sum(axis=0) / free.sum(axis=0)
    assert lost.min() >= -1e-3  # of tol
    assert lost.max() > 0.9
    assert lost.min() < 0.1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"transient": None}, r"no \[transient\]"),
        ({"wall": ConcaveWall(5.0, size=(2.0, 2.0))}, "wall.shape is ConcaveWall"),
        ({"wall": FlatWall(size=(3.0, 1.5))}, "transient.side = 2 m .* wall's 1.5 m"),
        ({"wall_material": Lambert(0.0)}, "wall_albedo = 0"),
        (
            {"hidden": PlanarObject(0.5 * LETTER, 0.8, position=(0, 0, 1))},
            "100 % of its reflectance in grey",
        ),
    ],
)
def test_scenes_that_cannot_be_taken_over_time(changes, words):
    with pytest.raises(SceneError, match=words):
        render_scene(scene(**changes))


def test_walls_of_paint_are_refused_and_sums_of_one_are_not():
    default = Scene(**{k: getattr(scene(), k) for k in ("laser", "wall", "hidden", "camera")})
    with pytest.raises(SceneError, match='give lobe = "lambert"'):
        render_scene(replace(default, transient=SCAN))
    alone = render_scene(scene(wall_material=SumMaterial(Lambert(0.8))))
    assert np.array_equal(alone.H, render_scene(scene()).H)


def test_meshes_are_taken_as_they_stand():
    plate = trimesh.creation.box(extents=(0.4, 0.4, 0.02))
    hidden = MeshObject(plate, position=(0.0, 0.0, 1.005), material=Lambert(0.6))
    H = render_scene(scene(hidden=hidden)).H
    first = 1.5 + 0.02 * np.flatnonzero(H.sum(axis=(1, 2)))[0]
    # over the spot and back to it: twice the distance of its front, 1.99 m, is in the bin of 1.98
    assert first == pytest.approx(1.98, rel=1e-12)


def test_volume_faces_a_grid():
    volume = Volume.facing(wall_grid(2.0, 4), (0.5, 1.0, 0.1))
    assert volume.z == pytest.approx([0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    assert np.array_equal(volume.points[0, ..., :2], wall_grid(2.0, 4)[..., :2])
    with pytest.raises(SamplingError, match="no grid"):
        Volume.facing(np.zeros((4, 3)), (0.5, 1.0, 0.1))
    with pytest.raises(SamplingError, match="off an even grid"):
        Volume.facing(wall_grid(2.0, 4).swapaxes(0, 1), (0.5, 1.0, 0.1))
    with pytest.raises(SceneError, match="far = 0.2 m is before near"):
        Volume.facing(wall_grid(2.0, 4), (0.5, 0.2, 0.1))


def test_mean_roughness_leaves_a_matt_wall_as_it_is():
    facets = FacetWall(1e-3, 0.01)
    plain = render_scene(scene())
    assert (render_scene(scene(wall_roughness=WallRoughness(facets, "mean"))).H == plain.H).all()
    assert (
        render_scene(scene(wall_roughness=WallRoughness(FacetWall(1e-3, 0.0)))).H == plain.H
    ).all()
    with pytest.raises(SceneError, match="realisation is 'pattern', must be 'mean'"):
        render_scene(scene(wall_roughness=WallRoughness(facets)))
