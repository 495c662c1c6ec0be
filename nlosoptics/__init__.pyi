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
from .scene import Scene as Scene
from .simulation import Result as Result
from .simulation import simulate as simulate
