"""Every public noun pickles, copies and stays read-only, and computes the same bits afterwards."""

from __future__ import annotations

import copy
import importlib
import pickle
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics import imaging, psf, raytrace, scene, study, transient
from nlosoptics.errors import SceneError

ROOT = Path(__file__).parents[2]
RNG = np.random.default_rng(7)


def square(x: Any, y: Any) -> Any:
    """Height of a callable wall that pickles by its name."""
    return 1e-3 * x * x + 0 * y


def slopes(x: Any, y: Any) -> Any:
    """Its gradient."""
    return 2e-3 * x, 0 * y


def falling(r: Any) -> Any:
    """An autocorrelation that pickles by its name."""
    return np.exp(-np.abs(r) / 1e-3)


@cache
def mesh(side: int = 9) -> Any:
    """A wall of triangles, which a tree for rays was built for already."""
    trimesh = pytest.importorskip("trimesh")
    x, y = np.meshgrid(*2 * [np.linspace(-1.5, 1.5, side)])
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + side + 1], 1),
            np.stack([corner, corner + side + 1, corner + side], 1),
        ]
    )
    corners = np.stack([x, y, 1e-3 * x * x], -1).reshape(-1, 3)
    made = trimesh.Trimesh(corners, faces, process=False)
    raytrace.intersect_mesh(made, np.array([[0.1, 0.2, 1.0]]), np.array([[0.0, 0.0, -1.0]]))
    return made


def room(**changes: Any) -> nlos.Scene:
    """An example scene over few pixels."""
    found = nlos.Scene.load(ROOT / "examples" / "scenes" / "letter_flat.toml").resized(16)
    return replace(found, **changes)


def wave(**changes: Any) -> psf.Wavefront:
    """A wave on an aperture of two parts."""
    return psf.Wavefront.from_zernike(
        {4: 1e-7, 7: 5e-8}, wavelength=6e-7, pupil_radius=5e-3, image_distance=0.05, **changes
    )


def capture() -> transient.TransientCapture:
    light = RNG.exponential(size=(20, 4, 4))
    return transient.TransientCapture(
        H=light,
        laser_points=(0, 0, 0),
        sensor_points=transient.wall_grid(1.0, 4),
        delta_t=0.1,
        by_bounce={3: light / 2, 4: light / 2},
        details={"within": {"table": np.arange(3.0)}, "list": [np.arange(2)]},
    )


@cache
def result() -> nlos.Result:
    """A run with a field of point spreads asked for nowhere: a few pixels, reconstructed."""
    pytest.importorskip("torch")
    return nlos.simulate(room(), seed=3, reconstruct=True)


#: Nouns of every kind: of files, functions, arrays, mappings and kept state.
MADE: Mapping[str, Any] = {
    "CallableWall": lambda: scene.CallableWall(square, slopes, max_height=1.0, max_curvature=0.01),
    "FacetWall": lambda: scene.FacetWall(1e-3, 2e-3, seed=3, size=2.0),
    "GaussianWall": lambda: scene.GaussianWall(1e-6, 1e-3, seed=3),
    "HeightMapWall": lambda: scene.HeightMapWall.random(
        height_rms=1e-6, correlation_length=0.1, size=1.0, pitch=0.04
    ),
    "Measurement": lambda: importlib.import_module("nlosoptics.inverse").Measurement(
        RNG.random((3, 4)), noise_sigma=RNG.random((3, 4)), masked=RNG.random((3, 4)) > 0.5
    ),
    "MeshObject": lambda: scene.MeshObject(mesh(), position=(0.3, 0.0, 2.0), scale=0.1),
    "MeshWall": lambda: scene.MeshWall(mesh()),
    "Occluder": lambda: scene.Occluder(mesh(), position=(0.3, 0.0, 2.0), pitch=1.0),
    "OrenNayar": lambda: scene.OrenNayar(0.5, 0.3),
    "PlanarObject": lambda: scene.PlanarObject(RNG.random((5, 7)), 0.1, position=(0.3, 0.0, 1.0)),
    "Scene": lambda: room(occluders=(mesh().copy().apply_translation((0, 0, 5)),)),
    "SumMaterial": lambda: scene.SumMaterial(scene.Lambert(0.5), scene.Ward(0.2, 0.1)),
    "SumWall": lambda: scene.SumWall(scene.FlatWall(), scene.WavyWall(1e-6, 0.1), size=1.0),
    "WallRoughness": lambda: scene.WallRoughness(scene.FacetWall(1e-3, 2e-3), "mean"),
    "Aperture": lambda: psf.Aperture.round(5e-3, 0.3, vanes=3, vane_width=2e-4),
    "Roughness": lambda: psf.Roughness(1e-7, 1e-3, "exponential"),
    "Wavefront": lambda: wave(aperture=psf.Aperture.round(5e-3, 0.3)),
    "PointSpread": lambda: psf.point_spread(wave(), shape=64),
    "ScenePointSpread": lambda: psf.scene_point_spread(room(), shape=32),
    "ForwardModel": lambda: imaging.ForwardModel(RNG.random((5, 5)), shape=(8, 9)),
    "TransientCapture": capture,
    "PhasorImage": lambda: transient.PhasorImage(
        intensity=RNG.random((6, 6, 6)),
        volume=transient.Volume(*3 * [np.linspace(0.5, 1.0, 6)]),
        method="phasor",
        field=RNG.random((6, 6, 6)) + 1j,
        camera="transient",
        wl_mean=0.1,
        wl_sigma=0.1,
    ),
    "TracedImage": lambda: raytrace.trace_image(
        room(), n_rays=256, max_bounces=3, t_start=3.0, delta_t=1.0, n_bins=4
    ),
    "Plan": lambda: nlos.plan(room()),
    "Study": lambda: study.Study.from_tables(
        {
            "scene": "examples/scenes/letter_flat.toml",
            "figures": ["strehl"],
            "axes": {"laser.power": ["1 mW", "2 mW"]},
        },
        ROOT,
    ),
    "Result": result,
}


def assert_same(one: Any, other: Any, place: str, *, locked: bool = True) -> None:
    """Same types, and the same bits in every array; arrays and mappings closed in the other."""
    assert type(one) is type(other), place
    if hasattr(one, "parameters"):  # a module of torch
        for name, value in one.state_dict().items():
            assert bool((value == other.state_dict()[name]).all()), f"{place}.{name}"
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape) == (other.dtype, other.shape), place
        same = one.tobytes() == other.tobytes()
        assert same, place  # pytest would spend a minute on the difference of the bytes
        assert not (locked and other.flags.writeable), f"{place} can be written"
    elif hasattr(one, "identical"):  # a dataset of xarray
        assert one.identical(other), place
    elif isinstance(one, Mapping):
        assert list(one) == list(other), place
        for key in one:
            assert_same(one[key], other[key], f"{place}[{key}]", locked=locked)
    elif is_dataclass(one):
        for entry in fields(one):
            pair = (getattr(noun, entry.name) for noun in (one, other))
            assert_same(*pair, f"{place}.{entry.name}", locked=locked)
    elif isinstance(one, tuple | list):
        assert len(one) == len(other), place
        locked = locked and not hasattr(one, "_fields")  # numpy's own tuples lock nothing
        for i, pair in enumerate(zip(one, other, strict=True)):
            assert_same(*pair, f"{place}[{i}]", locked=locked)
    elif hasattr(one, "faces"):
        for name in ("vertices", "faces"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), place
    else:
        assert one == other, place


#: What nouns compute, by their classes; whoever travels computes the same bits.
USES: Mapping[type, Any] = {
    scene.Wall: lambda wall: wall.derivatives(np.linspace(-0.4, 0.4, 7), np.full(7, 0.1)),
    scene.Material: lambda lobes: lobes.albedo(np.linspace(0.1, 1.5, 5)),
    scene.PlanarObject: lambda hidden: hidden.reflectance,
    scene.MeshObject: lambda hidden: np.asarray(hidden.surface.vertices),
    scene.Occluder: lambda body: np.asarray(body.surface.vertices),
    nlos.Scene: lambda found: np.asarray(found.occluding_mesh.vertices),
    psf.Aperture: lambda outline: outline.nodes(5, 5)[2],
    psf.Roughness: lambda rough: rough.correlation(np.geomspace(1e-5, 1e-2, 9)),
    psf.Wavefront: lambda found: psf.point_spread(found, shape=64).intensity,
    imaging.ForwardModel: lambda model: model.forward(np.eye(8, 9)),
    transient.TransientCapture: lambda found: found.edges,
}


def travelled(noun: Any) -> list[tuple[str, Any]]:
    return [
        *(
            (f"pickle {n}", pickle.loads(pickle.dumps(noun, n)))
            for n in (2, pickle.HIGHEST_PROTOCOL)
        ),
        ("deep copy", copy.deepcopy(noun)),
        ("again", copy.deepcopy(pickle.loads(pickle.dumps(noun)))),
    ]


@pytest.mark.parametrize("kind", MADE)
def test_nouns_travel_and_are_short_in_print(kind: str) -> None:
    """Before and after use: what is kept of a use is left behind and made again."""
    noun = MADE[kind]()
    size = len(pickle.dumps(noun))
    uses = [use for known, use in USES.items() if isinstance(noun, known)]
    fresh = travelled(noun)
    here = [use(noun) for use in uses]
    for how, other in [*fresh, *travelled(noun)]:
        assert other is not noun
        assert_same(noun, other, f"{kind} by {how}", locked=hasattr(noun, "__setstate__"))
        for use, found in zip(uses, here, strict=True):
            assert use(other).tobytes() == found.tobytes(), how
    assert copy.copy(noun) is noun or not hasattr(noun, "__setstate__")
    assert len(pickle.dumps(noun)) == size
    assert len(repr(noun)) < 4000


def test_a_scene_travels_to_where_its_files_are_not(tmp_path: Path) -> None:
    """Pictures, heights and meshes are in the pickle; and from there into a folder again."""
    trimesh = pytest.importorskip("trimesh")
    (tmp_path / "here").mkdir()
    np.save(tmp_path / "here" / "picture.npy", RNG.random((5, 6)))
    np.save(tmp_path / "here" / "heights.npy", 1e-6 * RNG.random((16, 16)))
    trimesh.creation.box((0.1, 0.1, 0.2)).export(tmp_path / "here" / "box.ply")
    made = room(
        wall=scene.HeightMapWall(tmp_path / "here" / "heights.npy", pitch=0.1),
        hidden=scene.PlanarObject(tmp_path / "here" / "picture.npy", 0.1, position=(0.3, 0, 1)),
        occluders=(scene.Occluder(tmp_path / "here" / "box.ply", position=(0, 0, 1)),),
    )
    packed = pickle.dumps(made)
    (tmp_path / "here").rename(tmp_path / "gone")
    there = pickle.loads(packed)
    assert there == made
    assert there.wall.height(0.1, 0.2) == scene.HeightMapWall(
        tmp_path / "gone" / "heights.npy", pitch=0.1
    ).height(0.1, 0.2)
    assert there.occluding_mesh.bounds[:, 2] == pytest.approx([0.9, 1.1])
    assert replace(there.hidden, yaw=0.1).reflectance.shape == (5, 6)
    for name, content in scene.file.scene_files(there).items():
        (tmp_path / name).write_bytes(content)
    moved = nlos.Scene.load(tmp_path / "scene.toml")
    assert moved.hidden.reflectance.tobytes() == there.hidden.reflectance.tobytes()


def test_a_scene_whose_picture_is_missing_does_not_travel(tmp_path: Path) -> None:
    hidden = scene.PlanarObject(tmp_path / "none.png", (0.1, 0.1), position=(0.3, 0.0, 1.0))
    with pytest.raises(SceneError, match=r"none.png cannot be read .*put it back"):
        pickle.dumps(room(hidden=hidden))


def test_functions_without_a_name_are_refused_in_one_line() -> None:
    """By pickle alone; a deep copy takes them as they are."""
    bent = scene.CallableWall(lambda x, y: 0 * x, slopes, max_height=1.0, max_curvature=0.01)
    rough = psf.Roughness(1e-7, 1e-3, lambda r: np.exp(-np.abs(r) / 1e-3))
    for noun, name in ((bent, "wall.height"), (rough, "roughness.autocorrelation")):
        with pytest.raises(SceneError, match=rf"{name} = .* cannot be pickled .*top level") as told:
            pickle.dumps(noun)
        assert "\n" not in str(told.value)
        copy.deepcopy(noun)
    kept = pickle.loads(pickle.dumps(psf.Roughness(1e-7, 1e-3, falling)))
    assert kept.autocorrelation is falling
