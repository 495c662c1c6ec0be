__version__: str

from . import imaging as imaging
from . import inverse as inverse
from . import limits as limits
from . import psf as psf
from . import raytrace as raytrace
from . import report as report
from . import scene as scene
from . import study as study
from . import transient as transient
from . import views as views
from .runs import reconstructing as reconstructing
from .runs.plan import Plan as Plan
from .runs.plan import plan as plan
from .runs.results import Result as Result
from .runs.results import load_result as load_result
from .runs.simulate import simulate as simulate
from .scene import Scene as Scene
