"""Samples of every material against its density, its albedo and the law of large numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pytest import approx
from scipy import stats

from nlosoptics.errors import SceneError
from nlosoptics.scene import (
    Lambert,
    OrenNayar,
    Retroreflector,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
)

NORMAL = np.array([0.0, 0.0, 1.0])
MATERIALS = [
    Lambert(0.8),
    OrenNayar(0.8, 0.3),
    OrenNayar(0.8, 0.5, model="full"),
    OrenNayar(1.0, 0.3, normalised=True),
    SpecularMicrofacet(1.0, 0.02),
    SpecularMicrofacet(0.9, 0.2),
    SpecularMicrofacet(0.9, 0.7),
    SpecularMicrofacet(1.0, 0.02, distribution="ggx"),
    SpecularMicrofacet(0.9, 0.2, distribution="ggx"),
    SpecularMicrofacet(0.9, 0.7, distribution="ggx"),
    Ward(0.9, 0.03),
    Ward(0.9, 0.4),
    Ward(0.9, 1.0),
    Ward(0.9, 0.4, variant="duer"),
    Ward(0.9, 1.0, variant="bounded"),
    Retroreflector(0.9, 0.3),
    SumMaterial(OrenNayar(0.6, 0.3), SpecularMicrofacet(0.2, 0.1), Ward(0.2, 0.5)),
]
ANGLES = [0.0, 0.6, 1.2, 1.5]
CASES = [
    pytest.param(material, theta, id=f"{index}-{type(material).__name__}-{theta}")
    for index, material in enumerate(MATERIALS)
    for theta in ANGLES
]


def direction(theta, phi=0.0):
    theta, phi = np.broadcast_arrays(theta, phi)
    sine = np.sin(theta)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)


def draws(count: int, seed: int):
    return np.random.default_rng(seed).random((count, 3))


N_AZIMUTHS = 24


def is_diffuse(material) -> bool:
    return isinstance(material, Lambert | OrenNayar)


def about_incident(theta: float):
    """Rows of a frame with the incident direction as its z axis."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def coordinates(material, theta: float, exitant):
    """Polar angle and azimuth, of exitants of diffuse lobes, else of their half vectors.

    Those of retroreflectors are about the incident direction.

    Half vectors of the upper hemisphere and exitants of the whole sphere are one to one.
    """
    if isinstance(material, Retroreflector):
        exitant = exitant @ about_incident(theta).T
    elif not is_diffuse(material):
        exitant = exitant + direction(theta)
        exitant = exitant * np.sign(exitant[:, 2:])
    x, y, z = exitant.T
    # without the arccosine's loss near the axis
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x) % (2 * math.pi)


def shares(material, theta: float, rings, panels: int, turns: int):
    """Integrals of the density over rings of polar angle and sectors of azimuth."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    fine = np.append(np.geomspace(1e-5, 0.3, panels), np.linspace(0, math.pi / 2, panels))
    edges = np.union1d(rings, fine)
    half = np.diff(edges)[:, None] / 2
    angle = (edges[:-1, None] + half * (nodes + 1)).ravel()
    weight = (half * weights).ravel() * np.sin(angle)
    turn = (np.arange(N_AZIMUTHS * turns) + 0.5) * 2 * math.pi / (N_AZIMUTHS * turns)
    exitant, stretch = direction(angle[:, None], turn), 1.0
    if isinstance(material, Retroreflector):
        exitant = exitant @ about_incident(theta)
    elif not is_diffuse(material):
        facet, along = exitant, exitant @ direction(theta)
        exitant = 2 * along[..., None] * facet - direction(theta)
        stretch = 4 * np.abs(along)  # dOmega_o = 4 |i.h| dOmega_h
    density = material.pdf(direction(theta), exitant, NORMAL) * stretch * weight[:, None]
    density = density.reshape(len(angle), N_AZIMUTHS, turns).sum(axis=-1)
    totals = np.zeros((len(rings) - 1, N_AZIMUTHS))
    np.add.at(totals, np.searchsorted(rings, angle) - 1, density)
    return totals * 2 * math.pi / (N_AZIMUTHS * turns)


@pytest.mark.thorough
@pytest.mark.parametrize(("material", "theta"), CASES)
def test_samples_follow_the_density(material, theta: float) -> None:
    """Chi-squared over rings and sectors, on the whole sphere."""
    count = 100_000
    # rings that hold about equal numbers of another set of samples
    first, _ = material.sample(direction(theta), NORMAL, draws(4000, 31))
    cuts = np.quantile(coordinates(material, theta, first)[0], np.linspace(0, 1, 17)[1:-1])
    rings = np.concatenate([[0.0], cuts, [math.pi / 2]])
    expected = shares(material, theta, rings, 60, 6).ravel() * count
    exitant, _ = material.sample(direction(theta), NORMAL, draws(count, 32))
    angle, turn = coordinates(material, theta, exitant)
    sector = np.minimum((turn / (2 * math.pi) * N_AZIMUTHS).astype(int), N_AZIMUTHS - 1)
    found = np.zeros((len(rings) - 1, N_AZIMUTHS))
    np.add.at(found, (np.clip(np.searchsorted(rings, angle) - 1, 0, len(rings) - 2), sector), 1)
    found = found.ravel()
    rare = expected < 10  # where chi-squared is not the distribution; together instead
    expected = np.append(expected[~rare], expected[rare].sum())
    found = np.append(found[~rare], found[rare].sum())
    if expected[-1] < 10:
        assert found[-1] <= 40
        expected, found = expected[:-1], found[:-1]
    chi_squared = ((found - expected) ** 2 / expected).sum()
    assert stats.chi2.sf(chi_squared, len(expected) - 1) > 1e-3 / len(CASES)


@pytest.mark.parametrize(("material", "theta"), CASES)
def test_density_integrates_to_one(material, theta: float) -> None:
    total = shares(material, theta, [0.0, math.pi / 2], 60, 16).sum()
    # midpoints in azimuth across the line where facets turn their back, and the horizon
    assert total == approx(1.0, abs=1e-4)


@pytest.mark.parametrize(("material", "theta"), CASES)
def test_weights_are_reflectance_over_density(material, theta: float) -> None:
    incident = direction(theta)
    exitant, weight = material.sample(incident, NORMAL, draws(5000, 33))
    assert np.isfinite(weight).all()
    assert (weight >= 0).all()
    below = exitant[:, 2] <= 0
    assert_array_equal(weight[below], 0.0)
    exitant, weight = exitant[~below], weight[~below]
    f = material.evaluate(incident, exitant, NORMAL)
    density = material.pdf(incident, exitant, NORMAL)
    # exp(-tan^2/alpha^2) cancels between the two, Lambda of grazing exitants rounds
    assert weight * density == approx(f * exitant[:, 2], rel=1e-10, abs=1e-300)


@pytest.mark.thorough
@pytest.mark.parametrize(("material", "theta"), CASES)
def test_mean_weight_is_the_albedo(material, theta: float) -> None:
    _, weight = material.sample(direction(theta), NORMAL, draws(200_000, 34))
    # 3 standard errors; 1e-8 for lobes whose samples all weigh the same
    limit = 3 * weight.std() / math.sqrt(weight.size) + 1e-8
    assert weight.mean() == approx(float(material.albedo(theta)), abs=limit)


@pytest.mark.thorough
def test_mirrors_are_drawn_as_they_are() -> None:
    incident = direction(0.7)
    mirror = SpecularMicrofacet(0.3, 0.0)
    exitant, weight = mirror.sample(incident, NORMAL, draws(100, 40))
    assert exitant == approx(np.broadcast_to(direction(-0.7), (100, 3)), abs=1e-15)
    assert_array_equal(weight, 0.3)
    assert_array_equal(mirror.pdf(incident, exitant, NORMAL), 0.0)
    both = SumMaterial(Lambert(0.5), mirror)
    exitant, weight = both.sample(incident, NORMAL, draws(100_000, 41))
    mirrored = np.abs(exitant - direction(-0.7)).max(axis=-1) < 1e-12
    # a share of 0.3/0.8, within 4 deviations
    assert mirrored.mean() == approx(0.375, abs=4 * math.sqrt(0.375 * 0.625 / 1e5))
    assert weight == approx(np.full(100_000, 0.8), rel=1e-14)
    assert both.pdf(incident, NORMAL, NORMAL) == approx(0.625 / math.pi, rel=1e-15)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda m: m.sample([math.nan, 0, 1], NORMAL, [0.5] * 3), "incident has length nan"),
        (lambda m: m.sample(NORMAL, NORMAL, [0.5, 1.0, 0.5]), "draws hold 1, limit 0 to below 1"),
        (lambda m: m.sample(NORMAL, NORMAL, [0.5] * 2), r"draws has shape \(2,\), .* must be 3"),
        (lambda m: m.pdf([math.inf, 0, 0], NORMAL, NORMAL), "incident has length inf"),
        (lambda m: m.evaluate(NORMAL, [math.inf, 0, 1], NORMAL), "exitant holds NaN or infinity"),
    ],
)
def test_bad_directions_and_draws(act, message: str) -> None:
    for material in (Lambert(0.5), Ward(0.5, 0.3)):
        with pytest.raises(SceneError, match=message) as caught:
            act(material)
        assert "\n" not in str(caught.value)
