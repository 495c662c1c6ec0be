"""From the wave in the exit pupil to the point spread function, and its metrics.

- `pupils`, `aiming`, `aberration`: exit pupil, rays by the wall and wave of a scene.
- `slopes`, `facet_waves`: the wave of given slopes, and of a wall of random facets.
- `ray_waves`, `tessellation`: the wave of traced rays, and the area of each.
- `wavefronts`, `nodes`, `zernikes`, `spectra`: the sampled wave.
- `fits`, `residuals`: least-squares terms; piston and tilt taken out, and where the rays land.
- `quadrature`, `fft`, `mdft`, `nufft`, `airy`, `geometric`, `huygens`: one transform each;
  `pupil_grids`, `rims`, `separable`, `local_fits`, `pixels` and `windows` serve them, `estimates`
  bounds their errors.
- `methods`: runs one or picks among them; `point_spreads`: `point_spread`; `comparisons`: all of
  them side by side.
- `metrics`: Strehl ratio, encircled energy, MTF, widths, Zernike fit.
"""

from .aberration import path_difference, wall_aberration, wavefront
from .comparisons import Comparison, ComparisonRow, compare
from .facet_waves import facet_reach, facet_wavefront, pupil_slopes
from .huygens import SurfacePointSpread, huygens_point_spread
from .metrics import encircled_energy, fit_zernike, fwhm, mtf, rms_aberration, strehl
from .nodes import grid_nodes, polar_nodes
from .point_spreads import PointSpread, point_spread
from .pupils import ExitPupil, exit_pupil
from .ray_waves import wavefront_from_rays
from .slopes import integrated_slopes, wavefront_from_slopes
from .wavefronts import Removed, Wavefront
from .windows import window_shape
from .zernikes import zernike, zernike_order

__all__ = [
    "Comparison",
    "ComparisonRow",
    "ExitPupil",
    "PointSpread",
    "Removed",
    "SurfacePointSpread",
    "Wavefront",
    "compare",
    "encircled_energy",
    "exit_pupil",
    "facet_reach",
    "facet_wavefront",
    "fit_zernike",
    "fwhm",
    "grid_nodes",
    "huygens_point_spread",
    "integrated_slopes",
    "mtf",
    "path_difference",
    "point_spread",
    "polar_nodes",
    "pupil_slopes",
    "rms_aberration",
    "strehl",
    "wall_aberration",
    "wavefront",
    "wavefront_from_rays",
    "wavefront_from_slopes",
    "window_shape",
    "zernike",
    "zernike_order",
]
