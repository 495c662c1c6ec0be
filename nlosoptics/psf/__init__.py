"""From the wave in the exit pupil to the point spread function, and its metrics."""

from .point_spreads import PointSpread, point_spread
from .nodes import grid_nodes, polar_nodes
from .wavefronts import Removed, Wavefront
