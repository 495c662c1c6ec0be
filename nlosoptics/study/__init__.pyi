from .answers import (
    Fraction as Fraction,
)
from .answers import fraction_within as fraction_within
from .answers import sensitivities as sensitivities
from .answers import sobol_indices as sobol_indices
from .design.point import StudyPoint as StudyPoint
from .design.study import Study as Study
from .optima import Optimum as Optimum
from .optima import optimum as optimum
from .planning import plan_study as plan_study
from .results import Results as Results
from .running import run_study as run_study
from .sweeping import sweep as sweep
