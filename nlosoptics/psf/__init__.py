"""Exit pupils, waves, point spread functions (PSFs) and their metrics.

`scene_point_spread` computes the wave and the PSF of a scene. Without a scene, make a `Wavefront`
(`Wavefront.from_zernike`, `from_function`, `from_map`) and pass it to `point_spread`.

Sub-folders: ``aperture`` (pupil outlines and nodes), ``wave`` (sampled waves), ``pupil`` (exit
pupil and wave of a scene), ``window`` (image windows, pixels, error bounds), ``transform`` (from
wave to PSF), ``batch`` (many waves on one pupil), ``propagation`` (fields between parallel planes),
``walls`` (PSFs of scenes and fields), ``rough`` (rough walls), ``metrics`` (Strehl ratio, MTF, best
focus and others), ``exchange`` (other programs). Import everything from ``nlosoptics.psf``.

Arguments out of range raise `SceneError`, and arrays that would not fit into memory
`MemoryLimitError`.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
