"""Curves: modulation transfer, encircled energy, the course of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import counted, in_range, whole
from ..errors import SamplingError, SceneError
from .canvas import new_axes
from .palette import BLUE, GREY, MARKERS, ORANGE, SERIES, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..inverse import Reconstruction, Training
    from ..psf import MetricEstimate, SpotDiagram

Array = NDArray[np.float64]

#: Label of a fit's record, and what it counts; two records of one label share axes.
RECORDS = {
    "objective": ("objective", "iteration"),
    "residual": ("residual, rms of the noise", "iteration"),
    "change": ("relative change", "iteration"),
    "fourier_error": ("Fourier error", "restart"),
    "training": ("mean squared error", "epoch"),
    "validation": ("mean squared error", "epoch"),
}
WIDE_RANGE = 10.0  # of a record, beyond which its scale is logarithmic
FEW = 50  # values, up to which each has a marker


def mtf(
    frequency: ArrayLike,
    along_x: ArrayLike | MetricEstimate,
    along_y: ArrayLike | MetricEstimate | None = None,
    *,
    diffraction_limit: ArrayLike | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw the modulation transfer function along x and y.

    Parameters
    ----------
    frequency : array_like, (n,)
        In the image, cycles per m.
    along_x, along_y : array_like or MetricEstimate, (n,)
        As of `psf.mtf` with ``azimuth`` 0 and pi/2; that of `psf.metric_estimate` is drawn with
        its standard error.
    diffraction_limit : array_like, (n,), optional
        The same of a wave without aberration.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        Modulation from 0 to 1 against cycles/mm.

    Raises
    ------
    SamplingError
        If an array does not fit the frequencies, or holds values that are not finite.
    """
    places = _samples("frequency", frequency) * 1e-3
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.0, height=4.2)
    if diffraction_limit is not None:
        limit = _samples("diffraction_limit", diffraction_limit, like=places, of="frequency")
        axes.plot(places, limit, color=GREY, linestyle="--", label="diffraction limit")
    cuts = [("along_x", "along x", BLUE, "-"), ("along_y", "along y", VERMILION, "-.")]
    for (name, label, colour, line), given in zip(cuts, (along_x, along_y), strict=True):
        if given is None:
            continue
        values = _samples(name, _value(given), like=places, of="frequency")
        axes.plot(places, values, color=colour, linestyle=line, label=label)
        if hasattr(given, "standard_error"):
            error = _samples(name, given.standard_error, like=places, of="frequency")
            axes.fill_between(places, values - error, values + error, color=colour, alpha=0.25)
    axes.set(
        xlabel="frequency in the image (cycles/mm)",
        ylabel="modulation",
        ylim=(0.0, 1.02),
        xlim=(float(places.min()), float(places.max())),
        title="modulation transfer",
    )
    axes.grid(alpha=0.25)
    axes.legend()
    return axes


def encircled_energy(
    radius: ArrayLike,
    energy: ArrayLike | MetricEstimate,
    *,
    diffraction_limit: ArrayLike | None = None,
    shares: Sequence[float] = (0.5, 0.8),
    axes: Axes | None = None,
) -> Axes:
    """Draw the energy within circles, with the radii that hold given shares.

    Parameters
    ----------
    radius : array_like, (n,)
        m, rising.
    energy : array_like or MetricEstimate, (n,)
        As of `psf.encircled_energy`; that of `psf.metric_estimate` is drawn with its standard
        error.
    diffraction_limit : array_like, (n,), optional
        The same of a wave without aberration.
    shares : sequence of float
        Above 0, up to 1; their radii are read off straight lines between the radii given.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        Share of the energy against um.

    Raises
    ------
    SceneError
        If a share is out of range.
    SamplingError
        If an array does not fit the radii, the radii do not rise, or values are not finite.
    """
    radii = _samples("radius", radius) * 1e6
    if len(radii) > 1 and np.diff(radii).min() <= 0.0:
        raise SamplingError("radius must rise from value to value; sort it together with energy")
    wanted = [in_range("shares", share, 0.0, 1.0, open_low=True) for share in shares]
    values = _samples("energy", _value(energy), like=radii, of="radius")
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.0, height=4.2)
    if diffraction_limit is not None:
        limit = _samples("diffraction_limit", diffraction_limit, like=radii, of="radius")
        axes.plot(radii, limit, color=GREY, linestyle="--", label="diffraction limit")
    axes.plot(radii, values, color=BLUE, label="encircled energy")
    if hasattr(energy, "standard_error"):
        error = _samples("energy", energy.standard_error, like=radii, of="radius")
        axes.fill_between(radii, values - error, values + error, color=BLUE, alpha=0.25)
    lines = zip(wanted, (VERMILION, ORANGE, *SERIES[2:]), strict=False)
    for share, colour in lines:
        place = _crossing(radii, values, share)
        if place is None:
            axes.plot([], [], " ", label=f"{100 * share:g} % not within {radii[-1]:.3g} µm")
            continue
        style: dict[str, Any] = {"color": colour, "linewidth": 1.2, "linestyle": ":"}
        axes.plot([place, place, radii[0]], [0.0, share, share], **style)
        label = f"{100 * share:g} % within {place:.3g} µm"
        axes.plot([place], [share], color=colour, marker="o", linestyle="", label=label)
    axes.set(
        xlabel="radius (µm)",
        ylabel="share of the energy",
        ylim=(0.0, 1.02),
        xlim=(float(radii[0]), float(radii[-1])),
        title="encircled energy",
    )
    axes.grid(alpha=0.25)
    axes.legend(loc="lower right")
    return axes


def history(
    fit: Reconstruction | Training, *, axes: Sequence[Axes] | None = None
) -> tuple[Axes, ...]:
    """Draw how a fit went: each of its records over the iterations.

    Parameters
    ----------
    fit : Reconstruction or Training
        What has a ``history``.
    axes : sequence of matplotlib Axes, optional
        Where to draw, one for each record that has values, training and validation on the same; a
        new figure by default.

    Returns
    -------
    tuple of Axes
        In the order of the records. Scales are logarithmic where a record is positive and spans
        much. A dashed line marks the residual that fits the data to their noise.

    Raises
    ------
    SceneError
        If the method keeps no records, such as a network, or did nothing.
    """
    panels: dict[str, dict[str, Array]] = {}
    for name, record in fit.history.items():
        if len(record):
            panels.setdefault(RECORDS.get(name, (name, ""))[0], {})[name] = np.asarray(record)
    if not panels:
        raise SceneError(
            "this fit kept no records: its method takes no iterations, or had nothing to fit"
        )
    on = (
        tuple(axes)
        if axes is not None
        else new_axes(len(panels), width=4.0 * len(panels), height=3.6)
    )
    if len(on) != len(panels):
        raise SceneError(
            f"{counted(len(on), 'axis', 'axes')} for {counted(len(panels), 'record')}, "
            f"{', '.join(panels)}; give as many"
        )
    from matplotlib.ticker import MaxNLocator

    for axis, (label, records) in zip(on, panels.items(), strict=True):
        unit = "iteration"
        for (name, record), colour, marker in zip(records.items(), SERIES, MARKERS, strict=False):
            unit = RECORDS.get(name, ("", "iteration"))[1]
            style = "" if unit == "restart" else "-"
            dots = marker if len(record) <= FEW or not style else ""
            axis.plot(
                np.arange(1, len(record) + 1),
                record,
                color=colour,
                linestyle=style,
                marker=dots,
                markersize=4,
                label=name,
            )
        every = np.concatenate(list(records.values()))
        if every.min() > 0.0 and every.max() > WIDE_RANGE * every.min():
            axis.set_yscale("log")
        if "residual" in records:
            axis.axhline(1.0, color=GREY, linestyle="--", linewidth=1.2, label="noise")
        if len(axis.lines) > 1:
            axis.legend()
        axis.grid(alpha=0.25)
        axis.set(xlabel=unit, ylabel=label)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    return on


def _value(given: Any) -> Any:
    """The values of a `MetricEstimate`, or what was given."""
    return getattr(given, "value", given)


def _samples(name: str, values: ArrayLike, *, like: Array | None = None, of: str = "") -> Array:
    """Finite values (n,) as float64, as many as ``like``, which are those ``of`` something."""
    array = np.asarray(values, dtype=np.float64)
    if like is None and (array.ndim != 1 or array.size < 2):
        raise SamplingError(f"{name} has shape {array.shape}, must be (n,), n at least 2")
    if like is not None and array.shape != like.shape:
        raise SamplingError(f"{name} has shape {array.shape}, must be {like.shape} like {of}")
    n_bad = array.size - int(np.count_nonzero(np.isfinite(array)))
    if n_bad:
        raise SamplingError(f"{name} has {n_bad} of {array.size} values that are not finite")
    return array


def _crossing(places: Array, values: Array, level: float) -> float | None:
    """Where a curve first reaches a level, by straight lines; None where it does not."""
    reached = np.flatnonzero(values >= level)
    if not len(reached):
        return None
    at = int(reached[0])
    if at == 0:
        return float(places[0])
    return float(np.interp(level, values[at - 1 : at + 1], places[at - 1 : at + 1]))


def spot_diagram(spots: SpotDiagram, *, most: int = 20_000, axes: Axes | None = None) -> Axes:
    """Draw where rays land, beside the disc that diffraction makes of a perfect wave.

    Parameters
    ----------
    spots : SpotDiagram
        As of `psf.spot_diagram`.
    most : int
        Of more rays, every so-manieth is drawn.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        Image coordinates in um, turned as the camera shows them: y grows downward. A dot's area is
        its share of the light; the circle about the centroid is the first dark ring of Airy's
        pattern.
    """
    whole("most", most)
    (axes,) = (axes,) if axes is not None else new_axes(1, width=5.4, height=5.4)
    from matplotlib.patches import Circle

    drawn = slice(None, None, max(1, -(-len(spots.x) // most)))
    x, y, energy = (1e6 * spots.x[drawn], 1e6 * spots.y[drawn], spots.energy[drawn])
    rms, airy = 1e6 * spots.radius, 1e6 * spots.airy_radius
    centre = (1e6 * spots.centroid[0], 1e6 * spots.centroid[1])
    axes.scatter(
        x,
        y,
        s=np.clip(8.0 * energy / energy.mean(), 0.5, 40.0),
        color=BLUE,
        linewidths=0,
        alpha=0.7,
        rasterized=True,
        label=f"rays, {rms:.3g} µm rms",
    )
    style: dict[str, Any] = {"fill": False, "color": VERMILION, "linewidth": 1.5}
    axes.add_patch(Circle(centre, airy, label=f"first dark ring, {airy:.3g} µm", **style))
    half = 1.3 * max(airy, float(np.abs(x - centre[0]).max()), float(np.abs(y - centre[1]).max()))
    axes.set(
        xlim=(centre[0] - half, centre[0] + half),
        ylim=(centre[1] + half, centre[1] - half),
        aspect="equal",
        xlabel="x (µm)",
        ylabel="y (µm)",
        title="spot diagram",
    )
    axes.grid(alpha=0.25)
    axes.legend(loc="upper right")
    return axes
