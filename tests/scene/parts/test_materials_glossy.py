"""Ward lobes and GGX microfacets, against closed forms and conservation of energy."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from pytest import approx

from nlosoptics.kernels.brdf import masked_cosine
from nlosoptics.scene import (
    Lambert,
    OrenNayar,
    Retroreflector,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
)

TRUTHS = json.loads((Path(__file__).parents[2] / "truths" / "materials.json").read_text())
NORMAL = np.array([0.0, 0.0, 1.0])
DEGREE = math.pi / 180
VARIANTS = {
    "1992": "ward_albedo_normal_1992",
    "duer": "ward_albedo_normal_duer",
    "bounded": "ward_albedo_normal_gmd",
}
WARD_ROWS = [
    pytest.param(variant, row, id=f"{variant}-{row['parameters']['alpha']}")
    for variant, name in VARIANTS.items()
    for row in TRUTHS
    if row["name"] == name
]
SMITH_ROWS = [row for row in TRUTHS if row["name"] in ("beckmann_smith_G1", "ggx_smith_G1")]
ANGLES = np.concatenate([np.linspace(0, 1.5, 9), math.pi / 2 - np.geomspace(0.05, 1e-6, 6)])


def direction(theta, phi=0.0):
    theta, phi = np.broadcast_arrays(theta, phi)
    sine = np.sin(theta)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)


@pytest.mark.parametrize(("variant", "row"), WARD_ROWS)
def test_ward_albedo_at_normal_incidence(variant: str, row) -> None:
    material = Ward(1.0, float(row["parameters"]["alpha"]), variant=variant)
    assert float(material.albedo(0.0)) == approx(float(row["value"]), abs=1e-12)
    _, weight = material.sample(NORMAL, NORMAL, np.random.default_rng(21).random((200_000, 3)))
    error = weight.std() / math.sqrt(weight.size)
    # 1e-12 for what every sample weighs the same
    assert weight.mean() == approx(float(row["value"]), abs=3 * error + 1e-12)


@pytest.mark.parametrize("row", SMITH_ROWS, ids=lambda row: f"{row['name']}-{row['value']}")
def test_smith_masking(row) -> None:
    given = row["parameters"]
    cosine = math.cos(float(given["theta_deg"]) * DEGREE)
    masked = masked_cosine(cosine, float(given["alpha"]), row["name"] == "ggx_smith_G1")
    assert cosine / masked == approx(float(row["value"]), abs=1e-12)


def test_ward_is_its_formula() -> None:
    """With tan and the half vector written out, at directions all over the hemisphere."""
    for alpha, theta, out, phi in itertools.product(
        (0.1, 0.4, 1.0), (0.2, 0.9, 1.4), (0.3, 1.1, 1.5), (0.1, 2.0, 3.0)
    ):
        i, o = direction(theta), direction(out, phi)
        h = (i + o) / np.linalg.norm(i + o)
        peak = 0.7 * math.exp(-((math.tan(math.acos(h[2])) / alpha) ** 2)) / (math.pi * alpha**2)
        expected = {
            "1992": peak / (4 * math.sqrt(i[2] * o[2])),
            "duer": peak / (4 * i[2] * o[2]),
            "bounded": peak / (4 * (h @ i) ** 2 * h[2] ** 4),
        }
        for variant, f in expected.items():
            found = float(Ward(0.7, alpha, variant=variant).evaluate(i, o, NORMAL))
            # tan^2/alpha^2 of up to 1e3 turns rounding of 1e-16 into 1e-12
            assert found == approx(f, rel=1e-11, abs=1e-300)


def test_ggx_is_its_formula() -> None:
    """Walter et al. 2007, eqs. 33 and 34."""
    for slope, theta, out, phi in itertools.product(
        (0.05, 0.3, 0.7), (0.2, 0.9, 1.4), (0.3, 1.1, 1.5), (0.1, 2.0, 3.0)
    ):
        alpha = math.sqrt(2) * slope
        i, o = direction(theta), direction(out, phi)
        h = (i + o) / np.linalg.norm(i + o)
        tangent = math.tan(math.acos(h[2]))
        density = alpha**2 / (math.pi * h[2] ** 4 * (alpha**2 + tangent**2) ** 2)
        for angle in (theta, out):
            density *= 2 / (1 + math.sqrt(1 + (alpha * math.tan(angle)) ** 2))
        expected = 0.6 * density / (4 * i[2] * o[2])
        material = SpecularMicrofacet(0.6, slope, distribution="ggx")
        # tan from an arccosine: rounding over its slope of at least 0.02
        assert float(material.evaluate(i, o, NORMAL)) == approx(expected, rel=1e-10)


@pytest.mark.parametrize("alpha", [1e-5, 1e-3, 0.05, 0.3, 1.0])
def test_narrow_ward_lobes(alpha: float) -> None:
    """Toward a mirror, 1992 tends to rho cos(theta) and the others to rho, to order alpha^2."""
    for theta in (0.0, 0.5, 1.0):
        for variant, limit in (("1992", math.cos(theta)), ("duer", 1.0), ("bounded", 1.0)):
            albedo = float(Ward(0.8, alpha, variant=variant).albedo(theta))
            # rounding of the half vector's cosine against alpha^2, as in the docstring
            assert albedo == approx(0.8 * limit, abs=0.8 * 4 * alpha**2 + 1e-15 / alpha**2)


CONSERVING = [
    Lambert(1.0),
    *(SpecularMicrofacet(1.0, slope) for slope in (0.01, 0.1, 0.3, 0.7)),
    *(SpecularMicrofacet(1.0, slope, distribution="ggx") for slope in (0.001, 0.1, 0.3, 0.7)),
    *(Ward(1.0, alpha, variant="bounded") for alpha in (0.02, 0.2, 0.5, 1.0)),
    *(Retroreflector(1.0, angle) for angle in (1e-3, 0.1, 0.5)),
    *(OrenNayar(1.0, slope, normalised=True) for slope in (0.1, 0.346, 1.0)),
    *(OrenNayar(1.0, slope, model="full", normalised=True) for slope in (0.1, 0.3, 1.0)),
    SumMaterial(OrenNayar(0.6, 0.3), SpecularMicrofacet(0.35, 0.3)),
    SumMaterial(Lambert(0.5), Ward(0.5, 0.4, variant="bounded")),
]


@pytest.mark.thorough
@pytest.mark.parametrize("material", CONSERVING, ids=repr)
def test_white_furnace(material) -> None:
    """No more light leaves than arrives, at any incidence."""
    angles = ANGLES if isinstance(material, Lambert | SumMaterial) else np.append(ANGLES, 1.5707)
    narrow = getattr(material, "slope_rms", 1.0) or 1.0
    # the quadrature's 1e-9, and the rounding of cosines against a narrow lobe
    rounding = 1e-15 / (narrow * np.cos(angles)) ** 2
    kept = rounding < 1e-3
    assert (material.albedo(angles) <= 1 + 1e-9 + rounding)[kept].all()
    for theta in (0.0, 0.8, 1.4, 1.55):
        draws = np.random.default_rng(22).random((20_000, 3))
        _, weight = material.sample(direction(theta), NORMAL, draws)
        assert weight.mean() <= 1 + 4 * weight.std() / math.sqrt(weight.size) + 1e-12


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_ggx_has_long_tails(distribution: str) -> None:
    """At the same slope: far from the mirror GGX is far brighter, near grazing it shadows more."""
    material = SpecularMicrofacet(1.0, 0.1, distribution=distribution)
    f = float(material.evaluate(NORMAL, direction(1.2), NORMAL))
    assert (f > 1e-3) == (distribution == "ggx")


def test_ward_converges_to_beckmann_for_small_slopes() -> None:
    """Duer's lobe is Beckmann's without masking, but for 1/cos^4 of the half vector."""
    exitant = direction(0.5 + np.linspace(-0.004, 0.004, 9))
    ward = Ward(0.9, 0.002, variant="duer").evaluate(direction(0.5), exitant, NORMAL)
    facets = SpecularMicrofacet(0.9, 0.002 / math.sqrt(2)).evaluate(direction(0.5), exitant, NORMAL)
    # 1/cos^4 at tilts up to 2e-3 is 8e-6; cosines rounded to 1e-16 against alpha^2 of 4e-6
    assert ward == approx(facets, rel=1e-5)
