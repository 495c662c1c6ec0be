"""From the wave in the exit pupil to the point spread function, and its metrics.

- `pupils`, `aiming`, `callable_aiming`, `aberration`: exit pupil, rays by the wall and wave of a
  scene; `obstruction`: what an occluder leaves of it; `paraxial`: its second-order optics.
- `slopes`, `facet_waves`: the wave of given slopes, and of a wall of random facets; how the pupil
  sees the wall.
- `ray_waves`, `tessellation`: the wave of traced rays, and the area of each.
- `wavefronts`, `nodes`, `zernikes`, `spectra`, `function_waves`: the sampled wave.
- `apertures`, `aperture_parts`, `polygons`, `outlines`, `cell_spectra`: pupils of any outline.
- `fits`, `residuals`: least-squares terms; piston and tilt taken out, and where the rays land.
- `quadrature`, `fft`, `mdft`, `nufft`, `airy`, `geometric`, `huygens`: one transform each;
  `polynomials`, `soft_pupils`, `soft_images` (polynomial waves by fast transforms or by products
  with cosines and sines), `pupil_grids`, `rims`, `rim_tails`, `separable`, `local_fits`, `pixels`
  and `windows` serve them, `estimates` bounds their errors.
- `methods`: runs one of them; `choices` picks the cheapest that does, by `costs` and what `regimes`
  says of the wave; `point_spreads`: `point_spread`; `comparisons`: all of them side by side;
  `bands` and `fields`: over wavelengths and over the object; `cores`, `tails`: on wide
  pixels, and beyond a window.
- `roughness`, `rough_views`: statistics of a rough wall, and what the pupil sees of it.
- `transfers`, `halos`, `rough_means`: the mean point spread over all such walls; `screens`,
  `rough_samples`: that of one drawn at random; `correlations`, `rough_scales`: long waves drawn,
  short ones as their mean.
- `scene_optics`: exit pupil, rays, wall view and wave of a scene, computed once; `scene_psf`: the
  one door from a scene to its point spread, which decides how its pupil is sampled.
- `lobes`: the point spread of a wall's mirror-like lobes; `hybrids`, `hybrid_waves`: with the light
  of all other lobes by rays.
- `metrics`, `spots`: Strehl ratio, energy in circles and squares, MTF and PTF, widths, centroid,
  spot diagram and radius, Zernike fit; `metric_errors`: their error bars over patterns drawn at
  random.
- `exchange`, `poppy_files`, `zernike_tables`: waves for other tools and from them.
"""

from .aberration import path_difference, wall_aberration, wavefront
from .apertures import Aperture
from .bands import band_point_spread, gaussian_band
from .comparisons import Comparison, ComparisonRow, compare
from .cores import wide_point_spread
from .exchange import PrysmPupil, from_prysm, to_prysm
from .facet_waves import WallView, facet_wavefront, pupil_slopes, wall_view
from .fields import PointSpreadField, isoplanatic_radius, point_spread_field
from .huygens import SurfacePointSpread, huygens_point_spread
from .hybrids import HybridPointSpread, hybrid_point_spread
from .lobes import lobe_point_spread
from .metric_errors import MetricEstimate, metric_estimate
from .metrics import encircled_energy, fit_zernike, fwhm, mtf, rms_aberration, strehl
from .nodes import grid_nodes, polar_nodes
from .point_spreads import PointSpread, point_spread
from .poppy_files import read_poppy, write_poppy
from .pupils import ExitPupil, exit_pupil
from .ray_waves import wavefront_from_rays
from .regimes import Regime
from .rough_means import RoughPointSpread, mean_point_spread
from .rough_samples import sample_point_spread
from .rough_scales import split_scale, two_scale_point_spread
from .roughness import Roughness
from .scene_optics import SceneOptics
from .scene_psf import ScenePointSpread, scene_point_spread
from .slopes import integrated_slopes, wavefront_from_slopes
from .spots import (
    SpotDiagram,
    centroid,
    ensquared_energy,
    peak_strehl,
    ptf,
    spot_diagram,
    spot_radius,
)
from .tails import widened
from .wavefronts import Removed, Wavefront
from .windows import window_shape
from .zernike_tables import ZernikeTable, read_zernikes, write_zernikes
from .zernikes import zernike, zernike_order

__all__ = [
    "Aperture",
    "Comparison",
    "ComparisonRow",
    "ExitPupil",
    "HybridPointSpread",
    "MetricEstimate",
    "PointSpread",
    "PointSpreadField",
    "PrysmPupil",
    "Regime",
    "Removed",
    "RoughPointSpread",
    "Roughness",
    "SceneOptics",
    "ScenePointSpread",
    "SpotDiagram",
    "SurfacePointSpread",
    "WallView",
    "Wavefront",
    "ZernikeTable",
    "band_point_spread",
    "centroid",
    "compare",
    "encircled_energy",
    "ensquared_energy",
    "exit_pupil",
    "facet_wavefront",
    "fit_zernike",
    "from_prysm",
    "fwhm",
    "gaussian_band",
    "grid_nodes",
    "huygens_point_spread",
    "hybrid_point_spread",
    "integrated_slopes",
    "isoplanatic_radius",
    "lobe_point_spread",
    "mean_point_spread",
    "metric_estimate",
    "mtf",
    "path_difference",
    "peak_strehl",
    "point_spread",
    "point_spread_field",
    "polar_nodes",
    "ptf",
    "pupil_slopes",
    "read_poppy",
    "read_zernikes",
    "rms_aberration",
    "sample_point_spread",
    "scene_point_spread",
    "split_scale",
    "spot_diagram",
    "spot_radius",
    "strehl",
    "to_prysm",
    "two_scale_point_spread",
    "wall_aberration",
    "wall_view",
    "wavefront",
    "wavefront_from_rays",
    "wavefront_from_slopes",
    "wide_point_spread",
    "widened",
    "window_shape",
    "write_poppy",
    "write_zernikes",
    "zernike",
    "zernike_order",
]
