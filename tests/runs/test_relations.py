"""Relations between runs of different scenes, which hold whatever the methods are."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import nlosoptics as nlos
from nlosoptics import psf
from nlosoptics.errors import NlosError
from nlosoptics.scene import (
    Camera,
    ConcaveWall,
    ConvexWall,
    FlatWall,
    Laser,
    PlanarObject,
    Scene,
    WavyWall,
)

pytestmark = pytest.mark.thorough
TOL = 1e-3
#: Relative rms error that a run's image may have against the tolerance's own, both runs together.
TWICE = 2.0 * TOL
usual = settings(
    max_examples=5,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[Phase.generate],  # to make a failing room simpler would take minutes
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
PICTURES = np.random.default_rng(5).random((4, 8, 8)) < 0.4


@dataclass(frozen=True)
class Room:
    """A room by a few numbers; ``scene(scale)`` has all lengths that many times as large."""

    shape: str
    bend: float
    object_at: tuple[float, float, float]
    f_number: float
    picture: int

    def scene(self, scale: float = 1.0) -> Scene:
        """Return the room; the angles stay, as do power and exposure."""
        size = (1.4 * scale, 1.0 * scale)
        walls: dict[str, Any] = {
            "flat": lambda: FlatWall(size=size),
            "concave": lambda: ConcaveWall((4.0 + 10.0 * self.bend) * scale, size=size),
            "convex": lambda: ConvexWall((4.0 + 10.0 * self.bend) * scale, size=size),
            "wavy": lambda: WavyWall(
                2e-4 * self.bend * scale, 0.5 * scale, size=size, direction=self.bend
            ),
        }
        camera = Camera(
            focal_length=0.05 * scale,
            stop_diameter=0.05 * scale / self.f_number,
            position=(-0.45 * scale, 0.0, 0.8 * scale),
            aim=(0.0, 0.0, 0.0),
            pixel_pitch=1e-3 * scale,
            pixels=(24, 24),
            binning=1,
        )
        x, y, z = self.object_at
        return Scene(
            Laser(
                wavelength=600e-9 * scale,
                power=5e-3,
                beam_diameter=3e-3 * scale,
                position=(0.9 * scale, 0.0, 1.2 * scale),
                aim=(0.55 * scale, 0.0, 0.0),
            ),
            walls[self.shape](),
            PlanarObject(
                PICTURES[self.picture].astype(float),
                0.3 * scale,
                position=(x * scale, y * scale, z * scale),
            ),
            camera,
        )


rooms = st.builds(
    Room,
    shape=st.sampled_from(("flat", "concave", "convex", "wavy")),
    bend=st.floats(0.1, 1.0),
    object_at=st.tuples(st.floats(0.4, 0.7), st.floats(-0.1, 0.1), st.floats(0.8, 1.2)),
    f_number=st.floats(3.0, 12.0),
    picture=st.integers(0, 3),
)


def expected(scene: Scene) -> NDArray[np.float64]:
    """Return the expected electrons of a scene that is accepted."""
    try:
        return np.asarray(nlos.simulate(scene, tol=TOL).image.expected)
    except NlosError:
        assume(False)
        raise


def rms(values: NDArray[np.float64]) -> float:
    return math.sqrt(float(np.mean(values**2)))


@usual
@given(rooms, st.sampled_from((0.5, 3.0)))
def test_all_lengths_scaled_with_the_wavelength(room: Room, scale: float) -> None:
    """The same angles and waves; photons of a longer wavelength are more in the same energy."""
    near, far = expected(room.scene()), expected(room.scene(scale))
    assert rms(far - scale * near) < TWICE * scale * rms(near)
    waves = [psf.rms_aberration(psf.wavefront(room.scene(by))) / by for by in (1.0, scale)]
    # paths of metres in double precision differ by some 1e-15 m
    assert waves[1] == pytest.approx(waves[0], rel=1e-6, abs=1e-14)


@usual
@given(rooms, st.floats(0.2, 5.0))
def test_power_and_exposure_change_places(room: Room, factor: float) -> None:
    """Electrons follow the energy; dark current is 0 here."""
    scene = room.scene()
    brighter = replace(
        scene,
        laser=replace(scene.laser, power=scene.laser.power * factor),
        camera=replace(scene.camera, exposure=scene.camera.exposure / factor),
    )
    # nothing else depends on either; products are rounded in another order
    np.testing.assert_allclose(expected(brighter), expected(scene), rtol=1e-12)


@usual
@given(rooms, st.integers(0, 3))
def test_pictures_superpose(room: Room, other: int) -> None:
    """Light of two pictures is the sum of their lights, above that of a black one."""

    def of(picture: NDArray[np.float64]) -> NDArray[np.float64]:
        scene = room.scene()
        return expected(replace(scene, hidden=replace(scene.hidden, image=picture)))

    one, two = 0.5 * PICTURES[room.picture], 0.5 * PICTURES[other]
    both, black = of(one + two), of(np.zeros((8, 8)))
    found = of(one) + of(two)
    # three runs, each to the tolerance
    assert rms(both + black - found) < 3.0 * TOL * rms(both)


@usual
@given(rooms, st.tuples(st.floats(-0.1, 0.7), st.floats(-0.2, 0.2), st.floats(0.3, 0.8)))
def test_an_occluder_never_adds_light(room: Room, at: tuple[float, float, float]) -> None:
    scene = room.scene()
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.08)
    ball.apply_translation(at)
    without, with_it = expected(scene), expected(replace(scene, occluders=(ball,)))
    assert (with_it - without).max() <= TWICE * rms(without)
    assert with_it.sum() <= without.sum() * (1.0 + TWICE)
