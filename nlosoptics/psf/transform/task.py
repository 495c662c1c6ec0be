"""Input and output of a transform from a wave to its point spread."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import NamedTuple

import numpy as np

from ..._vectors import Array
from ..wave.detilted import Residual
from ..wave.regime import Regime, regime
from ..window import antialiased_disc, error_bounds
from ..window.pixels import PixelRule
from ..window.window import Window
from . import antialiased_fft, antialiased_pupil, high_aperture, nufft, quadrature

#: Pixel side, Airy units, up to which errors are assumed not to average out over a pixel.
NO_BEATS = 0.8


class Soft(NamedTuple):
    """Polynomial wave, what the errors of its softened rims depend on, and its grid."""

    wave: antialiased_pupil.SoftWave
    rim: antialiased_pupil.Rim
    grid: antialiased_fft.Grid


@dataclass(frozen=True, eq=False)
class Task:
    """Input of every transform.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    tol : float
        Largest permitted error, relative to the peak.
    pitch : float
        Image sampling or pixel side, m.
    shape : (int, int)
        (ny, nx).
    rule : PixelRule or None
        Average over pixels; None for point samples.
    whole : bool
        Whether the window holds the rays.
    polarisation : "unpolarised" or float, optional
        Polarisation of the high-aperture model; None for the scalar model.
    """

    residual: Residual
    tol: float
    pitch: float
    shape: tuple[int, int]
    rule: PixelRule | None
    whole: bool = True
    polarisation: high_aperture.Polarisation | None = None

    @property
    def pixels(self) -> Window:
        """Sample points or pixel centres of the result."""
        return Window.centred(self.pitch, self.shape)

    @property
    def samples(self) -> Window:
        """Points at which the intensity is computed; finer than `pixels` for pixel averages."""
        return self.pixels if self.rule is None else self.rule.window(self.pitch, self.shape)

    @property
    def level(self) -> float:
        """Fraction of the transmitted energy in a pixel whose mean is the ideal peak."""
        return self.residual.pixel_share(self.pitch)

    @property
    def pixel(self) -> float:
        """Pixel side used in error bounds, Airy units; 0 for point samples.

        With an aperture at most `NO_BEATS`, since its lobes may be wider than an Airy unit.
        """
        pixel = 0.0 if self.rule is None else self.pitch / self.residual.airy_unit
        return pixel if self.residual.wavefront.aperture is None else min(pixel, NO_BEATS)

    @cached_property
    def coarse(self) -> quadrature.Coarse:
        """Nodes of a polar or cells wave that suffice for ``tol``, in a window with a dark edge."""
        return quadrature.coarse(self.residual, self.samples, self.tol, self.growth)

    @cached_property
    def soft(self) -> Soft | None:
        """Polynomial of a polar wave on a grid; None if there is none or its rim exceeds tol."""
        wave = antialiased_pupil.soft_wave(self.residual, self.tol)
        if wave is None:
            return None
        rim = antialiased_pupil.rim_of(self.residual, wave)
        grid = self.soft_grid(rim, self.tol)
        return Soft(wave, rim, grid) if 2 * grid.error <= self.tol else None

    def soft_grid(self, rim: antialiased_pupil.Rim, tol: float) -> antialiased_fft.Grid:
        """Return the grid with softened rims for an error of half of ``tol``."""
        most = math.inf if self.rule is None else 1 / self.level  # all energy in one pixel
        period = antialiased_pupil.period_of(
            self.residual, rim, self.samples, tol, self.pixel, most
        )
        reach = antialiased_disc.SHORT_REACH if self.tol >= 1e-4 else antialiased_disc.REACH
        return antialiased_fft.padded(self.residual, self.samples, period, reach)

    @cached_property
    def growth(self) -> Array:
        """Error of the nodes of a polar or cells wave without image point and count."""
        return quadrature.growth(self.residual)

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Shape of the nodes of a polar or cells wave that the window needs."""
        counts = quadrature.node_counts(self.residual, self.samples, self.growth)
        if self.polarisation is None:
            return counts
        more = high_aperture.more_nodes(self.residual)
        return tuple(n + extra for n, extra in zip(counts, more, strict=True))

    @cached_property
    def regime(self) -> Regime:
        """Sampling regime of the wave."""
        return regime(self.residual, self.pitch)

    @property
    def components(self) -> int:
        """Number of transforms of the model."""
        if self.polarisation is None:
            return 1
        return 5 if isinstance(self.polarisation, str) else 3

    def weights(self, u: Array, v: Array) -> list[Array | float]:
        """Return the weights of the field's components at pupil coordinates, m."""
        distance = self.residual.wavefront.image_distance
        return high_aperture.field_weights(u, v, distance, self.polarisation)

    def levels(self, nodes: nufft.Nodes) -> tuple[float, float]:
        """Return `high_aperture.levels` of nodes."""
        distance = self.residual.wavefront.image_distance
        return high_aperture.levels(nodes, distance, self.polarisation)

    def gain(self, peak: float) -> float:
        """Return the largest weight of a node relative to the square root of the ideal peak."""
        if self.polarisation is None:
            return 1.0
        sine = high_aperture.check_cone(self.residual)
        return 1 / math.sqrt(peak * math.sqrt(1 - sine**2))

    def sum(self, nodes: nufft.Nodes, epsilon: float) -> tuple[Array, float, float]:
        """Return the mean intensity of a sum over nodes, 1 at the ideal peak, and `levels`."""
        peak, secant = self.levels(nodes)
        fields = (
            nufft.field(self.residual, nodes, self.samples, epsilon, weight)
            for weight in self.weights(nodes.u, nodes.v)
        )
        mean = self.averaged(reduce(np.add, map(nufft.squares, fields)))
        mean /= peak
        return mean, peak, secant

    def bound(
        self,
        intensity: Array,
        field_error: Array | float,
        energy_error: float,
        spill: Array | float = 0.0,
    ) -> float:
        """Return an upper bound of the error relative to the peak, on these pixels."""
        return error_bounds.intensity_error(
            intensity,
            field_error,
            energy_error,
            spill=spill,
            pixel=self.pixel,
            level=self.level,
        )

    def transform_error(self, mean: Array, epsilon: float) -> float:
        """Bound the error of the NUFFT by `error_bounds.transform_error` on these pixels."""
        if self.whole:
            return error_bounds.transform_error(mean, epsilon, pixel=self.pixel)
        # light outside the window, a field of at most 1, leaks into it
        return 2 * epsilon / math.sqrt(float(mean.max())) + epsilon**2 / float(mean.max())

    def averaged(self, fine: Array) -> Array:
        """Return an intensity at `samples`, averaged over pixels if required."""
        if self.rule is None:
            return fine
        return self.rule.mean_down(self.rule.mean(fine))


@dataclass(frozen=True, eq=False)
class Result:
    """Output of a transform.

    Parameters
    ----------
    method : str
        Name of the method.
    mean : ndarray, (ny, nx)
        Intensity at points, or averaged over pixels; 1 at the ideal peak.
    error : float
        Upper bound of the error, relative to the largest intensity.
    level : float
        Factor from ``mean`` to the fraction of the transmitted energy per pixel.
    reason : str
        One line: why this method and this model were used.
    model : {"scalar", "high-aperture"}
        Model of diffraction.
    model_error : float
        Upper bound of the scalar model's error relative to the peak; 0 for the high-aperture model.
    """

    method: str
    mean: Array
    error: float
    level: float
    reason: str = ""
    model: str = "high-aperture"
    model_error: float = 0.0


#: Mean intensity, error relative to its peak, and factor from `Task.level` to `Result.level`.
Image = tuple[Array, float, float]
