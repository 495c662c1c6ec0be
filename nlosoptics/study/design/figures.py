"""Figures of merit by name, and functions of the user's by import path."""

from __future__ import annotations

import inspect
import json
import math
import pkgutil
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import scipy  # its parts are loaded lazily, on first use

from ... import limits, psf
from ..._checks import in_range, positive, real
from ...errors import SamplingError, SceneError
from ...limits.transfer import image_modulation
from ...psf import SceneOptics
from .compensation import adjusted
from .values import number

if TYPE_CHECKING:
    from .file import Compensate, FigureTable
    from .point import StudyPoint
    from .variables import Variable

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
        Most expensive stage that it needs: "scene", "point spread", "forecast" or "own function".
    has_error : bool
        Whether it comes with an error.
    compensate : dict, optional
        Table of the values that are adjusted before it is computed, as JSON.
    """

    name: str
    source: str
    options: dict[str, Any]
    unit: str
    meaning: str
    stage: str
    has_error: bool
    compensate: dict[str, Any] | None = None

    def value(self, point: StudyPoint, folder: Path) -> tuple[float, float]:
        """Return the figure of a point and its error, which is NaN if it has none."""
        there = point
        if self.compensate is not None:
            there = compensated(point, self.compensate, folder)
            there.warnings.clear()
        answer = self._answer(there, folder)
        point.warnings |= there.warnings
        value, error = answer if isinstance(answer, tuple) else (answer, math.nan)
        return real(self.name, value), float(error)

    def _answer(self, point: StudyPoint, folder: Path) -> Answer:
        """Return what the function returns; points with the same point spread share it."""
        function = _function(self.source, folder)
        if self.source not in FIGURES or self.stage != "point spread":
            return function(point, **self.options)
        name = json.dumps([self.source, self.options], sort_keys=True)
        shared: Answer = point.of_point_spread(name, lambda: function(point, **self.options))
        return shared


@dataclass(frozen=True)
class _Known:
    function: Callable[..., Answer]
    unit: str
    stage: str
    has_error: bool


#: Figures of merit of the library by name.
FIGURES: dict[str, _Known] = {}


def _figure(stage: str, unit: str = "", *, has_error: bool = False) -> Callable[..., Any]:
    """Return a decorator that adds a figure of merit under the name of its function."""

    def added(function: Callable[..., Answer]) -> Callable[..., Answer]:
        FIGURES[function.__name__] = _Known(function, unit, stage, has_error)
        return function

    return added


@_figure("point spread")
def strehl(point: StudyPoint) -> Answer:
    """Strehl ratio of the smooth wall's wave, without tilt."""
    return psf.strehl(point.point_spread.wavefront, remove=("piston", "tilt"))


@_figure("point spread", "waves")
def aberration_rms(point: StudyPoint) -> Answer:
    """Rms wave aberration of the smooth wall, waves."""
    wave = point.point_spread.wavefront
    return psf.rms_aberration(wave) / wave.wavelength


@_figure("point spread", "m")
def spot_rms(point: StudyPoint) -> Answer:
    """Rms radius of the geometric spot of the smooth wall, on the detector."""
    return psf.spot_radius(point.point_spread.wavefront)


@_figure("point spread", "m")
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


@_figure("point spread")
def mtf(point: StudyPoint, frequency: float, azimuth: float = 0.0) -> Answer:
    """Modulation of stripes in the image by lens, wall and pixels, at cycles/m on the object."""
    frequency = positive("frequency", frequency, unit="cycles/m")
    scale = limits.object_scale(point.scene)
    nyquist = 0.5 / (point.scene.camera.image_pitch * scale)
    if frequency > nyquist:
        raise SamplingError(
            f"frequency = {frequency:g} cycles/m on the object, but pixels show at most "
            f"{nyquist:.4g}; use a lower frequency, or bin fewer pixels (camera.binning)"
        )
    return image_modulation(SceneOptics(point.scene), frequency * scale, azimuth, point.tol)


@_figure("forecast")
def photons(point: StudyPoint) -> Answer:
    """Photons of the object's image in one exposure."""
    return point.forecast.photons


@_figure("forecast")
def contrast(point: StudyPoint) -> Answer:
    """Share of the object's image in the light on the detector."""
    return 1.0 - point.forecast.veil


@_figure("forecast", "1/m")
def resolution(point: StudyPoint) -> Answer:
    """Highest frequency on the object above the noise, cycles/m."""
    return point.forecast.limit


@_figure("forecast")
def relay_modes(point: StudyPoint) -> Answer:
    """Independent patterns of the object above the noise, by mirror-like or diffuse light."""
    return float(point.forecast.modes)


@_figure("forecast", has_error=True)
def predicted_correlation(point: StudyPoint) -> Answer:
    """Predicted correlation of a reconstruction with the object, with the spread of fits."""
    return point.forecast.score, point.forecast.score_spread


@_figure("scene")
def value(point: StudyPoint, address: str) -> Answer:
    """Value of the scene at an address."""
    found = number(point.value(address))
    if found is None:
        raise SceneError(
            f"{address} = {point.value(address)!r} is not a number; name the address of a number"
        )
    return found[0]


#: Names that arrays of the results have themselves.
TAKEN = ("status", "message", "seconds", "case", "draw", "trial", "zip", "point", "id")
#: Endings of names of arrays that belong to a figure.
ENDINGS = ("_error", "_status", "_compensated")


def figure(given: str | FigureTable, folder: Path) -> Figure:
    """Return the figure of an entry of a study file, whose function is imported."""
    source = given if isinstance(given, str) else given.figure
    options = {} if isinstance(given, str) else dict(given.model_extra or {})
    name = source.rpartition(":")[2] if isinstance(given, str) else given.name or source
    if source == "value" and name == source:
        name = plain_name(str(options.get("address", source)))
    if not name.isidentifier() or name in TAKEN or name.endswith(ENDINGS):
        raise SceneError(
            f"figures: {name!r} cannot name a figure; give a name of letters, digits and _ that "
            f"does not end in {' or '.join(ENDINGS)}"
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


def plain_name(address: str) -> str:
    """Return an address as a name of letters, digits and _: camera_position_0."""
    return re.sub(r"\W+", "_", address).strip("_")


def with_compensation(
    figures: tuple[Figure, ...], table: Compensate, folder: Path, variables: tuple[Variable, ...]
) -> tuple[Figure, ...]:
    """Return figures, the same after compensation, and the values that the compensators take."""
    best = next((f for f in figures if f.name == table.figure), None) or figure(
        table.figure, folder
    )
    given = {
        "figure": {"source": best.source, "options": best.options},
        "goal": table.goal,
        "variables": {
            address: limits.model_dump(by_alias=True) for address, limits in table.variables.items()
        },
    }
    after = [
        replace(
            f,
            name=f"{f.name}_compensated",
            meaning=f"{f.meaning}, after compensation",
            compensate=given,
        )
        for f in figures
        if f.source != "value"
    ]
    values = [
        Figure(
            name=f"{plain_name(one.address)}_compensated",
            source="value",
            options={"address": one.address},
            unit=one.unit,
            meaning=f"{one.address} after compensation",
            stage=best.stage,
            has_error=False,
            compensate=given,
        )
        for one in variables
    ]
    return (*figures, *after, *values)


def compensated(point: StudyPoint, table: Mapping[str, Any], folder: Path) -> StudyPoint:
    """Return a point at which some values are adjusted for the best figure."""
    function, options = _function(table["figure"]["source"], folder), table["figure"]["options"]
    sign = 1.0 if table["goal"] == "minimise" else -1.0

    def cost(there: StudyPoint) -> float:
        answer = function(there, **options)
        return sign * real("figure", answer[0] if isinstance(answer, tuple) else answer)

    return point.adjusted(json.dumps(table), lambda: adjusted(point, table["variables"], cost))


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
