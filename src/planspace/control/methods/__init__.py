"""The shipped methods, one file each."""

from planspace.control.method import Method
from planspace.control.methods.cem import CEM
from planspace.control.methods.mppi import MPPI
from planspace.control.methods.sampling import Sampling

METHODS: dict[str, Method] = {method.name: method for method in (Sampling(), MPPI(), CEM())}
"""The default settings of each shipped method, by name."""
