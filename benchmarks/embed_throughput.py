"""Training speed of embeddings: all seeds in one program, compared with the usual ways to train them.

    python benchmarks/embed_throughput.py [--device cpu] [--rounds 5] [--seeds 1 5 6 20 50]

Each row is the number of optimiser steps per second, summed over seeds, for the preset `paper` with batches
of 50 triplets of 60 random demonstrations. Every round measures all rows one after another. All seeds in one
program are compared with
  (a) one process per core, each with a compiled loop of one seed, only on the CPU;
  (b) one compiled update per Python call for one seed, as in the 2020 code.
Compilation is not measured.
"""

import argparse
import multiprocessing
import os
import time
from dataclasses import replace

import numpy as np

CONTROLS, STATES, LENGTH, DEMOS = 1, 4, 120, 60
STEPS = 5000


def prepare(num_seeds: int, steps: int, one_by_one: bool = False):
    """Return a function that trains all seeds for some steps, with one call for all steps or one per step."""
    import jax
    import jax.numpy as jnp
    import jax.random as jr

    from planspace.demos.dataset import Demos
    from planspace.demos.episode import Episode
    from planspace.demos.state_info import StateInfo
    from planspace.embed.config import PRESETS
    from planspace.embed.inputs import Inputs
    from planspace.embed.samples import make_samples
    from planspace.embed.steps import init, make_advance, run_steps

    rng = np.random.default_rng(0)
    info = StateInfo(tuple("abcd"), ("",) * STATES, (), CONTROLS)
    episodes = [
        Episode(
            rng.normal(size=(LENGTH, STATES)).cumsum(axis=0) / 10,
            np.zeros((LENGTH - 1, CONTROLS)),
            np.arange(LENGTH) * 0.02,
            np.zeros(STATES),
            True,
            i,
            0,
        )
        for i in range(DEMOS)
    ]
    demos = Demos.from_episodes(info, episodes)
    config = replace(PRESETS["paper"], steps=10**7)
    inputs = Inputs.fit(demos.states, info.names, info.units, (), "raw")
    samples = make_samples(demos, np.arange(DEMOS), inputs, config, 0)
    keys = jnp.stack([jr.key(s) for s in range(num_seeds)])
    state = init(keys, samples, config)
    at_once = make_advance(keys, samples, config, steps)
    one = jnp.array(1)

    def advance() -> None:
        nonlocal state
        if one_by_one:
            for step in range(steps):
                state, _ = run_steps(state, jnp.array(step), one, keys, samples, config, 1)
            jax.block_until_ready(state.model.log_scale)
        else:
            state, _ = at_once(state, 0, steps)

    advance()  # compiles
    return advance


def rate(advance) -> float:
    began = time.perf_counter()
    advance()
    return STEPS / (time.perf_counter() - began)


def single_seed_worker(core: int, start, rounds: int, results) -> None:
    """Time a compiled loop of one seed on one core, once per round, when `start` lets it begin."""
    os.sched_setaffinity(0, {core})
    advance = prepare(1, STEPS)
    for _ in range(rounds):
        start.wait()
        results.put(rate(advance))
        start.wait()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu", help="a JAX platform: cpu, cuda, tpu")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seeds", type=int, nargs="*", default=[1, 5, 6, 20, 50])
    arguments = parser.parse_args()
    os.environ["JAX_PLATFORMS"] = arguments.device
    cores = sorted(os.sched_getaffinity(0)) if arguments.device == "cpu" else []
    context = multiprocessing.get_context("spawn")
    start, results = context.Barrier(len(cores) + 1), context.Queue()
    workers = [
        context.Process(target=single_seed_worker, args=(core, start, arguments.rounds, results), daemon=True)
        for core in cores
    ]
    for worker in workers:
        worker.start()
    together = {n: prepare(n, STEPS) for n in sorted({5, *arguments.seeds})}
    one_by_one = prepare(1, STEPS, one_by_one=True)
    rows = []
    for _ in range(arguments.rounds):
        row = {f"{n} seeds together": n * rate(advance) for n, advance in together.items()}
        row["(b) one update per call, one seed"] = rate(one_by_one)
        if cores:
            start.wait()  # now only the workers run
            start.wait()
            row[f"(a) one seed per process, {len(cores)} processes"] = sum(results.get() for _ in cores)
        rows.append(row)
    print("command: python benchmarks/embed_throughput.py, device", arguments.device)
    print(f"{'steps per second, summed over seeds':<40}{'median':>10}{'five seeds relative to it':>30}")
    for name in rows[0]:
        values = np.array([row[name] for row in rows])
        ratio = np.array([row["5 seeds together"] / row[name] for row in rows])
        spread = f"{np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f})"
        print(f"{name:<40}{np.median(values):>10,.0f}{spread:>30}")


if __name__ == "__main__":
    main()
