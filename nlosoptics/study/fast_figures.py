"""Figures of merit from smooth fields of the wave, evaluated for many draws at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from .._checks import positive, real
from ..errors import SceneError
from ..limits import object_scale
from ..psf.aperture.quadrature_nodes import polar_nodes
from ..psf.metrics.pupil_overlap import overlap_nodes
from ..psf.pupil.scene_optics import PointOptics
from ..psf.walls.lobe_psf import lobe_transfer
from ..psf.wave.polar_series import values_at

Array = NDArray[np.float64]
#: Largest frequency relative to the cutoff of the lens: nodes of the overlap move too fast beyond.
HIGHEST: Final = 0.9
#: Aliases above this part of the cutoff are left out; the transfer function is below 0.003 there.
NEGLIGIBLE: Final = 0.98
MOST_ALIASES: Final = 64


class FastFigure(Protocol):
    """Figure of merit that follows from fields which change smoothly with the scene.

    Attributes
    ----------
    uses_nodes : bool
        Whether the number of nodes that `fields` gets changes the result.
    """

    uses_nodes: bool

    def fields(self, seen: PointOptics, n: int) -> dict[str, Array]:
        """Return the fields of one scene, in units in which 1e-6 is negligible.

        Parameters
        ----------
        seen : PointOptics
            Wave of the scene, with polar nodes.
        n : int
            Number of nodes along the pupil's radius or across an overlap.

        Returns
        -------
        dict of str to ndarray
            Fields; "phase" is in waves.
        """

    def values(self, fields: Mapping[str, Array]) -> Array:
        """Return the figure (draws,) of fields that have the draws as their first dimension."""


class WaveFigure:
    """Strehl ratio, or rms aberration in waves, of the wave without piston and tilt.

    Parameters
    ----------
    of : callable
        Function of phases, waves, and weights, both (draws, nodes), weights of sum 1.
    """

    uses_nodes = True

    def __init__(self, of: Callable[[Array, Array], Array]) -> None:
        self._of = of

    def fields(self, seen: PointOptics, n: int) -> dict[str, Array]:
        """Return phase and weight at polar nodes, see `FastFigure`."""
        residual = seen.first.residual
        wave = residual.wavefront
        u, v, area = polar_nodes(wave.pupil_radius, n, 4 * n)
        path, amplitude = values_at(*residual.polar_series, u, v, 1e-13)
        weight = area if amplitude is None else area * amplitude
        return {"phase": path / wave.wavelength, "weight": weight * (weight.size / weight.sum())}

    def values(self, fields: Mapping[str, Array]) -> Array:
        """Return the figure of each draw, see `FastFigure`."""
        draws = len(fields["phase"])
        weight = fields["weight"].reshape(draws, -1)
        return self._of(
            fields["phase"].reshape(draws, -1), weight / weight.sum(axis=1, keepdims=True)
        )


def _strehl(phase: Array, weight: Array) -> Array:
    return np.asarray(np.abs(_sums(phase, weight, 1)) ** 2)


def _rms(phase: Array, weight: Array) -> Array:
    mean = np.einsum("dn,dn->d", phase, weight)
    square: Array = np.einsum("dn,dn->d", (phase - mean[:, None]) ** 2, weight)
    return np.sqrt(square)


def _sums(phase: Array, weight: Array, axes: int) -> NDArray[np.complex128]:
    """Return ``sum(weight exp(2 pi i phase))`` over the last axes."""
    turned: NDArray[np.complex128] = weight * np.exp(2j * np.pi * phase)
    return np.asarray(turned.sum(axis=tuple(range(-axes, 0))))


class SpotFigure:
    """Rms radius of the geometric spot, m."""

    uses_nodes = False

    def fields(self, seen: PointOptics, n: int) -> dict[str, Array]:
        """Return landing points in Airy units, energies and the Airy unit, see `FastFigure`."""
        residual = seen.first.residual
        wave = residual.wavefront
        du, dv, share = (part[:-1] for part in residual.series.slopes(*wave.u.shape))
        scale = wave.image_distance / residual.airy_unit
        energy = share * wave.amplitude**2
        energy = energy * (energy.size / energy.sum())
        unit = np.log([residual.airy_unit])
        return {"x": du * scale, "y": dv * scale, "energy": energy, "unit": unit}

    def values(self, fields: Mapping[str, Array]) -> Array:
        """Return the figure of each draw, see `FastFigure`."""
        draws = len(fields["unit"])
        x, y, energy = (fields[name].reshape(draws, -1) for name in ("x", "y", "energy"))
        share = energy / energy.sum(axis=1, keepdims=True)
        square = _rms(x, share) ** 2 + _rms(y, share) ** 2
        return np.asarray(np.exp(fields["unit"][:, 0]) * np.sqrt(square))


class MtfFigure:
    """Modulation at a frequency on the object, with lobes, pixels and their aliases.

    Parameters
    ----------
    near : sequence of PointOptics
        Wave of the scene in the middle of the distributions, then those at the steps about it.
        Aliases that the lens does not pass in all of them are left out.
    frequency : float
        Cycles per m on the object.
    azimuth : float
        Direction, rad from x toward y.

    Raises
    ------
    SceneError
        If the frequency is too close to the cutoff of the lens or above the limit of the pixels, or
        if the pixels are so wide that too many frequencies alias.

    Notes
    -----
    Values integrated over pixels of side p have the spectrum
    ``sum_kl H(F) sinc(F_x p) sinc(F_y p)`` with ``F = f - (k, l)/p``.
    """

    uses_nodes = True

    def __init__(self, near: Sequence[PointOptics], frequency: float, azimuth: float = 0.0) -> None:
        self._frequency = positive("frequency", frequency, unit="cycles/m")
        self._azimuth = real("azimuth", azimuth)
        widest = max(self._pixel(seen) for seen in near)
        orders = np.arange(-math.ceil(widest) - 1, math.ceil(widest) + 2)
        if 2 * widest > MOST_ALIASES:
            raise self._too_wide(widest)
        across, along = (part.ravel() for part in np.meshgrid(orders, orders))
        self._aliases = np.stack([across, along], axis=1)
        for seen in near:
            self._check(seen)
            places, pitch = self._places(seen), seen.scene.camera.image_pitch
            passed = np.hypot(*places.T) * seen.first.residual.airy_unit < NEGLIGIBLE
            passed &= np.abs(np.prod(np.sinc(places * pitch), axis=1)) > 1e-9
            self._aliases = self._aliases[passed]
        if len(self._aliases) > MOST_ALIASES:
            raise self._too_wide(widest)
        lobes = near[0].scene.mirror_lobes
        self._distributions = [getattr(lobe, "distribution", "beckmann") for lobe in lobes]
        self._scale = 1.0
        self._scale = float(self.fields(near[0], 1)["turn"].max())

    def _check(self, seen: PointOptics) -> None:
        """Raise `SceneError` if the frequency is too high for the lens or the pixels."""
        on_detector = float(np.hypot(*self._frequency_of(seen)))
        for limit, what, remedy in (
            (
                HIGHEST / seen.first.residual.airy_unit,
                "0.9 of the lens's cutoff",
                "smaller f-number",
            ),
            (
                1 / (2 * seen.scene.camera.image_pitch),
                "the pixels' Nyquist frequency",
                "smaller pixels",
            ),
        ):
            if on_detector > limit:
                raise SceneError(
                    f"figure mtf: frequency = {self._frequency:g} cycles/m is {on_detector:.4g} "
                    f"cycles/m on the detector, limit {limit:.4g} ({what}) for tier = 'fast'; use "
                    f"a lower frequency, {remedy} or tier = 'full'"
                )

    def _too_wide(self, widest: float) -> SceneError:
        return SceneError(
            f"figure mtf: frequency aliases more than {MOST_ALIASES} times by pixels of "
            f"{widest:.3g} Airy units, the limit for tier = 'fast'; use smaller pixels, a larger "
            "f-number or tier = 'full'"
        )

    def _pixel(self, seen: PointOptics) -> float:
        """Return the side of a pixel in Airy units."""
        return seen.scene.camera.image_pitch / seen.first.residual.airy_unit

    def _places(self, seen: PointOptics) -> Array:
        """Return the frequencies (aliases, 2) that the pixels do not tell apart, 1/m."""
        return self._frequency_of(seen) - self._aliases / seen.scene.camera.image_pitch

    def _frequency_of(self, seen: PointOptics) -> Array:
        """Return the frequency (2,), along x and y on the detector, 1/m."""
        length = self._frequency * object_scale(seen.scene)
        return length * np.array([math.cos(self._azimuth), math.sin(self._azimuth)])

    def fields(self, seen: PointOptics, n: int) -> dict[str, Array]:
        """Return fields of the overlaps, the pixels and the lobes, see `FastFigure`."""
        residual = seen.first.residual
        wave, lobes = residual.wavefront, seen.scene.mirror_lobes
        places = self._places(seen)
        phase, weight = overlap_nodes(residual, places, n)
        shift = places @ np.array(residual.shift)
        steps = wave.wavelength * wave.image_distance * places
        lags = np.hypot(*(seen.view.footprint @ steps.T))
        total = sum(lobe.specular_reflectance for lobe in lobes)
        return {
            "phase": phase / (2 * math.pi) - shift[:, None, None],
            "weight": weight * n**2,
            "sharp": np.prod(np.sinc(places * seen.scene.camera.image_pitch), axis=1),
            "turn": residual.wavenumber * seen.view.cos_sum * lags / self._scale,
            "slope": np.array([lobe.slope_rms for lobe in lobes]) * self._scale,
            "share": np.array([lobe.specular_reflectance / total for lobe in lobes]),
        }

    def values(self, fields: Mapping[str, Array]) -> Array:
        """Return the figure of each draw, see `FastFigure`."""
        nodes = fields["phase"].shape[-1] ** 2
        passed = fields["sharp"] * _sums(fields["phase"], fields["weight"], 2) / nodes
        if self._distributions:
            parts = [
                fields["share"][:, j, None]
                * lobe_transfer(kind, fields["turn"] * fields["slope"][:, j, None])
                for j, kind in enumerate(self._distributions)
            ]
            passed = passed * sum(parts)
        return np.asarray(np.abs(passed.sum(axis=1)))


def fast_figure(source: str, options: Mapping[str, Any], near: Sequence[PointOptics]) -> FastFigure:
    """Return a figure by its name, one of `FAST` but "value".

    ``near`` are the waves of the scenes about the middle of the distributions, which is the first.
    """
    if source == "mtf":
        return MtfFigure(near, **options)
    if source == "spot_rms":
        return SpotFigure()
    return WaveFigure(_strehl if source == "strehl" else _rms)
