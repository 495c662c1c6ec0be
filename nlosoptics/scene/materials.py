"""How surfaces scatter: bidirectional reflectance as a sum of lobes.

Directions are unit vectors that point away from the surface, incident and exitant alike.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import in_range, one_of
from ..errors import SceneError

Array = NDArray[np.float64]
LAMBERT, OREN_NAYAR, OREN_NAYAR_FULL, BECKMANN = range(4)  # kinds of lobe, as in _kernels


class Material:
    """Base of all materials."""

    def _lobes(self) -> Array:
        """Rows (kind, strength, slope rms, factor) of the compiled sum."""
        raise NotImplementedError

    @property
    def specular_reflectance(self) -> float:
        """Share of the incident power that mirror-like lobes return, 0 to 1."""
        return 0.0

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
        from . import _kernels

        i, o, n = (np.asarray(v, dtype=np.float64) for v in (incident, exitant, normal))
        mu_i, mu_o, between = np.broadcast_arrays(
            np.sum(i * n, axis=-1), np.sum(o * n, axis=-1), np.sum(i * o, axis=-1)
        )
        out = np.empty(mu_i.size)
        _kernels.evaluate(self._lobes(), np.ravel(mu_i), np.ravel(mu_o), np.ravel(between), out)
        return out.reshape(mu_i.shape)

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


def _check_angle(theta: ArrayLike) -> Array:
    theta = np.asarray(theta, dtype=np.float64)
    if not np.all((theta >= 0) & (theta <= math.pi / 2)):
        raise SceneError(f"theta = {theta!r} is out of range, must be 0 to pi/2 rad")
    return theta


def _panels(edges: ArrayLike) -> tuple[Array, Array]:
    """Gauss-Legendre nodes and weights on the panels between ``edges`` (n, ...), along axis 0."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    edges = np.asarray(edges, dtype=np.float64)
    middles, halves = (edges[1:] + edges[:-1]) / 2, np.diff(edges, axis=0) / 2
    points = middles[:, None] + np.multiply.outer(nodes, halves).swapaxes(0, 1)
    heavy = np.multiply.outer(weights, halves).swapaxes(0, 1)
    return points.reshape(-1, *edges.shape[1:]), heavy.reshape(-1, *edges.shape[1:])


def _directional_albedo(material: Material, theta: Array, integral: Any) -> Array:
    """Int f cos dOmega at every theta, by ``integral(material, theta)`` for one."""
    return np.array([integral(material, t) for t in theta.ravel().tolist()]).reshape(theta.shape)


def _over_exitant_angles(material: Material, theta: float) -> float:
    """Directional albedo of a wide lobe with kinks at its mirror angle and across the plane."""
    edges = theta + 0.05 * np.array([-20.0, -8, -3, -1, 0, 1, 3, 8, 20])
    edges = np.concatenate([[0.0], edges[(edges > 0) & (edges < math.pi / 2)], [math.pi / 2]])
    polar, polar_weights = _panels(edges)
    # one side of the plane of incidence, doubled
    turn, turn_weights = _panels([0.0, 0.05, 0.15, 0.5, math.pi / 2, math.pi])
    p, a = np.meshgrid(polar, turn, indexing="ij")
    exitant = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=-1)
    incident = (math.sin(theta), 0.0, math.cos(theta))
    f = material.evaluate(incident, exitant, (0.0, 0.0, 1.0))
    return 2 * float((f * np.sin(p) * np.cos(p) * polar_weights[:, None] * turn_weights).sum())


def _over_slopes(material: SpecularMicrofacet, theta: float) -> float:
    """Directional albedo of a mirror-like lobe, over the slopes (p, q) of its facets.

    Facet (-p, -q, 1) sends the light to the exitant o, ``dOmega_o = 4 (i.h) cos^3(h) dp dq``. Those
    that send it below the horizon lie outside a circle of radius 1/cos about (-tan, 0).
    """
    sine, cosine = math.sin(theta), math.cos(theta)
    reach = 8.5 * material.slope_rms  # exp(-36) beyond
    # q = sin(turn)/cos, which takes the root out of the circle's ends
    turn, turn_weights = _panels(np.linspace(0.0, math.asin(min(1.0, reach * cosine)), 5))
    q, q_weights = np.sin(turn) / cosine, np.cos(turn) / cosine * turn_weights
    # cos(turn)/cos - tan, free of cancellation at grazing
    top = (1 - q * q) * cosine / (np.cos(turn) + sine)
    bottom = -(np.cos(turn) + sine) / cosine
    limits = np.clip(bottom, -reach, reach), np.clip(top, -reach, reach)
    p, p_weights = _panels(np.linspace(*limits, 5))
    facet = np.stack(np.broadcast_arrays(-p, -q, 1.0), axis=-1)
    cos_h = 1 / np.linalg.norm(facet, axis=-1)
    half = facet * cos_h[..., None]
    incident = np.array([sine, 0.0, cosine])
    along = half @ incident
    exitant = 2 * along[..., None] * half - incident
    f = material.evaluate(incident, exitant, (0.0, 0.0, 1.0))
    integrand = f * np.maximum(exitant[..., 2], 0.0) * 4 * along * cos_h**3
    return 2 * float((integrand * p_weights * q_weights).sum())


@cache
def _largest_albedo(rho: float, slope_rms: float, model: str) -> float:
    """Largest directional albedo of an Oren-Nayar lobe, the one at grazing incidence."""
    return float(OrenNayar(rho, slope_rms, model=model).albedo(math.pi / 2))


@dataclass(frozen=True, init=False)
class Lambert(Material):
    """Ideal diffuse reflector, f_r = albedo/pi.

    Parameters
    ----------
    albedo : float
        Reflected share of the incident power, 0 to 1; kept as ``rho``.
    """

    rho: float

    def __init__(self, albedo: float) -> None:
        object.__setattr__(self, "rho", in_range("albedo", albedo, 0.0, 1.0))

    def _lobes(self) -> Array:
        return np.array([[LAMBERT, self.rho, 0.0, 1.0]])

    def albedo(self, theta: ArrayLike) -> Array:
        """Directional albedo, the same at every angle ``theta``, rad."""
        return np.full(_check_angle(theta).shape, self.rho)


@dataclass(frozen=True, init=False)
class OrenNayar(Material):
    """Rough diffuse reflector of V-grooves.

    Parameters
    ----------
    albedo : float
        Diffuse albedo of the facets, 0 to 1; kept as ``rho``.
    slope_rms : float
        Standard deviation of the facet tilt, rad, 0 to 1; 0 is Lambert.
    model : {"fit", "full"}
        Qualitative fit with interreflection [1]_, or the full single-bounce model [2]_ with the
        same interreflection.
    normalised : bool
        Divide by the largest directional albedo where that exceeds 1: the fit does not conserve
        energy for albedos above 0.933.

    References
    ----------
    .. [1] Wolff, Nayar and Oren, Int. J. Comput. Vis. 30, 55 (1998), as used by Wu et al.,
       Adv. Photon. Nexus 3, 026010 (2024), eq. 4.
    .. [2] Oren and Nayar, SIGGRAPH 1994, 239.
    """

    rho: float
    slope_rms: float
    _: KW_ONLY
    model: str = "fit"
    normalised: bool = False

    def __init__(
        self, albedo: float, slope_rms: float, *, model: str = "fit", normalised: bool = False
    ) -> None:
        object.__setattr__(self, "rho", in_range("albedo", albedo, 0.0, 1.0))
        object.__setattr__(
            self, "slope_rms", in_range("slope_rms", slope_rms, 0.0, 1.0, unit="rad")
        )
        object.__setattr__(self, "model", one_of("model", model, ("fit", "full")))
        object.__setattr__(self, "normalised", bool(normalised))

    def _lobes(self) -> Array:
        kind = OREN_NAYAR if self.model == "fit" else OREN_NAYAR_FULL
        return np.array([[kind, self.rho, self.slope_rms, 1.0 / self._excess()]])

    def _excess(self) -> float:
        """Largest directional albedo, when it is to be divided out, else 1."""
        if not self.normalised:
            return 1.0
        return max(1.0, _largest_albedo(self.rho, self.slope_rms, self.model))

    def albedo(self, theta: ArrayLike) -> Array:
        """Directional albedo at ``theta``, rad: closed form of the fit, quadrature of the full."""
        t = _check_angle(theta)
        if self.model == "full":
            return _directional_albedo(self, t, _over_exitant_angles)
        s2 = self.slope_rms**2
        sine, cosine = np.sin(t), np.cos(t)
        # 1 - sin^3 = cos^2 (1 + sin + sin^2)/(1 + sin), so that tan stays finite
        cap = (2 / 3) * sine * cosine * (1 + sine + sine**2) / (1 + sine)
        bracket = sine * (t - sine * cosine) + cap
        direct = 1 - 0.5 * s2 / (s2 + 0.33) + 0.45 * s2 / (s2 + 0.09) / math.pi * bracket
        total = self.rho * direct + 0.17 * self.rho**2 * s2 / (s2 + 0.13)
        return np.asarray(total / self._excess())


@dataclass(frozen=True)
class SpecularMicrofacet(Material):
    """Mirror-like lobe of microfacets with Beckmann slopes and separable Smith shadowing.

    Parameters
    ----------
    reflectance : float
        Fresnel reflectance of a facet, taken the same at every angle, 0 to 1.
    slope_rms : float
        Standard deviation of the facet slope per axis, rad, 0 to 0.7; 0 is a smooth mirror.
        Beckmann's alpha is sqrt(2) times this.

    References
    ----------
    .. [1] Walter et al., Microfacet models for refraction through rough surfaces, EGSR 2007.
    """

    reflectance: float
    slope_rms: float

    def __post_init__(self) -> None:
        for name, high in (("reflectance", 1.0), ("slope_rms", 0.7)):
            object.__setattr__(self, name, in_range(name, getattr(self, name), 0.0, high))

    def _lobes(self) -> Array:
        return np.array([[BECKMANN, self.reflectance, self.slope_rms, 1.0]])

    @property
    def specular_reflectance(self) -> float:
        """The reflectance."""
        return self.reflectance

    @property
    def diffuse(self) -> Material | None:
        """None: the whole material is one mirror-like lobe."""
        return None

    def albedo(self, theta: ArrayLike) -> Array:
        """Directional albedo at ``theta``, rad; a smooth mirror returns its reflectance."""
        t = _check_angle(theta)
        if self.slope_rms == 0.0:
            return np.full(t.shape, self.reflectance)
        return _directional_albedo(self, t, _over_slopes)


@dataclass(frozen=True, init=False)
class SumMaterial(Material):
    """Sum of materials, such as a diffuse body under a faint gloss.

    Parameters
    ----------
    *parts : Material
        Summands, those of a sum in its stead; their albedos may add to at most 1.
    """

    parts: tuple[Material, ...]

    def __init__(self, *parts: Any) -> None:
        if len(parts) == 1 and isinstance(parts[0], (list, tuple)):
            parts = tuple(parts[0])
        if not parts or not all(isinstance(p, Material) for p in parts):
            raise SceneError(f"SumMaterial got {parts!r}; give at least one material")
        flat = [q for p in parts for q in (p.parts if isinstance(p, SumMaterial) else (p,))]
        object.__setattr__(self, "parts", tuple(flat))
        total = sum(getattr(p, "rho", p.specular_reflectance) for p in self.parts)
        if total > 1.0 + 1e-12:
            raise SceneError(
                f"the material's albedos add to {total:g}, limit 1; lower one of its lobes"
            )

    def _lobes(self) -> Array:
        return np.concatenate([part._lobes() for part in self.parts])

    @property
    def specular_reflectance(self) -> float:
        """Sum over the mirror-like parts."""
        return sum(part.specular_reflectance for part in self.parts)

    @property
    def diffuse(self) -> Material | None:
        """The parts that are not mirror-like."""
        parts = [part for part in self.parts if part.diffuse is not None]
        return SumMaterial(*parts) if parts else None

    def albedo(self, theta: ArrayLike) -> Array:
        """Directional albedo at ``theta``, rad."""
        return np.asarray(sum(part.albedo(theta) for part in self.parts))
