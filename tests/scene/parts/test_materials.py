"""Materials against closed forms, quadrature and the laws of reflection."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.scene import Lambert, OrenNayar, SpecularMicrofacet, SumMaterial, Ward

TRUTHS = json.loads((Path(__file__).parents[2] / "truths" / "materials.json").read_text())
NORMAL = (0.0, 0.0, 1.0)
DEGREE = math.pi / 180
LOBES = [
    Lambert(0.8),
    OrenNayar(0.8, 0.3),
    OrenNayar(1.0, 0.5, normalised=True),
    OrenNayar(0.8, 0.3, model="full", normalised=True),
    SpecularMicrofacet(0.05, 0.02),
    SpecularMicrofacet(1.0, 0.5),
    SpecularMicrofacet(1.0, 0.3, distribution="ggx"),
    Ward(0.9, 0.3),
    Ward(0.9, 0.3, variant="duer"),
    Ward(0.9, 0.3, variant="bounded"),
    SumMaterial(OrenNayar(0.75, 0.3), SpecularMicrofacet(0.05, 0.1)),
]
KINDS = [f"{index}-{type(lobe).__name__}" for index, lobe in enumerate(LOBES)]


def rows(name: str) -> list[dict]:
    return [row for row in TRUTHS if row["name"] == name]


def direction(theta, phi=0.0):
    theta, phi = np.broadcast_arrays(theta, phi)
    sine = np.sin(theta)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)


def directions(count: int, seed: int):
    """Unit vectors above the surface, uniform in solid angle."""
    rng = np.random.default_rng(seed)
    return direction(np.arccos(rng.random(count)), rng.random(count) * 2 * math.pi)


# Closed forms


@pytest.mark.parametrize(
    "row", rows("oren_nayar_directional_albedo"), ids=lambda r: str(r["value"])
)
def test_directional_albedo(row) -> None:
    given = row["parameters"]
    material = OrenNayar(float(given["rho"]), float(given["sigma"]))
    found = float(material.albedo(given["theta_i_deg"] * DEGREE))
    assert found == approx(float(row["value"]), abs=float(row["tolerance"]))


def test_worst_albedo() -> None:
    """The fit reflects up to 1.0768 of the light; no slope does more."""
    (row,) = rows("oren_nayar_worst_albedo")
    worst = float(row["parameters"]["sigma"])
    value, tolerance = float(row["value"]), float(row["tolerance"])
    assert float(OrenNayar(1.0, worst).albedo(math.pi / 2)) == approx(value, abs=tolerance)
    for slope in np.linspace(0, 1, 101):
        assert OrenNayar(1.0, slope).albedo(np.linspace(0, math.pi / 2, 31)).max() <= value + 1e-12


def test_lambert_albedo() -> None:
    assert_array_equal(Lambert(0.3).albedo([0.0, 1.0, math.pi / 2]), 0.3)
    assert float(Lambert(0.3).evaluate(NORMAL, NORMAL, NORMAL)) == 0.3 / math.pi


@pytest.mark.parametrize("model", ["fit", "full"])
def test_smooth_oren_nayar_is_lambert_to_the_last_bit(model: str) -> None:
    incident, exitant = directions(20_000, 1), directions(20_000, 2)
    grazing = direction(math.pi / 2, np.linspace(0, 6, 200))
    for rho in (1.0, 0.8, 0.1 + 0.2):
        smooth = OrenNayar(rho, 0.0, model=model)
        assert_array_equal(smooth.evaluate(incident, exitant, NORMAL), rho / math.pi)
        assert_array_equal(smooth.evaluate(grazing, grazing[::-1], NORMAL), rho / math.pi)


def test_beckmann_peak_at_normal_incidence() -> None:
    """f = F D(0) / 4 with D(0) = 1/(pi alpha^2), alpha^2 = 2 slope^2, no masking."""
    f = float(SpecularMicrofacet(0.05, 0.1).evaluate(NORMAL, NORMAL, NORMAL))
    assert f == approx(0.05 / (4 * math.pi * 2 * 0.1**2), rel=1e-14)  # rounding


# Laws


@pytest.mark.parametrize("material", LOBES, ids=KINDS)
def test_reciprocity(material) -> None:
    incident, exitant = directions(20_000, 3), directions(20_000, 4)
    there = material.evaluate(incident, exitant, NORMAL)
    back = material.evaluate(exitant, incident, NORMAL)
    assert abs(there - back).max() <= 1e-14 * abs(there).max()
    assert (abs(there - back) <= 1e-14 * there).all()


@pytest.mark.parametrize("material", LOBES, ids=KINDS)
def test_nothing_below_the_surface(material) -> None:
    above, below = directions(100, 8), -directions(100, 9)
    for pair in ((above, below), (below, above), (below, below)):
        assert_array_equal(material.evaluate(*pair, NORMAL), 0.0)


def quadrature_albedo(material, theta: float, panels: int = 40) -> float:
    """Int f cos dOmega by brute force over exitant angles; panels end at the lobe and at kinks."""
    nodes, weights = np.polynomial.legendre.leggauss(16)

    def composite(edges):
        low, high = np.array(edges[:-1])[:, None], np.array(edges[1:])[:, None]
        return ((low + high) / 2 + (high - low) / 2 * nodes).ravel(), (
            (high - low) / 2 * weights
        ).ravel()

    # narrower toward the horizon, where Ward's lobe of 1992 goes as the root of the cosine
    near_horizon = math.pi / 2 - np.geomspace(1e-6, 0.02, 12)
    polar_edges = np.union1d(np.linspace(0, math.pi / 2, panels + 1), [theta, *near_horizon])
    polar, polar_weights = composite(polar_edges)
    turn, turn_weights = composite(np.linspace(0, math.pi, panels + 1))
    p, a = np.meshgrid(polar, turn, indexing="ij")
    f = material.evaluate(direction(theta), direction(p, a), NORMAL)
    return 2 * float(polar_weights @ (f * np.sin(p) * np.cos(p)) @ turn_weights)


@pytest.mark.parametrize("theta", [0.0, 0.3, 1.0, 1.3])
@pytest.mark.parametrize(
    "material",
    [
        Lambert(0.7),
        OrenNayar(1.0, 0.3),
        OrenNayar(0.9, 0.5, normalised=True),
        OrenNayar(0.9, 0.3, model="full"),
        SpecularMicrofacet(0.9, 0.2),
        SpecularMicrofacet(0.05, 0.6),
        SpecularMicrofacet(0.9, 0.2, distribution="ggx"),
        Ward(0.9, 0.3),
        Ward(0.9, 0.3, variant="duer"),
        Ward(0.9, 0.3, variant="bounded"),
        SumMaterial(OrenNayar(0.7, 0.4), SpecularMicrofacet(0.1, 0.3)),
    ],
    ids=repr,
)
def test_albedo_is_the_integral_of_evaluate(material, theta: float) -> None:
    # 640 x 640 nodes see a lobe of slope 0.2 to 1e-9; the full model's kink across the plane of
    # incidence lies on a panel's edge
    assert float(material.albedo(theta)) == approx(quadrature_albedo(material, theta), rel=1e-8)


@pytest.mark.parametrize("slope", [1e-4, 1e-3, 0.01, 0.1, 0.3, 0.7])
def test_microfacets_reflect_no_more_than_their_reflectance(slope: float) -> None:
    angles = np.linspace(0, math.pi / 2, 61)
    albedo = SpecularMicrofacet(0.8, slope).albedo(angles)
    # the half vector's cosine comes from a dot product rounded to 1e-16, against 4 cos^2, and is
    # compared with slope^2; at grazing itself nothing is left of it
    rounding = 1e-16 / (slope * np.cos(angles[:-1])) ** 2
    assert (albedo[:-1] <= 0.8 * (1 + 1e-9 + rounding)).all()
    assert (albedo > 0).all()
    # shadowing costs nothing where no facet is steep enough
    assert albedo[angles < 1.2] == approx(0.8, rel=max(1e-7, 8 * slope**2))


@pytest.mark.parametrize("model", ["fit", "full"])
@pytest.mark.parametrize("rho", [1.0, 0.8])
def test_normalised_conserves_energy(model: str, rho: float) -> None:
    angles = np.array([0.0, 0.5, 1.0, 1.3, 1.5, 1.56, 1.5705, math.pi / 2])
    for slope in (0.05, 0.3, 1.0):
        bare = OrenNayar(rho, slope, model=model).albedo(angles)
        normalised = OrenNayar(rho, slope, model=model, normalised=True).albedo(angles)
        assert normalised.max() <= 1 + 1e-12  # rounding, and the full model's quadrature
        if bare.max() <= 1:
            assert_array_equal(normalised, bare)
        else:
            assert normalised.max() == approx(1, abs=1e-12)


def test_sum_is_the_sum() -> None:
    parts = OrenNayar(0.6, 0.3), SpecularMicrofacet(0.1, 0.05), Lambert(0.2)
    total = SumMaterial(parts[0], SumMaterial(*parts[1:]))
    assert total == SumMaterial(*parts)
    incident, exitant = directions(500, 10), directions(500, 11)
    expected = sum(part.evaluate(incident, exitant, NORMAL) for part in parts)
    assert total.evaluate(incident, exitant, NORMAL) == approx(expected, rel=1e-14)
    assert float(total.albedo(0.7)) == approx(sum(float(p.albedo(0.7)) for p in parts), rel=1e-14)
    assert total.specular_reflectance == 0.1
    assert total.diffuse == SumMaterial(parts[0], parts[2])


# Bad input


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Lambert(1.1), "albedo = 1.1 is out of range, must be from 0 to 1"),
        (lambda: Lambert("white"), "albedo = 'white' is not a number"),
        (lambda: SpecularMicrofacet(2, 0.1), "reflectance = 2 is out of range"),
        (lambda: SpecularMicrofacet(0.1, 1e-9), "slope_rms = 1e-09 .* give 0 for a smooth mirror"),
        (lambda: Ward(0.5, 0.0), "alpha = 0 is out of range, must be from 1e-06 to 1"),
        (lambda: Ward(0.5, math.nan), "alpha = nan is not finite"),
        (
            lambda: SumMaterial(Lambert(0.7), SpecularMicrofacet(0.4, 0.5)),
            "add up to 1.1, limit 1; lower one",
        ),
        (lambda: SumMaterial(Lambert(0.7), Lambert(0.4)), "add up to 1.1, limit 1; lower one"),
    ],
)
def test_bad_materials(make, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        make()
