"""Coherence of the light from the laser spot: closed forms and speckle that is drawn."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy.special import j1

from nlosoptics import imaging
from nlosoptics.errors import SceneError

Z = 1.0


@pytest.fixture
def upright(flat_scene):
    """A beam along the normal."""
    return replace(flat_scene, laser=replace(flat_scene.laser, position=(0.0, 0.0, 1.2)))


def airy(v):
    return 2 * j1(v) / v


def test_round_spot_is_an_airy_field(upright):
    laser, s = upright.laser, np.array([2e-5, 1e-4, 2.6e-4, 9e-4])
    points = np.stack([s * 0.6, s * 0.8, np.full(4, Z)], axis=1)
    # points at +-s/2 from the axis, whose paths have no curvature in common
    found = [
        imaging.spot_coherence(upright, p, reference=(-p[0], -p[1], Z))
        for p in points * [0.5, 0.5, 1]
    ]
    exact = airy(math.pi * laser.beam_diameter * s / (laser.wavelength * Z))
    # third order of the paths: (D/2z)^2/2 of v, which is at most 13
    assert found == approx(exact, abs=2e-5)


def test_depth_is_a_sinc(upright):
    laser, depth = upright.laser, np.array([1e-3, 0.1, 0.3])
    points = np.stack([0 * depth, 0 * depth, Z + depth], axis=1)
    found = np.abs(imaging.spot_coherence(upright, points, reference=(0, 0, Z)))
    turns = laser.beam_diameter**2 / 8 / laser.wavelength * (1 / Z - 1 / (Z + depth))
    # fourth order of the paths: k (D/2)^4/8 z^3, 6e-6 rad
    assert found == approx(np.abs(np.sinc(turns)), abs=1e-5)


def test_oblique_beams_make_long_spots(upright):
    tilted = replace(upright, laser=replace(upright.laser, position=(1.2, 0.0, 1.2)))
    s, laser = 1.1e-4, tilted.laser
    long, wide = (
        imaging.spot_coherence(tilted, (x / 2, y / 2, Z), reference=(-x / 2, -y / 2, Z))
        for x, y in ((s, 0.0), (0.0, s))
    )
    v = math.pi * laser.beam_diameter * s / (laser.wavelength * Z)
    assert long == approx(airy(math.sqrt(2) * v), abs=2e-5)
    assert wide == approx(airy(v), abs=2e-5)


def test_pairs_are_conjugate(flat_scene):
    centre = np.array(flat_scene.object_point)
    other = centre + np.array([5e-5, -3e-5, 2e-4])
    there = imaging.spot_coherence(flat_scene, other)
    back = imaging.spot_coherence(flat_scene, centre, reference=other)
    assert there == approx(np.conj(back), abs=1e-12)
    assert imaging.spot_coherence(flat_scene, centre) == approx(1.0, abs=1e-12)
    many = np.broadcast_to(other, (3, 100, 3))
    assert imaging.spot_coherence(flat_scene, many) == approx(np.full((3, 100), there), abs=1e-15)


def test_points_on_either_side_of_a_spot_near_an_edge(upright):
    """Far from the wall's centre, against Gauss's rule over chords of the beam."""
    laser = replace(
        upright.laser, beam_diameter=4e-5, position=(0.9, -0.3, 0.8), aim=(0.45, -0.35, 0.0)
    )
    scene = replace(upright, laser=laser)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    turn, s = np.meshgrid(0.5 * math.pi * nodes, nodes)
    share = np.outer(weights, weights) * np.cos(turn) ** 2
    beam = np.subtract(laser.aim, laser.position)
    beam /= np.linalg.norm(beam)
    across = np.cross(beam, [0.3, 0.4, 0.5])
    across /= np.linalg.norm(across)
    place = 2e-5 * (
        np.sin(turn)[..., None] * across + (s * np.cos(turn))[..., None] * np.cross(beam, across)
    )
    place = place + laser.aim
    place -= place[..., 2:] / beam[2] * beam
    other = np.array([0.36, -0.33, 0.07])
    points = np.array([[0.53, -0.4, 0.05], [0.4, -0.31, 0.09], [0.46, -0.34, 0.2]])
    paths = [np.linalg.norm(place - p, axis=-1) for p in (other, *points)]
    k = 2 * math.pi / laser.wavelength
    exact = [(share * np.exp(1j * k * (one - paths[0]))).sum() / share.sum() for one in paths[1:]]
    assert imaging.spot_coherence(scene, points, reference=other) == approx(exact, abs=1e-9)
    assert imaging.spot_coherence(scene, points[:0], reference=other).shape == (0,)


def test_drawn_speckle_has_this_correlation(flat_scene):
    """Siegert's relation for a spot of many grains with random phases."""
    rng, laser = np.random.default_rng(5), flat_scene.laser
    n, draws = 700, 6000
    beam = np.subtract(laser.aim, laser.position)
    beam = beam / np.linalg.norm(beam)
    r, turn = laser.beam_diameter / 2 * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    across = np.cross(beam, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    starts = np.outer(r * np.cos(turn), across) + np.outer(r * np.sin(turn), np.cross(beam, across))
    grains = starts + np.array(laser.position)
    grains -= np.outer(grains[:, 2] / beam[2], beam)  # to the wall, z = 0
    centre = np.array(flat_scene.object_point)
    other = centre + np.array([0.0, 1.2e-4, 0.0])
    k = 2 * np.pi / laser.wavelength
    phases = np.exp(2j * np.pi * rng.random((draws, n)))
    light = [
        np.abs(phases @ np.exp(1j * k * np.linalg.norm(grains - p, axis=1))) ** 2
        for p in (centre, other)
    ]
    drawn = np.corrcoef(*light)[0, 1]
    expected = abs(complex(imaging.spot_coherence(flat_scene, other))) ** 2
    assert 0.2 < expected < 0.8
    # correlation of 6000 draws, and 700 grains in place of a continuous spot, three times each
    assert drawn == approx(expected, abs=3 * (1 / math.sqrt(draws) + 1 / math.sqrt(n)))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([0.0, 0.0], "have shape"),
        ([0.0, 0.0, np.nan], "finite"),
        ([0.0, 0.0, -1.0], "behind the wall"),
        (["a", "b", "c"], "not numbers"),
    ],
)
def test_bad_points_are_refused(flat_scene, points, message):
    with pytest.raises(SceneError, match=message):
        imaging.spot_coherence(flat_scene, points)
    with pytest.raises(SceneError, match="one point"):
        imaging.spot_coherence(flat_scene, (0, 0, 1), reference=np.ones((2, 3)))
