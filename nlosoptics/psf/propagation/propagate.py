"""Propagation of a sampled field to a parallel plane, with a choice of methods."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal

import numpy as np

from ..._checks import fits_memory, in_range, one_of, positive, real
from ...errors import MemoryLimitError, SamplingError, SceneError
from ..window.error_bounds import rounded_up
from ..window.grids import ComplexArray
from ..window.window import shape_of
from .diffraction_sums import (
    ROUNDING,
    Axis,
    Spectrum,
    band,
    by_impulse,
    by_transfer,
    impulse_error,
    is_near,
    leak,
    transfer,
)
from .scalar_field import PropagatedField, ScalarField

Method = Literal[
    "auto", "angular_spectrum", "fresnel_transfer", "fresnel_one_step", "fresnel_chirp_z"
]
#: Factor of model errors: sums over the output lattice differ from integrals of an exact field.
LATTICE: Final = 1.25
METHODS = ("angular_spectrum", "fresnel_transfer", "fresnel_chirp_z", "fresnel_one_step")


@dataclass(frozen=True)
class Candidate:
    """Method that could propagate a field, before it is run.

    Parameters
    ----------
    cost : float
        Points of its FFTs times their logarithm.
    method : str
        Name.
    error, model : float
        Numerical and model error, relative to the whole field.
    run : callable
        Computes the samples, without the factor exp(ikz).
    bytes : float
        Memory that it needs.
    """

    cost: float
    method: str
    error: float
    model: float
    run: Callable[[], ComplexArray]
    bytes: float


def propagate(
    field: ScalarField,
    distance: float,
    *,
    method: Method = "auto",
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    tol: float = 1e-3,
) -> PropagatedField:
    """Propagate a sampled scalar field through free space to a parallel plane.

    Parameters
    ----------
    field : ScalarField
        Field on the plane z = ``field.z``. It is zero outside its samples, unless it is periodic.
    distance : float
        Distance to the new plane along +z, m. If negative, the wave is propagated back toward its
        source.
    method : str
        ``auto`` selects, of the methods whose numerical and model errors together are at most
        ``tol``, the one with the fewest operations.

        - ``angular_spectrum`` multiplies the spectrum of the field by the exact transfer function
          of free space. It is valid at any distance and for any output pitch.
        - ``fresnel_transfer`` uses the paraxial transfer function.
        - ``fresnel_chirp_z`` sums the Fresnel integral over the samples, for any output pitch. The
          sampled field acts as a grating; the distance must be large enough for its diffraction
          orders to miss the output samples.
        - ``fresnel_one_step`` computes the Fresnel integral by a single FFT of n x n samples. The
          output has the shape (n, n) and the pitch ``wavelength |distance|/(n field.pitch)``.
    pitch : float, optional
        Distance between output samples, m; by default that of the field. Omit it for
        ``fresnel_one_step``, whose output pitch is fixed.
    shape : int or (int, int), optional
        Number of output samples (ny, nx); by default that of the field. For ``fresnel_one_step``,
        n is the largest of ny, nx and the two sides of the field.
    tol : float
        Largest permitted rms error of the complex field relative to its rms, above 0, at most 1. A
        method requested by name must keep its numerical error within ``tol``; its model error,
        which is that of the Fresnel approximation, is reported, but not limited.

    Returns
    -------
    PropagatedField
        Field on the plane z = ``field.z + distance``, with the phase of the distance,
        ``exp(ik distance)``.

    Raises
    ------
    SceneError
        If an argument is out of range or the field is zero everywhere. For a periodic field, also
        if ``pitch`` or ``shape`` differs from that of the field, or ``method`` is "fresnel_chirp_z"
        or "fresnel_one_step".
    SamplingError
        If no method reaches ``tol``, or the requested method does not.
    MemoryLimitError
        If an array would not fit into memory; raised before it is allocated.

    See Also
    --------
    point_spread : Focused waves from a pupil to the image plane.

    Notes
    -----
    The field at the distance z is ``U(x, y) = sum F exp(2 pi i (fx x + fy y)) H``, with F the
    spectrum of the input at the spatial frequencies fx and fy. Let f^2 = fx^2 + fy^2 and
    k = 2 pi/lambda. The exact transfer function is ``H = exp(ikz sqrt(1 - (lambda f)^2))`` [1]_;
    in the Fresnel approximation it is ``H = exp(ikz) exp(-i pi lambda z f^2)``.

    Frequencies whose rays do not reach the output samples are removed, because H would be
    undersampled there [2]_. The removal sets in gradually, to avoid ripples. Evanescent waves are
    kept if the distance is much smaller than the width of the output. Otherwise they are removed,
    and the numerical error includes them. The phase kz has a relative error of 1e-16.

    For a periodic field the sum is exact, and energy is conserved to rounding error.

    References
    ----------
    .. [1] Goodman, Introduction to Fourier Optics, 3rd ed., sec. 3.10 and 4.2.
    .. [2] Matsushima and Shimobaba, Optics Express 17 (2009) 19662.

    Examples
    --------
    A Gaussian beam doubles its area, and halves its intensity, after one Rayleigh range:

    >>> import numpy as np
    >>> from nlosoptics import psf
    >>> waist, wavelength = 0.2e-3, 500e-9
    >>> beam = psf.ScalarField.from_function(
    ...     lambda x, y: np.exp(-(x**2 + y**2) / waist**2),
    ...     pitch=20e-6, shape=128, wavelength=wavelength,
    ... )
    >>> far = psf.propagate(beam, np.pi * waist**2 / wavelength)
    >>> print(f"{far.intensity.max():.4f} at z = {far.z:.4f} m")
    0.5000 at z = 0.2513 m
    >>> far.error_estimate + far.model_error < 1e-3
    True
    """
    one_of("method", method, ("auto", *METHODS))
    distance = real("distance", distance)
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    z = abs(distance)
    if not np.any(field.samples):
        raise SceneError("field.samples are all 0; give a field that carries power")
    if field.periodic:
        step, size = field.pitch, field.shape
        same = (pitch is None or pitch == step) and (shape is None or shape_of(shape) == size)
        if not same or method in ("fresnel_chirp_z", "fresnel_one_step"):
            raise SceneError(
                "field.periodic = True, so that the output must have its lattice, by "
                "'angular_spectrum' or 'fresnel_transfer'; omit pitch and shape"
            )
    else:
        step, size = _output(field, z, method, pitch, shape)
    candidates = _candidates(field, distance, step, size, tol)
    best, values, gain, notes = _first_within(field, candidates, method, step, tol)
    # The fraction of a turn is split off, since k z itself has lost the digits of small phases.
    values = values * cmath.exp(2j * math.pi * math.fmod(z / field.wavelength, 1.0))
    if (unsure := field.sampling_error) > tol:
        notes.append(
            f"field.sampling_error = {unsure:.2g} exceeds tol: the continuous wave "
            "may differ more than error_estimate says"
        )
    return PropagatedField(
        samples=values if distance >= 0 else values.conj(),
        pitch=step,
        wavelength=field.wavelength,
        z=field.z + distance,
        periodic=field.periodic,
        method=best.method,
        error_estimate=best.error * gain,
        model_error=best.model * gain,
        reason="; ".join(notes),
    )


def _output(
    field: ScalarField,
    z: float,
    method: str,
    pitch: float | None,
    shape: int | tuple[int, int] | None,
) -> tuple[float, tuple[int, int]]:
    """Return pitch and shape of the output."""
    size = field.shape if shape is None else shape_of(shape)
    step = field.pitch if pitch is None else positive("pitch", pitch, unit="m")
    if method != "fresnel_one_step":
        return step, size
    n = max(*size, *field.shape)
    own = field.wavelength * z / (n * field.pitch)
    if z == 0 or (pitch is not None and abs(step / own - 1) > 1e-9):
        raise SamplingError(
            f"'fresnel_one_step' has the output pitch {own:.6g} m for {n} samples at the distance "
            f"{z:g} m, not {step:.6g} m; omit pitch, or use method='fresnel_chirp_z'"
        )
    return own, (n, n)


def _candidates(
    field: ScalarField, distance: float, step: float, size: tuple[int, int], tol: float
) -> list[Candidate]:
    """Return the methods that can propagate a field to a lattice, cheapest first."""
    z, wavelength = abs(distance), field.wavelength
    if z == 0 and step == field.pitch and size == field.shape:
        return [Candidate(0.0, name, 0.0, 0.0, lambda: field.samples, 0.0) for name in METHODS[:2]]
    # A wave that is traced back is the conjugate of one that travels on.
    samples = field.samples if distance >= 0 else field.samples.conj()
    if field.periodic:
        return _periodic(samples, field.pitch, wavelength, z)
    samples, axes = _trimmed(samples, field.pitch, size, step)
    spectrum = Spectrum(samples, field.pitch, pad=True)
    reach = max(a.reach for a in axes)
    near = reach if is_near(reach, wavelength, z) else 0.0
    paraxial_error, omitted = _model_errors(spectrum, axes, wavelength, z, near)
    # Energy of band-limited errors on lattices coarser than their Nyquist pitch
    # (Plancherel-Polya): the band is that of the input, or that of its extent after a chirp.
    folding = 1.0
    for a in axes:
        local = a.n * a.dx * step / (wavelength * z) if z > 0 else math.inf
        folding *= math.sqrt(max(1, math.ceil(min(step / a.dx, local) - 1e-9)))
    found = []
    for name, paraxial in (("angular_spectrum", False), ("fresnel_transfer", True)):
        by, bx = (
            band(a, e, wavelength, z, paraxial, tol / (4 * folding), 0.0 if paraxial else near)
            for a, e in zip(axes, spectrum.edge, strict=True)
        )
        lost = 0.0 if paraxial else omitted
        found.append(
            Candidate(
                cost=_cost(axes[0].n, by.count, axes[1].n, bx.count, by.period, bx.period)
                + _cost(by.count, size[0], bx.count, size[1], by.period, bx.period),
                method=name,
                error=folding * (ROUNDING + math.hypot(by.tail, bx.tail, lost)),
                model=LATTICE * folding * paraxial_error if paraxial else 0.0,
                run=partial(by_transfer, samples, (by, bx), wavelength, z, paraxial),
                bytes=100.0 * by.count * max(bx.count, size[1], axes[1].n),
            )
        )
    if z > 0:
        errors = (
            impulse_error(samples, axes[k], k, spectrum.edge[k], wavelength, z) for k in (0, 1)
        )
        chirp = Candidate(
            cost=_cost(axes[0].n, size[0], axes[1].n, size[1], 0.0, 0.0),
            method="fresnel_chirp_z",
            error=folding * (ROUNDING + math.hypot(*errors)),
            model=LATTICE * folding * paraxial_error,
            run=partial(by_impulse, samples, axes, wavelength, z),
            bytes=100.0 * max(axes[0].n, size[0]) * max(axes[1].n, size[1]),
        )
        found.append(chirp)
        if size[0] == size[1] and abs(wavelength * z / (step * field.pitch * size[0]) - 1) < 1e-9:
            cost = _cost(axes[0].n, size[0], axes[1].n, size[1], *size)
            found.append(replace(chirp, method="fresnel_one_step", cost=cost))
    return sorted(found, key=lambda candidate: candidate.cost)


def _periodic(samples: ComplexArray, dx: float, wavelength: float, z: float) -> list[Candidate]:
    """Return the transfer functions on the discrete frequencies of a periodic field."""
    spectrum = Spectrum(samples, dx, pad=False)
    exact, paraxial = (
        transfer(*spectrum.frequency, wavelength, z, kernel) for kernel in (False, True)
    )
    differ = math.sqrt(float(np.sum(spectrum.energy * np.abs(paraxial - exact) ** 2)))

    def run(path: ComplexArray) -> ComplexArray:
        return np.asarray(np.fft.ifft2(np.fft.fft2(samples) * path))

    return [
        Candidate(0.0, "angular_spectrum", ROUNDING, 0.0, partial(run, exact), 0.0),
        Candidate(0.0, "fresnel_transfer", ROUNDING, differ, partial(run, paraxial), 0.0),
    ]


def _trimmed(
    samples: ComplexArray, dx: float, size: tuple[int, int], step: float
) -> tuple[ComplexArray, tuple[Axis, Axis]]:
    """Return the samples without the zeros around them, and the axes along y and x."""
    cuts, axes = [], []
    for k, (n, count) in enumerate(zip(samples.shape, size, strict=True)):
        lit = np.flatnonzero(np.any(samples, axis=1 - k))
        cuts.append(slice(lit[0], lit[-1] + 1))
        axes.append(Axis(int(lit[0]) - n // 2, int(lit[-1] - lit[0]) + 1, dx, count, step))
    return np.ascontiguousarray(samples[cuts[0], cuts[1]]), (axes[0], axes[1])


def _model_errors(
    spectrum: Spectrum, axes: tuple[Axis, Axis], wavelength: float, z: float, near: float
) -> tuple[float, float]:
    """Return the errors of the Fresnel approximation and of waves omitted by the exact sum.

    Both are relative to the whole field. Waves whose rays miss the output do not count. The exact
    sum omits evanescent waves. Close to the input it keeps them, but waves along the planes return
    by its periodicity.
    """
    paraxial, exact = (
        transfer(*spectrum.frequency, wavelength, z, kernel) for kernel in (True, False)
    )
    share = np.ones((1, 1))
    for f, a in zip(spectrum.frequency, axes, strict=True):
        share = share * leak(wavelength * z * np.abs(f) - a.reach, wavelength * z)
    square = 1 - wavelength**2 * (spectrum.frequency[0] ** 2 + spectrum.frequency[1] ** 2)
    # no narrower than the resolution of the spectrum
    ring = max(
        z**2 / (z**2 + 4 * near**2) if near else 0.0,
        4 * wavelength * spectrum.nyquist / min(spectrum.energy.shape),
    )
    lacking = (np.abs(square) if near else square) < ring
    error = float(np.sum(spectrum.energy * np.abs(share * (paraxial - exact)) ** 2))
    omitted = float(np.sum(spectrum.energy[lacking] * np.abs(exact[lacking]) ** 2))
    return math.sqrt(error), math.sqrt(omitted)


def _cost(ny: int, my: int, nx: int, mx: int, py: float, px: float) -> float:
    """Return an estimate of the work of FFTs from (ny, nx) to (my, mx) samples.

    It is the number of points times its logarithm. ``py`` and ``px`` are the sizes for which a
    plain FFT suffices; 0 if there is none.
    """

    def one(n: int, m: int, size: float) -> float:
        chirp = 2.0 * (n + m)
        return size * math.log2(size) if max(n, m) <= size < chirp else chirp * math.log2(chirp)

    return ny * one(nx, mx, px) + mx * one(ny, my, py)


def _first_within(
    field: ScalarField, candidates: list[Candidate], method: str, step: float, tol: float
) -> tuple[Candidate, ComplexArray, float, list[str]]:
    """Run candidates until one is within ``tol``.

    Returns
    -------
    candidate : Candidate
        The method.
    values : ndarray
        Output samples without the factor exp(ikz).
    gain : float
        Factor from errors relative to the whole field to those relative to the output.
    notes : list of str
        Why it was taken, and why others were not.
    """
    notes: list[str] = []
    reached, too_large = math.inf, None
    auto = method == "auto"
    for candidate in candidates:
        if not auto and candidate.method != method:
            continue
        error = candidate.error + (candidate.model if auto else 0.0)
        text = f"{candidate.method} has a numerical error of {candidate.error:.2g}"
        text += f" and a model error of {candidate.model:.2g}" if candidate.model else ""
        if error <= tol:
            try:
                fits_memory(candidate.method, candidate.bytes, "use a smaller shape")
            except MemoryLimitError as refusal:
                too_large = refusal
                notes.append(f"{candidate.method} does not fit into memory")
                continue
            values = candidate.run()
            power = float(np.sum(values.real**2 + values.imag**2)) * step**2
            gain = math.sqrt(field.power / power) if power > 0 else math.inf
            error *= gain
            if error <= tol:
                head = "the fewest operations within" if auto else "requested, within"
                notes.insert(0, f"{candidate.method}: {head} tol = {tol:g}")
                return candidate, values, gain, notes
            text += f", in a window with {1 / gain**2:.2g} of the power"
        reached = min(reached, error)
        notes.append(text)
    if too_large is not None:
        raise too_large
    if not notes:
        raise SamplingError(f"{method!r} needs a distance above 0 m; use 'angular_spectrum'")
    raise SamplingError(
        f"{', and '.join(notes)}, limit tol = {tol:g}; use "
        + (f"tol = {rounded_up(reached)}" if reached < 1 else "another distance or window")
        + ("" if auto else ", or method='auto'")
    )
