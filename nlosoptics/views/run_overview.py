"""One figure that shows a whole run: room, wave aberration, PSF, image and reconstruction."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .canvas import new_axes
from .maps import image, point_spread, pupil_field, reconstruction, wavefront
from .sketch import room_from_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..runs.results import Result


def overview(result: Result) -> tuple[Axes, ...]:
    """Draw the results of a run in one figure, in the order of the computation.

    Parameters
    ----------
    result : Result
        Result of `simulate`, with or without a reconstruction.

    Returns
    -------
    tuple of Axes
        Two rows. The upper row shows the room from above, the wave aberration (of a rough wall the
        phase in the pupil) and the point spread function. The lower row shows the camera image and,
        where there is one, the reconstruction without and with the ground truth.

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
    from ..limits import object_scale  # loads scipy; views alone is light

    axes = new_axes(6, width=16.5, height=9.6, columns=3)
    figure: Any = axes[0].get_figure(root=True)
    figure.get_layout_engine().set(w_pad=0.15, h_pad=0.1)
    scale = object_scale(result.scene)
    room_from_above(result.scene, axes[0])
    axes[0].legend(fontsize="small", loc="best")
    if result.pupil_field is None:
        wavefront(result.wavefront, axes=axes[1])
    else:
        pupil_field(result.pupil_field, axes=axes[1])
    point_spread(result.point_spread, scale="linear", axes=axes[2])
    image(result.image, object_scale=scale, axes=axes[3])
    used = 4
    if result.reconstruction is not None:
        truth = ground_truth(result)
        used = 5 if truth is None else 6
        free = axes[used - 1 : 3 : -1]  # the truth comes first, and is drawn on the right
        reconstruction(result.reconstruction, truth, pitch=scale * result.image.pitch, axes=free)
    for spare in axes[used:]:
        spare.remove()
    return axes[:used]


def ground_truth(result: Result) -> NDArray[np.float64] | None:
    """Return the image without blur and noise, largest value 1; None if it is dark."""
    ideal = result.image.ideal
    brightest = float(ideal.max())
    return ideal / brightest if brightest > 0 else None
