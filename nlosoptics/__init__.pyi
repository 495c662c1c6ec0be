__version__: str

from . import imaging as imaging
from . import inverse as inverse
from . import limits as limits
from . import psf as psf
from . import raytrace as raytrace
from . import report as report
from . import scene as scene
from . import transient as transient
from . import views as views
from .planning import Plan as Plan
from .planning import plan as plan
from .results import Result as Result
from .results import load_result as load_result
from .scene import Scene as Scene
from .simulation import simulate as simulate
