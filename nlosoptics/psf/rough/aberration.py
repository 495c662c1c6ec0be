"""Wave aberration of a given rough wall by rays: its facets' tilts as path and amplitude."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..._vectors import Array
from ...errors import CausticError
from ...scene import FacetWall, GaussianWall
from ..wave.wavefront import Wavefront
from .relief import ReliefView


def rough_wave(wave: Wavefront, view: ReliefView) -> Wavefront:
    """Return the wave of a wall with its relief, from the wave of the smooth wall.

    The path over the wall point x to the pupil point p is stationary at
    ``x = M p + (cos_i + cos_o) d_eff grad h(x)``. The wave is the path there,
    ``(x - M p)^T d_eff^-1 (x - M p)/2 - (cos_i + cos_o) h(x)``, and the amplitude is
    ``|det(1 - (cos_i + cos_o) d_eff Hess h)|^(-1/2)``. A facet is plane and keeps the amplitude. At
    a pupil point that no facet lights the path over the crease is taken.
    """
    lit = wave.weights > 0
    path, amplitude = _path(view, wave.u[lit], wave.v[lit], wave.wavelength)
    aberration, transmitted = wave.aberration.copy(), wave.amplitude.copy()
    aberration[lit] += path
    transmitted[lit] *= amplitude
    return replace(wave, aberration=aberration, amplitude=transmitted)


def _path(view: ReliefView, u: Array, v: Array, wavelength: float) -> tuple[Array, Array]:
    """Return path, m, and relative amplitude at pupil points (u, v), each (n,)."""
    assert view.effective_distance is not None
    relief = view.roughness
    cosines = view.cos_sum(wavelength)
    aimed = np.stack([u, v], axis=1) @ view.footprint.T
    throw = cosines * view.effective_distance
    at, place = aimed, view.axes.T

    def derivatives(points: Array) -> tuple[Array, Array, Array]:
        """Return height (n,), gradient (n, 2) and Hessian (n, 2, 2) in the tangent plane."""
        world = view.origin + points @ view.axes
        h, hx, hy, hxx, hxy, hyy = relief.derivatives(world[:, 0], world[:, 1]).T
        hessian = np.stack([np.stack([hxx, hxy], 1), np.stack([hxy, hyy], 1)], 1)
        bend = np.einsum("ia,nij,jb->nab", place, hessian, place)
        return h, np.stack([hx, hy], axis=1) @ place, bend

    # a contraction, which needs about 20 steps
    for _ in range(60):
        height, slope, bend = derivatives(at)
        after = aimed + slope @ throw.T
        moved = float(np.abs(after - at).max())
        at = after
        if moved <= 1e-10 * view.length:
            break
    height, slope, bend = derivatives(at)
    area = np.linalg.det(np.eye(2) - throw @ bend)
    if not np.all(area > 0):
        raise CausticError(
            f"the wall's relief focuses light before the pupil: its curvature reaches "
            f"{1 / np.linalg.norm(throw, 2):.3g} 1/m, at which W is undefined; use a longer "
            "correlation length or a smaller slope"
        )
    step = at - aimed
    back = np.linalg.inv(view.effective_distance)
    path = 0.5 * np.einsum("na,ab,nb->n", step, back, step) - cosines * height
    return path, 1 / np.sqrt(area)


def aberration_error(view: ReliefView, wavelength: float) -> float:
    """Estimate the error of the PSF by rays on the relief, relative to its peak.

    Rays neglect diffraction between wall and pupil. A ripple of frequency f along the wall changes
    phase by ``q = pi lambda d_eff f^2``. For Gaussian heights the mean of q is
    ``q0 = lambda d_eff/(pi l^2)``, and the rms error of the field beyond path and amplitude is of
    the order ``s q0^2 + (s q0)^2``. Beside a crease between facets the field differs within some
    Fresnel zones. To first order in the slopes s_f of the facets and in one dimension,
    the mean square error is ``(k (cos_i + cos_o))^2 Var(jump) L^3 e/area`` with the length of the
    creases per area ``2 sqrt(3)/c``, ``Var(jump) = 16/3 s_f^2`` and ``L^2 = lambda d_eff``.
    """
    relief, s = view.roughness, view.rayleigh_parameter
    if s == 0:
        return 0.0
    assert view.effective_distance is not None
    distance = float(np.linalg.norm(view.effective_distance, 2))
    if isinstance(relief, GaussianWall):
        q = wavelength * distance / (math.pi * relief.correlation_length**2)
        return 2 * (2.5 * s * q**2 + 3 * (s * q) ** 2)
    if isinstance(relief, FacetWall):
        per_metre = s / relief.height_rms
        zone = math.sqrt(wavelength * distance)
        jump = 16 / 3 * (per_metre * relief.slope_rms) ** 2
        # Integral of sin^2(pi u^2/2)/u^4 over all u, divided by 4 pi^4.
        square = 2 * math.sqrt(3) / relief.cell * jump * zone**3 * 0.01194
        return 2 * math.sqrt(square)
    return math.inf
