"""Public functions name what they take, for each argument of another type."""

from __future__ import annotations

import importlib
import inspect

import numpy as np
import pytest
import trimesh

import nlosoptics as nlos
from nlosoptics import imaging, psf, study, transient
from nlosoptics.errors import MemoryLimitError, NlosError, SceneError

ROOMS = ("imaging", "limits", "psf", "raytrace", "study", "transient", "views", "inverse", "report")
#: Values of other types; an error names the argument, its type or the value.
WRONG = (None, "wrong", {"wrong": 1}, ["wrong", "wrong"])
#: Functions that do much work before they use the argument, and functions of any argument.
UNSEEN = ("axes", "progress", "start")
APART = ("inverse.pcin", "transient.render_scene", "study.run_study")

#: A confocal capture, which all methods of imaging take.
POINTS = transient.wall_grid(side=1.0, count=4)
CONFOCAL = transient.TransientCapture(
    H=np.random.default_rng(0).random((20, 4, 4)),
    laser_points=POINTS,
    sensor_points=POINTS,
    delta_t=0.1,
    pairing="confocal",
)
CAPTURE = transient.TransientCapture(
    H=np.ones((3, 4)), laser_points=np.zeros(3), sensor_points=np.eye(4, 3), delta_t=0.1
)


@pytest.fixture(scope="module")
def valid():
    """Values by the name or annotation of an argument."""
    scene = nlos.Scene.load("examples/scenes/letter_flat.toml").resized(16)
    made = psf.scene_point_spread(scene, 1e-2)
    picture = np.random.default_rng(1).random((16, 16))
    volume = transient.Volume.facing(POINTS, (0.5, 1.0, 0.25))
    light = np.random.default_rng(0).random(volume.shape)
    table = study.sweep(scene, {"laser.power": [1e-3, 2e-3]}, ["photons"])
    box = trimesh.creation.box((0.1, 0.1, 0.1)).apply_translation((0, 0, 0.7))
    rays = {"origins": [[0, 0, 1.0]], "directions": [[0, 0, -1.0]], "targets": [[0, 0, 0.0]]}
    reals = ("electrons", "distance", "slope_rms", "shift", "image_distance", "wavelength")
    reals += ("tol", "frequency", "radius", "side", "wl_mean", "t_start", "delta_t")
    wholes = ("samples", "n_r", "n_theta", "index", "n_rays", "n_bins", "pulses")
    slopes = {"slopes": np.zeros((4, 4, 2)), "mask": np.ones((4, 4), bool), "rho": 0.5}
    return {
        **dict.fromkeys(reals, 0.1),
        **dict.fromkeys(wholes, 16),
        **rays,
        **slopes,
        "Scene": scene,
        "Scene | SceneOptics": scene,
        "Wall": scene.wall,
        "Wavefront": made.wavefront,
        "PointSpread": made.point_spread,
        "point_spread": made.point_spread,
        "point_spreads": made.point_spread,
        "optics": made,
        "model": made.point_spread,
        "exit_pupil": made.exit_pupil,
        "source": made.wavefront,
        "TransientCapture": CONFOCAL,
        "VolumeImage": transient.VolumeImage(intensity=light, volume=volume, method="test"),
        "volume": volume,
        "Results": table,
        "figures": "photons",
        "axes": {"laser.power": [1e-3]},
        "mesh": box,
        "meshes": box,
        "image": picture,
        "images": np.ones((3, 16, 16)),
        "autocorrelation": picture,
        "reconstruction": picture,
        "truth": picture,
        "speckle_image": imaging.form_image(scene, made.point_spread),
        "coefficients": {4: 1e-8},
        "planes": (0.5, 1.0, 0.25),
        "nodes": np.zeros((1, 2)),
        "theta": 0.0,
        "object_point": scene.object_point,
        "pupil_centre": scene.camera.position,
        "pupil_aim": (0.0, 0.0, 0.0),
        "path": "wrong/wrong.png",
        "folder": "wrong",
        "name": "wrong",
    }


def functions():
    for room in ROOMS:
        package = importlib.import_module(f"nlosoptics.{room}")
        for name in package.__all__:
            function = getattr(package, name)
            if inspect.isfunction(function) and f"{room}.{name}" not in APART:
                yield pytest.param(function, id=f"{room}.{name}")


@pytest.mark.parametrize("function", list(functions()))
def test_a_wrong_type_is_named(function, valid) -> None:
    taken = [
        p for p in inspect.signature(function).parameters.values() if p.kind < 4 and p.kind != 2
    ]
    arguments = {
        p.name: valid.get(str(p.annotation), valid.get(p.name))
        for p in taken
        if p.default is p.empty
    }
    names = [p.name.rstrip("s") for p in taken]
    if any(value is None for value in arguments.values()):
        taken = taken[:1]
    for one in taken:
        if isinstance(one.default, bool) or one.name in UNSEEN:
            continue
        for wrong in WRONG:
            optional = wrong is None and one.default is None
            text = wrong == "wrong" and "str" in str(one.annotation)
            if optional or text:
                continue
            with pytest.raises(NlosError) as refused:
                function(**arguments | {one.name: wrong})
            told = (*names, f"is a {type(wrong).__name__}", f"of type {type(wrong).__name__}")
            told += ("wrong",)
            assert any(part in str(refused.value) for part in told), (one.name, wrong, refused)


def test_values_that_no_array_can_be_made_of_are_refused() -> None:
    points = np.zeros((2, 2, 3))
    points[..., 0], points[..., 1] = np.meshgrid([0.0, 1.0], [0.0, 1.0])
    for step in (1e-12, 1e-320):
        with pytest.raises(MemoryLimitError, match="voxels needs .* use a larger step"):
            transient.Volume.facing(points, (1.0, 2.0, step))
    wave = psf.Wavefront.from_zernike({}, wavelength=5e-7, pupil_radius=5e-3, image_distance=0.1)
    for pitch in (1e-300, 1e200):
        with pytest.raises(SceneError, match="pitch = .* out of range"):
            psf.window_shape(wave, pitch=pitch)
    with pytest.raises(SceneError, match="volume is a NoneType; give a Volume"):
        transient.backprojection(CAPTURE, None)  # type: ignore[arg-type]


def test_a_long_value_is_shortened_in_an_error() -> None:
    with pytest.raises(SceneError) as refused:
        psf.encircled_energy(
            psf.Wavefront.from_zernike({}, wavelength=5e-7, pupil_radius=1e-3, image_distance=0.1),
            list(range(-900, 0)),
        )
    assert len(str(refused.value)) < 160
