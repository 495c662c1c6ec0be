"""Pupil maps for prysm and from it, and what it and others mean by theirs.

What was found with their own transforms (POPPY 1.1.2, prysm 0.21.1, HCIPy 0.7.1; tests hold the
first two) of a pupil map [row, column]:

========  =====================  ===========================  ==============================
tool      OPD above 0            grid of n samples            W = a u moves the spot to
========  =====================  ===========================  ==============================
here      longer path            ``(arange(n) - n//2) dx``    ``+a d``
prysm     longer path            the same                     ``+a d``
HCIPy     (a phase, longer)      ``(arange(n) - (n-1)/2) dx`` ``+a d``
POPPY     shorter path           ``(arange(n) - (n-1)/2) dx`` ``+a d``, as OPD = -W
========  =====================  ===========================  ==============================

All of them have columns along x and row 0 at the lowest y, so nothing is flipped or transposed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import positive
from ...errors import SamplingError, SceneError
from ..wave.wavefront import Wavefront

Array = NDArray[np.float64]


class PrysmPupil(NamedTuple):
    """A pupil as prysm takes it, in prysm's units and its order of arguments.

    Parameters
    ----------
    amplitude : ndarray
        (n, n), relative.
    phase : ndarray
        (n, n), nm, positive for a longer path.
    wavelength : float
        Micrometres.
    dx : float
        Pitch, mm.
    """

    amplitude: Array
    phase: Array
    wavelength: float
    dx: float


def to_prysm(wavefront: Wavefront) -> PrysmPupil:
    """Pupil arrays for ``prysm.propagation.Wavefront.from_amp_and_phase(*pupil)``.

    Focus it over ``1e3 * image_distance`` mm. What the wave has ``removed`` stays so.

    Parameters
    ----------
    wavefront : Wavefront
        A grid. Cells that the rim cuts get the amplitude times the part of them that is inside.

    Returns
    -------
    PrysmPupil

    Raises
    ------
    SamplingError
        If the wave is not on a grid.
    """
    amplitude = cell_amplitude(wavefront)
    phase = wavefront.aberration * 1e9
    return PrysmPupil(amplitude, phase, wavefront.wavelength * 1e6, wavefront.pupil_pitch * 1e3)


def from_prysm(
    pupil: PrysmPupil | tuple[ArrayLike, ArrayLike, float, float],
    *,
    image_distance: float,
    pupil_radius: float | None = None,
) -> Wavefront:
    """Wavefront of prysm's pupil arrays.

    Parameters
    ----------
    pupil : PrysmPupil or tuple
        Amplitude, phase in nm, wavelength in micrometres and dx in mm, as of `PrysmPupil`; the
        phase may be anything, even NaN, where the amplitude is 0.
    image_distance, pupil_radius : float
        m, as of `Wavefront.from_map`.

    Returns
    -------
    Wavefront
        A grid.

    Raises
    ------
    SceneError
        If arrays are not real, not square, not equal in shape or not finite.
    """
    if not isinstance(pupil, tuple) or len(pupil) != 4:
        raise SceneError("pupil is no prysm pupil; give (amplitude, phase in nm, um, mm)")
    amplitude, phase = maps("pupil", pupil[0], pupil[1])
    return Wavefront.from_map(
        phase / 1e9,
        amplitude,
        wavelength=positive("pupil.wavelength", pupil[2], unit="um") * 1e-6,
        pupil_pitch=positive("pupil.dx", pupil[3], unit="mm") * 1e-3,
        image_distance=image_distance,
        pupil_radius=pupil_radius,
    )


def cell_amplitude(wavefront: Wavefront) -> Array:
    """Amplitude whose sum over whole cells is the wave's own: cut cells have their share."""
    if wavefront.layout != "grid":
        raise SamplingError(
            f"a {wavefront.layout} wavefront is no picture of the pupil; sample it with "
            "nodes='grid'"
        )
    return wavefront.amplitude * wavefront.weights / wavefront.pupil_pitch**2


def maps(name: str, amplitude: ArrayLike, path: ArrayLike) -> tuple[Array, Array]:
    """Both as float64 (n, n), the path 0 where there is no light."""
    for word, array in (("amplitude", amplitude), ("path", path)):
        if (kind := np.asarray(array).dtype).kind not in "biuf":
            raise SceneError(
                f"{name}: {word} is of {kind}; give real numbers, of a complex pupil modulus "
                "and phase"
            )
    light, lead = np.array(amplitude, dtype=np.float64), np.array(path, dtype=np.float64)
    if light.ndim != 2 or light.shape[0] != light.shape[1] or light.shape != lead.shape:
        raise SceneError(
            f"{name}: amplitude has shape {light.shape} and path {lead.shape}; give two equal "
            "squares, of a cube one slice"
        )
    lead[(light == 0) & ~np.isfinite(lead)] = 0.0
    return light, lead
