"""Blind fit with an untrained network as the object's prior; the evidence judges the wall."""

from __future__ import annotations

import copy
import math
import time
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ..._checks import whole
from ..._progress import Progress
from ..._random import checked_seed, generator
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data._threads import gradients, single_thread
from ..data.adam import descend
from ..data.arrays import as_numpy
from ..data.checkpoints import Stop
from ..data.measurement import measured
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction, beside
from ..data.scaled_images import ScaledImage
from ..data.scores import registered_correlation
from ..published.unet import UNetObject
from ..wave.frames import frames_of
from ..wave.pupil_psf import PupilPSF
from .evidence import evidence_fit
from .free_energy import Floats, FreeEnergy
from .search_settings import SETTINGS
from .wall_proposals import wall_proposals

GUIDE, WALLS = 602, 604  # streams of the network's input and of the proposed walls


@single_thread()
@gradients()
def network_fit(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    proposals: int = 3,
    base: int = 8,
    max_iterations: int = 160,
    seed: int = 0,
    start: None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Fit object and wall to one image, with an untrained network as the object's prior.

    The parts are those of `wu2024_fit`: a U-net that is fitted to this image alone, and a
    differentiable point spread. What differs is where the fit starts and what judges it:

    1. The network of wall proposals names walls for this image, see the Notes of `evidence_fit`.
    2. From each of them a new U-net with noise as its input and then, from a quarter of the steps
       on, also the wall are fitted to the image [1]_. Few steps keep the network from fitting
       noise.
    3. The free energy, with the object integrated out, ranks the fitted walls. `evidence_fit` takes
       the best as a start. It finds the wall and the status by its own tests; if they doubt this
       wall, it searches as it does without the U-net.
    4. With this wall fixed, a new U-net gives the object: the mean over the second half of its
       steps, which has a smaller random error than the last one.

    Where the network of proposals does not apply, the wall is that of `evidence_fit`. The status is
    that of `evidence_fit`. If it is "converged", the two objects must have a correlation of 0.9, so
    that two different priors agree; otherwise it is "ambiguous".

    Parameters
    ----------
    images, pupil_psf, defocus
        See `evidence_fit`; one image, and a point spread of its shape. Coefficients other than 0
        are an additional start.
    proposals : int
        Number of proposed walls that are fitted with the U-net.
    base : {8, 16, 32}
        Width of the U-net, see `UNet`.
    max_iterations : int
        Number of steps of the U-net for each wall, at least 4. The last fit has three times as
        many.
    seed : int
        Seed of proposals, weights and search.
    start : None
        There is no saved state; the fit starts again.
    progress : callable or None
        Function that is called repeatedly with a text and the completed fraction, 0 to 1. It may
        raise `Stop`; the result is then the answer of `evidence_fit` so far.

    Returns
    -------
    Reconstruction
        As from `evidence_fit`, with the object of the U-net and its score. ``physical_parameters``
        also contains ``agreement``, the correlation of both objects.

    Raises
    ------
    SceneError, SamplingError
        As from `evidence_fit`; also if there are several images, or a state is given.

    References
    ----------
    .. [1] Ulyanov, Vedaldi and Lempitsky, Int. J. Comput. Vis. 128 (2020) 1867.
    """
    started = time.perf_counter()
    proposals, steps = whole("proposals", proposals), whole("max_iterations", max_iterations, 4)
    seed = checked_seed(seed)
    if start is not None:
        raise SceneError('start is given, but recipe "network" cannot resume; leave it out')
    frames = frames_of(images, pupil_psf, defocus=defocus, walls=None)
    if len(frames.images) > 1 or frames.shape != pupil_psf.shape:
        raise SamplingError(
            f'images has shape {frames.images.shape}, recipe "network" takes one of the point '
            f'spread\'s shape, {pupil_psf.shape}; give all images to recipe "evidence"'
        )
    data, extra = frames.measured[0].in_torch(), frames.defocus.tolist()
    source = None if data.is_background() else wall_proposals(frames, pupil_psf)
    walls = [] if source is None else [*source.walls(proposals, generator(seed, WALLS))]
    given = pupil_psf.coefficients.detach().double().cpu().numpy()
    if given.any():
        walls.append(given)
    report = _Reports(progress, len(walls) + 2)

    def fitted(wall: Floats, count: int, moves: bool) -> tuple[Floats, Tensor]:
        report.part += 1
        noise = generator(seed + report.part, GUIDE).uniform(size=(8, *frames.shape))
        guide = torch.from_numpy(noise).to(data.data.device, torch.float32)
        network = UNetObject(guide, base=base, seed=seed + report.part)
        return _fitted(data, pupil_psf, extra, wall, network, count, moves, report)

    best = pupil_psf
    with suppress(Stop):
        ends = [fitted(wall, steps, True)[0] for wall in walls]
        if ends:
            rows, columns = (8 * math.ceil(SETTINGS.narrow * n / 8) for n in frames.shape)
            energy, stage = FreeEnergy(frames, pupil_psf, grid=(rows, columns)), SETTINGS.compare
            judged = energy.descend(energy.starts(np.array(ends), stage.first), stage)
            best = _moved(pupil_psf, judged.best(1).coefficients[0])
    report.part = len(walls)
    found = evidence_fit(images, best, defocus=defocus, seed=seed, progress=report)
    if found.status != "too_few_photons":
        wall = found.physical_parameters["coefficients"]
        with suppress(Stop):
            level = fitted(wall, 3 * steps, False)[1]
            kernel = _moved(pupil_psf, wall)(defocus=extra)[0].detach().double()
            model = ForwardModel(as_numpy(kernel), shape=frames.shape, boundary="circular")
            found = _with_object(found, measured(images).gain, data, model, level)
    if report.stopped:
        found = replace(found, status="unconverged")
    return replace(found, seconds=time.perf_counter() - started)


class _Reports:
    """Progress of ``parts`` parts, the first of which has the number 0; remembers a `Stop`."""

    def __init__(self, progress: Progress | None, parts: int) -> None:
        self._progress, self._parts = progress, parts
        self.part, self.stopped = -1, False

    def __call__(self, text: str, done: float) -> None:
        try:
            if self._progress is not None and not self.stopped:
                self._progress(f"network: {text}", (self.part + done) / self._parts)
        except Stop:
            self.stopped = True
        if self.stopped:
            raise Stop


@single_thread()
def _fitted(
    data: NoisyImage,
    pupil_psf: PupilPSF,
    defocus: list[float],
    wall: Floats,
    network: UNetObject,
    steps: int,
    moves: bool,
    report: _Reports,
) -> tuple[Floats, Tensor]:
    """Fit a network, and the wall if it ``moves``; return the wall and the object's mean.

    The wall moves from a quarter of the steps on. The mean object (H, W), image units, is that of
    the second half.
    """
    image = ScaledImage(data, float(data.data.max() - data.data.min()))
    angles = nn.Parameter(torch.as_tensor(wall).to(pupil_psf.coefficients))
    # the paper's learning rate
    adam = torch.optim.Adam([*network.parameters(), angles], 0.01)
    transfer = pupil_psf.transfer(angles, defocus=defocus)[0].detach()
    total = torch.zeros_like(data.data)
    for step in range(steps):
        if step % 20 == 0:
            report("object and proposed wall" if moves else "object", step / steps)
        if moves and 4 * step >= steps:
            transfer = pupil_psf.transfer(angles, defocus=defocus)[0]
        picture = network()
        seen = torch.fft.irfft2(torch.fft.rfft2(picture) * transfer, s=picture.shape)
        gain, residual = image.misfit(seen)
        descend(adam, image.weighted(residual * residual).sum())
        if 2 * step >= steps:
            total += (gain * picture).detach()
    return angles.detach().double().cpu().numpy(), total * (image.unit / (steps // 2))


def _moved(pupil_psf: PupilPSF, wall: Any) -> PupilPSF:
    """Return the point spread with other coefficients."""
    moved = copy.deepcopy(pupil_psf)
    with torch.no_grad():
        moved.coefficients.copy_(torch.as_tensor(wall))
    return moved


def _with_object(
    found: Reconstruction,
    gain: float | None,
    data: NoisyImage,
    model: ForwardModel,
    level: Tensor,
    least: float = 0.9,
) -> Reconstruction:
    """Return an answer of `evidence_fit` with the object of the network.

    ``least`` is the smallest correlation of two objects that agree.
    """
    if data.fit_background:  # which would explain a constant part of the object as well
        level = level - level.min()
    agreement = registered_correlation(as_numpy(level), found)
    doubts: dict[str, Any] = {}
    if found.status == "converged" and agreement < least:
        reason = (
            f"the objects of network and evidence have a correlation of {agreement:.2f}, must be "
            f"{least:g}; give a second image with a known defocus, or allow more max_iterations"
        )
        doubts = {"status": "ambiguous", "reasons": (reason,)}
    background, score = beside(data, level, model)
    gain = float(level.max()) if gain is None else gain
    values = {"gain": gain, "background": background, "agreement": agreement}
    return replace(
        found,
        object=data.like_input(level / gain),
        physical_parameters={**found.physical_parameters, **values},
        score=score,
        **doubts,
    )
