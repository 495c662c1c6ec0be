"""Waves on pupil cells as linear functions of few coefficients, in torch."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Unpack

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..._checks import counted, fits_memory, real, whole
from ...errors import SamplingError, SceneError
from ...psf import Wavefront, fit_zernike
from ...psf.pupil.slope_integration import slope_filter
from ...psf.wave.cell_series import CellSpectrum
from ...psf.wave.polar_series import PolarSpectrum, values_at
from ...psf.wave.zernikes import zernike
from ..data.arrays import real_array
from .pupil_optics import ImageOptions, PupilOptics

Array = NDArray[np.float64]
#: Function that returns a fixed aberration on the cells of given optics, (n_v, n_u), m.
Rest = Callable[[PupilOptics], Array]
#: Noll's defocus.
DEFOCUS = 4


class ZernikeWaves(nn.Module):
    """Sums of Zernike polynomials on the pupil's cells.

    ``modes``: distinct Noll indices, without 1, since piston does not affect the image. ``optics``:
    transform with the pupil's cells. ``rest``: function of the optics that returns a fixed
    aberration to add, (n_v, n_u), m.

    ``leaf_shape`` (int,): shape of one set of coefficients, in waves rms over the full disc.
    ``rest`` (n_v, n_u): fixed aberration divided by the wavelength.
    """

    _basis: Tensor
    rest: Tensor | None
    _phase: Tensor | None

    def __init__(self, modes: Iterable[int], optics: PupilOptics, rest: Rest | None = None) -> None:
        super().__init__()
        self.modes = _checked_modes(modes)
        self.leaf_shape: tuple[int, ...] = (len(self.modes),)
        lit = int(np.count_nonzero(optics.share))
        if lit < len(self.modes):
            raise SamplingError(
                f"{lit} pupil cells cannot hold {len(self.modes)} modes; use fewer modes or a "
                "larger shape"
            )
        size = optics.share.size * len(self.modes)
        held = f"{counted(len(self.modes), 'mode')} on the pupil"
        fits_memory(held, 24.0 * size, "use fewer modes")
        basis = np.stack([noll_mode(mode, optics) for mode in self.modes])
        self.register_buffer("_basis", like(optics, basis))
        self._rest_of = rest
        turns = self.rest_on(optics)
        self.register_buffer("rest", None if turns is None else like(optics, turns))
        # subtract whole waves before the conversion to single precision, to keep digits
        phase = None if turns is None else like(optics, turns - np.round(turns))
        self.register_buffer("_phase", phase)

    def rest_on(self, optics: PupilOptics) -> Array | None:
        """Return the fixed aberration over the wavelength on the cells of given optics."""
        if self._rest_of is None:
            return None
        return np.where(optics.share > 0, self._rest_of(optics), 0.0) / optics.wavelength

    def forward(self, coefficients: Tensor) -> Tensor:
        """Return aberration over wavelength, (..., n_v, n_u), modulo whole waves.

        It is 0 outside the pupil.
        """
        turns = self._sum(coefficients)
        return turns if self._phase is None else turns + self._phase

    def unwrapped(self, coefficients: Tensor) -> Tensor:
        """Return aberration over wavelength, (..., n_v, n_u), including whole waves."""
        turns = self._sum(coefficients)
        return turns if self.rest is None else turns + self.rest

    def _sum(self, coefficients: Tensor) -> Tensor:
        flat = coefficients @ self._basis.flatten(1)
        return flat.reshape(*coefficients.shape[:-1], *self._basis.shape[1:])


class SlopeWaves(nn.Module):
    """Waves integrated from slopes on a square grid by least squares, interpolated by splines.

    ``count``: nodes per side; node [count//2, count//2] is on the axis. ``slope_pitch``: distance
    of the nodes, m. ``optics``: transform with the pupil's cells.

    ``leaf_shape`` (int, int, 2): shape of one set of slopes dW/du, dW/dv, in waves per pupil
    radius. ``modes``: empty, since no Zernike polynomials are used.
    """

    _left: Tensor
    _right: Tensor
    _cosines: Tensor
    _sources: Tensor
    _inverse: Tensor
    _lit: Tensor

    def __init__(self, count: int, slope_pitch: float, optics: PupilOptics) -> None:
        super().__init__()
        self.modes: tuple[int, ...] = ()
        self.leaf_shape: tuple[int, ...] = (count, count, 2)
        fits_memory(f"{count} x {count} slopes", 200.0 * count**2, "use fewer slopes")
        axis = (np.arange(count, dtype=np.float64) - count // 2) * slope_pitch
        solve = slope_filter((count, count))
        left, right = (
            _spline(axis, cells) @ cosines.T
            for cells, cosines in zip((optics.v, optics.u), solve.cosines, strict=True)
        )
        for name, values in (
            ("_left", left),
            ("_right", right.T),
            ("_cosines", solve.cosines[0]),
            ("_sources", solve.sources[0]),
            ("_inverse", solve.inverse * (slope_pitch / optics.pupil_radius)),
            ("_lit", optics.share > 0),
        ):
            self.register_buffer(name, like(optics, values))

    def forward(self, coefficients: Tensor) -> Tensor:
        """Return aberration over wavelength, (..., n_v, n_u), 0 outside the pupil."""
        along, up = coefficients.unbind(-1)
        # a square grid has the same cosines both ways
        sources = self._cosines @ along @ self._sources.T + self._sources @ up @ self._cosines.T
        surface: Tensor = self._left @ (sources * self._inverse) @ self._right
        return surface * self._lit

    def unwrapped(self, coefficients: Tensor) -> Tensor:
        """Return aberration over wavelength, (..., n_v, n_u); equal to `forward`."""
        return self.forward(coefficients)


def fitted_modes(wave: Wavefront, modes: Sequence[int]) -> tuple[Rest, list[float]]:
    """Fit modes to a polar wave; return its residual as a function of optics, and the fit, waves.

    The function returns the residual on the cells of the optics, (n_v, n_u), m.
    """
    found = _checked_modes(modes)
    fit = fit_zernike(wave, max(found))
    known = {mode: fit[mode] for mode in found}
    rest = partial(_residual, wave.series(wave.aberration), known)
    return rest, [fit[mode] / wave.wavelength for mode in found]


def _residual(
    series: PolarSpectrum | CellSpectrum, fit: Mapping[int, float], optics: PupilOptics
) -> Array:
    """Return a wave minus its fitted modes on the cells of the optics, (n_v, n_u), m."""
    v, u = np.meshgrid(optics.v, optics.u, indexing="ij")
    rest = np.zeros_like(u)
    lit = optics.share > 0
    rest[lit] = on_cells(series, u[lit], v[lit])
    for mode, strength in fit.items():
        rest -= strength * noll_mode(mode, optics)
    return rest


def optics_of(
    wave: Wavefront, pitch: float, shape: int | tuple[int, int], **options: Unpack[ImageOptions]
) -> PupilOptics:
    """Return the optics of a polar wave's pupil, with its amplitude as transmission.

    ``pitch``, ``shape`` and ``options`` describe the image as in `PupilOptics`.
    """
    return PupilOptics(
        wavelength=wave.wavelength,
        pupil_radius=wave.pupil_radius,
        image_distance=wave.image_distance,
        pitch=pitch,
        shape=shape,
        transmission=partial(on_cells, wave.series(wave.amplitude)),
        **options,
    )


def on_cells(series: PolarSpectrum | CellSpectrum, u: Array, v: Array) -> Array:
    """Evaluate a series of a wave at pupil points; ``u`` and ``v`` in m, the result in m."""
    if isinstance(series, CellSpectrum):
        raise SamplingError("the wave is sampled on cells, not on polar nodes; use polar ones")
    return values_at(series, None, u, v, 1e-13)[0]


def checked_tangents(angles: Any, pitch: float, pupil_radius: float) -> Array:
    """Return the tangents of exit angles (g, g, 2), rad, at nodes ``pitch`` m apart.

    They must be finite, below pi/2 and cover the pupil.
    """
    values = real_array("angles", angles)
    if values.ndim != 3 or values.shape[0] != values.shape[1] or values.shape[2] != 2:
        raise SceneError(f"angles have shape {values.shape}; give (g, g, 2), rad")
    largest = float(np.abs(values).max(initial=0.0))
    if not largest < np.pi / 2:
        raise SceneError(
            f"angles reach {largest:.3g} rad, must be finite and below pi/2; give angles from the "
            "axis, 0 if there is no start value"
        )
    count = values.shape[0]
    reach = ((count - 1) // 2 + 0.5) * pitch
    if count < 2 or reach < pupil_radius * (1 - 1e-9):
        need = 2 * math.ceil(pupil_radius / pitch - 0.5) + 1
        raise SamplingError(
            f"{count} x {count} angles {pitch:.3g} m apart reach {reach:.3g} m from the "
            f"axis, the pupil {pupil_radius:.3g} m; give {max(need, 2)} or more a side"
        )
    return np.tan(values)


def _spline(nodes: Array, cells: Array) -> Array:
    """Return the matrix (cells, nodes) of cubic spline interpolation.

    With fewer than four nodes the degree is the highest possible one.
    """
    from scipy.interpolate import make_interp_spline

    spline = make_interp_spline(nodes, np.eye(nodes.size), k=min(3, nodes.size - 1))
    return np.asarray(spline(cells))


def noll_mode(mode: int, optics: PupilOptics) -> Array:
    """Return a Zernike polynomial (Noll index) on the cells, (n_v, n_u), rms 1 over the disc."""
    v, u = np.meshgrid(optics.v, optics.u, indexing="ij")
    values = zernike(mode, np.hypot(u, v) / optics.pupil_radius, np.arctan2(v, u))
    return np.where(optics.share > 0, values, 0.0)


def like(optics: PupilOptics, values: Any) -> Tensor:
    """Convert an array to a tensor with device and precision of the optics."""
    array = np.ascontiguousarray(np.asarray(values, dtype=np.float64))
    return torch.tensor(array, device=optics.device, dtype=optics.dtype)


def start_values(modes: Sequence[int] | Mapping[int, float], wavelength: float) -> list[float]:
    """Return initial coefficients in waves, from a mapping of mode to metres; else zeros."""
    if not isinstance(modes, Mapping):
        return [0.0] * len(modes)
    return [real(f"modes[{mode}]", value) / wavelength for mode, value in modes.items()]


def _checked_modes(modes: Iterable[int]) -> tuple[int, ...]:
    if isinstance(modes, (str, int, float)) or not hasattr(modes, "__iter__"):
        raise SceneError(f"modes = {modes!r}; give a sequence of Noll indices")
    found = tuple(whole("mode", mode, 1) for mode in modes)
    if not found:
        raise SceneError("modes is empty; give Noll indices from 2 on")
    if 1 in found:
        raise SceneError("modes holds 1, piston, which has no effect on the image; leave it out")
    if len(set(found)) < len(found):
        twice = next(mode for mode in found if found.count(mode) > 1)
        raise SceneError(f"modes holds {twice} more than once; give each index once")
    return found
