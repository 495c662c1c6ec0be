"""nlosoptics: optics of non-line-of-sight imaging, seeing around corners.

A laser illuminates a rough relay wall, light scatters to a hidden object and back, and an ordinary
camera looks at the wall. The subpackages follow the light:

- `scene`: laser, wall, hidden object, camera, materials, scene files.
- `raytrace`: ray tracing and intersections.
- `psf`: exit pupil, wave aberration, point spread functions, metrics.
- `imaging`: radiometry, photons, camera noise, the image model.
- `limits`: what can be recovered from an image, before any fit.
- `inverse`: reconstruction of the hidden object, in torch.
- `transient`: time-resolved captures and their reconstruction.
- `study`: design studies: sweeps, tolerances, yield.
- `views`: plots and 3-D views.
- `report`: HTML report of a run.

`plan` predicts the stages that a scene needs, with time and error; `simulate` runs them.
"""

import lazy_loader as _lazy

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
