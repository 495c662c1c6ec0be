"""Information limits of a scene's image before any fit: photons, modulation, modes, Fisher bounds.

- `relay`: transfer of wide lobes and the number of their modes above the noise.
- `modulation`: spectrum of the image formed by mirror-like lobes, and its noise.
- `wave_bounds`: Cramer-Rao bounds for the wall's wave.
- `verdicts`: whether the object is recoverable, in text; `reports`: `feasibility`.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
