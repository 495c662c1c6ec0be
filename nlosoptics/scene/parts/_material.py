"""What all materials share: lobes that compiled kernels evaluate and draw from."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import SceneError

Array = NDArray[np.float64]
#: Lobes of at most this slope rms, rad, are mirror-like: imaged as smooth.
MIRROR_SLOPE = 0.1


class Material:
    """Base of all materials."""

    def lobe_table(self) -> Array:
        """Lobes as the kernels take them, (n, 4): kind, strength, slope rms or alpha, factor."""
        raise NotImplementedError

    @property
    def specular_reflectance(self) -> float:
        """Share of the incident power that mirror-like lobes return, 0 to 1.

        Lobes are mirror-like up to a slope rms of 0.1 rad. That is 11 deg of spread in the
        reflected light: rougher lobes pass no picture and count as diffuse.
        """
        return 0.0

    @property
    def mirror_lobes(self) -> tuple[MirrorLobe, ...]:
        """The parts that `specular_reflectance` counts, those that reflect nothing left out."""
        return ()

    @property
    def diffuse(self) -> Material | None:
        """The material without its mirror-like lobes; None when nothing is left."""
        return self

    def evaluate(self, incident: ArrayLike, exitant: ArrayLike, normal: ArrayLike) -> Array:
        """Bidirectional reflectance f_r, 1/sr.

        Parameters
        ----------
        incident, exitant, normal : array_like, (..., 3)
            Unit vectors away from the surface, in one frame; shapes broadcast.

        Returns
        -------
        ndarray, (...)
            Zero where either direction is below the surface. Lobes of zero slope are mirrors, a
            delta function that contributes to `specular_reflectance` and not here.
        """
        from ...kernels import brdf

        return _by_cosines(brdf.evaluate, self.lobe_table(), incident, exitant, normal)

    def pdf(self, incident: ArrayLike, exitant: ArrayLike, normal: ArrayLike) -> Array:
        """Density of `sample` per solid angle of the exitant direction, 1/sr.

        Parameters
        ----------
        incident, exitant, normal : array_like, (..., 3)
            Unit vectors away from the surface, in one frame; shapes broadcast.

        Returns
        -------
        ndarray, (...)
            Integrates to 1 over the whole sphere, less the share of lobes of zero slope: facets
            may send a sample below the surface. Zero where the incident direction is below it.
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
        """Draw exitant directions.

        Parameters
        ----------
        incident, normal : array_like, (..., 3)
            Unit vectors away from the surface, in one frame; shapes broadcast with ``draws``.
        draws : array_like, (..., 3)
            Independent uniform numbers in [0, 1): two for the direction, one for the lobe.

        Returns
        -------
        exitant : ndarray, (..., 3)
            Unit vectors, of density `pdf`.
        weight : ndarray, (...)
            f_r cos(theta) over the density, whose mean is the directional albedo. Zero for
            exitants below the surface, and for all where the incident direction is below it.

        Notes
        -----
        Lambert and Oren-Nayar are drawn by the cosine about the normal, Ward by its half vector
        (Walter, Notes on the Ward BRDF, 2005), microfacets by their visible normals (Heitz and
        d'Eon 2014, Heitz 2018), mirrors as they are, and sums one lobe at a time in proportion to
        albedo, with the weight of all of them.
        """
        from ...kernels import brdf

        u = np.asarray(draws, dtype=np.float64)
        _three("draws", u)
        if not np.all((u >= 0.0) & (u < 1.0)):
            worst = u[~((u >= 0.0) & (u < 1.0))].flat[0]
            raise SceneError(f"draws hold {worst:g}, limit 0 to below 1; give uniform numbers")
        arrays = _broadcast(_unit("incident", incident), _unit("normal", normal), u)
        shape = arrays[0].shape
        i, n, u = (np.ascontiguousarray(a).reshape(-1, 3) for a in arrays)
        exitant, weight = np.empty_like(i), np.empty(len(i))
        brdf.samples(self.lobe_table(), i, n, u, exitant, weight)
        return exitant.reshape(shape), weight.reshape(shape[:-1])

    def albedo(self, theta: ArrayLike) -> Array:
        """Directional albedo: reflected share of light that arrives at ``theta``.

        Parameters
        ----------
        theta : array_like
            Angle of incidence, rad, 0 to pi/2.

        Returns
        -------
        ndarray, shape of theta
            Closed forms where they exist, else quadrature to about 1e-9 (mirror-like lobes of
            slope rms s: 1e-16/(s cos theta)^2 where that is more).
        """
        raise NotImplementedError


class MirrorLobe(Material):
    """Base of lobes about the mirror direction: mirror-like up to a slope rms of 0.1 rad.

    Attributes
    ----------
    slope_rms : float
        Standard deviation of the facet slope per axis, rad.
    """

    slope_rms: float

    @property
    def mirror_lobes(self) -> tuple[MirrorLobe, ...]:
        """The lobe itself where it is mirror-like and reflects something."""
        return (self,) if self.specular_reflectance > 0.0 else ()

    @property
    def diffuse(self) -> Material | None:
        """None for a mirror-like lobe, which is the whole material; else the material."""
        return None if self.slope_rms <= MIRROR_SLOPE else self


def _by_cosines(
    kernel: Any, lobes: Array, incident: ArrayLike, exitant: ArrayLike, normal: ArrayLike
) -> Array:
    """Fill an array by a kernel of the three cosines that an isotropic lobe depends on."""
    i, o, n = (np.asarray(v, dtype=np.float64) for v in (incident, exitant, normal))
    for name, direction in (("incident", i), ("exitant", o), ("normal", n)):
        _three(name, direction)
        if not np.isfinite(direction).all():
            raise SceneError(f"{name} is not finite; give unit vectors away from the surface")
    i, o, n = _broadcast(i, o, n)
    mu_i, mu_o, between = (np.sum(a * b, axis=-1) for a, b in ((i, n), (o, n), (i, o)))
    out = np.empty(mu_i.size)
    kernel(lobes, np.ravel(mu_i), np.ravel(mu_o), np.ravel(between), out)
    return out.reshape(mu_i.shape)


def _three(name: str, array: Array) -> None:
    if array.ndim == 0 or array.shape[-1] != 3:
        raise SceneError(f"{name} has shape {array.shape}, last axis must be 3; give (..., 3)")


def _broadcast(*arrays: Array) -> tuple[Array, ...]:
    try:
        return np.broadcast_arrays(*arrays)
    except ValueError:
        shapes = ", ".join(str(a.shape) for a in arrays)
        raise SceneError(f"shapes {shapes} do not broadcast; give one or n of each") from None


def _unit(name: str, value: ArrayLike) -> Array:
    array = np.asarray(value, dtype=np.float64)
    _three(name, array)
    length = np.sqrt(np.sum(array * array, axis=-1))
    wrong = ~(np.abs(length - 1.0) <= 1e-6)
    if wrong.any():
        first = float(length[wrong].flat[0])
        raise SceneError(f"{name} has length {first:g}, must be 1 to 1e-6; give unit vectors")
    return array


def check_angle(theta: ArrayLike) -> Array:
    """Angles of incidence as an array, rad."""
    theta = np.asarray(theta, dtype=np.float64)
    if not np.all((theta >= 0) & (theta <= math.pi / 2)):
        raise SceneError(f"theta = {theta!r} is out of range, must be 0 to pi/2 rad")
    return theta
