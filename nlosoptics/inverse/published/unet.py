"""Small U-nets that map pictures to pictures of the same, arbitrary size."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..._checks import one_of, whole
from ..._random import generator
from ...errors import SamplingError, SceneError

# Stage of `_random` that draws a network's weights.
WEIGHTS = 601
_SLOPE = 0.1


class UNet(nn.Module):
    """Encoder and decoder with skip connections [1]_, for pictures of any size.

    Parameters
    ----------
    base : {8, 16, 32}
        Channels at full resolution, doubled at each lower level. The network has 0.44, 1.77 or 7.06
        million weights at depth 4.
    depth : int
        Number of times the resolution is halved, 1 to 8.
    in_channels, out_channels : int
        Channels of the input and output pictures.
    seed : int
        Seed of the initial weights.

    See Also
    --------
    CnnBaseline : Network from images to objects.
    deep_image_prior : Untrained network fitted to one image.

    Notes
    -----
    Each level has two 3 x 3 convolutions in the encoder and one in the decoder, where a second one
    would take a third of the run time without a better fit. Each convolution is followed by
    normalisation over all channels and pixels of a picture (one group, independent of the
    batch) and a leaky ReLU. A 1 x 1 convolution without activation gives the output, which is
    not bounded. The decoder doubles the samples and concatenates those of the encoder. Sides
    that 2^depth does not divide are padded with their last samples and cropped again. The
    memory layout is channels_last, which makes a step on a CPU a fifth faster with the same
    results.

    References
    ----------
    .. [1] Ronneberger, Fischer and Brox, MICCAI 2015, Lecture Notes in Computer Science 9351, 234.
    """

    def __init__(
        self,
        base: int = 8,
        depth: int = 4,
        *,
        in_channels: int = 1,
        out_channels: int = 1,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.base = int(one_of("base", str(whole("base", base)), ("8", "16", "32")))
        self.depth = whole("depth", depth, 1, 8)
        self.in_channels = whole("in_channels", in_channels)
        self.out_channels = whole("out_channels", out_channels)
        draw = generator(seed, WEIGHTS)
        # Torch draws weights from its global generator, whose state is restored afterwards.
        # torch.manual_seed would also change the generators of accelerators.
        with torch.random.fork_rng(devices=[]):
            torch.default_generator.manual_seed(int(draw.integers(2**63)))
            # always in single precision on the processor, regardless of torch's defaults
            with torch.device("cpu"):
                self._build()
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def _build(self) -> None:
        widths = [self.base * 2**level for level in range(self.depth + 1)]
        entries = [self.in_channels, *widths[:-1]]
        self.encoder = nn.ModuleList(map(_stage, entries, widths))
        self.decoder = nn.ModuleList(
            _stage(coarse + fine, fine, 1) for fine, coarse in pairwise(widths)
        )
        self.head = nn.Conv2d(self.base, self.out_channels, 1, dtype=torch.float32)

    def forward(self, picture: Tensor) -> Tensor:
        """Map pictures (B, in_channels, H, W) to pictures (B, out_channels, H, W)."""
        if picture.ndim != 4 or picture.shape[1] != self.in_channels:
            raise SamplingError(
                f"picture has shape {tuple(picture.shape)}, must be (B, {self.in_channels}, H, W); "
                "give one batch of pictures"
            )
        rows, columns = picture.shape[-2:]
        multiple = 2**self.depth
        missing = (0, -columns % multiple, 0, -rows % multiple)
        values = F.pad(picture, missing, mode="replicate") if any(missing) else picture
        values = values.contiguous(memory_format=torch.channels_last)
        skipped: list[Tensor] = []
        for stage in self.encoder[:-1]:
            skipped.append(stage(values))
            values = F.max_pool2d(skipped[-1], 2)
        values = self.encoder[-1](values)
        for stage, beside in zip(reversed(self.decoder), reversed(skipped), strict=True):
            values = stage(torch.cat((F.interpolate(values, scale_factor=2.0), beside), dim=1))
        return cast(Tensor, self.head(values))[..., :rows, :columns]


class UNetObject(nn.Module):
    """Object represented as the output of an untrained U-net, between 0 and 1.

    Parameters
    ----------
    guide : Tensor, (H, W) or (C, H, W)
        Input of the network; each channel is shifted and scaled to mean 0 and variance 1. The
        object has the same device and precision.
    base, depth : int
        Size of the network, see `UNet`.
    seed : int
        Seed of its initial weights.

    Notes
    -----
    The network's structure alone favours objects over noise. It is fitted to one image [1]_.

    References
    ----------
    .. [1] Ulyanov, Vedaldi and Lempitsky, Int. J. Comput. Vis. 128 (2020) 1867.
    """

    guide: Tensor

    def __init__(self, guide: Tensor, *, base: int = 8, depth: int = 4, seed: int = 0) -> None:
        super().__init__()
        self.network = UNet(base, depth, in_channels=_channels(guide).shape[0], seed=seed)
        self.network.to(device=guide.device, dtype=guide.dtype)
        self.register_buffer("guide", _normalised(_channels(guide))[None])

    def set_guide(self, guide: Tensor) -> None:
        """Replace the network's input by another one with as many channels."""
        self.guide = _normalised(_channels(guide))[None].to(self.guide)

    def forward(self) -> Tensor:
        """Object (H, W), each pixel between 0 and 1."""
        return torch.sigmoid(cast(Tensor, self.network(self.guide))[0, 0])


def _stage(entering: int, leaving: int, convolutions: int = 2) -> nn.Sequential:
    layers: list[nn.Module] = []
    for channels in (entering, leaving)[:convolutions]:
        layers += [
            # no bias, since the following normalisation has its own offset
            nn.Conv2d(channels, leaving, 3, padding=1, bias=False, dtype=torch.float32),
            nn.GroupNorm(1, leaving, dtype=torch.float32),
            nn.LeakyReLU(_SLOPE, inplace=True),
        ]
    return nn.Sequential(*layers)


def _channels(guide: Any) -> Tensor:
    if not isinstance(guide, Tensor) or not guide.is_floating_point():
        raise SceneError(
            f"guide of type {type(guide).__name__} is not a tensor of floats; "
            "give torch.from_numpy(picture)"
        )
    if guide.ndim not in (2, 3):
        raise SamplingError(f"guide has shape {tuple(guide.shape)}, must be (H, W) or (C, H, W)")
    return guide.detach().reshape(-1, *guide.shape[-2:])


def _normalised(guide: Tensor) -> Tensor:
    centred = guide - guide.mean(dim=(-2, -1), keepdim=True)
    spread = centred.square().mean(dim=(-2, -1), keepdim=True).sqrt()
    # a uniform channel has no information and becomes zero
    return centred / torch.where(spread > 0.0, spread, torch.ones_like(spread))
