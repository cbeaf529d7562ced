"""Does an embedding become better when it also learns from what the controller did?

    python benchmarks/closing_loop.py runs/loop --plans 10

Round 0: an embedding of the plans. Each further round controls 60 starts that no plan and no test has, adds
demonstrations, and trains again on all of them. `--learn arrivals` adds the episodes that arrived;
`--learn visits` adds a plan from a random state of each episode, or, where it did not arrive, from its last
state. After every round the same 20 starts are controlled. Rows are added to
results/control/closing_loop.csv; what the folder holds is not made again. `--table` prints the table of
docs/appendix/control.md.
"""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
from csv_rows import add_row, has_row, make_parser, parse

from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.control.runs import DEMOS, EPISODES, control_into
from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.load import load_demos
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_embedding
from planspace.errors import PlanspaceError
from planspace.physics.replay import replay
from planspace.plan.demonstrations import plan_demos
from planspace.tasks.problem import Box

RESULTS = Path(__file__).parents[1] / "results" / "control" / "closing_loop.csv"
COLUMNS = (
    "problem",
    "learn",
    "plans",
    "round",
    "embedding_seed",
    "demonstrations",
    "horizon_s",
    "success",
    "return_mean",
)
LEARN_STARTS, TEST_STARTS, LEARN_SEED, TEST_SEED, SAMPLES, EPISODE_S = 60, 20, 1000, 0, 128, 8.0
LEARN_HORIZON_S = 0.32


def main() -> None:
    """Run the rounds that the results do not have yet."""
    parser = make_parser(__doc__, "where all that is made is kept")
    parser.add_argument("--problem", default="cartpole-swingup", help="a task with a planning problem")
    parser.add_argument("--plans", type=int, default=60, metavar="N", help="number of plans")
    parser.add_argument("--learn", choices=("arrivals", "visits"), default="visits")
    parser.add_argument("--rounds", type=int, default=2, metavar="N", help="rounds after the first embedding")
    parser.add_argument("--horizons", nargs="+", type=float, default=[0.16, 0.32], metavar="S")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="embeddings of each round")
    options, rows = parse(parser, RESULTS, table)
    plant = Plant.find(options.problem)
    folder = options.folder / f"{options.problem}-{options.plans}"
    demos = plan_demos(plant.problem, options.plans, out=folder / "plans")
    folder, more = folder / options.learn, arrivals if options.learn == "arrivals" else visits
    for number in range(options.rounds + 1):
        embeddings = [embedding_of(demos, folder, number, seed) for seed in range(options.seeds)]
        for seed, horizon in itertools.product(range(options.seeds), options.horizons):
            key = {
                "problem": options.problem,
                "learn": options.learn,
                "plans": str(options.plans),
                "round": str(number),
                "embedding_seed": str(seed),
                "horizon_s": str(horizon),
            }
            if not has_row(rows, key):
                out = folder / f"test-{number}{suffix(seed)}-{horizon}"
                found = test(plant, embeddings[seed], horizon, out) | {"demonstrations": str(len(demos))}
                add_row(RESULTS, COLUMNS, rows, key | found)
        if number < options.rounds:
            demos = more(plant, embeddings[0], demos, folder / f"learn-{number}", LEARN_SEED + number)


def embedding_of(demos: Demos, folder: Path, number: int, seed: int) -> Embedding:
    """An embedding of the demonstrations of a round: the best of five, from seeds of its own."""
    return fit_embedding(demos, seed=5 * seed, out=folder / f"embedding-{number}{suffix(seed)}")


def suffix(seed: int) -> str:
    """What marks an embedding's seed in the names of folders."""
    return f"-seed{seed}" if seed else ""


def test(plant: Plant, embedding: Embedding, horizon: float, out: Path) -> dict[str, str]:
    """Control the test starts."""
    config = ControlConfig(horizon_s=horizon, samples=SAMPLES)
    found = control_into(plant, embedding, config, out, num=TEST_STARTS, seed=TEST_SEED, episode_s=EPISODE_S)
    return {"success": f"{found.success:.2f}", "return_mean": f"{found.return_mean:.1f}"}


def arrivals(plant: Plant, embedding: Embedding, demos: Demos, out: Path, seed: int) -> Demos:
    """Control other starts, and add the episodes that arrived to the demonstrations."""
    control(plant, embedding, out, seed)
    controlled = load_demos(out / DEMOS)
    episodes = [fine(plant, controlled.episode(i)) for i in range(len(controlled))]
    return Demos.from_episodes(demos.info, [*map(demos.episode, range(len(demos))), *episodes])


def visits(plant: Plant, embedding: Embedding, demos: Demos, out: Path, seed: int) -> Demos:
    """Control other starts, and plan from states that were visited."""
    control(plant, embedding, out, seed)
    visited, rng = load_demos(out / EPISODES), np.random.default_rng(seed)
    episodes = [demos.episode(i) for i in range(len(demos))]
    for i in range(len(visited)):
        states = visited.episode(i).states
        state = states[rng.integers(len(states) // 4)] if visited.success[i] else states[-1]
        problem = replace(plant.problem, start=Box(tuple(state), tuple(state)))
        try:
            plan = plan_demos(problem, 1, out=out / "plans" / str(i), workers=0, verbose=False)
        except PlanspaceError as error:
            print(f"no plan from {state}: {error}", flush=True)
        else:
            episodes.append(plan.episode(0))
    return Demos.from_episodes(demos.info, episodes)


def control(plant: Plant, embedding: Embedding, out: Path, seed: int) -> None:
    """Control the starts that are learned from."""
    config = ControlConfig(horizon_s=LEARN_HORIZON_S, samples=SAMPLES)
    control_into(plant, embedding, config, out, num=LEARN_STARTS, seed=seed, episode_s=EPISODE_S)


def fine(plant: Plant, episode: Episode) -> Episode:
    """The same episode with a state for each physics step, as plans have."""
    repeats, step = plant.task.frame_skip, float(plant.model.opt.timestep)
    controls = np.repeat(episode.controls, repeats, axis=0)
    times = step * np.arange(len(controls) + 1)
    states = replay(plant.model, plant.space, episode.states[0], controls, times)
    return replace(episode, states=states, controls=controls, times=times)


def table(rows: list[dict[str, str]]) -> str:
    """Success after each round, mean and range over the embeddings, one column a horizon."""
    horizons = sorted({row["horizon_s"] for row in rows}, key=float)
    lines = [
        "| problem | learns from | plans | round | demonstrations | embeddings | "
        + " | ".join(f"{h} s" for h in horizons)
        + " |",
        f"|---|---|---|---|---|---|{'---|' * len(horizons)}",
    ]
    names = ("problem", "learn", "plans", "round", "demonstrations")
    for key in dict.fromkeys(tuple(row[name] for name in names) for row in rows):
        ours = [row for row in rows if tuple(row[name] for name in names) == key]
        cells = [[float(row["success"]) for row in ours if row["horizon_s"] == h] for h in horizons]
        seeds = len({row["embedding_seed"] for row in ours})
        lines.append(f"| {' | '.join([*key, str(seeds), *map(mean_and_range, cells)])} |")
    return "\n".join(lines)


def mean_and_range(values: list[float]) -> str:
    """The mean of fractions and, if there are several, their range, in percent."""
    if len(values) <= 1:
        return "".join(f"{value:.0%}" for value in values)
    return f"{np.mean(values):.0%} ({min(values):.0%} to {max(values):.0%})"


if __name__ == "__main__":
    main()
