"""Camera images at several wavelengths, traced by the same rays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import whole
from ..._nouns import Noun
from ..._progress import Progress
from ...errors import SceneError
from ...scene import Scene
from ..light.trace import MOST
from .trace_image import TracedImage, trace_image

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class ColourTraces(Noun):
    """Traced images at several wavelengths, as `trace_colours` returns them.

    Parameters
    ----------
    wavelengths : tuple of float
        Wavelengths of the laser, m.
    each : tuple of TracedImage
        Image at each wavelength.

    See Also
    --------
    trace_colours : Images at several wavelengths.
    """

    wavelengths: tuple[float, ...]
    each: tuple[TracedImage, ...]

    def ratio(self, index: int, to: int = 0) -> tuple[float, float]:
        """Return the ratio of the object's light at two wavelengths, and its standard error.

        Parameters
        ----------
        index, to : int
            Wavelengths of numerator and denominator, as positions in ``wavelengths``.

        Returns
        -------
        ratio : float
            Ratio of the powers ``each[index].paths.flux`` and ``each[to].paths.flux``.
        error : float
            Its standard error, which takes into account that the rays are the same.

        Raises
        ------
        SceneError
            If no light of the object was detected at the wavelength ``to``.
        """
        rays = self.each[to].paths.n_rays
        one, other = (self.each[k].group_power[: min(rays, 32)] for k in (index, to))
        count, mean = len(one), float(other.mean())
        if mean <= 0.0:
            raise SceneError(
                f"no light of the object was detected at {1e9 * self.wavelengths[to]:.6g} nm, but "
                "a ratio needs a power above 0; give another wavelength or more rays"
            )
        ratio = float(one.mean()) / mean
        if count < 4:
            return ratio, math.inf
        # the factor of Student's distribution as for all other errors
        spread = float(((one - ratio * other) ** 2).sum()) / (count * (count - 3))
        return ratio, math.sqrt(spread) / mean


def trace_colours(
    scene: Scene,
    wavelengths: Sequence[float],
    *,
    n_rays: int = 1 << 16,
    max_bounces: int = 5,
    t_start: float | None = None,
    delta_t: float | None = None,
    n_bins: int | None = None,
    outer_legs: bool = True,
    exposure: float | None = None,
    sampler: Literal["sobol", "philox"] = "sobol",
    seed: int = 0,
    progress: Progress | None = None,
) -> ColourTraces:
    """Compute the camera image at several wavelengths by Monte Carlo ray tracing.

    The laser has its power at each wavelength in turn. Materials whose albedo is a
    `nlosoptics.scene.Spectrum` are evaluated at this wavelength.

    Parameters
    ----------
    scene : Scene
        Scene to trace; the wavelength of its laser is not used.
    wavelengths : sequence of float
        Vacuum wavelengths, m.
    n_rays : int
        Number of rays for each wavelength.
    max_bounces : int, default 5
        Largest number of reflections, 1 to 64. Three correspond to wall, object, wall.
    t_start, delta_t : float, optional
        Start of bin 0 and width of a bin of the histogram, m of optical path.
    n_bins : int, optional
        Number of bins of the histogram; see `trace_image`.
    outer_legs : bool
        Whether path lengths in the histogram include the legs from the laser and to the lens.
    exposure : float, optional
        Exposure time of the expected electrons, s; by default the camera's.
    sampler : {"sobol", "philox"}
        ``"sobol"``: scrambled Sobol points, which usually give less noise. ``"philox"``:
        independent random numbers.
    seed : int
        Seed of the random numbers, 0 to 2^64 - 1.
    progress : callable(str, float), optional
        Called with ``"rays"`` and the completed fraction, 0 to 1.

    Returns
    -------
    ColourTraces
        Image at each wavelength, and ratios between them.

    Raises
    ------
    SceneError
        If an option is out of range, no wavelength is given, a spectrum does not include a
        wavelength, or a part of the scene is behind the wall.
    MemoryLimitError
        If the sums of an image would not fit in memory.

    See Also
    --------
    trace_image : Image at the wavelength of the scene's laser.
    nlosoptics.scene.Spectrum : Albedo that depends on the wavelength.

    Notes
    -----
    Each image is that of `trace_image` for the scene with this wavelength, bit by bit. The rays
    take the same paths at all wavelengths, up to the fourth reflection. Then weak rays are ended at
    random, which is decided by their power. If all materials have a single lobe and
    ``max_bounces`` is 3, the ratio of two powers is therefore exact. Otherwise it depends on the
    mix of paths, and its standard error is smaller than for independent rays.

    Quantum efficiency and transmission of the camera are the same at all wavelengths, but the same
    power has more photons at longer ones.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from nlosoptics import Scene, raytrace
    >>> from nlosoptics.scene import Lambert, Spectrum
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(16)
    >>> red = Lambert(Spectrum((450e-9, 650e-9), (0.2, 0.8)))
    >>> scene = replace(scene, hidden=replace(scene.hidden, material=red))
    >>> colours = raytrace.trace_colours(scene, (450e-9, 650e-9), n_rays=1024, max_bounces=3)
    >>> ratio, error = colours.ratio(1)
    >>> round(ratio, 6), error < 1e-9
    (4.0, True)
    """
    whole("n_rays", n_rays, 1, MOST)
    images: list[TracedImage] = []
    checked = _scenes(scene, wavelengths)

    def told(stage: str, share: float) -> None:
        if progress is not None:
            progress(stage, (len(images) + share) / len(checked))

    for one in checked:
        images.append(
            trace_image(
                one,
                n_rays=n_rays,
                max_bounces=max_bounces,
                t_start=t_start,
                delta_t=delta_t,
                n_bins=n_bins,
                outer_legs=outer_legs,
                exposure=exposure,
                sampler=sampler,
                seed=seed,
                progress=told,
            )
        )
    return ColourTraces(
        wavelengths=tuple(one.laser.wavelength for one in checked), each=tuple(images)
    )


def _scenes(scene: Scene, wavelengths: Sequence[float]) -> list[Scene]:
    """Return the scene at each wavelength; raise `SceneError` for anything else."""
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()")
    if not isinstance(wavelengths, Sequence | np.ndarray) or not len(wavelengths):
        raise SceneError(f"wavelengths is {wavelengths!r}; give a list of wavelengths in m")
    found = []
    for index, wavelength in enumerate(wavelengths):
        try:
            laser = replace(scene.laser, wavelength=wavelength)
            found.append(replace(scene, laser=laser))
        except SceneError as error:
            raise SceneError(f"wavelengths[{index}]: {error}") from None
    return found
