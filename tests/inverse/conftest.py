"""Measured images that the inverted model did not make."""

from __future__ import annotations

import functools
import importlib.util
import sys

import numpy as np
import pytest


@pytest.fixture(scope="session")
def known_psf(root):
    """The benchmark's generator: four samples per pixel, linear convolution, integrated pixels."""
    path = root / "benchmarks/inverse/known_psf.py"
    spec = importlib.util.spec_from_file_location("known_psf", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["known_psf"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def mismatches(root, known_psf):
    """The benchmark's generator of images that the model does not describe."""
    path = root / "benchmarks/inverse/mismatches.py"
    spec = importlib.util.spec_from_file_location("mismatches", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["mismatches"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def case(known_psf, examples):
    """``case(name, wall, seed, noise)``: a measured image and the model of its kernel."""
    from nlosoptics.imaging import ForwardModel

    point_spread = functools.cache(known_psf.fine_point_spread)

    @functools.cache
    def make(name, wall, seed=0, noise=0.01):
        picture = known_psf.picture(examples / "objects" / f"{name}.png")
        data = known_psf.measured(picture, point_spread(wall, seed), noise=noise, seed=seed)
        return data, ForwardModel(data.kernel, shape=data.image.shape)

    return make


@pytest.fixture(scope="session")
def point_spread_field():
    """A spot that widens to the right and gets a neighbour upward: three modes on 4 x 4 nodes."""
    from nlosoptics.psf import PointSpreadField

    def spot(width, place=0.0):
        axis = np.arange(15.0) - 7.0
        values = np.exp(-((axis - place) ** 2 + axis[:, None] ** 2) / (2 * width**2))
        return values / values.sum()

    nodes = np.cos(np.pi * (2 * np.arange(4) + 1) / 8)[::-1].copy()
    across, up = np.meshgrid(nodes, nodes)
    return PointSpreadField(
        modes=np.stack([spot(1.2), spot(2.5) - spot(1.2), spot(1.5, 2.0) - spot(1.2)]),
        weights=np.stack([np.ones_like(across), 0.5 + 0.45 * across, 0.4 * up]),
        across=nodes,
        up=nodes.copy(),
        pitch=1e-5,
        truncation_error=0.0,
        error_estimate=0.0,
    )
