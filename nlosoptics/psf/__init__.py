"""Exit pupils, waves, point spread functions (PSFs) and their metrics.

`scene_point_spread` computes the wave and the PSF of a scene. Without a scene, make a `Wavefront`
(`Wavefront.from_zernike`, `from_function`, `from_map`) and pass it to `point_spread`.

Functions of a wave or a point spread also take a `Scene` or a result of `nlosoptics.simulate`. The
wave is that of the object's reference point and of the smooth wall. The point spread, which
energies and widths use, includes the wall's lobes and the pixels. `point_spread` of a scene has the
options of `scene_point_spread`.

Arguments out of range raise `SceneError`, and arrays that would not fit into memory
`MemoryLimitError`.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
