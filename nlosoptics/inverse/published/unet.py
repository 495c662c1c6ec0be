"""Small U-nets that map pictures to pictures of the same, arbitrary size."""

from __future__ import annotations

from itertools import pairwise
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..._checks import one_of, whole
from ..._random import generator
from ...errors import SamplingError

WEIGHTS = 601  # stream of a network's weights


class UNet(nn.Module):
    """U-net: convolutional network from images to images of the same, arbitrary size [1]_.

    Parameters
    ----------
    base : {8, 16, 32}
        Number of channels at full resolution; it doubles each time the resolution is halved. At
        depth 4 the network has 0.44, 1.77 or 7.06 million weights.
    depth : int
        Number of times that the resolution is halved, 1 to 8.
    in_channels : int
        Number of channels of the input images; the output images have one.
    seed : int
        Seed of the initial weights.

    See Also
    --------
    wu2024_fit : Fit of object and wall, with the object from such a network.

    Notes
    -----
    At each resolution the encoder has two 3 x 3 convolutions and the decoder one, each followed by
    normalisation over all channels and pixels of an image and by a leaky ReLU. The decoder doubles
    the number of samples along each side and appends the encoder's channels of the same resolution.
    A final 1 x 1 convolution gives the output, which is not bounded. If 2^depth does not divide a
    side of the image, the image is padded with its last samples, and the output is cropped.

    References
    ----------
    .. [1] Ronneberger, Fischer and Brox, MICCAI 2015, Lecture Notes in Computer Science 9351, 234.
    """

    def __init__(
        self, base: int = 8, depth: int = 4, *, in_channels: int = 1, seed: int = 0
    ) -> None:
        super().__init__()
        self.base = int(one_of("base", str(whole("base", base)), ("8", "16", "32")))
        self.depth = whole("depth", depth, 1, 8)
        self.in_channels = whole("in_channels", in_channels)
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
        self.head = nn.Conv2d(self.base, 1, 1, dtype=torch.float32)

    def forward(self, picture: Tensor) -> Tensor:
        """Map a batch of images (B, in_channels, H, W) to images (B, 1, H, W)."""
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

    ``guide`` (H, W): input of the network; each channel is shifted and scaled to mean 0 and
    variance 1. The object has the same device and precision. ``base``, ``depth``: size of the
    network, see `UNet`. ``seed``: seed of its initial weights.

    The network's structure alone favours objects over noise. It is fitted to one image [1]_.

    References
    ----------
    .. [1] Ulyanov, Vedaldi and Lempitsky, Int. J. Comput. Vis. 128 (2020) 1867.
    """

    def __init__(self, guide: Tensor, *, base: int = 8, depth: int = 4, seed: int = 0) -> None:
        super().__init__()
        self.set_guide(guide)
        self.network = UNet(base, depth, in_channels=self.guide.shape[1], seed=seed)
        self.network.to(device=guide.device, dtype=guide.dtype)

    def set_guide(self, guide: Tensor) -> None:
        """Set the network's input, (H, W) or (C, H, W)."""
        picture = guide.detach().reshape(1, -1, *guide.shape[-2:])
        centred = picture - picture.mean(dim=(-2, -1), keepdim=True)
        spread = centred.square().mean(dim=(-2, -1), keepdim=True).sqrt()
        # a uniform picture has no information and becomes zero
        self.guide = centred / torch.where(spread > 0.0, spread, 1.0)

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
            nn.LeakyReLU(0.1, inplace=True),
        ]
    return nn.Sequential(*layers)
