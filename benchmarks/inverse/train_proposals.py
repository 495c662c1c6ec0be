"""Train the network that proposes walls for one image, and write its weights.

    python benchmarks/inverse/train_proposals.py --device cuda --compile --processes 14 \\
        --seconds 575 --weights new.safetensors

Processes draw new pictures all along; the device turns, scales and mixes them, blurs them by random
walls and adds noise. The training ends by the clock, so two runs differ. In the package are the
weights of the command above on one H200 GPU with 16 processor cores: 17,396 steps, which saw 17.8
million images of 1.4 million pictures. Written is a running mean. Every half minute a line states,
for walls of 0.25, 0.5 and 1 wave and pictures that training does not draw, three median errors,
waves rms, and the loss: of the most likely mean, of the nearest mean, and of the nearest of 24
draws with half the spread. The file belongs in the place of
nlosoptics/inverse/blind/wall_proposals.safetensors.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import time
from collections import deque
from pathlib import Path

import numpy as np
import torch
from pictures import SIDE, pictures
from torch import nn

from nlosoptics.inverse.blind.wall_network import MODES, WallNetwork, twin_signs
from nlosoptics.inverse.blind.wall_proposals import FORMAT
from nlosoptics.psf.aperture.quadrature_nodes import circle_shares
from nlosoptics.psf.wave.zernikes import zernike, zernike_order

RATE = 2.5e-3
DECAY = 0.02  # of the weights
MEAN = 0.999  # of the running mean of the weights, for each step
WARM = 300  # steps of a rising rate
EASY = 400  # steps in which pictures grow and noise becomes as strong as later
STRENGTHS = (0.12, 1.3)  # waves rms
NOISES = (0.003, 0.05)  # over the image's maximum
HIGHER = tuple(range(22, 46))  # Noll, present in the images and not proposed
TESTED = (0.25, 0.5, 1.0)
EVERY = 30.0  # seconds between reports
BLOCK = 256  # pictures that a process draws at a time
FINE = 2 * SIDE  # pixels of a drawn picture along each side


def log_likelihood(found, walls):
    """Logarithm of a mixture's density (B,) at coefficients (B, M) or at their twin.

    A wave W(x) and its twin -W(-x) have the same point spread: an image cannot tell which made it.
    """
    twin = walls * twin_signs().to(walls.device)
    pair = torch.stack([walls, twin], dim=1)[:, :, None]
    offset = (pair - found.means[:, None]) / found.deviations[:, None]
    each = -0.5 * offset.square() - found.deviations.log()[:, None]
    density = each.sum(dim=3) + found.weights[:, None]
    return density.flatten(1).logsumexp(dim=1) - math.log(2.0)


def save(network, path):
    """Write a network in half precision."""
    from safetensors.torch import save_file

    halves = {name: one.detach().half() for name, one in network.state_dict().items()}
    save_file(halves, path, {"format": FORMAT})


class Pictures:
    """Pictures on the device; the oldest are replaced by what processes have drawn."""

    def __init__(self, count: int, seed: int, processes: int, device: torch.device) -> None:
        self.seed, self.drawn = seed, 0
        self.stack = torch.empty(count, FINE, FINE, dtype=torch.uint8, device=device)
        self.pool = multiprocessing.get_context("spawn").Pool(processes)
        self.asked = deque(self.asking(block) for block in range(2 * processes))

    def asking(self, block: int):
        """Order one more block."""
        return self.pool.apply_async(drawn_block, [[self.seed, block]])

    def held(self) -> torch.Tensor:
        """All that are there; waits for the first block."""
        while self.asked[0].ready() or not self.drawn:
            place = self.drawn * BLOCK % len(self.stack)
            found = torch.from_numpy(self.asked.popleft().get())
            self.stack[place : place + BLOCK] = found.to(self.stack.device)
            self.drawn += 1
            self.asked.append(self.asking(self.drawn + len(self.asked)))
        return self.stack[: self.drawn * BLOCK]


def drawn_block(seed: list[int]) -> np.ndarray:
    """A block of pictures, 0 to 255."""
    number = int(np.random.SeedSequence(seed).generate_state(1)[0])
    return (255.0 * pictures(BLOCK, number, FINE) + 0.5).astype(np.uint8)


class Simulator:
    """Images of pictures by random walls at Nyquist's pitch, by one transform of 128 x 128."""

    def __init__(self, seed: int, device: torch.device) -> None:
        axis = np.arange(-SIDE // 2 - 1, SIDE // 2 + 2) / (SIDE // 2)
        u, v = np.meshgrid(axis, axis)
        share = circle_shares(axis, axis, axis[1] - axis[0], 1.0)
        rho, theta = np.hypot(u, v), np.arctan2(v, u)
        basis = [np.where(share > 0, zernike(j, rho, theta), 0.0) for j in MODES + HIGHER]
        self.share = torch.from_numpy(share.astype(np.float32)).to(device)
        self.basis = torch.from_numpy(np.stack(basis).astype(np.float32)).to(device)
        self.orders = torch.tensor([zernike_order(mode)[0] / 2.0 for mode in MODES], device=device)
        self.random = torch.Generator(device).manual_seed(seed)

    def evenly(self, low: float, high: float, *shape: int) -> torch.Tensor:
        """Random numbers between two limits."""
        where = self.share.device
        return low + (high - low) * torch.rand(*shape, generator=self.random, device=where)

    def normal(self, *shape: int) -> torch.Tensor:
        """Random numbers of a normal distribution."""
        return torch.randn(*shape, generator=self.random, device=self.share.device)

    def drawn(self, stack: torch.Tensor, strengths: torch.Tensor, ease: float = 0.0):
        """Images (B, SIDE, SIDE), their noise (B,) and the coefficients (B, M), waves rms.

        With ``ease`` up to 1 the pictures are smaller and the noise is weaker.
        """
        count, lengths = len(strengths), strengths[:, None]
        # every other wall has weaker high orders
        fall = self.evenly(0.0, 2.5, count, 1) * (self.evenly(0.0, 1.0, count, 1) < 0.5)
        walls = self.normal(count, len(MODES)) * self.orders**-fall
        walls *= lengths / walls.norm(dim=1, keepdim=True)
        more = self.normal(count, len(HIGHER))
        more *= lengths * self.evenly(0.0, 0.08, count, 1) / more.norm(dim=1, keepdim=True)
        seen = self.blurred(self.pictures(stack, count, ease), torch.cat([walls, more], dim=1))
        seen /= seen.amax(dim=(1, 2), keepdim=True).clamp(min=1e-6)
        least, most = np.log(NOISES)
        noise = self.evenly(least, most - ease * (most - least), count).exp()
        seen += noise[:, None, None] * self.normal(*seen.shape)
        return self.framed(seen), noise, walls

    def pictures(self, stack: torch.Tensor, count: int, ease: float) -> torch.Tensor:
        """Pictures from the stack: turned, mirrored, shifted, scaled; some are sums of two."""
        where = stack.device
        rows = torch.randint(len(stack), (count,), generator=self.random, device=where)
        upright = 0.5 * math.pi * self.evenly(0.0, 4.0, count).floor() + 0.15 * self.normal(count)
        free = self.evenly(0.0, 2.0 * math.pi, count)
        angles = torch.where(self.evenly(0.0, 1.0, count) < 0.5, upright, free)
        sizes = self.evenly(math.log(0.65 - 0.5 * ease), math.log(1.1 - 0.8 * ease), count).exp()
        mirror = self.evenly(-1.0, 1.0, count).sign()
        across = torch.stack([angles.cos() * mirror, -angles.sin() * mirror], dim=1)
        up = torch.stack([angles.sin(), angles.cos()], dim=1)
        shifts = self.evenly(-0.2, 0.2, count, 2, 1)
        affine = torch.cat([torch.stack([across, up], dim=1), shifts], dim=2) / sizes[:, None, None]
        grid = nn.functional.affine_grid(affine, [count, 1, FINE, FINE], align_corners=False)
        fine = stack[rows, None].float() / 255.0
        fine = nn.functional.grid_sample(fine, grid, align_corners=False)
        found = nn.functional.avg_pool2d(fine, FINE // SIDE)[:, 0]
        found = found.clamp(min=0.0).pow(self.evenly(0.7, 1.4, count, 1, 1))
        second = self.evenly(0.0, 1.0, count, 1, 1) * (self.evenly(0.0, 1.0, count, 1, 1) < 0.15)
        found = torch.maximum(found, second * found.roll(1, 0))
        dark = self.evenly(0.0, 0.03, count, 1, 1) * (self.evenly(0.0, 1.0, count, 1, 1) < 0.5)
        return torch.maximum(found, dark)

    def blurred(self, objects: torch.Tensor, walls: torch.Tensor) -> torch.Tensor:
        """Pictures seen by walls (B, M + more), waves rms, linear convolution."""
        phase = 2.0 * math.pi * (walls @ self.basis.flatten(1)).view(-1, *self.share.shape)
        pupil = torch.polar(self.share.expand_as(phase), phase)
        field = torch.fft.fft2(pupil, s=(2 * SIDE, 2 * SIDE))
        spread = field.real.square() + field.imag.square()
        spectrum = torch.fft.rfft2(spread) * torch.fft.rfft2(objects, s=(2 * SIDE, 2 * SIDE))
        seen = torch.fft.irfft2(spectrum, s=(2 * SIDE, 2 * SIDE))
        return seen[:, :SIDE, :SIDE]

    def framed(self, seen: torch.Tensor) -> torch.Tensor:
        """Images minus the level of their edges; every fifth is of a smaller frame."""
        count = len(seen)
        some = self.evenly(40.0, SIDE + 1.0, count, 2, 1).floor()
        sides = torch.where(self.evenly(0.0, 1.0, count, 1, 1) < 0.2, some, float(SIDE))
        first = ((SIDE - sides) / 2.0).floor()
        at = torch.arange(SIDE, device=seen.device)
        within = (at >= first) & (at < first + sides)
        ends = (at == first) | (at == first + sides - 1.0)
        inner = within[:, 0, :, None] & within[:, 1, None]
        edges = inner & (ends[:, 0, :, None] | ends[:, 1, None])
        levels = torch.where(edges, seen, math.nan).flatten(1).nanmedian(dim=1).values
        return torch.where(inner, seen - levels[:, None, None], 0.0)


def told(network: WallNetwork, images, noise, walls) -> str:
    """Loss and median errors of the mixtures of test images."""
    found, random = network(images, noise), torch.Generator(images.device).manual_seed(0)

    def errors(proposed):
        twin = proposed * twin_signs().to(walls)
        near = [(one - walls[:, None]).norm(dim=2) for one in (proposed, twin)]
        return torch.minimum(*near)

    best = found.weights.argmax(dim=1)
    means = errors(found.means)
    parts = torch.multinomial(found.weights.exp(), 24, replacement=True, generator=random)
    rows = torch.arange(len(walls), device=walls.device)[:, None]
    spread = torch.randn(*parts.shape, len(MODES), generator=random, device=walls.device)
    draws = errors(found.means[rows, parts] + 0.5 * spread * found.deviations[rows, parts])
    loss = -log_likelihood(found, walls).mean()
    three = [means[rows[:, 0], best], means.amin(dim=1), draws.amin(dim=1)]
    return " ".join(f"{one.median().item():.3f}" for one in three) + f" ({loss.item():.1f})"


def rate(step: int, share: float) -> float:
    """Factor of the rate: a rise, and a cosine down to 1 % at the end of the time."""
    return min(1.0, (step + 1) / WARM) * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))


def main() -> None:
    """Train for the given time and write the weights."""
    begun = time.perf_counter()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu", help="torch device")
    parser.add_argument("--seconds", type=float, default=480.0, help="of all, wall time")
    parser.add_argument("--batch", type=int, default=1024)
    parser.add_argument("--pictures", type=int, default=65536, help="pictures held at a time")
    parser.add_argument("--processes", type=int, default=1, help="that draw pictures")
    parser.add_argument("--compile", action="store_true", help="compile the network")
    parser.add_argument("--weights", type=Path, help="file of weights to write")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    device = torch.device(options.device)
    torch.manual_seed(options.seed)
    held = Pictures(options.pictures, options.seed, options.processes, device)
    network, mean = WallNetwork().to(device), WallNetwork().to(device)
    network.to(memory_format=torch.channels_last)
    mean.load_state_dict(network.state_dict())
    if options.compile:
        network.layers.compile()
    adam = torch.optim.AdamW(
        network.parameters(), RATE, weight_decay=DECAY, fused=device.type == "cuda"
    )
    others = torch.from_numpy(255.0 * pictures(300, options.seed + 1, FINE)).byte().to(device)
    tests = [
        Simulator(n, device).drawn(others, torch.full((600,), strength, device=device))
        for n, strength in enumerate(TESTED)
    ]
    simulator = Simulator(options.seed + 7, device)
    total, first, step, share, reports = torch.zeros((), device=device), 0.0, 0, 0.0, 0
    while share < 1.0:
        ease = max(0.0, 1.0 - step / EASY)
        strengths = simulator.evenly(*np.log(STRENGTHS), options.batch).exp()
        images, noise, walls = simulator.drawn(held.held(), strengths, ease)
        for group in adam.param_groups:
            group["lr"] = RATE * rate(step, share)
        with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
            found = network(images, noise)
        loss = -log_likelihood(found, walls).mean()
        adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 10.0)
        adam.step()
        with torch.no_grad():
            torch._foreach_lerp_(
                list(mean.parameters()),
                list(network.parameters()),
                1.0 - min(MEAN, step / (step + 10.0)),
            )
            total += loss
        step += 1
        if step % 10 == 1:
            total.item()  # the clock waits for the device
        now = time.perf_counter() - begun
        first = first or now  # what compilation takes does not count
        share = min(1.0, (now - first) / (options.seconds - first))
        if now > EVERY * (reports + 1) or share == 1.0:
            with torch.no_grad():
                lines = ", ".join(told(mean, *test) for test in tests)
            print(
                f"step {step}, {now:.0f} s, {held.drawn * BLOCK} pictures: "
                f"loss {total.item() / step:.2f}, {lines}",
                flush=True,
            )
            reports = now // EVERY
            if options.weights is not None:
                save(mean, options.weights)
    held.pool.terminate()


if __name__ == "__main__":
    main()
