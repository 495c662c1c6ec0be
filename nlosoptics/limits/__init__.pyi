from .modulation import object_scale as object_scale
from .relay import lambert_relay_limit as lambert_relay_limit
from .relay import lambert_relay_transfer as lambert_relay_transfer
from .relay import lobe_relay_transfer as lobe_relay_transfer
from .reports import Feasibility as Feasibility
from .reports import feasibility as feasibility
