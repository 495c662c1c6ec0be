"""Prediction, before any fit, of what an image of a scene can show of the hidden object.

`feasibility` is the main function: it predicts photons, noise, modulation, resolution and whether
the object can be recovered. Other functions give the modulation that a diffuse or a glossy wall
transmits.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
