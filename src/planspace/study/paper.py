"""The study `paper`: the paper's experiments, and its claims with the numbers that decide them."""

from collections.abc import Iterator
from dataclasses import replace

from planspace.embed.config import PRESETS
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.study.design import RAW, Arm, Builder, Claim, Measure, Study, panel_of
from planspace.tasks.catalog import TASKS

LOW_Z, HIGH_Z = "low-Z augment", "high-Z augment"
ONLY_LOW_Z, ONLY_HIGH_Z = "low-Z only", "high-Z only"
LOW_DIM, HIGH_DIM = 3, 10
ALGOS: tuple[str, ...] = ("trpo", "ppo")
PAPER_STEPS = 8_000_000
TASK_NAMES = tuple(
    task.name
    for task in sorted(TASKS.values(), key=lambda task: task.paper_order or 0)
    if task.paper_order is not None
)
"""The paper's tasks, in its order."""


def paper(budget: str, grid: Builder) -> Study:
    """Compare five arms on four tasks with two algorithms, with embeddings of two systems and two sizes."""
    return Study(
        "paper",
        budget,
        "What did the paper find, and does it hold?",
        tuple(arm for algo in ALGOS for task in TASK_NAMES for arm in _arms(task, algo, grid)),
        (*_swing_up_claims(), *_cartpole_claims(), *_reacher_claims(), *_algorithm_claims()),
        tuple(_notes(grid.budget.steps)),
    )


def _notes(steps: int) -> Iterator[str]:
    yield (
        "The two reachers are the same task for policies that observe only z, because they do not see the "
        "target. These arms are run once and shown twice."
    )
    yield (
        "The demonstrations are made by planspace and reach their goals. Embeddings and both algorithms use "
        "the preset paper."
    )
    if steps < PAPER_STEPS:
        yield (
            f"The paper ran {PAPER_STEPS:,} steps per seed, this study {steps:,}. Claims about the end of "
            "training are judged after these steps."
        )


def _arms(task: str, algo: str, grid: Builder) -> Iterator[Arm]:
    panel, plans = panel_of(task, algo), grid.plans_for(task)
    low, high = (
        grid.fit(plans, replace(PRESETS["paper"], z_dim=z_dim), num_seeds=grid.budget.embeddings)
        for z_dim in (LOW_DIM, HIGH_DIM)
    )
    base = TrainConfig(find_algorithm(algo))
    # the two reachers do not differ if only z is observed
    only, same = replace(base, z="replace"), "reacher-raw" if task == "reacher-trig" else task
    yield grid.arm(panel, RAW, task, base)
    yield grid.arm(panel, LOW_Z, task, replace(base, z="augment"), [low])
    yield grid.arm(panel, HIGH_Z, task, replace(base, z="augment"), [high])
    yield grid.arm(panel, ONLY_LOW_Z, same, only, [low])
    yield grid.arm(panel, ONLY_HIGH_Z, same, only, [high])


def _swing_up_claims() -> Iterator[Claim]:
    trpo, ppo = (_ClaimsAgainstRaw("cartpole-swingup", algo) for algo in ALGOS)
    for z in (LOW_Z, HIGH_Z):
        yield trpo.more(f"TRPO swings up better on average with {z}", "final", z)
        yield _late(trpo.more(f"TRPO rises slightly faster with {z}", "early", z))
        yield trpo.same(f"The best cases with {z} are like raw's", "best", z)
        yield trpo.more(f"Seeds vary less towards the end with {z}", "spread", z)
        yield ppo.more(f"PPO: the two best seeds are better with {z}", "best", z)
        yield ppo.more(f"PPO: slightly better on average with {z}", "final", z)
    low, high = (f"{trpo.panel}/{z}" for z in (LOW_Z, HIGH_Z))
    yield Claim("Seeds vary less with low-Z than with high-Z", FIGURE, "spread", low, high, late=True)
    for z in (ONLY_LOW_Z, ONLY_HIGH_Z):
        yield trpo.less(f"Swing-up: {z} does not do well", "final", z)
        yield ppo.less(f"Swing-up, PPO: {z} does not do well", "final", z)


def _cartpole_claims() -> Iterator[Claim]:
    judge, ppo = _ClaimsAgainstRaw("cartpole", "trpo"), panel_of("cartpole", "ppo")
    name = f"{judge.panel}/{RAW}"
    yield Claim("CartPole: raw is near perfect almost at once", SOURCE, "early", name, "", margin=80.0)
    for z in (LOW_Z, HIGH_Z):
        yield judge.same(f"CartPole: {z} is even with raw or slightly worse", "final", z)
    for z in (ONLY_LOW_Z, ONLY_HIGH_Z):
        text = f"CartPole: {z} still does well"
        yield Claim(text, SOURCE, "final", f"{judge.panel}/{z}", "", margin=80.0, late=True)
        yield judge.less(f"CartPole: {z} is not as good as raw", "final", z)
        text = f"CartPole: {z} does better with TRPO than with PPO"
        yield Claim(text, SOURCE, "final", f"{judge.panel}/{z}", f"{ppo}/{z}", late=True)
    for z in (RAW, LOW_Z, HIGH_Z):
        text = f"CartPole, PPO: {z} finds nearly perfect policies"
        yield Claim(text, SOURCE, "final", f"{ppo}/{z}", "", margin=90.0)


def _reacher_claims() -> Iterator[Claim]:
    trig, raw = _ClaimsAgainstRaw("reacher-trig", "trpo"), _ClaimsAgainstRaw("reacher-raw", "trpo")
    yield trig.same("ReacherTrig: low-Z is even with raw", "final", LOW_Z)
    yield trig.less("ReacherTrig: high-Z is behind early", "early", HIGH_Z)
    yield trig.same("ReacherTrig: high-Z catches up", "final", HIGH_Z)
    yield raw.more("ReacherRaw: seeds vary less early with low-Z", "early_spread", LOW_Z)
    yield raw.less("ReacherRaw: high-Z slightly under-performs", "final", HIGH_Z)
    yield _late(raw.more("ReacherRaw: low-Z improves on raw, to a lesser extent", "final", LOW_Z))
    for task in ("reacher-trig", "reacher-raw"):
        for z in (ONLY_LOW_Z, ONLY_HIGH_Z):
            yield _late(_ClaimsAgainstRaw(task, "trpo").less(f"{task}: {z} does not do well", "final", z))
            yield _late(_ClaimsAgainstRaw(task, "ppo").less(f"{task}, PPO: {z} does not do well", "final", z))
        for z in (LOW_Z, HIGH_Z):
            yield _ClaimsAgainstRaw(task, "ppo").less(f"{task}, PPO: {z} slightly under-performs", "final", z)
        for arm in (RAW, LOW_Z, HIGH_Z):
            text = f"{task}, PPO: {arm} is no particularly strong policy"
            name = f"{panel_of(task, 'ppo')}/{arm}"
            yield Claim(text, SOURCE, "final", name, "", "less", margin=STRONG_REACHER, late=True)


def _algorithm_claims() -> Iterator[Claim]:
    for task in ("cartpole-swingup", "reacher-trig", "reacher-raw"):
        for arm in (RAW, LOW_Z, HIGH_Z):
            ppo, trpo = (f"{panel_of(task, algo)}/{arm}" for algo in ("ppo", "trpo"))
            text = f"{task}, {arm}: PPO under-performs TRPO"
            yield Claim(text, SOURCE, "final", ppo, trpo, "less", late=arm != RAW)


def _late(claim: Claim) -> Claim:
    """Mark a claim as made or changed after some returns were known."""
    return replace(claim, late=True)


SOURCE, FIGURE = "RL performance", "figure of TRPO"
"""Parts of the paper that make the claims."""
STRONG_REACHER = 10.0
"""A strong reacher policy has a return above minus this: halfway between the paper's levels of a reacher that
does nothing, -14, and one that reaches the target, -6."""


class _ClaimsAgainstRaw:
    """Makes claims that compare the arms of a task and algorithm with the arm `raw`."""

    def __init__(self, task: str, algo: str):
        self.panel, self.similar = panel_of(task, algo), TASKS[task].similar_return or 0.0

    def more(self, text: str, measure: Measure, arm: str) -> Claim:
        return Claim(text, SOURCE, measure, f"{self.panel}/{arm}", f"{self.panel}/{RAW}")

    def less(self, text: str, measure: Measure, arm: str) -> Claim:
        return Claim(text, SOURCE, measure, f"{self.panel}/{arm}", f"{self.panel}/{RAW}", "less")

    def same(self, text: str, measure: Measure, arm: str) -> Claim:
        return Claim(
            text, SOURCE, measure, f"{self.panel}/{arm}", f"{self.panel}/{RAW}", "same", self.similar
        )
