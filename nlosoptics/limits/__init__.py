"""Information limits of a scene's image before any fit: photons, modulation, modes, Fisher bounds.

- `relay`: transfer of wide lobes and the number of their modes above the noise.
- `modulation`: spectrum of the image formed by mirror-like lobes, and its noise.
- `wave_bounds`: Cramer-Rao bounds for the wall's wave.
- `verdicts`: whether the object is recoverable, in text; `reports`: `feasibility`.
"""

from .modulation import object_scale
from .relay import lambert_relay_limit, lambert_relay_transfer, lobe_relay_transfer
from .reports import Feasibility, feasibility

__all__ = [
    "Feasibility",
    "feasibility",
    "lambert_relay_limit",
    "lambert_relay_transfer",
    "lobe_relay_transfer",
    "object_scale",
]
