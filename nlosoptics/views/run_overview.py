"""One figure of a whole run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._checks import expect
from .canvas import new_axes
from .maps import image, point_spread, reconstruction, wavefront
from .sketch import room_from_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
        reconstruction and the true object.

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
    expect("result", result, "Result")
    from ..limits import object_scale  # loads scipy; views alone is light

    fit, truth = result.reconstruction, ground_truth(result)
    count = 4 if fit is None else 5 if truth is None else 6
    axes = new_axes(count, width=16.5, height=9.6, columns=3)
    room_from_above(result.scene, axes[0])
    axes[0].legend(fontsize="small", loc="best")
    wavefront(result.pupil_field or result.wavefront, axes=axes[1])
    point_spread(result.point_spread, scale="linear", axes=axes[2])
    scale = object_scale(result.scene)
    image(result.image, object_scale=scale, axes=axes[3])
    if result.burst is not None:
        axes[3].set_title(f"camera image, 1 of {len(result.burst)}")
    if fit is not None:
        # the truth comes first in `reconstruction`, and is drawn on the right here
        reconstruction(fit, truth, pitch=scale * result.image.pitch, axes=axes[:3:-1])
    return axes


def ground_truth(result: Result) -> NDArray[np.float64] | None:
    """Return the image without blur and noise, largest value 1; None if it is dark."""
    ideal = result.image.ideal
    brightest = float(ideal.max())
    return ideal / brightest if brightest > 0 else None
