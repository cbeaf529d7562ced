"""How demonstrations are planned: the settings of every step, in one nested dataclass."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Suppress, arg

from planspace.errors import UsageError, check_setting, unknown
from planspace.plan.durations import in_seconds
from planspace.plan.metric import Metric, check_metric
from planspace.plan.planner import PAGE, Planner, as_planner
from planspace.plan.planners import PLANNERS
from planspace.plan.sst import SST
from planspace.seams import UNSET_IF_NONE, check_fits

if TYPE_CHECKING:
    from planspace.tasks.problem import Problem

LARGEST_SETTING = 1e12
OWN_SETTINGS = ("restarts", "keep_trees", "tree_nodes")
"""The settings of `PlanConfig` itself, apart from the planner."""


@dataclass(frozen=True)
class PolishConfig:
    """Settings of the polish, which shortens a plan and lands it on its goal."""

    max_iterations: Annotated[int, arg(name="polish-max-iterations")] = 80
    """Linear programs in total, each followed by a simulation; 0 leaves the planner's path as it is."""
    shortcut_rounds: Annotated[int, arg(name="polish-shortcut-rounds")] = 30
    """Rounds of shortcuts by simulation, for plans with contacts; see `shortcut`. 0 makes none."""
    max_blocks: Annotated[int, arg(name="polish-max-blocks")] = 400
    """A plan with more steps of `polish_step_s` is polished in longer steps."""
    step_s: Annotated[float, arg(name="polish-step-s")] = 0.01
    """Time for which a polished plan holds each control [s]; at least one physics step."""
    landing: Annotated[float, arg(name="polish-landing")] = 1.0
    """Aim at this fraction of the goal's tolerance."""
    tracking_cost: Annotated[float, arg(name="polish-tracking-cost")] = 0.01
    """Cost of the largest control in the feedback, relative to the weighted states. Lower values track more
    stiffly."""
    repairs: Annotated[int, arg(name="polish-repairs")] = 60
    """A path that does not arrive is continued to the goal by a straight line, which no control follows, and
    at most this many linear programs make it a plan; 0 gives up such paths."""
    velocity_margin: Annotated[float, arg(name="polish-velocity-margin")] = 0.0
    """If positive, changes keep velocities below their bounds by this fraction of them. Otherwise a change
    that exceeds a bound is only rejected; set it, for example to 0.01, if velocities reach their bounds."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UsageError: a setting is out of its range.
        """
        check_setting("polish_max_iterations", self.max_iterations, self.max_iterations >= 0, "at least 0")
        check_setting("polish_shortcut_rounds", self.shortcut_rounds, self.shortcut_rounds >= 0, "at least 0")
        check_setting("polish_max_blocks", self.max_blocks, self.max_blocks >= 1, "at least 1")
        check_setting("polish_step_s", self.step_s, self.step_s > 0, "above 0")
        check_setting("polish_landing", self.landing, 0 < self.landing <= 1, "above 0 and at most 1")
        check_setting("polish_tracking_cost", self.tracking_cost, self.tracking_cost > 0, "above 0")
        check_setting("polish_repairs", self.repairs, self.repairs >= 0, "at least 0")
        margin = self.velocity_margin
        check_setting("polish_velocity_margin", margin, 0 <= margin < 1, "at least 0 and below 1")


@dataclass(frozen=True)
class RegulatorConfig:
    """Settings of the regulator that takes over near the goal and holds it."""

    control_cost: Annotated[float, arg(name="regulator-control-cost")] = 0.001
    """Cost of the largest control, held for one step, relative to the weighted states. Lower values act more
    strongly."""
    velocity_cost: Annotated[float, arg(name="regulator-velocity-cost")] = 0.1
    """Factor on the weights of velocities; lower values let the robot move faster."""
    max_s: Annotated[float, arg(name="regulator-max-s")] = 1.5
    """Time within which the regulator must arrive [s]."""
    hold_s: Annotated[float, arg(name="regulator-hold-s")] = 1.0
    """Time for which the regulator must then hold the goal [s], if the problem wants it held."""
    step_s: Annotated[float, arg(name="regulator-step-s")] = 0.01
    """Time for which the regulator holds each control [s]; at least one physics step."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UsageError: a setting is out of its range.
        """
        check_setting("regulator_max_s", self.max_s, self.max_s > 0, "above 0")
        check_setting("regulator_hold_s", self.hold_s, self.hold_s >= 0, "at least 0")
        check_setting("regulator_step_s", self.step_s, self.step_s > 0, "above 0")
        check_setting("regulator_control_cost", self.control_cost, self.control_cost > 0, "above 0")
        check_setting("regulator_velocity_cost", self.velocity_cost, self.velocity_cost >= 0, "at least 0")


@dataclass(frozen=True)
class PlanConfig:
    """How demonstrations are planned."""

    planner: Planner = field(default_factory=SST)
    """Searches for a path from a start to a goal."""
    restarts: Annotated[
        int | None,
        arg(metavar="INT", help_behavior_hint=lambda given: f"(default: {given})" if given != "None" else ""),
    ] = None
    """Independent searches per plan. The two shortest paths are polished, and the better plan is kept. More
    searches find shorter plans. By default 2 for sst and 1 for others."""
    polish: PolishConfig = field(default_factory=PolishConfig)
    """Shortens a plan and lands it on its goal."""
    regulator: RegulatorConfig = field(default_factory=RegulatorConfig)
    """Takes over near the goal and holds it."""
    keep_trees: bool = False
    """Store the tree of the search that found each plan, too: states that the planner reached, and how long
    it took to reach each from its parent."""
    tree_nodes: Annotated[int, arg(metavar="N")] = 5000
    """Largest number of nodes of a stored tree. Of a larger tree, random nodes and their ancestors are
    stored."""

    metric: Annotated[Metric | None, Suppress] = field(default=None, metadata=UNSET_IF_NONE)
    """How far states are from a goal, for example `embedding.time_to_go`: sst then extends the nodes nearest
    to the goal more often; see its setting `greedy`."""

    def __post_init__(self) -> None:
        """Check the planner, the restarts, the number of nodes and the metric.

        Raises:
            UsageError: the object is no `Planner`, a number is below 1, or the planner uses no metric.
        """
        check_setting("tree_nodes", self.tree_nodes, self.tree_nodes >= 1, "at least 1")
        check_fits(self.planner, Planner, PAGE)
        if self.metric is not None:
            check_metric(self.metric, self.planner)
        check_setting("restarts", self.restarts, self.restarts is None or self.restarts >= 1, "at least 1")

    @property
    def num_searches(self) -> int:
        """Searches per plan: `restarts`, or what the planner prefers."""
        return self.restarts or int(getattr(self.planner, "default_restarts", 1))

    @classmethod
    def for_problem(cls, problem: "Problem", /, **changes: Any) -> "PlanConfig":
        """The defaults, with the problem's own planner and settings and with further changes.

        Args:
            problem: its `settings` name fields of the planners and of the parts of this class:
                `polish_FIELD`, `regulator_FIELD`, `ompl_FIELD`, and `sst_FIELD` or `FIELD` for `sst`.
            changes: settings with the same names, those in `OWN_SETTINGS`, and `planner`, which is a name or
                an object. A planner that is not shipped takes its own fields as `FIELD`. None leaves the
                default.

        Raises:
            UsageError: a setting that does not exist, or a value out of range.
        """
        own = {"planner": problem.planner, **dict(problem.settings)}
        given = own | {key: value for key, value in changes.items() if value is not None}
        try:
            return cls._from_settings(problem, given)
        except UsageError as error:
            if given != own:
                raise
            raise UsageError(f"problem {problem.name!r}: {error}") from error

    @classmethod
    def _from_settings(cls, problem: "Problem", given: dict[str, Any]) -> "PlanConfig":
        given = dict(given)
        chosen = given.pop("planner")
        if any(name.endswith("_steps") for name in given):  # of version 0.1.0
            given = in_seconds(given, problem.compile()[0].opt.timestep)
        return _Settings(find_planner(chosen)).configured(given)


def find_planner(given: Any) -> Planner:
    """A shipped planner by its name, or the planner that was handed over.

    Raises:
        UsageError: the name is unknown, or the object does not fit the protocol `Planner`.
    """
    if not isinstance(given, str):
        return as_planner(given)
    if given not in PLANNERS:
        raise unknown("planner", given, PLANNERS)
    return PLANNERS[given]


class _Settings:
    """The flat names of all settings: which field of which part each one names.

    A problem file may give settings of several planners, because the planner can be chosen on the command
    line. Those of other planners are checked and then not used.
    """

    def __init__(self, planner: Planner):
        shipped: dict[str, Planner] = {}
        for name, default in PLANNERS.items():
            shipped.setdefault(name.partition("-")[0], default)
        kinds = {type(default): group for group, default in shipped.items()}
        self.group = kinds.get(type(planner), "")
        parts = {"polish": PolishConfig(), "regulator": RegulatorConfig()}
        self.parts: dict[str, Any] = {**shipped, **parts, self.group: planner}

    def configured(self, given: dict[str, Any]) -> PlanConfig:
        """The config with the settings given."""
        changed: dict[str, dict[str, Any]] = {part: {} for part in self.parts}
        own: dict[str, Any] = {}
        for key, value in given.items():
            if key == "keep_trees":
                own[key] = bool(value)
            elif key in OWN_SETTINGS:
                own[key] = int(_like(1, key, value))
            else:
                part, name = self._place(key)
                changed[part][name] = _like(getattr(self.parts[part], name), key, value)
        try:
            parts = {key: replace(part, **changed[key]) for key, part in self.parts.items() if changed[key]}
            parts = self.parts | parts
            return PlanConfig(parts[self.group], polish=parts["polish"], regulator=parts["regulator"], **own)
        except (UsageError, ValueError) as error:
            raise UsageError(f"settings: {error}") from error

    def _place(self, key: str) -> tuple[str, str]:
        """The part and the field that a setting names."""
        known = dict(self._names())
        if key in known:
            return known[key]
        if (default := f"{SST.name}_{key}") in known:
            return known[default]
        raise unknown("setting", key, ["planner", *OWN_SETTINGS, *known])

    def _names(self) -> Iterator[tuple[str, tuple[str, str]]]:
        for part, settings in self.parts.items():
            if is_dataclass(settings):
                for f in fields(settings):
                    yield (f"{part}_{f.name}" if part else f.name), (part, f.name)


def _like(default: Any, key: str, value: Any) -> int | float:
    """A number from a file or the command line, as an integer if the default is one."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST_SETTING:
        raise UsageError(f"setting {key!r} takes a number, got {value!r}.")
    if isinstance(default, bool) or not isinstance(default, int | float):
        raise UsageError(f"setting {key!r} is not a number; it can only be set from Python.")
    if isinstance(default, int) and value != int(value):
        raise UsageError(f"setting {key!r} takes an integer, got {value!r}.")
    return type(default)(value)
