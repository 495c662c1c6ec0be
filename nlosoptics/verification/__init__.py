"""Is it right, on this machine? Closed forms, published values and invariants, in seconds.

`verify` runs all checks; ``nlosoptics verify`` prints them.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
