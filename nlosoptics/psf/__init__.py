"""From the wave in the exit pupil to the point spread function, and its metrics.

- `pupils`, `aiming`, `aberration`: exit pupil, rays by the wall and wave of a scene.
- `slopes`, `facet_waves`: the wave of given slopes, and of a wall of random facets; how the pupil
  sees the wall.
- `ray_waves`, `tessellation`: the wave of traced rays, and the area of each.
- `wavefronts`, `nodes`, `zernikes`, `spectra`: the sampled wave.
- `fits`, `residuals`: least-squares terms; piston and tilt taken out, and where the rays land.
- `quadrature`, `fft`, `mdft`, `nufft`, `airy`, `geometric`, `huygens`: one transform each;
  `pupil_grids`, `rims`, `separable`, `local_fits`, `pixels` and `windows` serve them, `estimates`
  bounds their errors.
- `methods`: runs one or picks among them; `point_spreads`: `point_spread`; `comparisons`: all of
  them side by side; `bands` and `fields`: over wavelengths and over the object.
- `roughness`, `rough_views`: statistics of a rough wall, and what the pupil sees of it.
- `transfers`, `rough_means`: the mean point spread over all such walls; `screens`, `rough_samples`:
  that of one drawn at random.
- `hybrids`: waves for a wall's mirror-like lobes, rays for the rest.
- `metrics`, `spots`: Strehl ratio, energy in circles and squares, MTF and PTF, widths, centroid,
  spot radius, Zernike fit.
"""

from .aberration import path_difference, wall_aberration, wavefront
from .bands import band_point_spread, gaussian_band
from .comparisons import Comparison, ComparisonRow, compare
from .facet_waves import WallView, facet_reach, facet_wavefront, pupil_slopes, wall_view
from .fields import PointSpreadField, isoplanatic_radius, point_spread_field
from .huygens import SurfacePointSpread, huygens_point_spread
from .hybrids import HybridPointSpread, hybrid_point_spread
from .metrics import encircled_energy, fit_zernike, fwhm, mtf, rms_aberration, strehl
from .nodes import grid_nodes, polar_nodes
from .point_spreads import PointSpread, point_spread
from .pupils import ExitPupil, exit_pupil
from .ray_waves import wavefront_from_rays
from .rough_means import RoughPointSpread, mean_point_spread
from .rough_samples import sample_point_spread
from .roughness import Roughness
from .slopes import integrated_slopes, wavefront_from_slopes
from .spots import centroid, ensquared_energy, peak_strehl, ptf, spot_radius
from .wavefronts import Removed, Wavefront
from .windows import window_shape
from .zernikes import zernike, zernike_order

__all__ = [
    "Comparison",
    "ComparisonRow",
    "ExitPupil",
    "HybridPointSpread",
    "PointSpread",
    "PointSpreadField",
    "Removed",
    "RoughPointSpread",
    "Roughness",
    "SurfacePointSpread",
    "WallView",
    "Wavefront",
    "band_point_spread",
    "centroid",
    "compare",
    "encircled_energy",
    "ensquared_energy",
    "exit_pupil",
    "facet_reach",
    "facet_wavefront",
    "fit_zernike",
    "fwhm",
    "gaussian_band",
    "grid_nodes",
    "huygens_point_spread",
    "hybrid_point_spread",
    "integrated_slopes",
    "isoplanatic_radius",
    "mean_point_spread",
    "mtf",
    "path_difference",
    "peak_strehl",
    "point_spread",
    "point_spread_field",
    "polar_nodes",
    "ptf",
    "pupil_slopes",
    "rms_aberration",
    "sample_point_spread",
    "spot_radius",
    "strehl",
    "wall_aberration",
    "wall_view",
    "wavefront",
    "wavefront_from_rays",
    "wavefront_from_slopes",
    "window_shape",
    "zernike",
    "zernike_order",
]
