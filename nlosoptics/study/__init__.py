"""Design studies: figures of merit against any values of a scene, on all cores or a cluster.

`Study.load` reads a study file. `run_study` computes the figures of merit at all points of the
study and keeps them in a folder, the store, which a later run completes or extends. `Results` reads
the store. `sensitivities`, `sobol_indices`, `fraction_within` and `optimum` evaluate the results.
"""

import lazy_loader as _lazy

# lazy, because a worker sets its number of threads before numpy is imported
__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
