"""Pupil maps for prysm and from prysm, and the sign and grid conventions of several tools.

The conventions for a pupil map [row, column] were measured with the tools' own transforms (POPPY
1.1.2, prysm 0.21.1, HCIPy 0.7.1); a test checks prysm's. Here a is a slope and d the distance:

========  =====================  ===========================  ==============================
tool      positive OPD means     grid of n samples            W = a u moves the spot to
========  =====================  ===========================  ==============================
here      longer path            ``(arange(n) - n//2) dx``    ``+a d``
prysm     longer path            ``(arange(n) - n//2) dx``    ``+a d``
HCIPy     longer path (a phase)  ``(arange(n) - (n-1)/2) dx`` ``+a d``
POPPY     shorter path           ``(arange(n) - (n-1)/2) dx`` ``+a d``, as OPD = -W
========  =====================  ===========================  ==============================

In all of them columns run along x and row 0 is at the lowest y, so maps are never flipped or
transposed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import expect, positive
from ..._vectors import Array
from ...errors import SceneError
from ..wave.wavefront import Wavefront


class PrysmPupil(NamedTuple):
    """Pupil arrays for the Python library prysm, in its units and in the order of its arguments.

    Parameters
    ----------
    amplitude : ndarray, (n, n)
        Relative amplitude, 0 outside the pupil.
    phase : ndarray, (n, n)
        Wave aberration, nm, positive for a longer path.
    wavelength : float
        Wavelength, micrometres.
    dx : float
        Distance between samples, mm.

    See Also
    --------
    to_prysm : Maps of a wave for prysm.
    """

    amplitude: Array
    phase: Array
    wavelength: float
    dx: float


def to_prysm(wavefront: Wavefront) -> PrysmPupil:
    """Convert a wave to arrays for the Python library prysm.

    Pass the result on as ``prysm.propagation.Wavefront.from_amp_and_phase(*pupil)``. The distance
    for prysm's focusing functions is ``1e3 * wavefront.image_distance``, mm.

    Parameters
    ----------
    wavefront : Wavefront
        Wave with ``layout`` = "grid" (samples on a square grid, see `Wavefront`). Terms listed in
        ``wavefront.removed``, such as tilt, are not added back.

    Returns
    -------
    PrysmPupil
        Amplitude (n, n), aberration (n, n) in nm, wavelength in micrometres and sample distance in
        mm. The arrays are in the order of the wave's grid. In a square that the rim of the pupil
        crosses, the amplitude is multiplied by the fraction of the square inside the pupil.

    Raises
    ------
    SamplingError
        If the layout of the wave is not "grid".

    See Also
    --------
    from_prysm : Wave from prysm's maps.

    Examples
    --------
    A wave with 50 nm rms of defocus on a grid of 65 x 65 samples:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {4: 50e-9}, wavelength=632.8e-9, pupil_radius=0.0125, image_distance=1.0,
    ...     nodes="grid", samples=65,
    ... )
    >>> pupil = psf.to_prysm(wave)
    >>> print(pupil.phase.shape, f"{pupil.wavelength:.4f} um, {pupil.dx:.4f} mm")
    (65, 65) 0.6328 um, 0.3846 mm
    """
    wavefront = expect("wavefront", wavefront, "Wavefront")
    pitch = wavefront.pupil_pitch
    return PrysmPupil(
        amplitude=wavefront.amplitude * wavefront.weights / pitch**2,
        phase=wavefront.aberration * 1e9,
        wavelength=wavefront.wavelength * 1e6,
        dx=pitch * 1e3,
    )


def from_prysm(
    pupil: PrysmPupil | tuple[ArrayLike, ArrayLike, float, float],
    *,
    image_distance: float,
    pupil_radius: float | None = None,
) -> Wavefront:
    """Make a wave from pupil arrays of the Python library prysm.

    Parameters
    ----------
    pupil : PrysmPupil or tuple
        Four values: relative amplitude (n, n); wave aberration (n, n), nm, positive for a longer
        path; wavelength, micrometres; and distance between samples, mm. Aberrations where the
        amplitude is 0 are ignored and may be NaN.
    image_distance : float
        Distance from the pupil to the image plane, m; negative if the pupil lies beyond the image.
    pupil_radius : float, optional
        Radius of the pupil, m, which defines the F-number; by default that of the largest disc
        inside the arrays, their dark margin included.

    Returns
    -------
    Wavefront
        Wave with ``layout`` = "grid" (samples on a square grid, see `Wavefront`).

    Raises
    ------
    SceneError
        If the arrays are not real, not square, not finite or differ in shape, or a number is out of
        range.

    See Also
    --------
    to_prysm : Maps of a wave for prysm.
    """
    if not isinstance(pupil, tuple) or len(pupil) != 4:
        raise SceneError(
            "pupil is not a prysm pupil; give (amplitude, phase in nm, wavelength in um, dx in mm)"
        )
    for name, array in zip(("amplitude", "phase"), pupil, strict=False):
        if (kind := np.asarray(array).dtype).kind not in "biuf":
            raise SceneError(f"pupil: {name} has type {kind}; give real numbers")
    amplitude, phase = (np.array(array, dtype=np.float64) for array in pupil[:2])
    if amplitude.shape != phase.shape or phase.ndim != 2 or len(set(phase.shape)) > 1:
        raise SceneError(
            f"pupil: amplitude has shape {amplitude.shape} and phase {phase.shape}; give two "
            "square arrays of the same shape"
        )
    phase[(amplitude == 0) & ~np.isfinite(phase)] = 0.0
    return Wavefront.from_map(
        phase / 1e9,
        amplitude,
        wavelength=positive("pupil.wavelength", pupil[2], unit="um") * 1e-6,
        pupil_pitch=positive("pupil.dx", pupil[3], unit="mm") * 1e-3,
        image_distance=image_distance,
        pupil_radius=pupil_radius,
    )
