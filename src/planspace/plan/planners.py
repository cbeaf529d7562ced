"""The planners that come with planspace."""

from planspace.plan.ompl.planners import OMPL_PLANNERS
from planspace.plan.planner import Planner
from planspace.plan.sst import SST

PLANNERS: dict[str, Planner] = {SST.name: SST(), **OMPL_PLANNERS}
"""Name to planner with default settings."""
