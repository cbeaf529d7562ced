"""Planning: what a planner of your own needs. `planspace.plan_demos` plans with it."""

from planspace.demos.search_tree import SearchTree
from planspace.plan.config import PlanConfig
from planspace.plan.planner import Failure, Plan, Planner
from planspace.plan.planners import PLANNERS

__all__ = ["PLANNERS", "Failure", "Plan", "PlanConfig", "Planner", "SearchTree"]
