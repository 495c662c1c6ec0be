"""Train the network that proposes walls for one image, and write its weights.

    python benchmarks/inverse/train_proposals.py --state training.pt --weights new.safetensors

Each step draws pictures, walls, noise and frames from its own stream of random numbers, so a run
that was cut off goes on from its state with the same bits. The weights that are written are a
running mean. Every 250 steps a line states the median error of the most likely mean, waves rms, for
walls of 0.25, 0.5 and 1 wave and pictures that training does not draw; in brackets the loss. The
file belongs in the place of nlosoptics/inverse/blind/wall_proposals.safetensors.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np
import torch
from pictures import SIDE, pictures

from nlosoptics.inverse.blind.wall_network import MODES, WallNetwork, twin_signs
from nlosoptics.inverse.blind.wall_proposals import saved_network
from nlosoptics.psf.aperture.quadrature_nodes import circle_shares
from nlosoptics.psf.wave.zernikes import zernike, zernike_order

BATCH = 32
RATE = 1e-3
DECAY = 0.01  # of the weights
MEAN = 0.998  # of the running mean of the weights, for each step
WARM = 200  # steps of a rising rate
FALL = 0.3  # share of the steps at the end with a falling rate
STRENGTHS = (0.1, 1.2)  # waves rms
EVEN = 2500  # steps of evenly drawn strengths; later ones draw their logarithm evenly
NOISES = (0.003, 0.05)  # over the image's maximum
HIGHER = tuple(range(22, 46))  # Noll, present in the images and not proposed
TESTED = (0.25, 0.5, 1.0)


class Simulator:
    """Images of pictures by random walls at Nyquist's pitch, by one transform of 128 x 128."""

    def __init__(self, stack: np.ndarray) -> None:
        self.stack = torch.from_numpy(stack)
        axis = np.arange(-SIDE // 2 - 1, SIDE // 2 + 2) / (SIDE // 2)
        u, v = np.meshgrid(axis, axis)
        share = circle_shares(axis, axis, axis[1] - axis[0], 1.0)
        rho, theta = np.hypot(u, v), np.arctan2(v, u)
        basis = [np.where(share > 0, zernike(j, rho, theta), 0.0) for j in MODES + HIGHER]
        self.share = torch.from_numpy(share.astype(np.float32))
        self.basis = torch.from_numpy(np.stack(basis).astype(np.float32))
        self.orders = np.array([zernike_order(mode)[0] for mode in MODES])

    def drawn(self, draw: np.random.Generator, count: int, strengths: np.ndarray):
        """Images (B, SIDE, SIDE), their noise (B,) and the coefficients (B, M), waves rms."""
        walls = draw.normal(size=(count, len(MODES)))
        # every other wall has weaker high orders
        fall = np.where(draw.random(count) < 0.5, 0.0, draw.uniform(0.0, 2.5, size=count))
        walls *= (self.orders / 2.0) ** -fall[:, None]
        lengths = strengths[:, None]
        walls *= lengths / np.linalg.norm(walls, axis=1, keepdims=True)
        more = draw.normal(size=(count, len(HIGHER)))
        more /= np.linalg.norm(more, axis=1, keepdims=True)
        more *= lengths * draw.uniform(0.0, 0.08, size=(count, 1))
        every = torch.from_numpy(np.concatenate([walls, more], axis=1).astype(np.float32))
        seen = self.blurred(self.pictures(draw, count), every)
        seen /= seen.amax(dim=(1, 2), keepdim=True)
        noise = np.exp(draw.uniform(*np.log(NOISES), size=count)).astype(np.float32)
        sigma = torch.from_numpy(noise)
        seen += sigma[:, None, None] * torch.from_numpy(
            draw.standard_normal(size=tuple(seen.shape), dtype=np.float32)
        )
        return self.framed(draw, seen), sigma, every[:, : len(MODES)]

    def pictures(self, draw: np.random.Generator, count: int):
        """Pictures from the stack: turned, mirrored, shifted, a few of them added."""
        found = torch.empty(count, SIDE, SIDE)
        for row in range(count):
            picture = self.stack[draw.integers(len(self.stack))]
            picture = torch.rot90(picture, int(draw.integers(4)))
            if draw.random() < 0.5:
                picture = picture.flip(1)
            shift = [int(n) for n in draw.integers(-5, 6, size=2)]
            found[row] = picture.roll(shift, (0, 1)) ** float(draw.uniform(0.7, 1.4))
        surround = np.where(draw.random(count) < 0.5, 0.0, draw.uniform(0.0, 0.03, size=count))
        return found.clamp_(min=torch.from_numpy(surround.astype(np.float32))[:, None, None])

    def blurred(self, objects, walls):
        """Pictures seen by walls (B, M + more), waves rms, linear convolution."""
        phase = 2.0 * math.pi * (walls @ self.basis.flatten(1)).view(-1, *self.share.shape)
        pupil = torch.polar(self.share.expand_as(phase), phase)
        field = torch.fft.fft2(pupil, s=(2 * SIDE, 2 * SIDE))
        spread = field.real.square() + field.imag.square()
        spectrum = torch.fft.rfft2(spread) * torch.fft.rfft2(objects, s=(2 * SIDE, 2 * SIDE))
        seen = torch.fft.irfft2(spectrum, s=(2 * SIDE, 2 * SIDE))
        return seen[:, :SIDE, :SIDE]

    def framed(self, draw: np.random.Generator, seen):
        """Images minus the level of their edges; every fifth is of a smaller frame."""
        found = torch.zeros_like(seen)
        for row, image in enumerate(seen):
            sides = [SIDE, SIDE] if draw.random() < 0.8 else draw.integers(40, SIDE + 1, size=2)
            inner = tuple(slice((SIDE - n) // 2, (SIDE - n) // 2 + int(n)) for n in sides)
            part = image[inner]
            edges = torch.cat([part[0], part[-1], part[:, 0], part[:, -1]])
            found[row][inner] = part - edges.median()
        return found


def error(found, walls):
    """Median distance of the most likely mean from the wall or its twin, waves rms."""
    rows = torch.arange(len(walls))
    mean = found.means[rows, found.weights.argmax(dim=1)]
    twin = walls * twin_signs()
    return torch.minimum((mean - walls).norm(dim=1), (mean - twin).norm(dim=1)).median().item()


def rate(step: int, steps: int) -> float:
    """Factor of the rate: a rise, a plateau, and a cosine down to 1 %."""
    late = max(0.0, (step - (1.0 - FALL) * steps) / (FALL * steps))
    return min(1.0, (step + 1) / WARM) * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * late)))


def main() -> None:
    """Train to the given step and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=12000)
    parser.add_argument("--objects", type=int, default=6000, help="different pictures")
    parser.add_argument("--state", type=Path, default=Path("training.pt"), help="taken up again")
    parser.add_argument("--pictures", type=Path, help="file that keeps the drawn pictures")
    parser.add_argument("--weights", type=Path, help="file of weights to write at the end")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(options.seed)
    network = WallNetwork()
    mean = WallNetwork()
    mean.load_state_dict(network.state_dict())
    adam = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    first = 0
    if options.state.exists():
        saved = torch.load(options.state, weights_only=True)
        network.load_state_dict(saved["network"])
        mean.load_state_dict(saved["mean"])
        adam.load_state_dict(saved["adam"])
        first = saved["step"]
    held = Simulator(pictures(300, seed=options.seed + 1))
    tests = [
        held.drawn(np.random.default_rng([options.seed, n]), 200, np.full(200, strength))
        for n, strength in enumerate(TESTED)
    ]
    if options.pictures is None or not options.pictures.exists():
        stack = pictures(options.objects, seed=options.seed)
        if options.pictures is not None:
            np.save(options.pictures, stack)
    else:
        stack = np.load(options.pictures)
    simulator = Simulator(stack)
    total, started = 0.0, time.process_time()
    for step in range(first, options.steps):
        draw = np.random.default_rng([options.seed, 7, step])
        strengths = draw.uniform(*STRENGTHS, size=BATCH)
        if step >= EVEN:
            strengths = np.exp(draw.uniform(*np.log(STRENGTHS), size=BATCH))
        images, noise, walls = simulator.drawn(draw, BATCH, strengths)
        for group in adam.param_groups:
            group["lr"] = RATE * rate(step, options.steps)
        loss = -network(images, noise).log_likelihood(walls).mean()
        adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
        adam.step()
        share = min(MEAN, step / (step + 10.0))
        with torch.no_grad():
            for one, other in zip(mean.parameters(), network.parameters(), strict=True):
                one.lerp_(other, 1.0 - share)
        total += loss.item()
        if (step + 1) % 250 == 0 or step + 1 == options.steps:
            with torch.no_grad():
                errors = [error(mean(i, n), w) for i, n, w in tests]
                losses = [-mean(i, n).log_likelihood(w).mean().item() for i, n, w in tests]
            told = " ".join(
                f"{s:g}: {e:.3f} ({x:.1f})" for s, e, x in zip(TESTED, errors, losses, strict=True)
            )
            seconds = time.process_time() - started
            print(f"step {step + 1}: loss {total / 250:.2f}, {told}, {seconds:.0f} s", flush=True)
            total = 0.0
            parts = {"network": network.state_dict(), "mean": mean.state_dict()}
            new = options.state.with_suffix(".new")
            torch.save({**parts, "adam": adam.state_dict(), "step": step + 1}, new)
            new.replace(options.state)
    if options.weights is not None:
        options.weights.write_bytes(saved_network(mean))


if __name__ == "__main__":
    main()
