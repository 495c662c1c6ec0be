"""Complete runs: planning, simulation, reconstruction, and the record of a run."""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach(__name__, submodules=["reconstructing"])
