"""Figures of whole runs: the stages of one run, and the PSFs of a study's extreme points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from .canvas import new_axes
from .maps import image, point_spread, pupil_field, reconstruction, wavefront
from .saving import GrowingFigure, panel_files
from .sketch import room_from_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..inverse import Reconstruction
    from ..psf import ScenePointSpread
    from ..runs.results import Result
    from ..scene import Scene
    from ..study import Results

IMAGE, FIT = 3, 4  # indices of camera image and reconstruction among the axes of `overview`


def overview(result: Result) -> tuple[Axes, ...]:
    """Draw all results of a simulation in one figure, in the order of the computation.

    Parameters
    ----------
    result : Result
        Result of `nlosoptics.simulate`, with or without a reconstruction.

    Returns
    -------
    tuple of Axes
        Axes in two rows. The upper row shows the room from above, the wave aberration (or, if the
        result has a ``pupil_field``, the phase in the exit pupil) and the point spread function.
        The lower row shows the camera image and, where there is one, the reconstruction and the
        true object.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.

    See Also
    --------
    scene_sketch, wavefront, point_spread, image, reconstruction : The single figures.

    Examples
    --------
    >>> from nlosoptics import Scene, simulate, views
    >>> result = simulate(Scene.load("examples/scenes/letter_flat.toml").resized(32), seed=0)
    >>> [axes.get_title().split(",")[0] for axes in views.overview(result)]
    ['top view', 'wave aberration', 'point spread function', 'camera image']
    """
    axes = _empty()
    _draw_room(axes, result.scene)
    _draw_optics(axes, result)
    return _draw_images(axes, result)


def _empty() -> tuple[Axes, ...]:
    """Return the empty axes of an overview."""
    return new_axes(6, width=16.5, height=9.6, columns=3)


def _draw_room(axes: tuple[Axes, ...], scene: Scene) -> None:
    room_from_above(scene, axes[0])
    axes[0].legend(fontsize="small", loc="best")


def _draw_optics(axes: tuple[Axes, ...], found: ScenePointSpread | Result) -> None:
    """Draw the rest of the upper row of an overview."""
    if found.pupil_field is None:
        wavefront(found.wavefront, axes=axes[1])
    else:
        pupil_field(found.pupil_field, axes=axes[1])
    point_spread(found.point_spread, scale="linear", axes=axes[2])


def _draw_images(axes: tuple[Axes, ...], result: Result) -> tuple[Axes, ...]:
    """Draw the lower row of an overview; return the axes that are used, and remove the others."""
    from ..limits import object_scale  # loads scipy; views alone is light

    scale = object_scale(result.scene)
    image(result.image, object_scale=scale, axes=axes[IMAGE])
    used = FIT
    if result.reconstruction is not None:
        truth = ground_truth(result)
        used += 1 if truth is None else 2
        free = axes[used - 1 : FIT - 1 : -1]  # the truth comes first, and is drawn on the right
        reconstruction(result.reconstruction, truth, pitch=scale * result.image.pitch, axes=free)
    for spare in axes[used:]:
        spare.remove()
    return axes[:used]


def overview_panels(result: Result) -> dict[str, Sequence[Axes]]:
    """Draw the overview of a result; return the axes of its files, see `saving.panel_files`."""
    return _panels(overview(result), result)


def _panels(axes: tuple[Axes, ...], result: Result) -> dict[str, Sequence[Axes]]:
    pupil = "wavefront" if result.pupil_field is None else "pupil_phase"
    panels: dict[str, Sequence[Axes]] = {
        "overview": axes,
        pupil: axes[1:2],
        "image": axes[IMAGE:FIT],
    }
    if result.reconstruction is not None:
        panels["reconstruction"] = axes[FIT:]
    return panels


class AwaitedOverview:
    """Overview of a run that is drawn while the run computes.

    Parameters
    ----------
    scene : Scene
        Scene of the run.
    """

    def __init__(self, scene: Scene) -> None:
        self._axes = _empty()
        self._figure = GrowingFigure(self._axes)
        _draw_room(self._axes, scene)
        self._figure.draw(self._axes[:1])

    def draw_optics(self, found: ScenePointSpread) -> None:
        """Draw the wave and the point spread."""
        _draw_optics(self._axes, found)
        self._figure.draw(self._axes[1:IMAGE])

    def awaiting(self, result: Result) -> Callable[[Reconstruction | None], dict[str, bytes]]:
        """Draw the images of a result without its reconstruction.

        Returns
        -------
        callable
            Takes the reconstruction and returns the files of `overview_panels`; it may be called
            once. If the fit has converged and its values span 0 to 1, all but its image is prepared
            already; otherwise the figure is drawn anew.
        """
        stand_in: Any = None
        if result.plan.runs("reconstruction"):
            stand_in = SimpleNamespace(
                object=np.zeros(result.image.electrons.shape), status="converged"
            )
            stand_in.object[0, 0] = 1.0
        expected = replace(result, reconstruction=stand_in)
        axes = _draw_images(self._axes, expected)
        late = axes[FIT] if stand_in else None
        self._figure.draw(each for each in axes[IMAGE:] if each is not late)
        complete = self._figure.awaiting(_panels(axes, expected), late)

        def files(fit: Reconstruction | None) -> dict[str, bytes]:
            found = None
            if _looks(fit) == _looks(stand_in):
                if fit is not None:
                    axes[FIT].images[0].set_data(np.asarray(fit.object)[:, ::-1])
                found = complete()
            return found or panel_files(overview_panels(replace(result, reconstruction=fit)))

        return files


def _looks(fit: Any) -> Any:
    """Return all that decides on the titles and scales of a reconstruction."""
    if fit is None:
        return None
    values = np.asarray(fit.object)
    return fit.status, values.shape, values.min(), values.max()


def ground_truth(result: Result) -> NDArray[np.float64] | None:
    """Return the image without blur and noise, largest value 1; None if it is dark."""
    ideal = result.image.ideal
    brightest = float(ideal.max())
    return ideal / brightest if brightest > 0 else None


def study_gallery(
    results: Results,
    figure: str,
    *,
    smallest_is_best: bool = False,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw the point spread functions of the worst, the median and the best point of a study.

    A design study computes figures of merit, such as the Strehl ratio, at many points. Each point
    is the scene with one set of values.

    Parameters
    ----------
    results : Results
        Results of a study, complete or not. The point spread functions of the three points are
        computed again by `nlosoptics.study.Results.point_spread`.
    figure : str
        Name of the figure of merit by which the points are ranked, as in the study file.
    smallest_is_best : bool
        Whether the best point has the smallest figure of merit, as for a spot radius. By default it
        has the largest.
    axes : sequence of 3 matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    tuple of Axes
        Worst, median and best point: three maps with the same limits, in um, on logarithmic colour
        scales. Their titles give the figure of merit and the values that the study sets at the
        point.

    Raises
    ------
    SceneError
        If the study has no such figure of merit, or no point has a value of it.

    See Also
    --------
    point_spread : Map of a PSF.
    nlosoptics.study.Results : Results of a study.
    """
    figure = results.study.figure(figure).name
    chosen = ranked(results, figure, smallest_is_best=smallest_is_best)
    values = results.values(figure, incomplete=True)
    from ..study.design.values import label  # reads units, which other views do not need

    panels = tuple(axes or new_axes(len(chosen), width=12.0, height=4.4))
    widest = 0.0
    for panel, (rank, index) in zip(panels, chosen.items(), strict=True):
        point_spread(results.point_spread(index).point_spread, axes=panel)
        widest = max(widest, *map(abs, (*panel.get_xlim(), *panel.get_ylim())))
        told = [f"{rank}: {figure} = {values[index]:.3g}"]
        told += [f"{name} = {label(value)}" for name, value in results.study.delta(index).items()]
        panel.set_title("\n".join(told), fontsize=8)
    for panel in panels:
        panel.set(xlim=(-widest, widest), ylim=(-widest, widest))
    return panels


def ranked(results: Results, figure: str, *, smallest_is_best: bool = False) -> dict[str, int]:
    """Return the numbers of the worst, the median and the best point of a figure.

    Raises
    ------
    SceneError
        If the figure is known at no point.
    """
    values = results.values(figure, incomplete=True)
    order = np.argsort(-values if smallest_is_best else values, kind="stable")
    order = order[np.isfinite(values[order])]
    if not len(order):
        raise SceneError(f"{figure} is known at no point of {results.path}; run the study first")
    places = {"worst": 0, "median": len(order) // 2, "best": -1}
    return {rank: int(order[place]) for rank, place in places.items()}
