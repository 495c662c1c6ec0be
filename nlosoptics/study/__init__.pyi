from .answers import (
    Fraction as Fraction,
)
from .answers import (
    Sensitivity as Sensitivity,
)
from .answers import fraction_within as fraction_within
from .answers import sensitivities as sensitivities
from .answers import sobol_indices as sobol_indices
from .design.point import StudyPoint as StudyPoint
from .design.study import Study as Study
from .optima import Allowance as Allowance
from .optima import Optimum as Optimum
from .optima import inverse_sensitivities as inverse_sensitivities
from .optima import optimum as optimum
from .planning import StudyPlan as StudyPlan
from .planning import plan_study as plan_study
from .results import Results as Results
from .running import run_study as run_study
