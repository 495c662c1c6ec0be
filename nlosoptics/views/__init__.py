"""Figures and 3-D views of results; `save` writes them to files.

Every function draws on the axes or the plotter that is passed, or on a new one, and returns it.
Nothing is computed here, and no window opens. matplotlib and pyvista belong to the extra
``nlosoptics[views]`` and are imported when the first figure needs them. Figures are made without
pyplot, so that they need no display and keep no global state; plotters render off screen.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
