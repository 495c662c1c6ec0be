"""Parts of every solver: limits of detection, steps of Adam, what a result tells of itself."""

from __future__ import annotations

import math
import sys
from types import ModuleType

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from nlosoptics import inverse
from nlosoptics.errors import SamplingError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.data import deepinv as adapter
from nlosoptics.inverse.data import noisy_image, spectra
from nlosoptics.inverse.data.adam import adam_state, descend, take_up_adam
from nlosoptics.inverse.known.total_variation import sharpest

SHAPE = (20, 24)
KERNEL = np.outer([1.0, 3.0, 2.0], [1.0, 2.0, 4.0, 1.0, 0.5]) / 51.0
MODEL = ForwardModel(KERNEL, shape=SHAPE)
RISE = np.linspace(0.5, 1.5, SHAPE[0])[:, None] * np.ones(SHAPE)
NOISE = np.random.default_rng(5).normal(size=SHAPE)


def measured(image, **changes):
    given = inverse.Measurement(image, **{"noise_sigma": 0.1, **changes})
    return noisy_image.noisy_image(given, MODEL)


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.08])
def test_the_chance_of_equal_weights_is_that_of_chi_square(scale):
    """The spread of white noise has as many degrees of freedom as pixels, without the mean."""
    relative = scale * spectra.power(NOISE)
    found = noisy_image._chance(relative, np.ones(relative.shape), SHAPE, False)
    whole = scale * ((NOISE - NOISE.mean()) ** 2).sum()
    assert found == pytest.approx(chi2.sf(whole, NOISE.size - 1), rel=1e-9)


@pytest.mark.parametrize(("errors", "dark"), [(3.05, True), (3.13, False)])
def test_even_light_is_an_object_at_one_chance_in_1000(errors, dark):
    """3.09 standard errors of the mean; with an unknown background it is that background."""
    image = 0.1 * (NOISE - NOISE.mean() + errors / math.sqrt(NOISE.size))
    assert measured(image, fit_background=False).is_background() is dark
    assert measured(image).is_background()


def faintest(told, low, high):
    """Return the strength from which on something is told, by bisection."""
    assert not told(low)
    assert told(high)
    while high - low > 1e-9 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if told(middle) else (middle, high)
    return high


MAP = np.where(np.arange(SHAPE[1]) < 8, 0.3, 0.1) * np.ones(SHAPE)
MAP[3:6, 2:9] = np.inf
DOUBTS = {
    "known": {},
    "estimated": {"noise_sigma": None},
    "map": {"noise_sigma": MAP},
    "shape": {"background_shape": RISE},
    "no veil": {"fit_background": False},
}


@pytest.mark.parametrize("name", DOUBTS)
def test_the_faintest_objects_that_are_told_from_noise(name, on_record):
    """A dot, a stroke and an extended object, with and without the optics that passed them."""
    things = np.zeros((3, *SHAPE))
    things[0, 9, 11] = things[1, 5:15, 12] = 1.0
    things[2, 4:16, 5:20] = np.hanning(17)[1:-1]
    noise = NOISE * np.where(np.isfinite(MAP), MAP, 1.0) if name == "map" else 0.1 * NOISE

    def limit(thing, model):
        def told(strength):
            image = 0.5 + noise + strength * MODEL.forward(thing)
            return not measured(image, background=0.5, **DOUBTS[name]).is_background(model)

        return faintest(told, 1e-3, 1e3)

    on_record([limit(thing, model) for thing in things for model in (None, MODEL)], 1e-7)


@pytest.mark.parametrize(("given", "errors"), [(0.1, 2.0), (None, 18.0)])
def test_noise_is_left_up_to_three_errors_of_its_power(given, errors):
    data = measured(0.1 * NOISE, noise_sigma=given)
    limit = math.sqrt(1.0 + 3.0 * math.sqrt(errors / NOISE.size)) * data.sigma
    left = limit / math.sqrt((data.data**2).mean())
    assert data.is_noise_about((1.0 - 0.999 * left) * data.data)
    assert not data.is_noise_about((1.0 - 1.001 * left) * data.data)


@pytest.mark.parametrize("shape", [(64, 60), (61, 64), (24, 20)])
def test_noise_beyond_the_optics(shape, on_record):
    """A wide point spread leaves the noise alone at many frequencies, but in a small image."""
    kernel = np.exp(-(np.hypot(*np.mgrid[-9:10, -9:10]) ** 2) / 18.0)
    model = ForwardModel(kernel / kernel.sum(), shape=shape)
    draw = np.random.default_rng(6)
    truth = np.zeros(shape)
    truth[6:15, 8:17] = 1.0 + draw.random((9, 9))
    image = model.forward(truth) + 0.01 * draw.normal(size=shape)
    on_record([inverse.estimate_noise(image, model), inverse.estimate_noise(image)], 1e-8)


def test_without_noise_nothing_is_told_from_it():
    still = measured(np.full(SHAPE, 2.0), noise_sigma=None)
    assert still.sigma == 0.0
    assert still.is_background()
    assert still.is_noise_about(2.0)


def test_the_sharpest_object_of_noise_is_dark():
    level, veil, weight = sharpest(measured(3.0 + 0.1 * NOISE), MODEL)
    assert not level.any()
    assert level.shape == SHAPE
    assert veil == pytest.approx(3.0 + 0.1 * NOISE.mean(), rel=1e-12)
    assert weight == 0.0


def test_the_first_step_of_adam_is_its_rate_against_the_slope():
    """The state that it leaves brings another optimiser to the same second step."""
    places = [torch.zeros(3, dtype=torch.float64, requires_grad=True) for _ in range(2)]
    slope = torch.tensor([2.0, -3.0, 0.5], dtype=torch.float64)
    first, second = (torch.optim.Adam([place], lr=0.1) for place in places)
    descend(first, (slope * places[0]).sum())
    assert places[0].tolist() == pytest.approx([-0.1, 0.1, -0.1], rel=1e-6)
    state = {name: values.numpy() for name, values in adam_state("place", first).items()}
    take_up_adam("place", second, state)
    for adam, place in zip((first, second), places, strict=True):
        descend(adam, (slope * place * place).sum())
    assert torch.equal(*places)


def reconstruction(history, **parameters):
    return inverse.Reconstruction(
        object=np.zeros(SHAPE),
        physical_parameters=parameters,
        status="too_few_photons",
        score=1.23456,
        history={name: np.zeros(n) for name, n in history.items()},
        seconds=0.5,
    )


def test_a_result_tells_its_numbers():
    rows = reconstruction({"residual": 7, "change": 6}, tv_weight=0.123456, n=3, map=np.ones(2))
    assert rows._figures().rows == {
        "status": "too few photons",
        "residual, rms of the noise": "1.23",
        "iterations": "7",
        "seconds": "0.5",
        "tv weight": "0.1235",
        "n": "3",
    }
    retrieved = reconstruction({"fourier_error": 4})._figures()
    assert list(retrieved.rows)[1:3] == ["agreement of halves", "restarts"]
    assert retrieved.rows["restarts"] == "4"
    assert reconstruction({})._figures().rows["iterations"] == "0"


@pytest.fixture
def physics(monkeypatch):
    """The adapter's class on a stand-in of deepinv, which keeps what it is given."""

    class LinearPhysics(torch.nn.Module):
        def __init__(self, **options):
            super().__init__()
            self.options = options

    for name in ("deepinv", "deepinv.physics"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    sys.modules["deepinv.physics"].LinearPhysics = LinearPhysics
    adapter._physics_class.cache_clear()
    yield adapter.NlosPhysics
    adapter._physics_class.cache_clear()


def test_a_physics_of_deepinv_is_the_model(physics):
    """Of either kind; batches pass it, further parameters are refused."""
    batch = torch.rand((2, 1, *SHAPE), generator=torch.manual_seed(1))
    for model in (MODEL, inverse.TorchForwardModel.from_numpy(MODEL)):
        made = physics(model, noise_model="none")
        assert made.options == {"img_size": (1, *SHAPE), "noise_model": "none"}
        seen, back = made.A(batch), made.A_adjoint(batch)
        for k in range(2):
            # single precision
            np.testing.assert_allclose(seen[k, 0], MODEL.forward(batch[k, 0].numpy()), atol=1e-6)
            np.testing.assert_allclose(back[k, 0], MODEL.adjoint(batch[k, 0].numpy()), atol=1e-6)
        for call in (made.A, made.A_adjoint):
            with pytest.raises(SamplingError, match="takes no parameters, was given a, b; make"):
                call(batch, a=1, b=2)


SOLVERS = [inverse.tv_deconvolve, inverse.richardson_lucy, inverse.wiener, inverse.inverse_filter]


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.__name__)
def test_a_result_follows_the_unit_of_the_image(solver):
    """In a unit 2^12 times as large, gain, background and noise are as much smaller."""
    truth = np.zeros(SHAPE)
    truth[6:13, 8:15] = 1.0
    image = MODEL.forward(truth) + 0.5 + 0.02 * NOISE
    asked = {} if solver is inverse.inverse_filter else {"max_iterations": 9}
    plain, small = (
        solver(Measurement(unit * image, noise_sigma=0.02 * unit), MODEL, **asked)
        for unit in (1.0, 2.0**-12)
    )
    np.testing.assert_allclose(small.object, plain.object, rtol=0, atol=1e-9)
    for name in ("gain", "background", "noise_sigma"):
        was, now = (one.physical_parameters[name] for one in (plain, small))
        assert 2.0**12 * now == pytest.approx(was, rel=1e-9, abs=1e-12)
    assert small.score == pytest.approx(plain.score, rel=1e-9)
    assert small.status == plain.status


def test_scores_do_not_depend_on_the_unit_of_the_reconstruction():
    truth = np.zeros(SHAPE)
    truth[6:13, 8:15] = 1.0
    plain = inverse.registered_scores(truth + 0.1 * NOISE, truth)
    small = inverse.registered_scores(2.0**-30 * (truth + 0.1 * NOISE), truth)
    assert (small.correlation, small.psnr, small.ssim) == pytest.approx(
        (plain.correlation, plain.psnr, plain.ssim), rel=1e-12
    )
