"""Reconstruction by a network trained on simulated pairs of image and object."""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..._checks import counted, in_range, path_of, positive, reason, whole
from ..._nouns import Noun
from ..._progress import Progress
from ..._random import checked_seed, generator
from ..._whole_files import write_whole
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data._threads import gradients, single_thread
from ..data.adam import descend
from ..data.driver import reconstructed
from ..data.forward import TorchForwardModel, torch_model
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction, beside, frozen
from ..data.scaled_images import ScaledImage
from ..data.status import MOST_RESIDUAL, Ending
from .network_files import file_content, read_file
from .training_pairs import TrainingPairs
from .unet import UNet, normalised

BATCHES = 605  # stream of the order in which pairs are shown
_FORMAT = "nlosoptics CnnBaseline 1"
_ENTRY = "nlosoptics"


class CnnBaseline(nn.Module):
    """U-net that estimates the object from an image, for comparison with model-based solvers.

    A new instance has random weights. Train a network by `train_cnn`, or read a trained one by
    `load`. Calling the network on a batch of B images, (B, H, W), in any unit, returns objects
    (B, H, W) from 0 to 1; `reconstruct` takes one image. The network knows no optics. It recovers
    only objects like those of its training, seen via similar walls.

    Parameters
    ----------
    base : {8, 16, 32}
        Number of channels of the U-net at full resolution.
    depth : int
        Number of times that the U-net halves the resolution, 1 to 8.
    seed : int
        Seed of the initial weights.

    See Also
    --------
    train_cnn : Train a network on simulated pairs.
    UNet : Small U-net.
    """

    def __init__(self, *, base: int = 16, depth: int = 4, seed: int = 0) -> None:
        super().__init__()
        self.network = UNet(base, depth, seed=seed)

    def forward(self, images: Tensor) -> Tensor:
        """Compute objects (B, H, W), 0 to 1, from a batch of images (B, H, W) in any unit."""
        if images.ndim != 3:
            raise SamplingError(f"images has shape {tuple(images.shape)}, must be (B, H, W)")
        return torch.sigmoid(self.network(normalised(images)[:, None])[:, 0])

    @single_thread()
    def reconstruct(
        self,
        image: Any,
        model: ForwardModel | TorchForwardModel,
        *,
        tolerance: float = 0.1,
    ) -> Reconstruction:
        """Reconstruct the object of one image by the network.

        The network determines the object up to brightness. The image model is only used to fit
        gain and background, and to compare the object's image with the given one.

        Parameters
        ----------
        image : Measurement, ndarray or Tensor
            Camera image, (H, W), with its noise and background.
        model : ForwardModel or TorchForwardModel
            Image model of shape (H, W): the convolution of an object with the known point spread
            function.
        tolerance : float
            The status is "converged" if the residual exceeds the noise by at most this fraction.

        Returns
        -------
        Reconstruction
            Object and status, and as score the rms residual divided by the noise.

        Raises
        ------
        SamplingError
            If an array does not have the model's shape.
        SceneError
            If a value is out of range or not finite.
        """
        tolerance = in_range("tolerance", tolerance, 0.0, 0.5, open_low=True)

        def solve(data: NoisyImage) -> dict[str, Any]:
            scaled = ScaledImage(data, data.sigma)
            blur = torch_model(model, data.data.device, torch.float32)
            with torch.no_grad():
                found = self(scaled.image[None].to(next(self.parameters())))[0].to(scaled.image)
                strength = scaled.misfit(blur(found))[0].item() * scaled.unit
            level = strength * found.double()
            veil, score = beside(data, level, model)
            return {
                "level": level,
                "background": veil,
                "ending": Ending(
                    converged=score <= 1.0 + tolerance,
                    history={"objective": [], "residual": [], "change": []},
                    most_residual=max(MOST_RESIDUAL, 1.0 + tolerance),
                ),
            }

        return reconstructed(solve, image, model)

    def save(self, path: Path | str) -> None:
        """Save the network to a file in the safetensors format.

        If an error occurs, no partial file remains.

        Parameters
        ----------
        path : Path or str
            File to write.

        Raises
        ------
        SceneError
            If the file cannot be written.
        MissingExtraError
            If safetensors is not installed.
        """
        # a single text, so that equal networks give equal files
        told = {"format": _FORMAT, "base": self.network.base, "depth": self.network.depth}
        tensors = {
            name: values.detach().cpu().contiguous()
            for name, values in self.network.state_dict().items()
        }
        write_whole({path_of("path", path): file_content(tensors, {_ENTRY: json.dumps(told)})})

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Load a network that `save` wrote.

        Parameters
        ----------
        path : Path or str
            File to read.

        Returns
        -------
        CnnBaseline
            Network with the saved weights.

        Raises
        ------
        SceneError
            If the file cannot be read or does not contain such a network.
        MissingExtraError
            If safetensors is not installed.
        """
        path, written = path_of("path", path), "give one written by nlosoptics train"
        tensors, texts = read_file(path, written)
        try:
            told = dict(json.loads(texts[_ENTRY]))
        except (KeyError, TypeError, ValueError):
            told = {}
        if told.get("format") != _FORMAT:
            raise SceneError(
                f'{path} has format {told.get("format")!r}, must be "{_FORMAT}"; {written}'
            )
        try:
            made = cls(base=int(told["base"]), depth=int(told["depth"]))
            made.network.load_state_dict(tensors)
            finite = all(bool(held.isfinite().all()) for held in tensors.values())
        except (RuntimeError, KeyError, ValueError) as error:
            raise SceneError(
                f"{path} does not hold its network's weights ({reason(error)}); train it again"
            ) from None
        if not finite:
            raise SceneError(f"{path} has weights that are not finite; train it again")
        return made


@dataclass(frozen=True, eq=False, kw_only=True)
class Training(Noun):
    """Trained network, with the history of its training.

    Parameters
    ----------
    network : CnnBaseline
        Network after the epoch (pass over all training pairs) with the least validation error.
    history : mapping of str to ndarray, (n_epochs,)
        Mean squared error of the objects after each epoch, float64, read-only: ``training`` over
        the pairs used for training, ``validation`` over the pairs held out.
    interrupted : bool
        Whether Ctrl-C ended the training early.
    seconds : float
        Wall-clock time of the training, s.

    See Also
    --------
    train_cnn : Train a network on simulated pairs.
    """

    network: CnnBaseline
    history: Mapping[str, NDArray[np.float64]]
    interrupted: bool
    seconds: float


@single_thread()
@gradients()
def train_cnn(
    pairs: TrainingPairs,
    *,
    base: int = 16,
    depth: int = 4,
    epochs: int = 20,
    batch: int = 16,
    learning_rate: float = 3e-3,
    validation: float = 0.1,
    device: torch.device | str = "cpu",
    seed: int = 0,
    progress: Progress | None = None,
) -> Training:
    """Train a network to estimate objects from images, on given pairs of image and object.

    Ctrl-C ends the training and returns the best network so far.

    Parameters
    ----------
    pairs : TrainingPairs
        Pairs of image and object, for example from `training_pairs`.
    base : {8, 16, 32}
        Number of channels of the U-net at full resolution.
    depth : int
        Number of times that the U-net halves the resolution, 1 to 8.
    epochs : int
        Number of passes over all training pairs.
    batch : int
        Number of pairs in one step of the optimiser.
    learning_rate : float
        Initial learning rate of the optimiser (Adam); it decreases to zero along a cosine.
    validation : float
        Fraction of the pairs, above 0 and up to 0.9, that is not used for training, but to select
        the best epoch. These pairs are taken from the end.
    device : torch.device or str
        Device for training; the network is returned on the CPU.
    seed : int
        Seed of the initial weights and of the order of the pairs. On the same kind of processor,
        the same seed gives the same result bit for bit.
    progress : callable or None
        Function that is called after every step with a text and the completed fraction, 0 to 1.

    Returns
    -------
    Training
        Best network with the history of its training.

    Raises
    ------
    SceneError
        If a value is out of range or not finite, or there are fewer than two pairs.
    SamplingError
        If images and objects differ in shape.
    KeyboardInterrupt
        If Ctrl-C was pressed before the first epoch ended.

    See Also
    --------
    training_pairs : Simulate images of random objects.
    CnnBaseline : Network from images to objects.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.inverse import TrainingPairs, train_cnn
    >>> images = np.random.default_rng(0).random((4, 8, 8), dtype=np.float32)
    >>> pairs = TrainingPairs(images=images, objects=images)
    >>> training = train_cnn(pairs, base=8, depth=1, epochs=2)
    >>> training.history["validation"].shape, training.interrupted
    ((2,), False)
    """
    started = time.perf_counter()
    checked_seed(seed)
    epochs, batch = whole("epochs", epochs), whole("batch", batch)
    learning_rate = positive("learning_rate", learning_rate)
    validation = in_range("validation", validation, 0.0, 0.9, open_low=True)
    count = len(pairs.images)
    held = min(max(1, round(validation * count)), count - 1)
    shown = count - held
    if held < 1:
        raise SceneError(
            f"{counted(count, 'pair')}, must be at least 2, one for validation; simulate more"
        )
    made = CnnBaseline(base=base, depth=depth, seed=seed).to(device)
    images, objects = (values.to(device) for values in _tensors(pairs))
    adam = torch.optim.Adam(made.parameters(), learning_rate, fused=True)
    draw = generator(seed, BATCHES)
    best, least = None, math.inf
    history: dict[str, list[float]] = {"training": [], "validation": []}
    interrupted = False
    try:
        for epoch in range(epochs):
            order = torch.from_numpy(draw.permutation(shown)).to(device)
            total = 0.0
            for start in range(0, shown, batch):
                done = (epoch + start / shown) / epochs
                adam.param_groups[0]["lr"] = learning_rate * 0.5 * (1 + math.cos(math.pi * done))
                chosen = order[start : start + batch]
                loss = (made(images[chosen]) - objects[chosen]).square().mean()
                descend(adam, loss)
                total += loss.item() * len(chosen)
                if progress is not None:
                    told = f", validation {least:.4f}" if best is not None else ""
                    progress(f"training: epoch {epoch + 1} of {epochs}{told}", done)
            error = _validation(made, images[shown:], objects[shown:], batch)
            history["training"].append(total / shown)
            history["validation"].append(error)
            if error < least:
                best, least = copy.deepcopy(made.state_dict()), error
    except KeyboardInterrupt:
        if best is None:
            raise
        interrupted = True
    if best is None:
        raise SceneError(
            f"learning_rate = {learning_rate:g} gave weights that are not finite; lower it"
        )
    made.load_state_dict(best)
    if progress is not None and not interrupted:
        progress(f"training: validation {least:.4f}", 1.0)
    return Training(
        network=made.cpu(),
        history=frozen(history),
        interrupted=interrupted,
        seconds=time.perf_counter() - started,
    )


def _tensors(pairs: TrainingPairs) -> tuple[Tensor, Tensor]:
    """Return the training images and objects as checked single-precision tensors."""
    images, objects = (
        torch.tensor(np.asarray(values), dtype=torch.float32)
        for values in (pairs.images, pairs.objects)
    )
    if images.ndim != 3 or images.shape != objects.shape:
        raise SamplingError(
            f"pairs.images has shape {tuple(images.shape)}, pairs.objects "
            f"{tuple(objects.shape)}; give (N, H, W) both"
        )
    for name, values in (("images", images), ("objects", objects)):
        n_bad = int((~torch.isfinite(values)).sum())
        if n_bad:
            raise SceneError(
                f"pairs.{name} has {n_bad} of {values.numel()} values that are not finite; "
                "remove these pairs"
            )
    return images, objects


def _validation(made: CnnBaseline, images: Tensor, objects: Tensor, batch: int) -> float:
    """Return the mean squared error over pairs that were not used for training."""
    total = 0.0
    with torch.no_grad():
        for part, wanted in zip(
            torch.split(images, batch), torch.split(objects, batch), strict=True
        ):
            total += (made(part) - wanted).square().mean().item() * len(part)
    return total / len(images)
