"""Measure encoders of pictures on the swing-up: geometry of z, returns from pictures, and speed.

    python benchmarks/pixels.py runs/pixels [--steps 4000] [--stacks 20000] [--seeds 1] [--episodes 10]
    python benchmarks/pixels.py runs/pixels --rounds 1 [--size 64] [--frames 3]
    python benchmarks/pixels.py runs/pixels --only speed

Encoders of three targets are trained on the ready-made plans and their embedding: z, the raw state (the rival
without z), and a network with random weights of which only the last layer is trained. Then

- geometry.csv has the metrics of z from pictures on the held-out plans, beside those of z from states,
- returns.csv has the returns of the ready-made policies (three seeds), and of control by distance in z, if
  they see the true state, or only what an encoder reads from pictures. Rows of control without `kalman` were
  measured before there was a filter,
- visited.csv has the errors of the estimated state (root of the mean square) in episodes of the ready-made
  policies that act from what the encoder reads, from starts that no other table uses,
- speed.csv has pictures and stacks a second, in one process on one core, and in two on two (Linux only).

With `--rounds N`, each encoder is trained N more times (DAgger), each time with the states of those episodes
of the encoder before it, too.

Encoders and episodes are kept in the folder, so the same command goes on. The results are in results/pixels.
"""

import argparse
import itertools
import os
import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from csv_rows import Row, read_rows, write_rows

from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.control.runs import control_into
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.embed.pixels.config import TARGETS, ImageFitConfig
from planspace.embed.pixels.convolution import ConvolutionalNetwork
from planspace.embed.pixels.encoder import ImageEncoder
from planspace.embed.pixels.fit import fit_image_encoder
from planspace.embed.pixels.measure import measure_images
from planspace.embed.pixels.stacks import stacks_of_plans
from planspace.embed.saved_embedding import load_embedding
from planspace.physics.pictures import PictureConfig
from planspace.rl.play import play
from planspace.rl.saved_policy import load_policy

RESULTS = Path(__file__).parents[1] / "results" / "pixels"
NAME = "cartpole-swingup"
POLICY_SEEDS = (0, 1, 2)
FIRST_START, FIRST_VISIT = 1000, 5000
"""Seeds of the first start of a table, and of the first start of a round of visits."""
NUM_VISITS = 10
"""Episodes of each policy in a round of visits."""
SECONDS = 5.0
"""Length of a measurement of speed [s]."""
METRICS = ("straightness", "midpoint_error", "time_correlation", "decoded_error")
GEOMETRY = (
    "reads",
    "target",
    "seed",
    "steps",
    "rounds",
    "pictures",
    "demos",
    *METRICS,
    "z_correlation",
    "z_error",
)
RETURNS = (
    "acts",
    "reads",
    "seed",
    "steps",
    "rounds",
    "pictures",
    "filter",
    "policy_seed",
    "episodes",
    "return_mean",
    "return_worst",
    "success",
)
VISITED = ("target", "seed", "steps", "rounds", "pictures", "episodes", "x", "theta", "xdot", "thetadot")
SPEED = ("what", "processes", "per_second")


def main() -> None:
    """Run the parts that the results do not have yet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="where encoders and episodes are kept")
    parser.add_argument("--only", choices=("geometry", "returns", "visited", "speed"))
    parser.add_argument("--targets", nargs="+", choices=TARGETS, default=list(TARGETS))
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--stacks", type=int, default=20000)
    parser.add_argument("--seeds", type=int, default=1, help="encoders of each target")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=0, help="trainings with visited states")
    parser.add_argument("--size", type=int, default=64, help="width and height of the pictures")
    parser.add_argument("--frames", type=int, default=3, help="pictures in a stack")
    options = parser.parse_args()
    pictures = PictureConfig(width=options.size, height=options.size, frames=options.frames)
    if options.only in (None, "speed"):
        measure_speed()
    for seed in range(options.seeds):
        for target in options.targets if options.only != "speed" else ():
            config = ImageFitConfig(
                target=target, steps=options.steps, stacks=options.stacks, pictures=pictures
            )
            encoder = trained(options.folder, config, seed, options.rounds)
            cell = {"target": target, "seed": str(seed), "steps": str(options.steps)}
            cell |= {"rounds": str(options.rounds), "pictures": f"{options.frames} of {options.size}"}
            if options.only in (None, "geometry"):
                measure_geometry(encoder, cell)
            if options.only in (None, "returns"):
                measure_returns(encoder, cell, options.folder, options.episodes)
            if options.only in (None, "visited"):
                measure_visited(encoder, cell, options.folder, config, options.rounds)


def trained(folder: Path, config: ImageFitConfig, seed: int, rounds: int) -> ImageEncoder:
    """The encoder after some rounds; it is trained once."""
    visited: list[Demos] = []
    for earlier in range(rounds):
        encoder = trained(folder, config, seed, earlier)
        visited += visits(folder, config, seed, encoder, earlier)
    out = folder / (name_of(config, seed) + (f"-after-{rounds}" if rounds else ""))
    return fit_image_encoder(
        load_demos(NAME), load_embedding(NAME), config=config, visited=visited, out=out, seed=seed
    )


def name_of(config: ImageFitConfig, seed: int) -> str:
    """The name of an encoder's folder."""
    pictures = config.pictures
    looks = f"-{pictures.frames}x{pictures.width}" if pictures != PictureConfig() else ""
    return f"{config.target}-{seed}-{config.steps}-{config.stacks}{looks}"


def visits(
    folder: Path, config: ImageFitConfig, seed: int, encoder: ImageEncoder, rounds: int
) -> list[Demos]:
    """Episodes of each policy that acts from what an encoder reads; they are played once."""
    first, found = FIRST_VISIT + NUM_VISITS * rounds, []
    for policy_seed in POLICY_SEEDS:
        out = folder / f"{name_of(config, seed)}-visits-{rounds}-{policy_seed}"
        if not out.exists():
            play(load_policy(NAME, policy_seed), NUM_VISITS, first, encoder=encoder)[1].save(out)
        found.append(load_demos(out))
    return found


def measure_visited(
    encoder: ImageEncoder, cell: Row, folder: Path, config: ImageFitConfig, rounds: int
) -> None:
    """Add a row for the errors of the estimated state in episodes that the encoder led."""

    def errors() -> Row:
        found = []
        for demos in visits(folder, config, int(cell["seed"]), encoder, rounds):
            every = np.arange(len(demos))
            true, stacks = stacks_of_plans(demos, every, encoder.pictures, encoder.frame_s)
            _, space = demos.info.compile()
            found.append(space.difference(encoder.states(stacks.images), true.states))
        error = np.sqrt(np.mean(np.concatenate(found) ** 2, axis=0))
        count = {"episodes": str(NUM_VISITS * len(POLICY_SEEDS))}
        return count | {name: f"{x:.3f}" for name, x in zip(VISITED[-4:], error, strict=True)}

    add("visited.csv", VISITED, cell, errors)


def measure_geometry(encoder: ImageEncoder, cell: Row) -> None:
    """Add a row for z from pictures, and once one for z from states."""
    demos, about = load_demos(NAME), encoder.teacher.require_about()
    found = measure_images(encoder, demos, np.array(about.split["test"]))
    for reads, geometry in (("states", found.states), ("pixels", found.pixels)):
        key = {"reads": reads} | (cell if reads == "pixels" else dict.fromkeys(cell, ""))
        row = key | {"demos": str(geometry.num_demos)}
        row |= {name: f"{getattr(geometry, name):.3f}" for name in METRICS}
        if reads == "pixels":
            row |= {
                "z_correlation": f"{found.correlation.mean():.3f}",
                "z_error": f"{found.relative_error:.3f}",
            }
        add("geometry.csv", GEOMETRY, key, lambda row=row: row)


def measure_returns(encoder: ImageEncoder, cell: Row, folder: Path, episodes: int) -> None:
    """Add the rows of policies and of control, from pictures, and once from states."""
    named = {name: cell[name] for name in cell if name != "target"} | {"episodes": str(episodes)}
    for reads, eyes in ((cell["target"], encoder), ("states", None)):
        own = named if eyes else dict.fromkeys(named, "") | {"episodes": str(episodes)}
        joined = "kalman" if eyes else ""
        for policy_seed in POLICY_SEEDS:
            key = {"acts": "policy", "reads": reads, "filter": joined, "policy_seed": str(policy_seed), **own}

            def of_policy(policy_seed: int = policy_seed, eyes: ImageEncoder | None = eyes) -> Row:
                returns, _ = play(load_policy(NAME, policy_seed), episodes, FIRST_START, encoder=eyes)
                return {"return_mean": f"{returns.mean():.1f}", "return_worst": f"{returns.min():.1f}"}

            add("returns.csv", RETURNS, key, of_policy)
        key = {"acts": "control", "reads": reads, "filter": joined, "policy_seed": "", **own}
        out = folder / "-".join(("control", reads, joined, *own.values())).replace(" ", "-")

        def of_control(out: Path = out, eyes: ImageEncoder | None = eyes) -> Row:
            plant = Plant.find(NAME)
            found = control_into(
                plant, encoder.teacher, ControlConfig(), out, num=episodes, seed=0, encoder=eyes
            )
            return {
                "return_mean": f"{found.return_mean:.1f}",
                "return_worst": f"{found.return_worst:.1f}",
                "success": f"{found.success:.2f}",
            }

        add("returns.csv", RETURNS, key, of_control)


def measure_speed() -> None:
    """Add pictures a second and stacks encoded a second, in one process and in two."""
    for what, work in (("render", render_for_a_while), ("encode", encode_for_a_while)):
        for processes in (1, 2):
            key = {"what": what, "processes": str(processes)}

            def rate(work: Callable[[int], float] = work, processes: int = processes) -> Row:
                with get_context("spawn").Pool(processes) as pool:
                    return {"per_second": f"{sum(pool.map(work, range(processes))):.0f}"}

            add("speed.csv", SPEED, key, rate)


def render_for_a_while(core: int) -> float:
    """Pictures of 64 x 64 pixels a second in this process, on one core."""
    os.sched_setaffinity(0, {core})
    demos = load_demos(NAME)
    demos.render_states(np.arange(10), PictureConfig())
    return per_second(lambda: len(demos.render_states(np.arange(500), PictureConfig())))


def encode_for_a_while(core: int) -> float:
    """Stacks a second in this process, on one core, with a network of the default size and random weights."""
    os.sched_setaffinity(0, {core})
    config, rng = ImageFitConfig(), np.random.default_rng(0)
    sizes = (config.pictures.stack_shape[-1], *config.channels)

    def layer(*shape: int) -> tuple[np.ndarray, np.ndarray]:
        return rng.normal(size=shape).astype(np.float32), np.zeros(shape[-1], dtype=np.float32)

    kernels = tuple(layer(4, 4, a, b) for a, b in itertools.pairwise(sizes))
    flat = (config.pictures.height // 2 ** len(kernels)) ** 2 * sizes[-1]
    network = ConvolutionalNetwork(kernels, (layer(flat, config.hidden), layer(config.hidden, 3)))
    stack = rng.integers(0, 256, config.pictures.stack_shape, dtype=np.uint8)
    return per_second(lambda: len([network(stack) for _ in range(50)]))


def per_second(work: Callable[[], int]) -> float:
    """Call until the time is over."""
    began, done = time.perf_counter(), 0
    while time.perf_counter() - began < SECONDS:
        done += work()
    return done / (time.perf_counter() - began)


def add(file: str, columns: tuple[str, ...], key: Row, measure: Callable[[], Row]) -> None:
    """Add a row, unless the results have it."""
    if any(key.items() <= row.items() for row in read_rows(RESULTS / file)):
        return
    row = key | measure()
    rows = [*read_rows(RESULTS / file), row]  # another process may have added some
    print(file, *(rows[-1].get(column, "") for column in columns), sep="  ", flush=True)
    write_rows(RESULTS / file, columns, rows)


if __name__ == "__main__":
    main()
