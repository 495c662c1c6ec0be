"""Albedos that depend on the wavelength: values at a few wavelengths, and those between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..._checks import in_range
from ...errors import SceneError
from ._quantities import Length


@dataclass(frozen=True)
class Spectrum:
    """Albedo or reflectance that depends on the wavelength, for the lobes of a material.

    It takes the place of the number ``albedo`` or ``reflectance`` of a lobe. A `Scene` evaluates
    all its materials at the wavelength of its laser.

    Parameters
    ----------
    wavelengths : sequence of float
        Two or more vacuum wavelengths, m, in increasing order.
    values : sequence of float
        Albedo at each of these wavelengths, 0 to 1.
    wavelength : float, optional
        Wavelength, m, at which ``value`` is taken; by default the first of ``wavelengths``. A scene
        replaces it by the wavelength of its laser.

    Raises
    ------
    SceneError
        If a value is out of range, the wavelengths do not increase, their number differs from that
        of the values, or ``wavelength`` is outside their range.

    See Also
    --------
    Lambert : Ideal diffuse reflection.
    nlosoptics.raytrace.trace_image : Images at several wavelengths.

    Notes
    -----
    Between the wavelengths the albedo is interpolated linearly. Outside their range it is unknown,
    so that a scene with such a laser is refused.

    Examples
    --------
    >>> from nlosoptics.scene import Lambert, Spectrum
    >>> brick = Lambert(Spectrum((450e-9, 650e-9), (0.1, 0.4)))
    >>> brick.rho, round(brick.at(550e-9).rho, 3)
    (0.1, 0.25)
    """

    wavelengths: tuple[Length, ...]
    values: tuple[float, ...]
    wavelength: float | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name, low, high, unit in (("wavelengths", 1e-8, 1e-4, "m"), ("values", 0.0, 1.0, "")):
            given = getattr(self, name)
            if not isinstance(given, list | tuple | np.ndarray) or np.ndim(given) != 1:
                raise SceneError(f"{name} is {given!r}; give a list of numbers")
            checked = (
                in_range(f"{name}[{k}]", value, low, high, unit=unit)
                for k, value in enumerate(given)
            )
            put(self, name, tuple(checked))
        if len(self.wavelengths) < 2 or len(self.wavelengths) != len(self.values):
            raise SceneError(
                f"wavelengths has {len(self.wavelengths)} and values {len(self.values)} numbers, "
                "must be equally many, at least 2; give an albedo at each wavelength"
            )
        for k, (a, b) in enumerate(pairwise(self.wavelengths)):
            if not a < b:
                raise SceneError(
                    f"wavelengths[{k + 1}] = {b:g} m is not above wavelengths[{k}] = {a:g} m; give "
                    "increasing wavelengths"
                )
        first, last = self.wavelengths[0], self.wavelengths[-1]
        at = first if self.wavelength is None else self.wavelength
        if not first <= at <= last:
            raise SceneError(
                f"the albedo at the wavelength {1e9 * at:.6g} nm is unknown, its table has "
                f"{1e9 * first:.6g} to {1e9 * last:.6g} nm; use a wavelength in this range, or "
                "extend the table"
            )
        put(self, "wavelength", float(at))

    @property
    def value(self) -> float:
        """Albedo at ``wavelength``."""
        return float(np.interp(self.wavelength or 0.0, self.wavelengths, self.values))

    @property
    def mean(self) -> float:
        """Mean of the values, by which samples choose a lobe at any wavelength."""
        return sum(self.values) / len(self.values)

    def at(self, wavelength: float) -> Spectrum:
        """Return the same table with another wavelength, m."""
        return replace(self, wavelength=wavelength)


def strength(name: str, given: Any) -> tuple[float, Spectrum | None]:
    """Return the checked value of the albedo ``name``, and its table if it has one."""
    spectrum = given if isinstance(given, Spectrum) else None
    return in_range(name, given if spectrum is None else spectrum.value, 0.0, 1.0), spectrum
