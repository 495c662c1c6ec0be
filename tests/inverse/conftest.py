"""Measured images that the inverted model did not make."""

from __future__ import annotations

import functools
import importlib.util
import sys

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
