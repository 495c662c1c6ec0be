"""Exit pupils, waves, point spread functions (PSFs) and their metrics.

`scene_point_spread` computes the wave and the PSF of a scene. Without a scene, make a `Wavefront`
(`Wavefront.from_zernike`, `from_function`, `from_map`) and pass it to `point_spread`.

Sub-folders: ``aperture`` (pupil outlines and nodes), ``wave`` (sampled waves), ``pupil`` (exit
pupil and wave of a scene), ``window`` (image windows, pixels, error bounds), ``transform`` (from
wave to PSF), ``propagation`` (fields between parallel planes), ``walls`` (PSFs of scenes and
fields), ``rough`` (rough walls), ``metrics`` (Strehl ratio, MTF, best focus and others),
``exchange`` (other programs). Import everything from ``nlosoptics.psf``.
"""

from .aperture.aperture import Aperture
from .aperture.quadrature_nodes import grid_nodes, polar_nodes
from .exchange.poppy_files import read_poppy, write_poppy
from .exchange.prysm_poppy import PrysmPupil, from_prysm, to_prysm
from .exchange.zernike_tables import ZernikeTable, read_zernikes, write_zernikes
from .metrics.comparisons import Comparison, ComparisonRow, compare
from .metrics.estimates import MetricEstimate, metric_estimate
from .metrics.focus import ThroughFocus, best_focus, focus_shifted, through_focus
from .metrics.psf_metrics import (
    encircled_energy,
    fit_zernike,
    fwhm,
    mtf,
    rms_aberration,
    strehl,
)
from .metrics.spot_diagram import (
    SpotDiagram,
    centroid,
    ensquared_energy,
    peak_strehl,
    ptf,
    spot_diagram,
    spot_radius,
)
from .propagation.propagate import propagate
from .propagation.scalar_field import PropagatedField, ScalarField
from .pupil.exit_pupil import ExitPupil, exit_pupil
from .pupil.pupil_slopes import pupil_slopes
from .pupil.ray_wavefront import wavefront_from_rays
from .pupil.scene_optics import SceneOptics
from .pupil.slope_integration import integrated_slopes, wavefront_from_slopes
from .pupil.wall_view import WallView, wall_view
from .pupil.wall_wavefront import path_difference, wall_aberration, wavefront
from .rough.mean import RoughPointSpread, mean_point_spread
from .rough.roughness import Roughness
from .rough.sample import sample_point_spread
from .rough.two_scale import split_scale, two_scale_point_spread
from .transform.huygens import SurfacePointSpread, huygens_point_spread
from .transform.point_spread import PointSpread, point_spread
from .transform.wide_pixels import wide_point_spread
from .walls.diffraction_tail import widened
from .walls.field import PointSpreadField, isoplanatic_radius, point_spread_field
from .walls.hybrid import HybridPointSpread, hybrid_point_spread
from .walls.lobe_psf import lobe_point_spread
from .walls.polychromatic import band_point_spread, gaussian_band
from .walls.rough_wall import PupilField
from .walls.scene_psf import ScenePointSpread, scene_point_spread
from .wave.regime import Regime
from .wave.removed import Removed
from .wave.wavefront import Wavefront
from .wave.zernikes import zernike, zernike_order
from .window.window import window_shape

__all__ = [
    "Aperture",
    "Comparison",
    "ComparisonRow",
    "ExitPupil",
    "HybridPointSpread",
    "MetricEstimate",
    "PointSpread",
    "PointSpreadField",
    "PropagatedField",
    "PrysmPupil",
    "PupilField",
    "Regime",
    "Removed",
    "RoughPointSpread",
    "Roughness",
    "ScalarField",
    "SceneOptics",
    "ScenePointSpread",
    "SpotDiagram",
    "SurfacePointSpread",
    "ThroughFocus",
    "WallView",
    "Wavefront",
    "ZernikeTable",
    "band_point_spread",
    "best_focus",
    "centroid",
    "compare",
    "encircled_energy",
    "ensquared_energy",
    "exit_pupil",
    "fit_zernike",
    "focus_shifted",
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
    "propagate",
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
    "through_focus",
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
