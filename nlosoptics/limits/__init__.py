"""What a scene's image can tell, before any fit: photons, modulation, modes, Fisher information.

- `relay`: what wide lobes pass, and its modes above the noise.
- `modulation`: the picture of mirror-like lobes against its noise.
- `wave_bounds`: how well the wall's wave can be told.
- `verdicts`: all of that in words; `reports`: `feasibility`.
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
