"""Vector diffraction at high aperture: Debye integral of a wave that obeys the sine condition.

The pupil coordinates over the image distance are direction cosines, so that each component of the
electric field is a Fourier transform of the pupil function times a real weight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, Literal

import ducc0
import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, one_of, real
from ...errors import SamplingError, SceneError
from ..aperture.aperture import Aperture
from ..aperture.cell_nodes import shared_cell_nodes
from ..wave.detilted import Residual
from ..window.window import Window
from . import costs, geometric, mdft, nufft, quadrature
from .runners import Result, Task, check_sampling, checked_grid, grid_bound

Array = NDArray[np.float64]
Polarisation = Literal["unpolarised", "x", "y"] | float

#: Methods that can transform the components of the field.
METHODS: Final = ("auto", "quadrature", "mdft", "nufft", "geometric")
#: Relative error to which the nodes resolve the weights near grazing directions.
WEIGHTS: Final = 1e-15


def check_polarisation(polarisation: Polarisation) -> Polarisation:
    """Check a polarisation; return ``"unpolarised"`` or the angle of the field from x to y, rad."""
    if not isinstance(polarisation, str):
        return real("polarisation", polarisation)
    one_of("polarisation", polarisation, ("unpolarised", "x", "y"))
    return {"x": 0.0, "y": math.pi / 2}.get(polarisation, "unpolarised")


def largest_sine(residual: Residual) -> float:
    """Return the sine of the half angle of the cone of light, over all lit nodes and the rim."""
    wave = residual.wavefront
    farthest = wave.pupil_radius
    if wave.aperture is not None:
        farthest = wave.aperture.bounding_radius
    if wave.layout in ("grid", "scattered"):
        lit = wave.amplitude * wave.weights > 0
        reach = math.sqrt(float((wave.u[lit] ** 2 + wave.v[lit] ** 2).max()))
        farthest = reach if wave.layout == "grid" else max(farthest, reach)
    return farthest / abs(wave.image_distance)


def check_cone(residual: Residual) -> float:
    """Return `largest_sine`; raise `SceneError` if it is not below 1."""
    sine = largest_sine(residual)
    if sine >= 1:
        wave = residual.wavefront
        raise SceneError(
            f"the pupil reaches {sine * abs(wave.image_distance):.4g} m from the axis at "
            f"F/{1 / (2 * sine):.3g}, limit F/0.5, where it is as wide as the wave's sphere of "
            f"radius |wavefront.image_distance| = {abs(wave.image_distance):.4g} m; use a smaller "
            "pupil or a larger image_distance"
        )
    return sine


def field_weights(a: Array, b: Array, polarisation: Polarisation) -> list[Array]:
    """Return the weights of the field's components at direction cosines (a, b).

    The sum of the squared transforms is the intensity. The factor ``cos^(-1/2)`` is the square root
    of the cosine that conserves energy on the sphere, over the cosine of the sphere's area.

    Parameters
    ----------
    a, b : ndarray
        Pupil coordinates over the image distance, of one shape.
    polarisation : "unpolarised" or float
        As returned by `check_polarisation`.

    Returns
    -------
    list of ndarray
        Five weights of an unpolarised wave, three of a polarised one, of the shape of a.
    """
    cosine = np.sqrt(1 - a**2 - b**2)
    root = 1 / np.sqrt(cosine)
    mean = root * (1 + cosine) / 2
    bend = root / (1 + cosine)
    along, across = bend * (a**2 - b**2) / 2, bend * a * b
    if isinstance(polarisation, str):
        half = math.sqrt(0.5) * root
        # Mean of two waves, polarised along x and y: the cross terms of their components cancel.
        return [mean, along, across, half * a, half * b]
    c, s = math.cos(polarisation), math.sin(polarisation)
    return [
        c * (mean - along) - s * across,
        s * (mean + along) - c * across,
        root * (c * a + s * b),
    ]


@dataclass(frozen=True, eq=False)
class Nodes:
    """Pupil nodes of a sum.

    Parameters
    ----------
    u, v, path : ndarray, (n,)
        Coordinates and residual aberration, m.
    size, energy : ndarray, (n,)
        Amplitude times area, and squared amplitude times area, m^2.
    """

    u: Array
    v: Array
    path: Array
    size: Array
    energy: Array

    def weights(self, distance: float, polarisation: Polarisation) -> list[Array]:
        """Return the weights of the field's components, (n,) each, at an image distance, m."""
        return field_weights(self.u / distance, self.v / distance, polarisation)

    def squares(
        self, residual: Residual, weights: list[Array], window: Window, epsilon: float
    ) -> Iterator[Array]:
        """Yield the squared modulus (ny, nx) of the transform of each weight.

        They are relative to the square of the unaberrated scalar field. ``epsilon`` is the
        requested error of the transform, relative in the rms sense.
        """
        size = self.size / self.size.sum()
        points, coord = nufft.node_phasors(residual, self.u, self.v, self.path, size, window)
        plan = ducc0.nufft.plan(
            nu2u=True, coord=coord, grid_shape=window.shape, epsilon=epsilon, nthreads=1
        )
        for weight in weights:
            field = plan.nu2u(forward=True, points=weight * points)
            yield field.real**2 + field.imag**2


def nodes_of(residual: Residual, window: Window) -> Nodes:
    """Return the nodes for a window: refined if they define a series, otherwise as given."""
    wave = residual.wavefront
    if not wave.is_spectral:
        return own_nodes(residual)
    counts = node_counts(residual, window)
    fits_memory(
        f"quadrature over {' x '.join(map(str, counts))} nodes to {window.shape[0]} x "
        f"{window.shape[1]} points",
        nufft.n_bytes(math.prod(counts), window) + 64.0 * math.prod(counts),
        "use a smaller shape",
    )
    u, v, weights = wave.nodes(*counts)
    path = np.zeros_like(u)
    if np.any(residual.aberration):
        path = residual.series.at_nodes(*counts)
    amplitude = np.full_like(u, wave.amplitude.flat[0])
    if not residual.is_uniform:
        amplitude = residual.amplitude_series.at_nodes(*counts)
    return _gathered(u, v, path, amplitude, weights)


def own_nodes(residual: Residual) -> Nodes:
    """Return the lit nodes of the wave."""
    wave = residual.wavefront
    lit = wave.amplitude * wave.weights > 0
    return _gathered(
        wave.u[lit],
        wave.v[lit],
        residual.aberration[lit],
        wave.amplitude[lit],
        wave.weights[lit],
    )


def _gathered(u: Array, v: Array, path: Array, amplitude: Array, weights: Array) -> Nodes:
    """Return nodes of any shape as flat arrays."""
    size = (amplitude * weights).ravel()
    return Nodes(u.ravel(), v.ravel(), path.ravel(), size, amplitude.ravel() * size)


def node_counts(residual: Residual, window: Window) -> tuple[int, ...]:
    """Return the shape of the nodes that also resolve the weights' singularity at grazing.

    A function with a singularity at z > 1 is integrated over -1..1 by n Gauss-Legendre nodes with
    an error of about ``(z + sqrt(z^2 - 1))^(-2 n)``.
    """
    counts = quadrature.node_counts(residual, window)
    sine = largest_sine(residual)
    if residual.wavefront.layout == "polar":
        return counts[0] + _more(2 / sine**2 - 1), counts[1] + 4
    gap = (1 / sine - 1) * residual.aperture.bounding_radius
    more = [_more(1 + 2 * gap / size) for size in residual.aperture.patch_size]
    return counts[0], counts[1] + more[0], counts[2] + more[1]


def _more(z: float) -> int:
    """Return the number of further nodes for a singularity at z."""
    return math.ceil(-math.log(WEIGHTS) / (2 * math.log(z + math.sqrt(z * z - 1))))


def levels(distance: float, nodes: Nodes, weights: list[Array]) -> tuple[float, float]:
    """Return the ideal peak, relative to the scalar one, and the mean of 1/cos over the energy.

    The energy in the image plane is the squared field's integral, by Parseval's theorem the
    transmitted energy times this mean. ``distance`` is that of the image, m.
    """
    share = nodes.size / nodes.size.sum()
    peak = sum(float(np.sum(share * weight)) ** 2 for weight in weights)
    cosine = np.sqrt(1 - (nodes.u**2 + nodes.v**2) / distance**2)
    return peak, float(np.sum(nodes.energy / cosine) / np.sum(nodes.energy))


@lru_cache(maxsize=16)
def cell_levels(aperture: Aperture, n_s: int, n_t: int, distance: float) -> tuple[float, float]:
    """Return `levels` of an unpolarised wave of uniform amplitude on the nodes of an aperture.

    ``n_s`` and ``n_t`` are the nodes along both sides of each patch.
    """
    u, v, weights = (part.ravel() for part in shared_cell_nodes(aperture, n_s, n_t))
    nodes = Nodes(u, v, np.zeros_like(u), weights, weights)
    return levels(distance, nodes, nodes.weights(distance, "unpolarised"))


def predicted_seconds(task: Task, polarisation: Polarisation) -> float:
    """Predict the run time of `transform` on one core, s."""
    wave = task.residual.wavefront
    number = 5 if isinstance(polarisation, str) else 3
    if wave.layout == "grid":
        return number * costs.map_chirp(task.residual, task.samples)
    count = wave.u.size
    if wave.is_spectral:
        count = math.prod(node_counts(task.residual, task.samples))
    return number * costs.sum_over_nodes(count, task.samples)


def transform(task: Task, method: str, polarisation: Polarisation) -> Result:
    """Compute the intensity of a vector wave and its error bound.

    Parameters
    ----------
    task : Task
        Wave and window.
    method : str
        One of `METHODS`; ``auto`` takes the sum that suits the layout.
    polarisation : "unpolarised" or float
        As returned by `check_polarisation`.

    Returns
    -------
    Result

    Raises
    ------
    SamplingError
        If the method does not suit the layout, or the wave is sampled too coarsely.
    """
    layout = task.residual.wavefront.layout
    own = {"grid": "mdft", "scattered": "nufft"}.get(layout, "quadrature")
    if method == "geometric":
        return _geometric(task, polarisation)
    if method not in ("auto", own):
        raise SamplingError(
            f"method = '{method}' for the high-aperture model of a wavefront of layout '{layout}'; "
            f"use method='{own}' or 'auto'"
        )
    return _by_grid(task, polarisation) if own == "mdft" else _by_nodes(task, own, polarisation)


def _by_nodes(task: Task, method: str, polarisation: Polarisation) -> Result:
    """Sum over polar, cell or scattered nodes."""
    residual, samples = task.residual, task.samples
    spectral = residual.wavefront.is_spectral
    if not spectral:
        check_sampling(task)
    nodes = nodes_of(residual, samples)
    # Coarser than `nufft.epsilon` for small sums, since there are several
    epsilon = max(nufft.BEST, min(nufft.FAST, task.tol / 100))
    weights = nodes.weights(residual.wavefront.image_distance, polarisation)
    peak, secant = levels(residual.wavefront.image_distance, nodes, weights)
    mean = _mean(task, nodes, weights, epsilon) / peak
    rounding = task.transform_error(mean, epsilon) * _gain(task, peak)
    if spectral:
        lost = residual.truncation * _gain(task, peak)
        error = task.bound(mean, lost, lost**2)
    else:
        error = _scattered_error(task, nodes, mean, peak, secant, polarisation, epsilon)
    return Result(method, mean, error + rounding, task.level * peak / secant)


def _scattered_error(
    task: Task,
    nodes: Nodes,
    mean: Array,
    peak: float,
    secant: float,
    polarisation: Polarisation,
    epsilon: float,
) -> float:
    """Bound the error of scattered nodes by comparison with polar nodes of the same wave."""
    residual = task.residual
    u, v, areas, path, amplitude, doubt = nufft.reference_nodes(residual, task.samples)
    better = _gathered(u, v, path, amplitude, areas)
    distance = residual.wavefront.image_distance
    weights = better.weights(distance, polarisation)
    true_peak, true_secant = levels(distance, better, weights)
    truth = _mean(task, better, weights, epsilon) / true_peak
    # factors for the three normalisations: ideal-peak, flux, unit-sum
    flux = (better.size.sum() / nodes.size.sum()) ** 2 * (true_peak * secant / true_secant / peak)
    factors = (1.0, flux, flux * nodes.energy.sum() / better.energy.sum())
    worst = max(float(np.abs(truth * factor - mean).max()) for factor in factors)
    lost = residual.wavenumber * float(np.sum(better.size * doubt)) / float(better.size.sum())
    lost *= _gain(task, peak)
    return 1.2 * worst / float(mean.max()) + task.bound(mean, lost, lost**2)


def _mean(task: Task, nodes: Nodes, weights: list[Array], epsilon: float) -> Array:
    """Return the intensity of a sum over nodes, averaged over pixels if the task requires it."""
    fine = np.zeros(task.samples.shape)
    for square in nodes.squares(task.residual, weights, task.samples, epsilon):
        fine += square
    return task.averaged(fine)


def _gain(task: Task, peak: float) -> float:
    """Return the largest weight of a node relative to the square root of the ideal peak."""
    return 1 / math.sqrt(peak * math.sqrt(1 - check_cone(task.residual) ** 2))


def _by_grid(task: Task, polarisation: Polarisation) -> Result:
    """Transform the grid of a grid wavefront, once for each component."""
    residual, samples = task.residual, task.samples
    grid = checked_grid(task)
    n = grid.values.shape[0]
    fits_memory(
        f"the transform of {n} samples to {samples.shape[0]} x {samples.shape[1]}",
        48.0 * n * (n + max(samples.shape)) + 64.0 * n * n,
        "use a smaller shape",
    )
    nodes, wave = nodes_of(residual, samples), residual.wavefront
    weights = nodes.weights(wave.image_distance, polarisation)
    peak, secant = levels(wave.image_distance, nodes, weights)
    lit = wave.amplitude * wave.weights > 0
    mean = np.zeros(task.shape)
    for weight in weights:
        values = np.zeros_like(grid.values)
        values[lit] = grid.values[lit] * weight
        mean += mdft.intensity_in(residual, replace(grid, values=values), samples, task.rule)
    mean /= peak
    error = grid_bound(task, mean, grid) * _gain(task, peak) ** 2
    return Result("mdft", mean, error, task.level * peak / secant)


def _geometric(task: Task, polarisation: Polarisation) -> Result:
    """Compute the density of rays, each with its energy times 1/cos."""
    if task.rule is None:
        raise SamplingError(
            "rays give the energy per pixel, not the intensity at points; use pixel_integrated=True"
        )
    residual = task.residual
    wave = residual.wavefront
    square = (wave.u**2 + wave.v**2) / wave.image_distance**2
    # Unlit samples outside the cone stay dark.
    amplitude = wave.amplitude * np.maximum(1 - square, 1e-12) ** -0.25
    bright = replace(residual, wavefront=replace(wave, amplitude=amplitude))
    energy, error = geometric.density(bright, task.pixels)
    nodes = nodes_of(residual, task.pixels)
    distance = wave.image_distance
    peak, secant = levels(distance, nodes, nodes.weights(distance, polarisation))
    level = task.level * peak / secant
    return Result("geometric", energy / level, error, level)
