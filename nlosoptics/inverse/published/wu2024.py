"""Physics-constrained inverse network (PCIN) as published by Wu et al. 2024."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from functools import partial
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..._checks import counted, in_range, one_of, positive, whole
from ..._progress import Progress
from ..._random import checked_seed, generator
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data._threads import gradients, single_thread
from ..data.checkpoints import State, adam_state, goes_on, joined, spread, state_of, take_up_adam
from ..data.measurement import Measurement, measurement, real_array, shape_of
from ..data.reconstruction import Reconstruction, assemble, without_object
from ..data.scaled_images import ScaledImage, total_variation
from ..data.scores import registered_correlation
from ..wave.frames import known_defoci
from ..wave.pupil_psf import PupilPSF
from .unet import UNetObject

NetworkInput = Literal["image", "reconstruction"]

ANGLES = 603  # stream of the random angles
# Iterations of a first run and of a resumed run ("more than 4000", "approximately 1800" in the
# paper).
_COLD, _WARM = 4000, 1800
_SMOOTH = 1e-3
# Correlation of object and image above which the answer counts as trivial (no blur).
_TRIVIAL_CORRELATION = 0.95


@single_thread()
@gradients()
def wu2024_fit(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    start: Reconstruction | Mapping[str, Any] | None = None,
    start_waves: float = 0.5,
    base: int = 8,
    depth: int = 4,
    alternate: int = 10,
    network_input: NetworkInput = "image",
    learning_rate: float = 0.01,
    tv_weight: float = 1e-3,
    noise_sigma: Any = None,
    background: Any = 0.0,
    fit_background: bool = True,
    background_shape: Any = None,
    gain: float | None = None,
    max_iterations: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Reconstruction:
    """Fit object and wall to one image with an untrained U-net and random angles (PCIN) [1]_.

    Parameters
    ----------
    images : ndarray or Tensor
        One image, (H, W) or (1, H, W), any unit.
    pupil_psf : PupilPSF
        Point spread of shape (H, W). Its coefficients take the role of the exit angles; the object
        itself is not modified.
    defocus : sequence of one float, or None
        Known additional defocus of the image, m rms.
    start : Reconstruction, mapping or None
        Warm start: an earlier result of this function for a similar object, which provides angles
        and network. A saved state of a run with the same options resumes that run bit-identically
        (see `inverse.data.checkpoints`). None: cold start with random angles and weights.
    start_waves : float
        Rms wave aberration of a cold start, waves.
    base : {8, 16, 32}
        Channels of the network at full resolution, see `UNet`. Ignored for a warm start.
    depth : int
        Number of times the resolution is halved, see `UNet`. Ignored for a warm start.
    alternate : int
        Number of steps on the angles, followed by as many on the network.
    network_input : {"image", "reconstruction"}
        Input of the network in step 2: the measured image or the last reconstruction.
    learning_rate : float
        Learning rate of Adam for angles and weights.
    tv_weight : float
        Weight of the total variation in W(9), for an image with range 1.
    noise_sigma : float, array_like or None
        Standard deviation of the noise, one number, (H, W) or (1, H, W), image units; None:
        estimated by `estimate_noise`.
    background : float or array_like
        Known background, one number, (H, W) or (1, H, W), image units.
    fit_background : bool
        Whether to fit the strength of an additional background.
    background_shape : array_like or None
        Shape of the additional background, (H, W), non-negative; None: uniform.
    gain : float or None
        Known image units per object unit; None: the object is scaled to a maximum of 1.
    max_iterations : int or None
        Maximum number of steps on angles and network together; None: 4000 cold, 1800 warm.
    seed : int
        Seed of the random angles and weights.
    progress : callable or None
        Called after each alternation with a text and the completed fraction; may raise `Stop`.

    Returns
    -------
    Reconstruction
        Object, status and score. ``physical_parameters`` also contains ``coefficients`` (as in
        ``pupil_psf``), ``network_weights`` (n,) float32, ``network_base``, ``network_depth``,
        ``strehl`` (peak of the point spread relative to the unaberrated one) and ``iterations``.
        The status is "trivial" if object and image have a correlation of 0.95 or more, otherwise
        "unconverged" (see Notes).

    Raises
    ------
    SamplingError
        If there are several images, or shapes do not fit.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    pcin : Entry point of the blind solvers.
    evidence_fit : Blind fit of one or more images by their evidence.
    PupilPSF : Differentiable PSF of a wave.

    Notes
    -----
    Statements of the paper's section 2.2 and their implementation, W(n) being its equation n:

    ==================================================  ===========================================
    "The speckle image ... is fed into CNN with         `UNetObject` on the image, weights drawn by
    randomly initialized weights"; U-net                ``seed``
    "incorporated into the physical model with a        ``_random_angles``; `PupilPSF`, W(2), W(3);
    randomly initialized diffuse angle"                 the product I = O Phi of W(8) in
                                                        ``_Network.seen``
    1. loss between measured and modelled image         ``_phase`` of the angles, the object held
    optimizes the physical parameters, "network
    structure kept unchanged", "repeated"
    2. optimized parameters held, the loss optimizes    ``_phase`` of the network
    the network parameters, "repeated"
    3. "These two steps are alternated"                 the loop of ``run``
    W(9): squared error plus TV of the reconstruction   ``_Network.loss``
    ADAM, learning rate 0.01                            two of `torch.optim.Adam`
    "estimated and outputted as the final layer"        the last object, no average, no best one
    4000 iterations, 1800 with "the previous run's      ``max_iterations``; ``start``
    optimization results as input"
    512 x 512 pixels                                    any; see below for memory
    ==================================================  ===========================================

    The paper leaves some choices open, which are options here: the number of repetitions of steps 1
    and 2 (``alternate``); the input of the network in step 2 (``network_input``); the network's
    size (``base``); the spread of the random angles (``start_waves``); the weight of TV
    (``tv_weight``), which W(9) gives as 1 in unknown units (both sums are over pixels). Fixed
    choices are a sigmoid as last layer, least-squares brightness and background in every step, and
    moments of Adam that persist through the alternation. The frame is circular, as W(8) implies.

    The method is included for comparison. From random angles and one image it was never observed to
    find object and wall. It ends at the image itself, or at another object that fits the image to
    its noise or better (`benchmarks/inverse/wu2024.py`). Started at the true wall it drifts away. A
    residual at the noise level is therefore no sign of success, and the status is never
    "converged".

    References
    ----------
    .. [1] Wu et al., Advanced Photonics Nexus 3 (2024) 026010, section 2.2.
    """
    started = time.perf_counter()
    checked_seed(seed)
    alternate = whole("alternate", alternate)
    if max_iterations is None:
        max_iterations = _WARM if isinstance(start, Reconstruction) else _COLD
    max_iterations = whole("max_iterations", max_iterations)
    tv_weight = in_range("tv_weight", tv_weight, 0.0)
    learning_rate = in_range("learning_rate", learning_rate, 0.0, 1.0, open_low=True)
    one_of("network_input", network_input, ("image", "reconstruction"))
    gain = None if gain is None else positive("gain", gain)
    data = measurement(
        _only(images, pupil_psf),
        pupil_psf.shape,
        noise_sigma=_of_one("noise_sigma", noise_sigma),
        background=_of_one("background", background),
        fit_background=fit_background,
        background_shape=background_shape,
    )
    extra = _only_defocus(defocus)
    if data.is_background():
        model = _model(pupil_psf, pupil_psf.coefficients, extra)
        return without_object(data, model=model, gain=gain, started=started)
    unit = float(data.data.max() - data.data.min())
    image = ScaledImage(data, unit)
    if isinstance(start, Reconstruction):
        angles, network = _from_earlier(start, pupil_psf, image.image)
    else:
        angles = _random_angles(pupil_psf, start_waves, seed)
        network = UNetObject(image.image, base=base, depth=depth, seed=seed)
    fit = _Pcin(image, pupil_psf, extra, angles, network, learning_rate, tv_weight, data.sigma)
    behind = 0 if start is None or isinstance(start, Reconstruction) else fit.go_on(start)
    fit.run(behind, max_iterations, alternate, network_input, progress)
    return _result(fit, data, gain, started)


class _Pcin:
    """State of a fit: facet angles and network weights, each with an Adam optimiser."""

    def __init__(
        self,
        image: ScaledImage,
        pupil_psf: PupilPSF,
        defocus: list[float] | None,
        angles: Tensor,
        network: UNetObject,
        learning_rate: float,
        tv_weight: float,
        sigma: float,
    ) -> None:
        self.image, self.pupil_psf, self.defocus = image, pupil_psf, defocus
        self.angles = nn.Parameter(angles)
        self.network = network
        self._tv_weight = tv_weight
        self._noise = sigma / image.unit
        self._adams = (
            torch.optim.Adam([self.angles], learning_rate),
            torch.optim.Adam(network.parameters(), learning_rate, fused=True),
        )
        self.history: dict[str, list[float]] = {"objective": [], "residual": [], "change": []}

    def run(
        self,
        behind: int,
        max_iterations: int,
        alternate: int,
        network_input: NetworkInput,
        progress: Progress | None,
    ) -> None:
        """Alternate between fits of the angles and of the network until all iterations are used.

        ``behind`` is the number of iterations of a resumed fit, and ``alternate`` the number of
        iterations of each of the two fits in a turn.
        """
        left = max_iterations - behind
        while left > 0:
            for phase in (self._fit_angles, self._fit_network):
                steps = min(alternate, left)
                phase(steps)
                left -= steps
            if network_input == "reconstruction":
                self.network.set_guide(self.object())
            done = max_iterations - left
            if not goes_on(
                progress,
                f"pcin, Wu 2024: residual {self.history['residual'][-1]:.3f} after "
                f"{counted(done, 'iteration')}",
                done / max_iterations,
                partial(self._state, done),
            ):
                return

    def _state(self, count: int) -> State:
        """Return everything that the turn after the first ``count`` iterations starts from."""
        return state_of(
            self.gain() * self.object(),
            coefficients=self.angles,
            **adam_state("angles", self._adams[0]),
            **adam_state("network", self._adams[1]),
            guide=self.network.guide,
            count=count,
        )

    def go_on(self, state: Mapping[str, Any]) -> int:
        """Resume from a saved state; return the number of its iterations."""
        if not isinstance(state, Mapping) or not {"guide", "count"} <= set(state):
            raise SceneError("start holds no network; give a state of wu2024_fit, or leave it out")
        take_up_adam("angles", self._adams[0], state)
        take_up_adam("network", self._adams[1], state)
        spread("guide", state["guide"], [self.network.guide])
        return int(state["count"])

    def object(self) -> Tensor:
        """Return the current output of the network, (H, W), 0 to 1."""
        with torch.no_grad():
            picture: Tensor = self.network()
        return picture

    def gain(self) -> float:
        """Return the fitted number of image units per object unit."""
        with torch.no_grad():
            seen = _seen(self.network(), self._transfer())
            return self.image.misfit(seen)[0].item() * self.image.unit

    def _fit_angles(self, steps: int) -> None:
        """Fit the angles with the object fixed (step 1 of the paper)."""
        picture = self.object()
        for _ in range(steps):
            self._step(self._adams[0], picture, self._transfer())

    def _fit_network(self, steps: int) -> None:
        """Fit the network with the angles fixed (step 2 of the paper)."""
        with torch.no_grad():
            transfer = self._transfer()
        for _ in range(steps):
            self._step(self._adams[1], self.network(), transfer)

    def _transfer(self) -> Tensor:
        transfer = self.pupil_psf.transfer(self.angles, defocus=self.defocus)
        return transfer[0] if self.defocus is not None else transfer

    def _step(self, adam: torch.optim.Optimizer, picture: Tensor, transfer: Tensor) -> None:
        """Make one step of Adam on the loss of the paper's eq. 9.

        The loss is the squared error plus total variation, summed over the pixels.
        """
        gain, residual = self.image.misfit(_seen(picture, transfer))
        square = self.image.weighted(residual * residual).sum()
        loss = square + self._tv_weight * gain * total_variation(picture, _SMOOTH)
        adam.zero_grad()
        before = self.angles.detach().clone()
        loss.backward()  # type: ignore[no-untyped-call]
        adam.step()
        change = (self.angles.detach() - before).norm() / before.norm().clamp_min(1e-30)
        rms = math.sqrt(self.image.mean_square(residual.detach()).item())
        self.history["objective"].append(loss.item())
        self.history["residual"].append(rms / self._noise if self._noise > 0.0 else rms)
        self.history["change"].append(change.item())


def _seen(picture: Tensor, transfer: Tensor) -> Tensor:
    """Return the modelled image, eq. 8 of the paper without noise."""
    seen: Tensor = torch.fft.irfft2(torch.fft.rfft2(picture) * transfer, s=picture.shape)
    return seen


def _result(fit: _Pcin, data: Measurement, gain: float | None, started: float) -> Reconstruction:
    picture = fit.object()
    coefficients = fit.angles.detach()
    model = _model(fit.pupil_psf, coefficients, fit.defocus)
    level = fit.gain() * picture.double()
    seen = torch.from_numpy(model.forward(level.cpu().numpy())).to(level.device)
    strength = data.background_strength(data.data - seen)
    flat = _model(fit.pupil_psf, torch.zeros_like(coefficients), None)
    strehl = float(model.kernel.max() / flat.kernel.max())
    alike = registered_correlation(picture, data.data)
    weights = joined(list(fit.network.network.parameters()))
    return assemble(
        data,
        level,
        model=model,
        background=strength,
        gain=gain,
        status="trivial" if alike > _TRIVIAL_CORRELATION else "unconverged",
        history=fit.history,
        started=started,
        coefficients=_frozen(coefficients.to(torch.float64)),
        network_weights=_frozen(weights),
        network_base=float(fit.network.network.base),
        network_depth=float(fit.network.network.depth),
        strehl=strehl,
        iterations=float(len(fit.history["residual"])),
    )


def _only(images: Any, pupil_psf: PupilPSF) -> Any:
    """Return the single image, (H, W), of an argument (H, W) or (1, H, W)."""
    if not isinstance(pupil_psf, PupilPSF):
        raise SceneError(
            f"pupil_psf of type {type(pupil_psf).__name__} is not a PupilPSF; "
            "build one with PupilPSF.from_zernike"
        )
    shape = shape_of("images", images)
    if len(shape) != 3:
        return images
    if shape[0] != 1:
        raise SamplingError(
            f'images has {shape[0]} frames, recipe "wu2024" takes one; give one of them, or all of '
            'them to recipe "evidence"'
        )
    return images[0]


def _of_one(name: str, value: Any) -> Any:
    """Return the element of a value of shape (1,) or (1, H, W), and any other value itself."""
    shape = shape_of(name, value)
    return value[0] if len(shape) in (1, 3) and shape[0] == 1 else value


def _only_defocus(defocus: Any) -> list[float] | None:
    if defocus is None:
        return None
    return known_defoci(np.atleast_1d(real_array("defocus", defocus)), 1).tolist()


def _random_angles(pupil_psf: PupilPSF, waves: float, seed: int) -> Tensor:
    """Return normally distributed angles, scaled to a wave aberration of ``waves`` waves rms.

    One scaling suffices, since the wave is linear in the angles.
    """
    waves = positive("start_waves", waves)
    leaves = pupil_psf.coefficients
    drawn = torch.from_numpy(generator(seed, ANGLES).standard_normal(leaves.shape)).to(leaves)
    with torch.no_grad():
        aberration = pupil_psf.aberration(drawn) / pupil_psf.wavelength
    share = torch.as_tensor(pupil_psf.optics.share).to(aberration)
    mean = (share * aberration).sum() / share.sum()
    rms = ((share * (aberration - mean) ** 2).sum() / share.sum()).sqrt()
    return drawn * (waves / rms)


def _from_earlier(
    start: Reconstruction, pupil_psf: PupilPSF, image: Tensor
) -> tuple[Tensor, UNetObject]:
    """Return angles and network of an earlier result."""
    found = start.physical_parameters
    missing = {"coefficients", "network_weights", "network_base", "network_depth"} - set(found)
    if missing:
        raise SceneError(
            f"start has no {min(missing)}; give a Reconstruction that wu2024_fit returned"
        )
    wanted = tuple(pupil_psf.coefficients.shape)
    if np.shape(found["coefficients"]) != wanted:
        raise SamplingError(
            f"start has coefficients of shape {np.shape(found['coefficients'])}, pupil_psf of "
            f"{wanted}; give the pupil_psf of the earlier run"
        )
    base, depth = int(found["network_base"]), int(found["network_depth"])
    network = UNetObject(image, base=base, depth=depth)
    spread("network_weights", found["network_weights"], list(network.network.parameters()))
    angles = torch.from_numpy(np.array(found["coefficients"])).to(pupil_psf.coefficients)
    return angles, network


def _model(pupil_psf: PupilPSF, coefficients: Tensor, defocus: list[float] | None) -> ForwardModel:
    """Return the numpy image model for given coefficients."""
    with torch.no_grad():
        spread = pupil_psf(coefficients.detach(), defocus=defocus)
    kernel = spread[0] if defocus is not None else spread
    return ForwardModel(kernel.double().cpu().numpy(), shape=pupil_psf.shape, boundary="circular")


def _frozen(values: Tensor) -> NDArray[Any]:
    array = values.cpu().numpy().copy()
    array.flags.writeable = False
    return array
