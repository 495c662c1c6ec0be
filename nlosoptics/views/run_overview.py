"""One figure of a whole run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import expect
from .canvas import new_axes
from .maps import image, point_spread, reconstruction, wavefront
from .sketch import room_from_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..inverse import Reconstruction
    from ..runs.results import Result


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
        The lower row shows the camera image (of a burst the first one) and, where there is one, the
        reconstruction and the true object. A wall without a mirror-like lobe has no wave and no
        point spread function.

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
    result = expect("result", result, "Result")
    from ..limits import object_scale  # loads scipy; views alone is light

    fit, truth, options = shown_fit(result)
    waves = 0 if result.point_spread is None else 2
    count = waves + (2 if fit is None else 3 if truth is None else 4)
    axes = new_axes(count, width=16.5 if waves else 11.0, height=9.6, columns=3 if waves else 2)
    room_from_above(result.scene, axes[0])
    axes[0].legend(fontsize="small", loc="best")
    if result.point_spread is not None and result.wavefront is not None:
        wavefront(result.pupil_field or result.wavefront, axes=axes[1])
        point_spread(result.point_spread, scale="linear", axes=axes[2])
    at = axes[1 + waves]
    image(result.image, object_scale=object_scale(result.scene) if waves else None, axes=at)
    if result.burst is not None:
        at.set_title(f"camera image, 1 of {len(result.burst)}")
    if fit is not None:
        # the truth comes first in `reconstruction`, and is drawn on the right here
        reconstruction(fit, truth, **options, axes=axes[: 1 + waves : -1])
    return axes


def shown_fit(
    result: Result,
) -> tuple[Reconstruction | None, NDArray[np.float64] | None, dict[str, Any]]:
    """Return the reconstruction, the true object and the options with which both are drawn.

    An object from shadows is on cells of its plane, which the wall has not mirrored.
    """
    from ..imaging.objects import plate
    from ..limits import object_scale
    from ..runs.results import ground_truth

    fit, truth = result.reconstruction, ground_truth(result)
    if truth is not None:
        truth = truth / float(truth.max())
    if result.point_spread is not None or fit is None:
        return fit, truth, {"pitch": object_scale(result.scene) * result.image.pitch}
    return fit, truth, {"pitch": plate(result.scene)[2][0] / fit.object.shape[1], "mirrored": False}
