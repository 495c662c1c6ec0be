"""The trained network of the study: a U-net from camera images to objects, and its training pairs.

The network knows no optics. It recovers only objects like those of its training, seen by way of
similar walls.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray

from nlosoptics import imaging, inverse, psf
from nlosoptics.scene import Scene

Array = NDArray[np.float32]
MODES = tuple(range(4, 22))  # Noll, n = 2..5
TOL = 1e-2  # of a point spread's peak: the noise is of that size


class Network:
    """U-net with ``base`` channels; images in any unit to objects from 0 to 1, both (B, H, W)."""

    def __init__(self, base: int = 8, *, seed: int) -> None:
        self.unet = inverse.UNet(base, seed=seed)

    def __call__(self, images: torch.Tensor) -> torch.Tensor:
        """Objects (B, H, W) of images (B, H, W)."""
        mean = images.mean(dim=(1, 2), keepdim=True)
        spread = images.std(dim=(1, 2), keepdim=True).clamp_min(1e-12)
        return torch.sigmoid(self.unet(((images - mean) / spread)[:, None])[:, 0])

    def train(self, images: Array, objects: Array, *, epochs: int = 20, seed: int) -> float:
        """Fit the objects (N, H, W) of images (N, H, W); return the seconds it took."""
        started = time.perf_counter()
        draws = np.random.default_rng(seed)
        shown, wanted = torch.from_numpy(images), torch.from_numpy(objects)
        adam = torch.optim.Adam(self.unet.parameters(), 3e-3)
        batches = -(-len(images) // 16)
        falling = torch.optim.lr_scheduler.CosineAnnealingLR(adam, epochs * batches)
        for _ in range(epochs):
            for chosen in np.array_split(draws.permutation(len(images)), batches):
                adam.zero_grad()
                (self(shown[chosen]) - wanted[chosen]).square().mean().backward()
                adam.step()
                falling.step()
        return time.perf_counter() - started

    def reconstruct(
        self, image: NDArray[np.float64], noise: float, model: imaging.ForwardModel
    ) -> inverse.Reconstruction:
        """Object of one image; the image model only says how well it explains the image."""
        started = time.perf_counter()
        with torch.no_grad():
            found = self(torch.from_numpy(image)[None].float())[0].double().numpy()
        seen = np.stack([model.forward(found).ravel(), np.ones(image.size)], axis=1)
        (gain, background), *_ = np.linalg.lstsq(seen, image.ravel(), rcond=None)
        residual = image.ravel() - seen @ (gain, background)
        score = float(np.sqrt(np.mean(residual**2))) / noise
        return inverse.Reconstruction(
            object=found,
            physical_parameters={"gain": float(gain), "background": float(background)},
            status="converged" if score <= 1.1 else "unconverged",
            score=score,
            history={},
            seconds=time.perf_counter() - started,
        )


def training_pairs(scene: Scene, count: int, *, waves: float, seed: int) -> tuple[Array, Array]:
    """Images and objects (N, H, W) of random pictures by way of random walls, with all noise.

    The scene has a flat, smooth wall; each wall's wave has up to ``waves`` wavelengths rms.
    """
    pupil = psf.exit_pupil(scene)
    pixels, pitch = max(scene.camera.shape), scene.camera.image_pitch
    draws = np.random.default_rng(seed)
    pairs: list[tuple[Array, Array]] = []
    while len(pairs) < count:
        drawn = picture(draws)
        strengths = draws.normal(size=len(MODES))
        strengths *= waves * draws.uniform() * scene.laser.wavelength / np.linalg.norm(strengths)
        wave = psf.Wavefront.from_zernike(
            dict(zip(MODES, strengths.tolist(), strict=True)),
            wavelength=scene.laser.wavelength,
            pupil_radius=pupil.radius,
            image_distance=pupil.image_distance,
        )
        shape = max(2 * pixels + 1, psf.window_shape(wave, pitch=pitch, tol=TOL))
        spread = psf.point_spread(
            wave, pitch=pitch, shape=shape, tol=TOL, pixel_integrated=True, model="scalar"
        )
        taken = imaging.form_image(scene, spread, drawn, seed=int(draws.integers(2**63)))
        if taken.ideal.max() > 0.0:
            bright = taken.ideal / taken.ideal.max()
            pairs.append((taken.electrons.astype(np.float32), bright.astype(np.float32)))
    images, objects = (np.stack(part) for part in zip(*pairs, strict=True))
    return images, objects


def picture(draws: np.random.Generator, side: int = 128) -> NDArray[np.float64]:
    """One to five random bars, discs and rings on black."""
    axis = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    x, y = np.meshgrid(axis, axis)
    found = np.zeros_like(x)
    for inside in _shapes(x, y, draws):
        # mostly white, as letters are
        found[inside] = 1.0 if draws.uniform() < 0.7 else draws.uniform(0.3, 1.0)
    return found


def _shapes(
    x: NDArray[np.float64], y: NDArray[np.float64], draws: np.random.Generator
) -> Iterator[NDArray[np.bool_]]:
    for _ in range(int(draws.integers(1, 6))):
        centre, angle = draws.uniform(-0.45, 0.45, size=2), draws.uniform(0.0, np.pi)
        along = (x - centre[0]) * np.cos(angle) + (y - centre[1]) * np.sin(angle)
        across = (y - centre[1]) * np.cos(angle) - (x - centre[0]) * np.sin(angle)
        half, width = draws.uniform(0.15, 0.45), draws.uniform(0.04, 0.15)
        radius = np.hypot(along, across)
        yield (
            (np.abs(along) < half) & (np.abs(across) < width),
            radius < 2.0 * width,
            np.abs(radius - 0.7 * half) < 0.6 * width,
        )[int(draws.integers(3))]
