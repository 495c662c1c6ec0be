"""nlosoptics: the optics of seeing around corners.

A laser lights a rough relay wall, light scatters to a hidden object and back, and an ordinary
camera looks at the wall. The subpackages follow the light:

- `scene`: laser, wall, hidden object, camera, materials, the scene file.
- `raytrace`: rays and their intersections.
- `psf`: exit pupil, wave aberration, point spread functions, metrics.
- `imaging`: radiance, photons, camera noise, the forward model.
- `limits`: what an image can tell, before any fit.
- `inverse`: reconstructions, in torch.
- `transient`: time-resolved captures and their pictures.
- `views`: pictures.
- `report`: a page about a run.

`plan` says what a scene needs, `simulate` runs exactly that.
"""

import lazy_loader as _lazy

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
