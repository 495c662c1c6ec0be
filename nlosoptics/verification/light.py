"""Light in the room and on the detector."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import constants
from scipy.integrate import quad
from scipy.special import j0

from .. import imaging, limits, raytrace
from ..scene import (
    Camera,
    FlatWall,
    Lambert,
    Laser,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
)

_PICTURE = np.outer(np.arange(1.0, 7.0), (5.0, 1.0, 2.0, 0.0, 1.0, 4.0)) / 30  # without symmetry


def _room(**changes: Any) -> Scene:
    """Return a room with a matt wall, 1 m from a picture."""
    parts: dict[str, Any] = {
        "laser": Laser(
            wavelength=633e-9,
            power=5e-3,
            beam_diameter=3e-3,
            position=(1.3, 0.0, 1.1),
            aim=(0.6, 0.1, 0.0),
        ),
        "wall": FlatWall(size=(1.6, 1.2)),
        "hidden": PlanarObject(_PICTURE, 0.7, position=(0.0, 0.0, 1.0), material=Lambert(0.8)),
        "camera": Camera(
            position=(-0.6, 0.0, 0.8),
            aim=(-0.2, 0.0, 0.0),
            focal_length=0.05,
            stop_diameter=0.025,
            binning=512,
            exposure=0.04,
        ),
        "wall_material": Lambert(0.6),
    }
    return Scene(**parts | changes)


def _electrons_per_radiance(scene: Scene) -> float:
    """Return electrons on the whole detector, small and on the axis, for 1 W/(m^2 sr)."""
    camera = scene.camera
    lens = camera.stop_diameter / (2 * scene.image_distance)
    area = math.prod(camera.pixels) * camera.pixel_pitch**2
    rate = camera.quantum_efficiency * scene.laser.wavelength / (constants.h * constants.c)
    return math.pi * camera.transmission * lens**2 * area * camera.exposure * rate


def _small_detector(aim: tuple[float, float, float]) -> Camera:
    """Return the camera with one small pixel, whose axis meets the wall at a point."""
    return replace(_room().camera, aim=aim, pixels=(4, 4), binning=1)


def light_of_a_screen() -> tuple[float, float]:
    """Electrons from a luminous square, relative: Howell's configuration factors, B-3."""
    room = _room(camera=_small_detector((-0.35, -0.35, 0.0)))
    transport = imaging.WallTransport(room, cells=(5, 7), pixels=(1, 1), source="luminous")
    factor = 0.7 / math.hypot(1, 0.7) * math.atan(0.7 / math.hypot(1, 0.7)) / math.pi
    expected = _electrons_per_radiance(room) * 0.6 * factor
    return abs(transport.forward(np.ones((5, 7))).item() / expected - 1), 2e-4


def light_of_a_lit_cell() -> tuple[float, float]:
    """Electrons by way of spot, object and wall, relative: cosines over squares of distances."""
    room = _room(
        camera=_small_detector((-0.3, 0.4, 0.0)),
        hidden=PlanarObject(np.ones((2, 2)), 0.01, position=(0.0, 0.0, 1.0), material=Lambert(0.8)),
    )
    transport = imaging.WallTransport(room, cells=(1, 1), pixels=(1, 1))
    to_object, to_wall = 1 + 0.6**2 + 0.1**2, 1 + 0.3**2 + 0.4**2
    lit = 5e-3 * 0.6 / math.pi / to_object**2 * 0.8 / math.pi  # radiance, W/(m^2 sr)
    expected = _electrons_per_radiance(room) * lit * 0.01**2 / to_wall**2 * 0.6 / math.pi
    return abs(transport.matrix.item() / expected - 1), 1e-3


def traced_light() -> tuple[float, float]:
    """Traced image of a matt wall, in 5 standard errors: the same light by quadrature."""
    room = _room()
    image = raytrace.trace_image(room, n_rays=1 << 15, max_bounces=3, seed=1)
    rate = room.camera.quantum_efficiency * room.camera.exposure
    rate *= room.laser.wavelength / (constants.h * constants.c)
    expected = imaging.WallTransport(room, cells=_PICTURE.shape).forward(_PICTURE)
    limit = 5 * image.power_error * rate + 1e-3 * expected  # chance, and the quadrature's own
    return (abs(image.power * rate - expected) / limit).max(), 1.0


def energy_of_rays() -> tuple[float, float]:
    """Power of all traced light, relative: what is absorbed, escapes and arrives is what came."""
    paths = raytrace.trace(_room(), n_rays=1 << 12, analog=True, seed=2)
    return abs(math.fsum(paths.ledger.values()) / 5e-3 - 1), 1e-12


def draws() -> tuple[float, float]:
    """Random numbers by their addresses: equal seeds give equal bits, other seeds others."""
    first, again, other = (raytrace.trace(_room(), n_rays=1 << 12, seed=s).flux for s in (3, 3, 4))
    return float(first != again or first == other), 0.0


def mirror_image() -> tuple[float, float]:
    """Image in a flat mirror, in pixels: the pinhole view of the mirrored object."""
    picture = np.zeros((64, 64))
    picture[10:14, 48:52] = 1.0
    hidden = PlanarObject(picture, 0.3, position=(0.0, 0.0, 1.0), material=Lambert(0.8))
    camera = replace(_room().camera, aim=(-0.28, 0.0, 0.0), binning=16)
    mirror = SumMaterial((Lambert(0.3), SpecularMicrofacet(0.5, 1e-4)))
    room = _room(wall_material=mirror, hidden=hidden, camera=camera)
    right, up, _ = hidden.axes
    point = np.array(hidden.position) + 0.3 * ((50 / 64 - 0.5) * right + (0.5 - 12 / 64) * up)
    x, y, depth = camera.frame @ (point * (1, 1, -1) - np.array(camera.position))
    expected = -room.image_distance * np.array([x, y]) / depth / camera.image_pitch
    image = imaging.form_image(room).ideal
    rows, columns = np.indices(image.shape) - (np.array(image.shape)[:, None, None] - 1) / 2
    found = np.array([(image * columns).sum(), (image * rows).sum()]) / image.sum()
    return abs(found - expected).max(), 0.05


def photons() -> tuple[float, float]:
    """Noise of an image, in 5 standard errors: the variance of counted photons is their mean."""
    room = _room(camera=replace(_room().camera, binning=64, read_noise=0.0))
    image = imaging.form_image(room, seed=5)
    steps = (room.camera.full_well / 2**room.camera.bit_depth) ** 2 / 12 * 64**2  # digits
    squares = (image.electrons - image.expected) ** 2 / (image.expected + steps)
    return abs(squares.mean() - 1) / (5 * math.sqrt(2 / squares.size)), 1.0


def matt_wall() -> tuple[float, float]:
    """Modulation that a matt wall passes: the transform of 1/(1 + r^2)^2 by quadrature."""
    frequency = np.array([0.05, 0.2, 0.6])  # cycles/m, at 1 m
    expected = [
        quad(lambda r, v=v: 2 * r * j0(v * r) / (1 + r**2) ** 2, 0, 400, limit=5000)[0]
        for v in 2 * np.pi * frequency
    ]
    return abs(limits.lambert_relay_transfer(frequency, 1.0) - expected).max(), 1e-6


def adjoints() -> tuple[float, float]:
    """Inner products with each operator and its adjoint, relative: they are equal."""
    rng = np.random.default_rng(0)
    transport = imaging.WallTransport(_room(), cells=(6, 7), pixels=(5, 4), samples=3)
    spread = rng.random((5, 5))
    errors = []
    for model, of, to in (
        (transport, (6, 7), (5, 4)),
        (imaging.ForwardModel(spread, shape=(9, 8)), (9, 8), (9, 8)),
    ):
        f, y = rng.random(of), rng.random(to)
        errors.append((model.forward(f) * y).sum() / (model.adjoint(y) * f).sum() - 1)
    return abs(np.array(errors)).max(), 1e-12
