"""Base classes of materials, and the checks of directions and angles that they share."""

from __future__ import annotations

import math
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._vectors import dot
from ...errors import SceneError
from .spectrum import Spectrum, strength

Array = NDArray[np.float64]
#: Largest rms slope, rad, of a lobe that counts as mirror-like and forms an image.
MIRROR_SLOPE = 0.1


class Material:
    """Base class of all materials: the bidirectional reflectance of a surface.

    The reflectance is a sum of lobes. A lobe is one kind of reflection, such as the diffuse or the
    glossy part.

    See Also
    --------
    SumMaterial : Sum of several lobes.
    Lambert : Ideal diffuse reflection.
    """

    def lobe_table(self) -> Array:
        """Return the parameters of all lobes as an array, as compiled code needs them.

        Returns
        -------
        ndarray, (n, 7)
            One row per lobe. Columns: code of the kind of lobe (a constant of `kernels.codes`);
            albedo or reflectance; rms slope or alpha, rad; factor by which the lobe's reflectance
            is multiplied; strength by which samples choose a lobe; real and imaginary part of the
            refractive index, 0 where none is given (size, m, and 0 for a `Retroreflector`). The
            factor is 1, except for an
            `OrenNayar` lobe with ``normalised=True`` that would reflect more light than it
            receives. The strength is albedo times factor or, for a `Spectrum`, the mean of its
            values, so that samples are the same at all wavelengths.
        """
        raise NotImplementedError

    spectrum: Spectrum | None = None

    def _set_strength(self, field: str, name: str, given: float | Spectrum) -> None:
        """Store an albedo or reflectance as ``field``, and its table; messages call it ``name``."""
        value, spectrum = strength(name, given)
        object.__setattr__(self, field, value)
        object.__setattr__(self, "spectrum", spectrum)

    def _lobe(
        self, kind: int, value: float, width: float, factor: float = 1.0, index: complex = 0.0
    ) -> Array:
        """Return the table of one lobe; see `lobe_table`."""
        chosen = value * factor if self.spectrum is None else self.spectrum.mean
        return np.array([[kind, value, width, factor, chosen, index.real, index.imag]])

    def at(self, wavelength: float) -> Material:
        """Return the material at a wavelength; `Scene` calls this for its laser.

        Parameters
        ----------
        wavelength : float
            Vacuum wavelength, m. It has no effect on values that do not depend on the wavelength.

        Raises
        ------
        SceneError
            If a `Spectrum` of the material does not include the wavelength.
        """
        if self.spectrum is None or self.spectrum.wavelength == wavelength:
            return self
        coloured = copy(self)
        field = "reflectance" if hasattr(self, "reflectance") else "rho"
        coloured._set_strength(field, field, self.spectrum.at(wavelength))
        return coloured

    @property
    def is_coloured(self) -> bool:
        """Whether the material's albedo depends on the wavelength."""
        return self.spectrum is not None

    @property
    def is_black(self) -> bool:
        """Whether the material reflects no light at all."""
        lobes = self.lobe_table()
        return not bool((lobes[:, 1] * lobes[:, 3] > 0.0).any())

    @property
    def specular_reflectance(self) -> float:
        """Fraction of the incident power that mirror-like lobes reflect, 0 to 1.

        A lobe counts as mirror-like if its rms slope is at most 0.1 rad, which spreads the
        reflected light by 0.2 rad (11 deg) rms. Wider lobes form no useful image and count as
        diffuse.
        """
        return 0.0

    @property
    def mirror_lobes(self) -> tuple[MirrorLobe, ...]:
        """Mirror-like lobes (rms slope up to 0.1 rad) with a reflectance above zero."""
        return ()

    @property
    def diffuse(self) -> Material | None:
        """Material without its mirror-like lobes (see `mirror_lobes`); None if no lobe remains."""
        return self

    def evaluate(self, incident: ArrayLike, exitant: ArrayLike, normal: ArrayLike) -> Array:
        """Return the bidirectional reflectance f_r, 1/sr.

        Parameters
        ----------
        incident, exitant, normal : array_like, (..., 3)
            Unit vectors that point away from the surface, in one common frame; shapes broadcast.

        Returns
        -------
        ndarray, (...)
            f_r, zero where either direction is below the surface. A lobe of zero slope is a mirror,
            whose reflectance is a delta function of direction. It is not included here, but in
            `specular_reflectance`.

        Raises
        ------
        SceneError
            If a direction is not finite or the shapes do not broadcast.

        Examples
        --------
        >>> from nlosoptics.scene import Lambert
        >>> up = (0.0, 0.0, 1.0)
        >>> round(float(Lambert(0.8).evaluate(up, up, up)), 4)
        0.2546
        """
        from ...kernels import brdf

        return _by_cosines(brdf.evaluate, self.lobe_table(), incident, exitant, normal)

    def pdf(self, incident: ArrayLike, exitant: ArrayLike, normal: ArrayLike) -> Array:
        """Return the probability density with which `sample` draws exitant directions, 1/sr.

        Parameters
        ----------
        incident, exitant, normal : array_like, (..., 3)
            Unit vectors that point away from the surface, in one common frame; shapes broadcast.

        Returns
        -------
        ndarray, (...)
            Density per solid angle; zero where the incident direction is below the surface. Facets
            can reflect a sample below the surface, so the density is normalised to 1 over the whole
            sphere, not the hemisphere. Lobes of zero slope reflect into a single direction and have
            no density; the integral is smaller by the fraction of samples that they receive.

        Raises
        ------
        SceneError
            If a vector is not of unit length or the shapes do not broadcast.
        """
        from ...kernels import brdf

        directions = (
            _unit(name, value)
            for name, value in (("incident", incident), ("exitant", exitant), ("normal", normal))
        )
        return _by_cosines(brdf.densities, self.lobe_table(), *directions)

    def sample(
        self, incident: ArrayLike, normal: ArrayLike, draws: ArrayLike
    ) -> tuple[Array, Array]:
        """Draw random exitant directions with their Monte Carlo weights.

        Parameters
        ----------
        incident, normal : array_like, (..., 3)
            Unit vectors that point away from the surface, in one common frame; shapes broadcast
            with ``draws``.
        draws : array_like, (..., 3)
            Independent uniform numbers in [0, 1): two for the direction, one for the lobe.

        Returns
        -------
        exitant : ndarray, (..., 3)
            Unit vectors with the density `pdf`.
        weight : ndarray, (...)
            ``f_r cos(theta) / pdf``, with theta the angle between exitant direction and normal. The
            mean weight is the directional albedo, see `albedo`. The weight is zero if either
            direction is below the surface.

        Raises
        ------
        SceneError
            If a vector is not of unit length, a draw is outside [0, 1), or the shapes do not
            broadcast.

        Notes
        -----
        Lambert and Oren-Nayar lobes are sampled by the cosine to the normal, Ward lobes by the half
        vector (Walter, Notes on the Ward BRDF, 2005), microfacet lobes by their visible normals
        (Heitz and d'Eon 2014, Heitz 2018), and retroreflectors by their own density. A mirror
        has one exitant direction. A sum of materials draws one lobe in proportion to its albedo and
        weights the sample with the f_r and the density of the whole sum.
        """
        from ...kernels import brdf

        u = np.asarray(draws, dtype=np.float64)
        _three("draws", u)
        if not np.all((u >= 0.0) & (u < 1.0)):
            worst = u[~((u >= 0.0) & (u < 1.0))].flat[0]
            raise SceneError(f"draws hold {worst:g}, limit 0 to below 1; give uniform numbers")
        arrays = _broadcast(_unit("incident", incident), _unit("normal", normal), u)
        shape = arrays[0].shape
        # A copy, since numpy 2.0 warns when numba asks whether a broadcast array is writeable.
        i, n, u = (np.array(a, order="C").reshape(-1, 3) for a in arrays)
        exitant, weight = np.empty_like(i), np.empty(len(i))
        brdf.samples(self.lobe_table(), i, n, u, exitant, weight)
        return exitant.reshape(shape), weight.reshape(shape[:-1])

    def albedo(self, theta: ArrayLike) -> Array:
        """Return the directional albedo: the fraction reflected of the power incident at ``theta``.

        Parameters
        ----------
        theta : array_like, (...)
            Angle of incidence, rad, 0 to pi/2.

        Returns
        -------
        ndarray, (...)
            Reflected fraction, in the shape of ``theta``. A closed form is used for `Lambert`, for
            `OrenNayar` with the model "fit", and for mirrors of zero slope. All other lobes are
            integrated numerically. The error is about 1e-9, or ``1e-16/(s cos(theta))^2`` if that
            is larger, with s the rms slope of the lobe.

        Raises
        ------
        SceneError
            If an angle is outside 0 to pi/2.
        """
        raise NotImplementedError


class MirrorLobe(Material):
    """Base class of glossy reflections: lobes centred on the mirror direction.

    A lobe is one part of a bidirectional reflectance. It counts as mirror-like if its rms slope is
    at most 0.1 rad, otherwise as diffuse.

    Attributes
    ----------
    slope_rms : float
        Standard deviation of the facets' slope along each axis, rad.

    See Also
    --------
    SpecularMicrofacet : Beckmann or GGX microfacets.
    Ward : Glossy lobe of Ward's model.
    """

    slope_rms: float

    @property
    def mirror_lobes(self) -> tuple[MirrorLobe, ...]:
        """Tuple with this lobe if it is mirror-like and reflects light, otherwise empty."""
        return (self,) if self.specular_reflectance > 0.0 else ()

    @property
    def diffuse(self) -> Material | None:
        """Diffuse part of the material: the lobe itself if it counts as diffuse, otherwise None.

        A lobe counts as diffuse if its rms slope exceeds 0.1 rad.
        """
        return None if self.slope_rms <= MIRROR_SLOPE else self


def _by_cosines(
    kernel: Any, lobes: Array, incident: ArrayLike, exitant: ArrayLike, normal: ArrayLike
) -> Array:
    """Return ``kernel(lobes, cosines)`` for arrays of directions, (...).

    An isotropic lobe depends only on the cosines normal-incident, normal-exitant and
    incident-exitant.
    """
    i, o, n = (np.asarray(v, dtype=np.float64) for v in (incident, exitant, normal))
    for name, direction in (("incident", i), ("exitant", o), ("normal", n)):
        _three(name, direction)
        if not np.isfinite(direction).all():
            raise SceneError(
                f"{name} holds NaN or infinity; give unit vectors that point away from the surface"
            )
    i, o, n = _broadcast(i, o, n)
    mu_i, mu_o, between = (dot(a, b) for a, b in ((i, n), (o, n), (i, o)))
    out = np.empty(mu_i.size)
    kernel(lobes, np.ravel(mu_i), np.ravel(mu_o), np.ravel(between), out)
    return out.reshape(mu_i.shape)


def _three(name: str, array: Array) -> None:
    """Raise `SceneError` unless the last axis has length 3."""
    if array.ndim == 0 or array.shape[-1] != 3:
        raise SceneError(f"{name} has shape {array.shape}, last axis must be 3; give (..., 3)")


def _broadcast(*arrays: Array) -> tuple[Array, ...]:
    """Broadcast arrays against each other; raise `SceneError` if their shapes do not match."""
    try:
        return np.broadcast_arrays(*arrays)
    except ValueError:
        shapes = ", ".join(str(a.shape) for a in arrays)
        raise SceneError(
            f"shapes {shapes} do not broadcast; give one vector or the same number of each"
        ) from None


def _unit(name: str, value: ArrayLike) -> Array:
    """Return an array (..., 3) after checking that its vectors have unit length to 1e-6."""
    array = np.asarray(value, dtype=np.float64)
    _three(name, array)
    length = np.sqrt(np.sum(array * array, axis=-1))
    wrong = ~(np.abs(length - 1.0) <= 1e-6)
    if wrong.any():
        first = float(length[wrong].flat[0])
        raise SceneError(f"{name} has length {first:g}, must be 1 to 1e-6; give unit vectors")
    return array


def check_angle(theta: ArrayLike) -> Array:
    """Return angles of incidence as an array, rad; raise `SceneError` outside 0 to pi/2."""
    theta = np.asarray(theta, dtype=np.float64)
    if not np.all((theta >= 0) & (theta <= math.pi / 2)):
        raise SceneError(f"theta = {theta!r} is out of range, must be 0 to pi/2 rad")
    return theta
