"""One step of the U-nets beside the same networks in plain torch: ms and peak memory.

python benchmarks/inverse/unet_step.py [--sides 64 128 256 512] [--bases 8 16 32] [--repeats 12]

A step is the network forward, the gradient of a squared error, and Adam. "plain" has the same
layers and weights, written as one would without this package: rows innermost, Adam as it comes. One
thread; the least of the repeats, taken in turns. Memory is the process's largest, each in a
process of its own.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import nn


class PlainUNet(nn.Module):
    """The layers of `inverse.UNet` in the order in which they run."""

    def __init__(self, base, depth):
        super().__init__()
        widths = [base * 2**level for level in range(depth + 1)]
        self.encoder = nn.ModuleList()
        self.decoder = nn.ModuleList()
        entering = 1
        for width in widths:
            self.encoder.append(
                nn.Sequential(*self.layer(entering, width), *self.layer(width, width))
            )
            entering = width
        for level in range(depth):
            self.decoder.append(
                nn.Sequential(*self.layer(widths[level] + widths[level + 1], widths[level]))
            )
        self.head = nn.Conv2d(base, 1, 1)

    @staticmethod
    def layer(entering, leaving):
        convolution = nn.Conv2d(entering, leaving, 3, padding=1, bias=False)
        return convolution, nn.GroupNorm(1, leaving), nn.LeakyReLU(0.1)

    def forward(self, x):
        skipped = []
        for level, stage in enumerate(self.encoder):
            x = stage(x)
            if level < len(self.encoder) - 1:
                skipped.append(x)
                x = F.max_pool2d(x, 2)
        for level in reversed(range(len(self.decoder))):
            x = F.interpolate(x, scale_factor=2)
            x = self.decoder[level](torch.cat([x, skipped[level]], dim=1))
        return self.head(x)


def networks(base, side):
    """The two networks with the same weights, each with a picture and an optimiser."""
    from nlosoptics.inverse import UNet

    ours = UNet(base, 4)
    plain = PlainUNet(base, 4)
    plain.load_state_dict(ours.state_dict())
    # load_state_dict keeps the layout of the tensor that it fills
    picture = torch.rand(1, 1, side, side, generator=torch.Generator().manual_seed(0))
    return {
        "ours": (ours, picture, torch.optim.Adam(ours.parameters(), 0.01, fused=True)),
        "plain": (plain, picture, torch.optim.Adam(plain.parameters(), 0.01)),
    }


def step(network, picture, optimiser):
    """Seconds of one step."""
    started = time.perf_counter()
    optimiser.zero_grad()
    (network(picture) - 1.0).square().mean().backward()
    optimiser.step()
    return time.perf_counter() - started


def largest_memory():
    """Of this process alone, MiB; what `getrusage` tells is also its parent's."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return float(line.split()[1]) / 1024
    raise OSError("this system does not tell a process's largest memory")


def peak(kind, base, side):
    """Largest memory of a process that makes three steps, MiB."""
    torch.set_num_threads(1)
    made = networks(base, side).pop(kind)
    for _ in range(3):
        step(*made)
    return largest_memory()


def main():
    """Print a row for each size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sides", type=int, nargs="+", default=[64, 128, 256, 512])
    parser.add_argument("--bases", type=int, nargs="+", default=[8, 16, 32])
    parser.add_argument("--repeats", type=int, default=12)
    parser.add_argument("--json", action="store_true", help="one JSON line a row")
    options = parser.parse_args()
    torch.set_num_threads(1)
    fresh = multiprocessing.get_context("spawn")
    for base in options.bases:
        for side in options.sides:
            made = networks(base, side)
            row = {"base": base, "side": side}
            row["weights"] = sum(p.numel() for p in made["ours"][0].parameters())
            spent = {kind: [] for kind in made}
            for _ in range(options.repeats):
                for kind, parts in made.items():
                    spent[kind].append(step(*parts))
            for kind, seconds in spent.items():
                row[f"{kind}_ms"] = round(1e3 * min(seconds), 1)
                with fresh.Pool(1) as pool:
                    row[f"{kind}_peak_mib"] = round(pool.apply(peak, (kind, base, side)))
            if options.json:
                print(json.dumps(row), flush=True)
            else:
                print("  ".join(f"{name} {value}" for name, value in row.items()), flush=True)


if __name__ == "__main__":
    main()
