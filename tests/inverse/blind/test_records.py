"""Free energies of two frames, verdicts, steps of fits, and the network's view, on record."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nlosoptics.inverse import Measurement, PupilPSF, evidence_fit, pcin
from nlosoptics.inverse.blind.free_energy import FreeEnergy, Stage
from nlosoptics.inverse.blind.random_walls import Breeding, children, random_walls
from nlosoptics.inverse.blind.verdict import Verdict
from nlosoptics.inverse.blind.wall_network import channels, twin_signs
from nlosoptics.inverse.blind.wall_proposals import at_nyquist
from nlosoptics.inverse.wave.frames import frames_of

MODES = tuple(range(4, 12))
OPTICS = {"wavelength": 6e-7, "pupil_radius": 9e-4, "image_distance": 0.05, "pitch": 9e-6}


@pytest.fixture(params=["one", "two", "pixels lost"])
def energy(request):
    pupil = PupilPSF.from_zernike(MODES, shape=24, pixel_integrated=True, **OPTICS)
    count = 1 if request.param == "one" else 2
    rng = np.random.default_rng(3)
    data = rng.random((count, 18, 16)) + np.hypot(*np.mgrid[-9:9, -8:8]) / 8
    noise = np.full((count, 18, 16), 0.05)
    if request.param == "pixels lost":
        noise[0, 3, 4:7], noise[1, :, :5] = np.inf, 0.1
    frames = frames_of(
        Measurement(data, noise_sigma=noise, background=0.1),
        pupil,
        defocus=None if count == 1 else [0.0, 3e-7],
    )
    gains = request.param == "pixels lost"
    return FreeEnergy(frames, pupil, grid=(28, 26), dtype=np.float64, fit_gains=gains)


def test_an_energy(energy, on_record):
    rng = np.random.default_rng(0)
    walls = random_walls(3, energy.size, np.array([0.2, 0.3, 0.5]), rng)
    starts = energy.starts(walls, 3.0)
    stage = Stage(iterations=4, kappa=0.5, first=3.0, last=1.0, share=0.5, wave_rate=0.05)
    later = energy.descend(starts, stage)
    on_record(
        {
            "starts": starts,
            "values": energy.evaluate(starts, walls, 2.0, 0.5, True),
            "later": later,
            "judged": energy.judged(later),
            "objects": energy.objects(later),
            "spread": energy.point_spread(later),
            "apart": energy.apart(later, walls[:1]),
            "paces": [[stage.noise(i), stage.pace(i)] for i in range(5)],
            "bred": children(later, 6, energy.twin, Breeding(flips=0.4, noise=0.1), rng),
        }
    )


def test_what_the_network_sees(on_record):
    rng = np.random.default_rng(4)
    image = rng.random((40, 40)) + np.outer(np.hanning(40), np.hanning(40))
    coarse, noise = at_nyquist(image, 0.02, 0.8)
    pictures = torch.from_numpy(rng.random((2, 64, 64)))
    seen = channels(pictures.float(), torch.tensor([0.02, 0.1]))
    on_record([coarse, noise, seen, twin_signs()], 1e-4)


STATUS = ("converged", "trivial", "unconverged")
SAYS = ("", "wall and ", "a wave wi", "another w", "a wave of")
MARGINS = (0.0, -45.0, -55.0, -65.0, -75.0, -120.0)
EXPECTED = (math.nan, 0.2, 1.16, 1.18)  # of which 0.6 are 0.12, 0.696 and 0.708


def answer(squares, waves):
    """An answer of given mean squared residuals, with one mode."""
    return SimpleNamespace(
        chi_square=np.full((1, 1), squares), coefficients=np.array([[waves]]), count=1
    )


@pytest.mark.parametrize("several", [False, True])
def test_verdicts(several, on_record):
    """Around every limit: residuals, margins, rivals, the prior, and lengths of the wall."""
    told = {}
    for sigma in (3e-3, 0.02):
        frames = SimpleNamespace(
            counted=np.full(1, 4000), sigmas=np.full(1, sigma), n_walls=1, range=1.0
        )
        verdict = Verdict(frames, (4,), several)
        for squares, waves in itertools.product((0.8, 1.0, 1.05, 1.1, 3.0), (0.1, 0.13, 0.7, 2.0)):
            best, name = answer(squares, waves), f"{sigma} {squares} {waves}"
            errors = [verdict.model_error(best), verdict.structured(best), verdict.well(best)]
            errors += [verdict.model_limit(best, whole) for whole in (False, True)]
            said = []
            cases = itertools.product(MARGINS, (0.09, 0.3), (99.0, 101.0))
            for margin, share, rival in cases:
                given = (margin, -share * 4000), rival
                found = [
                    verdict.faults(best, *given, expected=length, held=0.0, start_error=None)
                    for length in EXPECTED
                ]
                found += [
                    verdict.faults(best, *given, expected=math.nan, held=held, start_error=0.1)
                    for held in (0.0, 150.0, 90.0)
                ]
                said += [SAYS.index(" ".join(one)[:9]) for one in found]
                said += [STATUS.index(verdict.status(best, margin, one)) for one in found]
            told[name] = [*errors, np.array(said)]
    on_record(told)


def steps(told):
    """What a fit says of its steps: each text once, and all shares of the work."""
    return [" / ".join(dict.fromkeys(text for text, _ in told)), np.array([one for _, one in told])]


def made(shape=(24, 28), frames=1):
    """Images of a rectangle by three modes."""
    optics = {"wavelength": 6e-7, "pupil_radius": 1e-3, "image_distance": 0.06, "pitch": 9e-6}
    pupil = PupilPSF.from_zernike((4, 5, 6), **optics, shape=shape)
    picture = torch.zeros(shape)
    picture[8:15, 9:18] = 500.0
    with torch.no_grad():
        pupil.coefficients.copy_(torch.tensor((0.15, -0.1, 0.1)))
        light = pupil.image(picture, defocus=[3e-7 * k for k in range(frames)]).numpy()
    return light + 2.0 * np.random.default_rng(0).normal(size=light.shape), pupil


FITS = {
    "near": (1, {"start_error": 0.1}),
    "random": (1, {"strength": 0.3}),
    "search": (2, {"defocus": [0.0, 3e-7]}),
    "two": (2, {"defocus": [0.0, 3e-7]}),
    "walls": (2, {"walls": [0, 1], "strength": 0.2}),
    "known": (1, {"known_object": np.pad(np.ones((7, 9)), ((8, 9), (9, 10)))}),
}


@pytest.mark.parametrize("name", FITS)
def test_steps_of_a_fit(name, on_record):
    """Each text with its share of the work; sums in single precision decide nothing here."""
    frames, options = FITS[name]
    images, pupil = made(frames=frames)
    if name == "search":
        with torch.no_grad():
            pupil.coefficients.zero_()
    told = []
    found = evidence_fit(
        images, pupil, max_iterations=1, progress=lambda *step: told.append(step), **options
    )
    settled = sorted(found.physical_parameters)
    on_record([steps(told), found.status, settled, sorted(found.history)], 1e-4)


def test_steps_of_the_front_door(on_record):
    images, pupil = made()
    told = []
    small = {"base": 8, "depth": 2, "progress": lambda *step: told.append(step)}
    found = pcin(images, pupil, recipe="wu2024", max_iterations=7, alternate=3, **small)
    on_record([steps(told)[1], found.status], 1e-3)
