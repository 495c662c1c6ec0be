"""Free energies of two frames, walls drawn at random, and the network's view, on record."""

import numpy as np
import pytest
import torch

from nlosoptics.inverse import PupilPSF
from nlosoptics.inverse.blind.free_energy import FreeEnergy, Stage
from nlosoptics.inverse.blind.random_walls import Breeding, children, random_walls
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
        data,
        pupil,
        defocus=None if count == 1 else [0.0, 3e-7],
        walls=None,
        noise_sigma=noise,
        background=0.1,
        fit_background=True,
        background_shape=None,
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
