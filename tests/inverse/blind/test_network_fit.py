"""Recipe "network": object by an untrained network, wall and status by the evidence."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics.errors import NlosError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import (
    Measurement,
    PupilPSF,
    Reconstruction,
    Stop,
    pcin,
    registered_correlation,
)
from nlosoptics.inverse.blind import network_fit

SIDE, NOISE = 32, 0.01
IMAGES = np.random.default_rng(1).random((2, SIDE, SIDE))
WALL = np.array([0.15, -0.1, 0.12, 0.1, -0.08, 0.05, 0.1, -0.06])  # 0.28 waves rms


@pytest.fixture(scope="module")
def pupil_psf():
    return PupilPSF.from_zernike(
        range(4, 12),
        wavelength=632.8e-9,
        pupil_radius=1e-3,
        image_distance=50e-3,
        pitch=632.8e-9 * 50e-3 / 2e-3 / 2,
        shape=SIDE,
    )


@pytest.fixture(scope="module")
def truth():
    picture = np.zeros((SIDE, SIDE))
    picture[7:25, 10:14] = picture[7:11, 10:22] = picture[20:23, 18:24] = 1.0
    return picture


@pytest.fixture(scope="module")
def image(pupil_psf, truth):
    kernel = pupil_psf(pupil_psf.coefficients.new_tensor(WALL)).detach().double().numpy()
    blurred = ForwardModel(kernel, shape=truth.shape, boundary="circular").forward(truth)
    sigma = NOISE * blurred.max()
    noise = sigma * np.random.default_rng(0).normal(size=blurred.shape)
    return Measurement(blurred + noise, noise_sigma=sigma)


def answered(monkeypatch, picture):
    """Let the evidence answer with the true wall and a picture; return the walls it is given."""
    walls = []

    def stub(images, pupil_psf, **options):
        walls.append(pupil_psf.coefficients.detach().clone().numpy())
        values = {"gain": 1.0, "background": 0.0, "coefficients": WALL}
        return Reconstruction(
            object=picture,
            physical_parameters=values,
            status="converged",
            score=1.0,
            history={},
            seconds=0.0,
        )

    monkeypatch.setattr(network_fit, "evidence_fit", stub)
    return walls


def test_the_object_is_that_of_a_network_with_the_wall_of_the_evidence(
    monkeypatch, image, pupil_psf, truth
):
    walls = answered(monkeypatch, truth)
    found = pcin(image, pupil_psf, recipe="network", proposals=1, max_iterations=60)
    likeness = registered_correlation(found, truth)
    # measured 0.908; the image has 0.716
    assert likeness > 0.85
    agreement = found.physical_parameters["agreement"]
    assert agreement == pytest.approx(likeness, rel=1e-9)
    assert found.status == ("converged" if agreement >= 0.9 else "ambiguous")
    assert (found.object.min(), found.object.max()) == pytest.approx((0.0, 1.0))
    assert walls[0].any()  # the proposed wall after its fit with a network
    assert not pupil_psf.coefficients.detach().any()


def test_objects_that_differ_are_not_converged(monkeypatch, image, pupil_psf, truth):
    answered(monkeypatch, truth[::-1])
    found = pcin(image, pupil_psf, recipe="network", proposals=1, max_iterations=20)
    assert found.status == "ambiguous"
    assert found.physical_parameters["agreement"] < 0.9
    assert "of network and evidence have a correlation of" in found.reasons[0]


@pytest.mark.parametrize("reports", [0, 2])
def test_a_stopped_fit_gives_the_answer_so_far(image, pupil_psf, reports):
    texts = []

    def progress(text, done):
        texts.append(text)
        assert 0.0 <= done <= 1.0
        if len(texts) > reports:
            raise Stop

    found = pcin(image, pupil_psf, recipe="network", max_iterations=20, progress=progress)
    assert found.status == "unconverged"
    assert len(texts) == reports + 1
    assert np.isfinite(found.object).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"images": IMAGES, "defocus": [0.0, 3e-7]}, "takes one of the point"),
        ({"images": IMAGES[0, :, 2:]}, "one of the point spread's shape"),
        ({"start": {}}, 'recipe "network" cannot resume; leave it out'),
        ({"proposals": 0}, "proposals = 0 is out of range"),
        ({"max_iterations": 3}, "max_iterations = 3 is out of range"),
    ],
)
def test_bad_input_is_refused(image, pupil_psf, change, words):
    options = {"images": image, "pupil_psf": pupil_psf, **change}
    with pytest.raises(NlosError, match=words):
        pcin(recipe="network", **options)


@pytest.mark.thorough
def test_wall_and_object_are_found_from_one_image(image, pupil_psf, truth):
    first, again = (pcin(image, pupil_psf, recipe="network", seed=1) for _ in range(2))
    assert registered_correlation(first, truth) > 0.95
    assert first.object.tobytes() == again.object.tobytes()
