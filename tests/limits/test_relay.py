"""Transfer of wide lobes: closed forms, and modes counted by an independent computation."""

from __future__ import annotations

import importlib.util
import json
import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest import approx
from scipy import constants, integrate, special

from nlosoptics import limits
from nlosoptics.errors import NlosError
from nlosoptics.imaging.objects import Patches
from nlosoptics.imaging.radiometry import arrivals, laser_spot
from nlosoptics.limits.relay import CONTRAST, count_modes, relay_light
from nlosoptics.scene import (
    Camera,
    FlatWall,
    Lambert,
    Laser,
    OrenNayar,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
)

ROWS = json.loads((Path(__file__).parents[1] / "truths" / "relay.json").read_text())


def rows(name: str) -> list[dict]:
    return [row for row in ROWS if row["name"] == name]


@pytest.mark.parametrize("row", rows("lambert_relay_transfer"), ids=lambda r: str(r["parameters"]))
def test_matt_wall_transfer(row: dict) -> None:
    given = row["parameters"]
    found = limits.lambert_relay_transfer(float(given["f_cycles_per_m"]), float(given["z_m"]))
    # both sides carry the rounding of K1, some 1e-15 each
    assert float(found) == approx(float(row["value"]), rel=1e-13)


def test_matt_wall_transfer_is_the_transform_of_its_irradiance() -> None:
    """Hankel transform of z^2/(r^2 + z^2)^2 over its integral, at another distance."""
    z, f = 0.7, 0.6
    ends = special.jn_zeros(0, 60) / (2 * math.pi * f)
    parts = [
        integrate.quad(
            lambda r: r * special.j0(2 * math.pi * f * r) / (r * r + z * z) ** 2, low, high
        )[0]
        for low, high in zip([0.0, *ends[:-1]], ends, strict=True)
    ]
    # whole half periods fall as r^-3.5: what is left after 60 is below 1e-6
    assert float(limits.lambert_relay_transfer(f, z)) == approx(2 * z * z * sum(parts), abs=2e-6)
    assert float(limits.lambert_relay_transfer(0.0, z)) == 1.0


@pytest.mark.parametrize("row", rows("lambert_relay_limit"), ids=lambda r: str(r["parameters"]))
def test_matt_wall_limit(row: dict) -> None:
    electrons = float(row["parameters"]["N_electrons"])
    # f z is a constant of the electrons
    for distance in (1.0, 0.4):
        found = limits.lambert_relay_limit(electrons, distance) * distance
        assert found == approx(float(row["value"]), rel=1e-12)


def test_lobe_transfer_is_that_of_its_blur() -> None:
    """Five cycles/m at 1 m need a slope below 0.04: physics of a Gaussian of 2 sigma d."""
    assert float(limits.lobe_relay_transfer(5.0, 1.0, 0.04)) == approx(
        math.exp(-8 * math.pi**2 * 0.04**2 * 25), rel=1e-14
    )
    assert float(limits.lobe_relay_transfer(5.0, 1.0, 0.0)) == 1.0


def relay_modes(scene: Scene, **options) -> int:
    light = relay_light(scene, **options)
    return 0 if light is None else count_modes(light.signal)


def truth_scene(exposure: float = 40e-3, **changes) -> Scene:
    """Laser spot at the origin, a plate of 0.6 m at 1 m, the camera at (-0.6, 0, 0.8)."""
    scene = Scene(
        Laser(
            wavelength=632.8e-9,
            power=5e-3,
            beam_diameter=3e-3,
            position=(1.2 * math.sin(math.radians(15)), 0.0, 1.2 * math.cos(math.radians(15))),
        ),
        FlatWall(),
        PlanarObject(np.full((8, 8), 0.35), 0.6, position=(0.0, 0.0, 1.0)),
        Camera(
            position=(-0.6, 0.0, 0.8),
            aim=(-0.3, 0.0, 0.0),
            focal_length=0.0506,
            stop_diameter=0.0253,
            binning=64,
            exposure=exposure,
        ),
        wall_material=Lambert(0.8),
    )
    return replace(scene, **changes)


WALLS = {
    "Lambert": (None, 40e-3),
    "Lambert, 10 ms": (None, 10e-3),
    "Lambert, 40 s": (None, 40.0),
    "Oren-Nayar sigma 0.5": (OrenNayar(0.8, 0.5), 40e-3),
    **{
        # alpha of Beckmann's distribution is sqrt(2) times the slope per axis
        f"Lambert+5% Beckmann {a}": (
            SumMaterial(Lambert(0.8), SpecularMicrofacet(0.05, a / math.sqrt(2))),
            40e-3,
        )
        for a in (0.05, 0.1, 0.2, 0.4)
    },
}


def grid(count: int, side: float, centre: tuple[float, float, float]) -> np.ndarray:
    """Centres of the cells of a square parallel to the wall, (count^2, 3)."""
    middle = ((np.arange(count) + 0.5) / count - 0.5) * side
    x, y = np.meshgrid(middle, middle)
    return np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1) + centre


@pytest.mark.parametrize("row", rows("relay_recoverable_modes"), ids=lambda r: str(r["parameters"]))
def test_modes_above_noise(row: dict) -> None:
    """The published numbers, with their bins on the wall and F/2 without falloff."""
    material, exposure = WALLS[row["parameters"]["wall"]]
    scene = truth_scene()
    cells = grid(24, 0.6, (0.0, 0.0, 1.0))
    patches = Patches(
        points=cells,
        normals=np.broadcast_to((0.0, 0.0, -1.0), cells.shape),
        areas=np.full(len(cells), (0.6 / 24) ** 2),
    )
    points = grid(48, 0.728, (-0.3, 0.0, 0.0))
    view = np.array(scene.camera.position) - points
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    pixels = (4096 / 48) ** 2
    per_radiance = math.pi * 0.9 / (4 * 2.0**2) * (9e-6) ** 2 * pixels * exposure * 0.7
    per_radiance *= 632.8e-9 / (constants.h * constants.c)
    response = np.empty((len(points), len(cells)))
    facing, material = (0.0, 0.0, 1.0), material or Lambert(0.8)
    for block, toward, light in arrivals(scene, laser_spot(scene), patches, points):
        lobes = material.evaluate(toward, view[block][:, None], facing)
        response[block] = light * toward[..., 2] * lobes * per_radiance
    variance = 0.35 * response.sum(axis=1) + pixels * 3.6**2
    signal = response * (CONTRAST / np.sqrt(variance))[:, None]
    assert count_modes(signal) == int(row["value"][0])


@pytest.mark.parametrize(
    ("wall", "expected", "within"), [("Lambert", 6, 1), ("Lambert, 40 s", 13, 1)]
)
def test_modes_of_a_scene(wall: str, expected: int, within: int) -> None:
    """The camera's own view of nearly that patch; the truth allows one mode more or less."""
    _, exposure = WALLS[wall]
    assert relay_modes(truth_scene(exposure)) == approx(expected, abs=within)


@pytest.fixture(scope="module")
def benchmark():
    """Scenes with occluders, and their modes by brute force with closed-form shadows."""
    root = Path(__file__).parents[2]
    spec = importlib.util.spec_from_file_location("modes", root / "benchmarks/relay_modes.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.thorough
@pytest.mark.parametrize("index", [4, 5])
def test_modes_past_occluders_are_those_of_brute_force(benchmark, index: int) -> None:
    """A disc and a rectangle, seen by 16 x 16 pixels."""
    scene, drawn = benchmark.drawn_scene(index)
    scene = replace(scene, camera=replace(scene.camera, binning=256))
    found, expected = relay_modes(scene), benchmark.brute_force(scene, drawn)
    # both average 16 paths over a pixel, each its own, and cut cells into 16 and 9 parts
    assert found == approx(expected, rel=0.1)
    assert relay_modes(replace(scene, occluders=())) < 0.8 * expected


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: limits.lambert_relay_transfer(-1.0, 1.0), "frequency"),
        (lambda: limits.lambert_relay_transfer(1.0, 0.0), "distance"),
        (lambda: limits.lambert_relay_limit(2.0, 1.0), "electrons"),
        (lambda: limits.lobe_relay_transfer(1.0, 1.0, -0.1), "slope_rms"),
        (lambda: limits.lambert_relay_transfer([0.0, math.inf], 1.0), "frequency = inf"),
        (lambda: limits.lambert_relay_transfer("low", 1.0), "frequency is not an array"),
        (lambda: limits.lobe_relay_transfer([0.0, math.nan], 1.0, 0.1), "frequency = nan"),
    ],
)
def test_bad_input_is_named(call, named: str) -> None:
    with pytest.raises(NlosError, match=named):
        call()


def test_frequencies_beyond_all_pass_nothing() -> None:
    high = [0.0, 1e5, 1e308]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert limits.lambert_relay_transfer(high, 1.0).tolist() == [1.0, 0.0, 0.0]
        assert limits.lobe_relay_transfer(high, 1.0, 0.1).tolist() == [1.0, 0.0, 0.0]
