"""Blind fits and networks: progress callbacks, interruption and resumption."""

from __future__ import annotations

import copy
import functools

import numpy as np
import pytest
import torch

from nlosoptics import inverse, reconstructing
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel

SIDE = 32
WAVELENGTH = 632.8e-9
UNIT = 50.0  # image units of the brightest object
SIGMA = 0.01 * UNIT
DEFOCUS = np.array([0.0, 0.5 * WAVELENGTH])


@functools.cache
def pupil() -> inverse.PupilPSF:
    """Three modes that start at a tenth of a wave each."""
    return inverse.PupilPSF.from_zernike(
        {4: 0.1 * WAVELENGTH, 5: 0.1 * WAVELENGTH, 7: 0.1 * WAVELENGTH},
        wavelength=WAVELENGTH,
        pupil_radius=1e-3,
        image_distance=50e-3,
        pitch=632.8e-9 * 50e-3 / 4e-3,
        shape=SIDE,
    )


@functools.cache
def case() -> tuple[np.ndarray, np.ndarray, ForwardModel]:
    """Two frames with known defoci, the truth, and the model of the first."""
    truth = np.zeros((SIDE, SIDE))
    truth[8:24, 10:14] = 1.0
    truth[8:12, 10:22] = 0.7
    wall = torch.tensor([0.15, -0.1, 0.2])
    with torch.no_grad():
        kernels = pupil()(wall, defocus=DEFOCUS).double().numpy()
    models = [ForwardModel(kernel, shape=truth.shape, boundary="circular") for kernel in kernels]
    noise = SIGMA * np.random.default_rng(0).normal(size=(2, SIDE, SIDE))
    return np.stack([model.forward(UNIT * truth) for model in models]) + noise, truth, models[0]


def measured(image):
    return inverse.Measurement(image, noise_sigma=SIGMA)


def wu2024(**watched):
    options = {"depth": 3, "alternate": 5, "network_input": "reconstruction"}
    images = case()[0][:1]
    return inverse.wu2024_fit(measured(images), pupil(), max_iterations=40, **options, **watched)


@functools.cache
def unknown() -> inverse.PupilPSF:
    """The same modes, with nothing known of them."""
    spread = copy.deepcopy(pupil())
    with torch.no_grad():
        spread.coefficients.zero_()
    return spread


def evidence(**watched):
    options = {"defocus": DEFOCUS, "max_iterations": 1}
    return inverse.pcin(measured(case()[0]), unknown(), **options, **watched)


def evidence_near(**watched):
    options = {"start_error": 0.1, "max_iterations": 1}
    return inverse.pcin(measured(case()[0]), pupil(), defocus=DEFOCUS, **options, **watched)


def evidence_near_one(**watched):
    return inverse.pcin(measured(case()[0][0]), pupil(), start_error=0.1, **watched)


def evidence_one(**watched):
    return inverse.pcin(measured(case()[0][0]), unknown(), max_iterations=1, **watched)


def phases(method):
    def solver(**watched):
        return inverse.phase_retrieval(
            measured(case()[0][0]),
            method=method,
            restarts=4,
            object_size=(16, 12),
            max_iterations=60,
            **watched,
        )

    return solver


SEARCHES = (evidence, evidence_near, evidence_near_one)


class Watch:
    """Keeps what it is shown; ends the fit at a report."""

    def __init__(self, last: int | None = None) -> None:
        self.last, self.fractions, self.states = last, [], []

    def __call__(self, text: str, fraction: float) -> None:
        assert text
        self.fractions.append(fraction)

    def look(self, snapshot) -> None:
        self.states.append(snapshot())
        if len(self.states) == self.last:
            raise inverse.Stop


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("solver", "last"),
    [(evidence, 3), (evidence, 4), (evidence_near, 4), (evidence_near_one, 3)],
)
def test_goes_on_bit_by_bit(solver, last) -> None:
    """A state holds all that the next step takes: weights, moments, counts."""
    seen = Watch()
    whole = solver(progress=seen)
    watch = Watch(last)
    part = solver(progress=watch)
    assert part.status == "unconverged"
    # the reports of both are the same, up to the end
    assert watch.fractions == seen.fractions[:last]
    assert np.array_equal(watch.states[-1]["object"], seen.states[last - 1]["object"])
    rest = Watch()
    again = solver(start=watch.states[-1], progress=rest)
    # a search saves its state before the step that it reports
    assert rest.fractions == seen.fractions[last - (solver in SEARCHES) :]
    assert again.object.tobytes() == whole.object.tobytes()
    assert again.status == whole.status
    assert again.score == whole.score


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("solver", "last"),
    [
        (wu2024, 2),
        (evidence, 1),
        (evidence, 3),
        (evidence_near, 2),
        (evidence_near_one, 1),
        (evidence_one, 2),
        (phases("raar"), 2),
        (phases("alternating"), 1),
    ],
)
def test_an_ended_fit_has_an_object_and_a_preview_in_image_units(solver, last) -> None:
    watch = Watch(last)
    found = solver(progress=watch)
    assert found.status == "unconverged"
    assert len(watch.states) == last  # not asked again
    preview = watch.states[-1]["object"]
    assert preview.shape == found.object.shape == (SIDE, SIDE)
    assert np.isfinite(found.object).all()
    assert found.object.max() == 1.0
    assert np.isfinite(found.score)
    if "gain" in found.physical_parameters:  # of phases alone no unit is known
        # what is returned may be a step behind or, of a search just begun, one descent ahead: its
        # light is the same but for what the background takes, a third where it is only guessed
        light = found.physical_parameters["gain"] * found.object.sum()
        assert preview.sum() == pytest.approx(light, rel=0.5)
        assert inverse.registered_correlation(preview, found.object) > 0.5


@pytest.mark.thorough
def test_a_search_for_one_image_goes_on_bit_by_bit() -> None:
    """Within the generations of its only round."""
    seen, watch, rest = Watch(), Watch(5), Watch()
    whole = evidence_one(progress=seen)
    evidence_one(progress=watch)
    again = evidence_one(start=watch.states[-1], progress=rest)
    assert again.object.tobytes() == whole.object.tobytes()
    assert rest.fractions == seen.fractions[4:]


@pytest.mark.thorough
def test_a_state_of_other_images_is_refused() -> None:
    watch = Watch(3)
    evidence(progress=watch)
    with pytest.raises(SamplingError, match="start's gains have shape"):
        evidence_near_one(start=watch.states[-1])


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("solver", "start", "named"),
    [
        (evidence, {"object": np.ones((SIDE, SIDE))}, "start holds no pool_coefficients"),
        (evidence, np.ones((3, 3)), "start of type ndarray is no saved state"),
    ],
)
def test_bad_starts_are_named(solver, start, named) -> None:
    with pytest.raises((SceneError, SamplingError)) as refused:
        solver(start=start)
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_kept_state_that_is_cut_or_no_archive_is_named(tmp_path) -> None:
    kept = tmp_path / reconstructing.CHECKPOINT
    np.savez(kept, identity="mine", object=np.ones((4, 4)))
    assert set(reconstructing.kept_state(tmp_path, "mine")) == {"object"}
    with pytest.raises(SceneError, match="number of iterations"):
        reconstructing.kept_state(tmp_path, "other")
    whole = kept.read_bytes()
    with (tmp_path / "object.npy").open("wb") as file:
        np.save(file, np.ones(3))
    spoilt = bytearray(whole)
    spoilt[len(whole) // 4] ^= 0xFF
    for content in (whole[:200], bytes(spoilt), (tmp_path / "object.npy").read_bytes(), b""):
        kept.write_bytes(content)
        with pytest.raises(SceneError, match="cannot be read .*; run without --resume"):
            reconstructing.kept_state(tmp_path, "mine")


def test_a_kept_state_is_of_one_tolerance() -> None:
    """Of the point spread: another one is another model."""
    tasks = [
        reconstructing.Task(scene=None, images=(), method="tv", tol=tol) for tol in (1e-3, 1e-2)
    ]
    assert tasks[0].identity() != tasks[1].identity()
