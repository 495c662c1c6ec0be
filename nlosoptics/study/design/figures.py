"""Figures of merit by name, and functions of the user's by import path."""

from __future__ import annotations

import inspect
import math
import pkgutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import scipy.optimize

from ... import psf
from ..._checks import in_range, positive, real
from ...errors import SceneError
from ...limits import object_scale

if TYPE_CHECKING:
    from .file import FigureTable
    from .point import StudyPoint

#: A value, or a value with its error.
Answer = float | tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Figure of merit of a study.

    Parameters
    ----------
    name : str
        Name in the results.
    source : str
        Name of a figure below, or the import path "module:function" of a function.
    options : dict
        Keyword arguments.
    unit : str
        SI unit, or empty.
    meaning : str
        What it is, in a few words.
    stage : str
        Most expensive stage that it needs: "point spread", "forecast" or "own function".
    has_error : bool
        Whether it comes with an error.
    """

    name: str
    source: str
    options: dict[str, Any]
    unit: str
    meaning: str
    stage: str
    has_error: bool

    def value(self, point: StudyPoint, folder: Path) -> tuple[float, float]:
        """Return the figure of a point and its error, which is NaN if it has none."""
        answer = _function(self.source, folder)(point, **self.options)
        value, error = answer if isinstance(answer, tuple) else (answer, math.nan)
        return real(self.name, value), float(error)


def strehl(point: StudyPoint) -> Answer:
    """Strehl ratio of the smooth wall's wave, without tilt."""
    return psf.strehl(point.point_spread.wavefront, remove=("piston", "tilt"))


def aberration_rms(point: StudyPoint) -> Answer:
    """Rms wave aberration of the smooth wall, waves."""
    wave = point.point_spread.wavefront
    return psf.rms_aberration(wave) / wave.wavelength


def spot_rms(point: StudyPoint) -> Answer:
    """Rms radius of the geometric spot of the smooth wall, on the detector."""
    return psf.spot_radius(point.point_spread.wavefront)


def encircled_energy_radius(point: StudyPoint, fraction: float = 0.8) -> Answer:
    """Radius about the reference point that holds a fraction of the energy, on the detector."""
    fraction = in_range("fraction", fraction, 0.0, 0.999, open_low=True)
    spread = point.point_spread.point_spread
    edge = float(min(-spread.x[0], spread.x[-1], -spread.y[0], spread.y[-1]) + spread.pitch / 2)
    held = float(psf.encircled_energy(spread, edge))
    if held < fraction:
        raise SceneError(
            f"the window of the point spread holds {held:.3g} of its energy within the largest "
            f"circle, fraction = {fraction:g}; use a smaller fraction or a smaller tol"
        )
    found = scipy.optimize.brentq(
        lambda r: float(psf.encircled_energy(spread, r)) - fraction, 0.0, edge, xtol=1e-6 * edge
    )
    return float(found)


def mtf(point: StudyPoint, frequency: float, azimuth: float = 0.0) -> Answer:
    """Modulation of the point spread with pixels at a frequency on the object, cycles/m."""
    frequency = positive("frequency", frequency, unit="cycles/m")
    on_detector = frequency * object_scale(point.scene)
    return float(psf.mtf(point.point_spread.point_spread, on_detector, azimuth=azimuth))


def photons(point: StudyPoint) -> Answer:
    """Photons of the object's image in one exposure."""
    return point.forecast.photons


def contrast(point: StudyPoint) -> Answer:
    """Share of the object's image in the light on the detector."""
    return 1.0 - point.forecast.veil


def resolution(point: StudyPoint) -> Answer:
    """Highest frequency on the object above the noise, cycles/m."""
    return point.forecast.limit


def relay_modes(point: StudyPoint) -> Answer:
    """Independent patterns of the object above the noise, by mirror-like or diffuse light."""
    return float(point.forecast.modes)


def predicted_correlation(point: StudyPoint) -> Answer:
    """Predicted correlation of a reconstruction with the object, with the spread of fits."""
    return point.forecast.score, point.forecast.score_spread


@dataclass(frozen=True)
class _Known:
    function: Callable[..., Answer]
    unit: str
    stage: str
    has_error: bool = False


FIGURES: Mapping[str, _Known] = {
    "strehl": _Known(strehl, "", "point spread"),
    "aberration_rms": _Known(aberration_rms, "waves", "point spread"),
    "spot_rms": _Known(spot_rms, "m", "point spread"),
    "encircled_energy_radius": _Known(encircled_energy_radius, "m", "point spread"),
    "mtf": _Known(mtf, "", "point spread"),
    "photons": _Known(photons, "", "forecast"),
    "contrast": _Known(contrast, "", "forecast"),
    "resolution": _Known(resolution, "1/m", "forecast"),
    "relay_modes": _Known(relay_modes, "", "forecast"),
    "predicted_correlation": _Known(predicted_correlation, "", "forecast", True),
}
#: Names that arrays of the results have themselves.
TAKEN = ("status", "message", "seconds", "case", "draw", "zip", "point", "id")


def figure(given: str | FigureTable, folder: Path) -> Figure:
    """Return the figure of an entry of a study file; functions are imported to see that they exist.

    Raises
    ------
    SceneError
        If there is no such figure, function or option.
    """
    source = given if isinstance(given, str) else given.figure
    options = {} if isinstance(given, str) else dict(given.model_extra or {})
    name = source.rpartition(":")[2] if isinstance(given, str) else given.name or source
    if not name.isidentifier() or name in TAKEN or name.endswith(("_error", "_status")):
        raise SceneError(
            f"figures: {name!r} cannot name a figure; give a name of letters, digits and _ that "
            "does not end in _error or _status"
        )
    function = _function(source, folder)
    try:
        inspect.signature(function).bind(None, **options)
    except TypeError as error:
        raise SceneError(f"figures: {source}: {error}; correct its options") from None
    known = FIGURES.get(source)
    text = (inspect.getdoc(function) or source).splitlines()[0]
    return Figure(
        name=name,
        source=source,
        options=options,
        unit="" if known is None else known.unit,
        meaning=text.rstrip("."),
        stage="own function" if known is None else known.stage,
        # an own function may return an error for some points only
        has_error=known is None or known.has_error,
    )


def _function(source: str, folder: Path) -> Callable[..., Answer]:
    """Return the function of a figure's name or import path; ``folder`` is searched first."""
    if source in FIGURES:
        return FIGURES[source].function
    if ":" not in source:
        raise SceneError(
            f"figures: {source!r} is unknown, must be one of {', '.join(FIGURES)}, or an import "
            "path such as mymodule:myfunction"
        )
    sys.path.insert(0, str(folder))
    try:
        function = pkgutil.resolve_name(source)
    except (ImportError, AttributeError, ValueError) as error:
        raise SceneError(
            f"figures: {source!r} cannot be imported ({error}); put the module into {folder}"
        ) from None
    finally:
        sys.path.remove(str(folder))
    if not callable(function):
        raise SceneError(f"figures: {source!r} is no function; name one")
    found: Callable[..., Answer] = function
    return found
