"""Zernike polynomials: orders, written-out forms, orthonormality, and fits."""

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.wave.zernikes import zernike_basis

WAVELENGTH = 632.8e-9
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": 12.5e-3, "image_distance": 50e-3}

# Noll 1976, table I; ANSI Z80.28; Wyant & Creath 1992, table III. (n, m), m < 0 a sine.
FIRST_ORDERS = {
    "noll": [(0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3)],
    "osa": [(0, 0), (1, -1), (1, 1), (2, -2), (2, 0), (2, 2), (3, -3), (3, -1), (3, 1), (3, 3)],
    "fringe": [(0, 0), (1, 1), (1, -1), (2, 0), (2, 2), (2, -2), (3, 1), (3, -1), (4, 0), (3, 3)],
}


@pytest.mark.parametrize("ordering", FIRST_ORDERS)
def test_first_orders_are_those_of_the_standards(ordering):
    first = 0 if ordering == "osa" else 1
    orders = [psf.zernike_order(first + i, ordering) for i in range(10)]
    assert orders == FIRST_ORDERS[ordering]


@pytest.mark.parametrize(("ordering", "count"), [("noll", 496), ("osa", 496), ("fringe", 37)])
def test_every_index_has_its_own_order(ordering, count):
    first = 0 if ordering == "osa" else 1
    orders = [psf.zernike_order(first + i, ordering) for i in range(count)]
    assert len(set(orders)) == count
    assert all(n >= abs(m) and (n - m) % 2 == 0 for n, m in orders)


def test_last_fringe_term_is_the_twelfth_degree():
    assert psf.zernike_order(36, "fringe") == (10, 0)
    assert psf.zernike_order(37, "fringe") == (12, 0)
    with pytest.raises(SceneError, match="1 to 37"):
        psf.zernike_order(38, "fringe")


@pytest.mark.parametrize(
    ("index", "written"),
    [
        (4, lambda r, t: np.sqrt(3) * (2 * r**2 - 1)),
        (5, lambda r, t: np.sqrt(6) * r**2 * np.sin(2 * t)),
        (8, lambda r, t: np.sqrt(8) * (3 * r**3 - 2 * r) * np.cos(t)),
        (11, lambda r, t: np.sqrt(5) * (6 * r**4 - 6 * r**2 + 1)),
        (14, lambda r, t: np.sqrt(10) * r**4 * np.cos(4 * t)),
        (22, lambda r, t: np.sqrt(7) * (20 * r**6 - 30 * r**4 + 12 * r**2 - 1)),
    ],
)
def test_noll_polynomials_as_written(index, written):
    r, t = np.meshgrid(np.linspace(0, 1, 21), np.linspace(-3, 3, 17))
    # a few roundings of terms up to 30 * sqrt(7)
    assert psf.zernike(index, r, t) == approx(written(r, t), abs=2e-14)


def test_fringe_polynomials_are_not_normalised():
    r = np.linspace(0, 1, 9)
    assert psf.zernike(9, r, 0.0, ordering="fringe") == approx(6 * r**4 - 6 * r**2 + 1, abs=1e-14)
    assert psf.zernike(7, 1.0, 0.0, ordering="fringe") == approx(1.0)


def test_orthonormal_up_to_degree_30():
    u, v, weights = psf.polar_nodes(1.0, 32, 64)
    basis = zernike_basis(range(1, 497), np.hypot(u, v), np.arctan2(v, u)).reshape(496, -1)
    gram = (basis * weights.ravel()) @ basis.T / np.pi
    # the nodes are exact for degree 60; 1e-13 is rounding of a sum of 2048 terms of up to 60
    assert np.abs(gram - np.eye(496)).max() < 1e-13


@pytest.mark.parametrize("index", [1276, 1288, 1301, 1326])
def test_radial_part_is_one_at_the_rim_at_degree_50(index):
    # the textbook sum of factorials has lost all its digits there
    n, m = psf.zernike_order(index)
    assert n == 50
    norm = np.sqrt((n + 1) * (1 if m == 0 else 2))
    angle = 0.0 if m >= 0 else np.pi / (2 * -m)
    assert psf.zernike(index, 1.0, angle) == approx(norm, rel=1e-12)


@pytest.mark.parametrize("ordering", ["noll", "osa", "fringe"])
@pytest.mark.parametrize("nodes", ["polar", "grid"])
def test_fit_returns_what_was_put_in(ordering, nodes):
    given = {2: 1e-7, 4: 5e-8, 8: 2e-8, 11: -3e-8}
    samples = 64 if nodes == "grid" else None
    wave = psf.Wavefront.from_zernike(
        given, ordering=ordering, nodes=nodes, samples=samples, **SYSTEM
    )
    fit = psf.fit_zernike(wave, 15, ordering=ordering)
    assert set(fit) == set(range(15) if ordering == "osa" else range(1, 16))
    # condition number below 10 and rounding of 1e-7 m
    assert [fit[i] for i in fit] == approx([given.get(i, 0.0) for i in fit], abs=1e-20)


def test_coefficients_are_rms_metres():
    wave = psf.Wavefront.from_zernike({4: 50e-9, 8: 20e-9}, **SYSTEM)
    assert psf.rms_aberration(wave) == approx(np.hypot(50e-9, 20e-9), rel=1e-13)


def test_too_few_nodes_for_the_degree():
    with pytest.raises(SamplingError, match="cannot hold Zernike degree 40"):
        psf.Wavefront.from_zernike({861: 1e-8}, samples=(8, 32), **SYSTEM)


@pytest.mark.parametrize(
    ("index", "ordering", "message"),
    [(0, "noll", "at least 1"), (-1, "osa", "at least 0"), (4, "wyant", "one of noll, osa")],
)
def test_bad_index_or_ordering(index, ordering, message):
    with pytest.raises(SceneError, match=message):
        psf.zernike(index, 0.5, 0.0, ordering=ordering)


def test_more_terms_than_nodes():
    wave = psf.Wavefront.from_zernike({}, samples=(3, 8), **SYSTEM)
    with pytest.raises(SamplingError, match="cannot determine 36"):
        psf.fit_zernike(wave, 36)
