"""Public functions name what they take, for first arguments of other types."""

from __future__ import annotations

import importlib
import inspect
import re

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics import psf, transient
from nlosoptics.errors import MemoryLimitError, SceneError

ROOMS = ("imaging", "limits", "psf", "raytrace", "study", "transient", "views")
#: Kinds of first arguments by their annotation.
NOUNS = re.compile(
    r"(Scene|SceneOptics|Wavefront|PointSpread|TransientCapture|VolumeImage|Results|Study|DepthMap)"
    r"( \| (SceneOptics|Wavefront|PointSpread|VolumeImage|PupilField))*"
)


CAPTURE = transient.TransientCapture(
    H=np.ones((3, 4)), laser_points=np.zeros(3), sensor_points=np.eye(4, 3), delta_t=0.1
)


def functions():
    for room in ROOMS:
        package = importlib.import_module(f"nlosoptics.{room}")
        for name in package.__all__:
            function = getattr(package, name)
            if inspect.isfunction(function):
                first = next(iter(inspect.signature(function).parameters.values()), None)
                if first is not None and NOUNS.fullmatch(str(first.annotation)):
                    yield pytest.param(function, id=f"{room}.{name}")


@pytest.mark.parametrize("function", list(functions()))
def test_a_wrong_type_is_told_with_what_is_taken(function) -> None:
    needed = [
        p
        for p in inspect.signature(function).parameters.values()
        if p.default is p.empty and p.kind is not p.VAR_KEYWORD and p.kind is not p.VAR_POSITIONAL
    ]
    for wrong in (None, "text", nlos.errors):
        positional = [wrong] + [1.0 for p in needed[1:] if p.kind is not p.KEYWORD_ONLY]
        named = {p.name: 1.0 for p in needed[1:] if p.kind is p.KEYWORD_ONLY}
        with pytest.raises(SceneError, match=rf"is a {type(wrong).__name__}; "):
            function(*positional, **named)


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
