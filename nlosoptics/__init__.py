"""nlosoptics: optics of non-line-of-sight imaging, seeing around corners.

A laser illuminates a relay wall, light scatters from there to a hidden object and back, and an
ordinary camera looks at the wall. Subpackages:

- `scene`: laser, wall, hidden object, camera, materials, scene files.
- `raytrace`: ray tracing and intersections.
- `psf`: exit pupil, wave aberration, point spread functions, metrics.
- `imaging`: radiometry, photons, camera noise, the image model.
- `limits`: prediction of what an image can show, before any fit.
- `inverse`: reconstruction of the hidden object.
- `transient`: time-resolved captures and their reconstruction.
- `study`: design studies: sweeps, tolerances, yield, optimisation.
- `views`: plots and 3-D views.
- `report`: HTML report of a run or a study.
- `verification`: checks of the library on this machine.

`Scene.load` reads a scene file, `plan` predicts the stages of its simulation with time and error,
and `simulate` runs them.
"""

import lazy_loader as _lazy

__version__ = "0.2.0"

_attribute, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Return a part, loaded at first use; name the right call for one that others have."""
    if name == "load_scene":
        raise AttributeError("nlosoptics has no load_scene; use nlosoptics.Scene.load(path)")
    return _attribute(name)
