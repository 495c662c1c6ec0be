"""Point spreads of rough walls, and what is predicted of them, on record."""

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.rough import otf, phase_screens, sample, scattered_light
from nlosoptics.psf.rough.source import rough_source
from nlosoptics.psf.walls import lobe_psf
from nlosoptics.psf.window.window import Window
from nlosoptics.scene import FacetWall

from ...records import attempt


@pytest.mark.parametrize("index", range(7))
def test_a_mean(index, draw, on_record):
    case = draw(23, index, 0.4, "rough")
    asked = case.options | {"tol": max(case.options["tol"], 1e-4)}
    view = case.rough["view"]
    on_record(attempt(psf.mean_point_spread, case.front, case.rough["roughness"], **view, **asked))


WALLS = {
    "gaussian": psf.Roughness(3e-8, 1e-3),
    "exponential": psf.Roughness(6e-8, 5e-4, "exponential"),
    "facets": FacetWall(4e-4, 2e-3, seed=4),
}


@pytest.fixture(params=WALLS)
def rough(request):
    system = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06, "nodes": "grid"}
    samples = 384 if request.param == "facets" else 128
    wave = psf.Wavefront.from_zernike({5: 5e-8}, obscuration=0.3, samples=samples, **system)
    view = {"footprint": np.diag([0.5, 0.6]), "cos_sum": 1.8}
    return wave, WALLS[request.param], view


@pytest.mark.parametrize("propagation", ["geometric", "fresnel"])
def test_a_sample(rough, propagation, on_record):
    wave, wall, view = rough
    asked = view | {"propagation": propagation, "pitch": 2e-6, "shape": 20, "seed": 3}
    asked["effective_distance"] = 0.4
    on_record(
        [
            attempt(psf.sample_point_spread, wave, wall, **asked, independent_patterns=2),
            attempt(psf.sample_point_spread, wave, wall, **asked | {"seed": None}),
            isinstance(wall, psf.Roughness)
            and attempt(psf.two_scale_point_spread, wave, wall, **asked, tol=0.05),
            attempt(psf.mean_point_spread, wave, wall, **view, tol=1e-2, pitch=2e-6, shape=20),
        ]
    )


@pytest.mark.parametrize("name", ["gaussian", "exponential"])
def test_statistics(name, on_record):
    rough, lags = WALLS[name], np.array([0.0, 1e-5, 3e-4, 2e-3])
    long, short = rough.split(1e-3)
    figures = [
        [
            attempt(lambda one=one: one.slope_rms),
            one.correlation(lags),
            one.structure(lags),
            one.reach(0.01),
        ]
        for one in (rough, long, short)
    ]
    on_record([figures, attempt(rough.lag_of, 1e-16), psf.split_scale(6e-7, 0.5)])


@pytest.mark.parametrize("cutoff", [2e-4, 3e-3])
def test_nodes_of_a_split(cutoff, on_record):
    """Lags at which C is asked for, and those that are tabulated, also of a measured C."""
    asked = []

    def autocorrelation(r):
        asked.append(np.array(r))
        return np.exp(-((r / 1e-3) ** 2))

    long, short = psf.Roughness(3e-8, 1e-3, autocorrelation).split(cutoff)
    lags = np.linspace(0.0, 3e-3, 41)
    measured = psf.Roughness(3e-8, 1e-3, [lags, np.exp(-((lags / 1e-3) ** 2))])
    tables = [one.autocorrelation.spline for one in (long, measured.split(cutoff)[0])]
    lengths = [long.correlation_length, short.correlation_length]
    found = [len(asked), np.concatenate([one.ravel() for one in asked]), lengths]
    on_record([found, [(one.k, one.t, one.c) for one in tables]])


def test_views_and_screens(rough, on_record):
    """Fractions, halos, lags and pitches, and the transfer functions of pupil and wall."""
    wave, wall, view = rough
    source = rough_source(wave, wall, view["footprint"], view["cos_sum"], 0.4)
    seen, residual = source.view, source.residual
    x = np.array([0.0, 2e-5, 3e-4, -2e-3])
    names = ("length", "has_tails", "coherent_fraction", "scattered_fraction")
    on_record(
        {
            "figures": [getattr(seen, name) for name in names],
            "lags": [attempt(seen.last_lag, cut) for cut in (0.5, 1e-2, 1e-6)],
            "halo": seen.halo(wave),
            "transfer": attempt(seen.scattered_transfer, x, 0.4 * x),
            "cells": [
                attempt(scattered_light.first_cells, residual, seen, 2e-6, tol)
                for tol in (1e-1, 1e-3)
            ],
            "across": [otf.cells_across(residual, error) for error in (None, 1e-2, 1e-5)],
            "overlap": [otf.annulus_overlap(x, 1e-3, inner) for inner in (0.0, 4e-4)],
            "pitches": isinstance(wall, psf.Roughness)
            and [
                phase_screens.widest_pitch(seen),
                phase_screens.spreading_matrix(seen),
                phase_screens.throw(seen, 1e-3),
                [phase_screens.stride(seen, pitch) for pitch in (3e-5, 1e-4)],
                sample.finest_pitch(seen, wave.wavelength),
                sample.grid_pitch(wave, 2e-5, 1e-3),
            ],
        }
    )


LIGHT = {
    "gaussian": psf.Roughness(6e-8, 1e-3),
    "exponential": psf.Roughness(3e-8, 4e-4, "exponential"),
    "steep": psf.Roughness(4e-7, 5e-3),
    "facets": FacetWall(9e-4, 5e-4),
}


@pytest.mark.parametrize("integrated", [False, True])
@pytest.mark.parametrize("layout", ["polar", "grid"])
@pytest.mark.parametrize("name", LIGHT)
def test_halos(name, layout, integrated, on_record):
    """Nodes of the sum, the light on narrow and wide pixels, and its stated error."""
    wave = psf.Wavefront.from_zernike(
        {2: 2e-7, 5: 8e-8, 7: -5e-8},
        wavelength=6e-7,
        pupil_radius=4e-3,
        image_distance=-0.06,
        obscuration=0.3,
        nodes=layout,
        samples=None if layout == "polar" else 61,
    )
    source = rough_source(wave, LIGHT[name], np.array([[0.5, 0.1], [-0.2, 0.6]]), 1.7)
    view, residual = source.view, source.residual
    window = Window.centred(2.3e-6, (7, 10))
    halo = scattered_light.Halo(residual, view, window, integrated, 7e-3)
    wide = scattered_light.Halo(residual, view, window, integrated, 7e-3, spread=4e-5)
    nodes, edges = halo.separations(0.12), [1e-6, 2.3e-5, 2e-4]
    turns = np.exp(300j * nodes.du - 200j * nodes.dv)
    asked = integrated, np.full((7, 10), 1e-3), 3e-3
    on_record(
        {
            "counts": [one.counts(f) for one in (halo, wide) for f in (0.3, 1.0, 2.7)],
            "nodes": nodes,
            "image": halo.image(nodes, turns),
            "halves": [
                [*scattered_light.inner_halves(residual, view, Window.centred(p, (n, n + 3)), tol)]
                for p, n, tol in ((2e-6, 9, 1e-2), (1e-4, 9, 1e-2), (9e-4, 41, 1e-4))
            ],
            "inner": [scattered_light.inner_window(window, half) for half in edges],
            "cells": [
                scattered_light.first_cells(residual, view, p, tol)
                for p, tol in ((1e-6, 1e-2), (1e-6, 1e-4), (1e-4, 1e-4))
            ],
            "light": scattered_light.scattered_light(residual, view, window, *asked),
            "wide": integrated
            and scattered_light.scattered_light(
                residual, view, Window.centred(9e-5, (7, 10)), *asked
            ),
        }
    )


@pytest.mark.parametrize("normalisation", ["unit-sum", "flux", "ideal-peak"])
def test_a_sample_in_pixels(normalisation, on_record):
    system = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": -0.06}
    waves = [
        psf.Wavefront.from_zernike({2: 1e-7, 6: 6e-8}, obscuration=0.2, **system),
        psf.Wavefront.from_zernike({2: 1e-7, 6: 6e-8}, nodes="grid", samples=90, **system),
        psf.Wavefront.from_map(
            np.zeros((90, 90)), wavelength=6e-7, pupil_pitch=9e-5, image_distance=-0.06
        ),
    ]
    asked = {"footprint": np.diag([0.5, 0.6]), "cos_sum": 1.8, "effective_distance": 0.4}
    asked |= {"shape": (8, 11), "seed": 3, "normalisation": normalisation}
    on_record(
        [
            attempt(
                psf.sample_point_spread, wave, wall, pitch=pitch, pixel_integrated=whole, **asked
            )
            for wave in waves
            for wall in (WALLS["gaussian"], psf.Roughness(2e-8, 3e-3), WALLS["exponential"])
            for pitch, whole in ((2e-6, False), (5e-6, True))
        ]
    )


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_transfer_of_lobes(distribution, on_record):
    on_record(lobe_psf.lobe_transfer(distribution, np.array([-2.0, 0.0, 1e-14, 0.3, 1.0, 20.0])))
