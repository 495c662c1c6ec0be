"""One page on the optics of a scene: wave, point spread, spots, contrast, energy and focus."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from .._checks import expect, whole
from .canvas import BLUE, GREY, VERMILION, few_ticks, new_axes
from .curves import spot_diagram, through_focus
from .maps import point_spread, wavefront

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..psf import ScenePointSpread

Tables = dict[str, tuple[str, NDArray[np.float64]]]


def analysis(optics: ScenePointSpread, *, samples: int = 41) -> tuple[Figure, Tables]:
    """Draw the optical analysis of one object point, and return the numbers behind the curves.

    Parameters
    ----------
    optics : ScenePointSpread
        Wave and point spread of a scene, from `nlosoptics.psf.scene_point_spread`.
    samples : int
        Number of points of each curve, at least 3.

    Returns
    -------
    figure : Figure
        Wave aberration, point spread of this wave without pixels, spot diagram, MTF along x and y,
        encircled energy, and Strehl ratio through focus.
    tables : dict of str to (str, ndarray)
        For each of "mtf", "encircled_energy", "through_focus" and "zernikes" a header with names
        and units, separated by commas, and the columns. Zernike coefficients are those of Noll 1
        to 21.

    Raises
    ------
    SamplingError
        If the wave is sampled on a layout without one of these metrics.

    See Also
    --------
    nlosoptics.psf.mtf, nlosoptics.psf.encircled_energy, nlosoptics.psf.through_focus
    nlosoptics.psf.spot_diagram, nlosoptics.psf.fit_zernike

    Examples
    --------
    >>> from nlosoptics import Scene, psf, views
    >>> scene = Scene.load("examples/scenes/letter_wavy.toml").resized(64)
    >>> figure, tables = views.analysis(psf.scene_point_spread(scene), samples=5)
    >>> print(tables["mtf"][0])
    frequency (1/mm),contrast along x,contrast along y,without aberration
    """
    from .. import psf

    whole("samples", samples, 3)
    wave = expect("optics", optics, "ScenePointSpread").wavefront
    spots, fine = psf.spot_diagram(wave), psf.point_spread(wave)
    cutoff = 1.0 / (wave.wavelength * wave.f_number)
    share = np.linspace(0.0, 1.0, samples)
    # blur of this radius leaves no contrast beyond its reciprocal
    frequencies = share * min(cutoff, 1.0 / max(spots.radius, 1.0 / cutoff))
    contrast = [psf.mtf(wave, frequencies, azimuth=angle) for angle in (0.0, 0.5 * np.pi)]
    part = frequencies / cutoff
    ideal = (np.arccos(part) - part * np.sqrt(1.0 - part**2)) * 2.0 / np.pi
    window = 0.45 * fine.pitch * min(fine.intensity.shape)
    radii = share[1:] * min(3.0 * max(spots.radius, spots.airy_radius), window)
    energy = psf.encircled_energy(fine, radii)
    # a quarter wave of defocus at the rim is 2 lambda N^2
    focus = psf.best_focus(wave)
    reach = 4.0 * wave.wavelength * wave.f_number**2 + abs(focus)
    strehls = psf.through_focus(wave, focus + (2.0 * share - 1.0) * reach)
    terms = psf.fit_zernike(wave, 21)
    axes = new_axes(6, width=15.0, height=9.0, columns=3)
    wavefront(wave, axes=axes[0])
    point_spread(fine, axes=axes[1])
    spot_diagram(spots, axes=axes[2])
    for values, name, colour in zip(contrast, ("x", "y"), (BLUE, VERMILION), strict=True):
        axes[3].plot(1e-3 * frequencies, values, color=colour, label=f"along {name}")
    axes[3].plot(1e-3 * frequencies, ideal, color=GREY, label="without aberration")
    axes[3].set(xlabel="frequency (cycles/mm)", ylabel="contrast", title="MTF", ylim=(0, 1))
    axes[4].plot(1e6 * radii, energy, color=BLUE)
    axes[4].set(xlabel="radius (µm)", ylabel="share", title="encircled energy", ylim=(0, 1))
    through_focus(strehls, axes=axes[5])
    axes[3].legend()
    for some in axes[3:5]:
        few_ticks(some)
        some.grid(alpha=0.25)
    tables: Tables = {
        "mtf": (
            "frequency (1/mm),contrast along x,contrast along y,without aberration",
            np.column_stack([1e-3 * frequencies, *contrast, ideal]),
        ),
        "encircled_energy": ("radius (um),share", np.column_stack([1e6 * radii, energy])),
        "through_focus": (
            "shift of the image plane (mm),strehl",
            np.column_stack([1e3 * strehls.shifts, strehls.values]),
        ),
        "zernikes": ("noll,coefficient (nm)", np.array([[k, 1e9 * c] for k, c in terms.items()])),
    }
    return cast("Figure", axes[0].figure), tables
