"""deepinv on our operator: its own checks and solvers, and a clean refusal without it."""

from __future__ import annotations

import pickle
import subprocess
import sys
import warnings
from importlib.util import find_spec

import numpy as np
import pytest
import torch

from nlosoptics import inverse
from nlosoptics.errors import MissingExtraError, SamplingError
from nlosoptics.imaging import ForwardModel


def stand_in_operators():
    """The two operators that torchvision looks for and a CPU-only torch lacks, without code."""
    probe = [sys.executable, "-c", "import torchvision"]
    run = subprocess.run(probe, capture_output=True, text=True, check=False, timeout=120)
    if "torchvision::nms does not exist" not in run.stderr:
        return None
    library = torch.library.Library("torchvision", "DEF")
    for name in ("nms", "qnms"):
        library.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    return library


@pytest.fixture(scope="module")
def deepinv():
    """The package, where it is installed and loads."""
    if find_spec("deepinv") is None:
        pytest.skip("deepinv is not installed")
    library = stand_in_operators()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import deepinv
        except (ImportError, RuntimeError) as error:
            pytest.skip(f"deepinv does not load: {error}")
        yield deepinv
    del library


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(0)
    kernel = rng.random((9, 8)) ** 3
    truth = np.zeros((32, 27))
    truth[8:20, 9:15] = 1.0
    # odd and even sides, light that leaves the frame
    return ForwardModel(kernel / kernel.sum(), shape=truth.shape), truth


@pytest.fixture
def physics(deepinv, scene):
    from nlosoptics.inverse.data.deepinv import NlosPhysics

    return NlosPhysics(scene[0])


def as_batch(picture):
    return torch.from_numpy(picture).to(torch.float32)[None, None]


def test_image_is_the_models(physics, scene):
    model, truth = scene
    # single precision
    np.testing.assert_allclose(physics.A(as_batch(truth))[0, 0], model.forward(truth), atol=1e-6)


def test_adjoint_by_their_check(physics, scene):
    _, truth = scene
    # single precision
    assert abs(float(physics.adjointness_test(as_batch(truth)))) < 1e-5


@pytest.mark.parametrize("boundary", ["padded", "circular"])
def test_adjoint_in_double_precision(deepinv, scene, boundary):
    from nlosoptics.inverse.data.deepinv import NlosPhysics

    model = ForwardModel(scene[0].kernel, shape=(32, 27), boundary=boundary)
    physics = NlosPhysics(inverse.TorchForwardModel.from_numpy(model, dtype=torch.float64))
    draw = torch.Generator().manual_seed(0)
    x, y = torch.randn((2, 2, 1, 32, 27), dtype=torch.float64, generator=draw)
    seen, back = physics.A(x), physics.A_adjoint(y)
    limit = 1e-12 * float(seen.norm() * y.norm())  # rounding
    assert abs(float((seen * y).sum() - (x * back).sum())) <= limit


def test_their_solvers_run_and_agree_with_ours(deepinv, physics, scene):
    model, truth = scene
    sigma = 0.01
    image = model.forward(truth) + sigma * np.random.default_rng(1).normal(size=truth.shape)
    y = as_batch(image)
    solver = deepinv.optim.optim_builder(
        iteration="PGD",
        prior=deepinv.optim.TVPrior(n_it_max=20),
        data_fidelity=deepinv.optim.L2(),
        params_algo={"stepsize": 1.0, "lambda": 0.01},
        max_iter=100,
    )
    theirs = solver(y, physics)[0, 0].detach().numpy()
    ours = inverse.tv_deconvolve(inverse.Measurement(image, noise_sigma=sigma), model)
    assert inverse.registered_correlation(theirs, truth) > 0.9
    assert inverse.registered_correlation(ours, truth) > inverse.registered_correlation(
        theirs, truth
    )
    least_squares = physics.A_dagger(y)
    residual = float((physics.A(least_squares) - y).norm() / y.norm())
    assert residual < 0.05  # the noise is 4 % of the image


def test_parameters_of_other_physics_are_refused(physics, scene):
    with pytest.raises(SamplingError, match="was given filter"):
        physics.A(as_batch(scene[1]), filter=torch.ones(1, 1, 3, 3))


def test_class_is_one_and_found_by_its_name(deepinv):
    from nlosoptics.inverse.data import deepinv as adapter

    assert pickle.loads(pickle.dumps(adapter.NlosPhysics)) is adapter.NlosPhysics


@pytest.mark.parametrize("kind", ["ImportError", "RuntimeError"])
def test_without_deepinv_the_remedy_is_one_line(kind):
    """Absent, or beside a torchvision that raises RuntimeError while it loads."""
    code = (
        "import sys\n"
        "class Broken:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] == 'deepinv':\n"
        f"            raise {kind}('operator torchvision::nms does not exist')\n"
        "sys.meta_path.insert(0, Broken())\n"
        "import nlosoptics.inverse.data.deepinv as adapter\n"
        "from nlosoptics.errors import MissingExtraError\n"
        "try:\n    adapter.NlosPhysics\n"
        "except MissingExtraError as error:\n    print(error)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert run.stdout.strip() == (
        "deepinv cannot be loaded (operator torchvision::nms does not exist); pip install "
        "'nlosoptics[deepinv]', with a torchvision that is built for the torch that is there"
    )


def test_no_other_name_is_promised():
    from nlosoptics.inverse.data import deepinv as adapter

    with pytest.raises(AttributeError, match="no attribute 'Physics'"):
        _ = adapter.Physics
    assert issubclass(MissingExtraError, ImportError)
