"""Control with the published settings of MuJoCo MPC: their cost, horizon, splines and noise.

    python benchmarks/control_peer.py runs/peer

MuJoCo MPC (Howell et al. 2022, github.com/google-deepmind/mujoco_mpc, Apache 2.0) has a hand-made cost for
the cart-pole and for the acrobot, in its files tasks/cartpole and tasks/acrobot. Here predictive sampling
with those costs controls planspace's models from the starts of `control.py`, with a new plan for each control
step of 0.04 s and the regulator at the goal, as for the other costs. 10 candidates are MuJoCo MPC's default.
Its own program plans as often as it can, so this measures its settings and not its program. Controls count
as fractions of their limits.

Rows are added to results/control/peer.csv. `--table` prints the table of docs/appendix/control.md.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from csv_rows import add_missing, make_parser, parse

from planspace.control.config import ControlConfig
from planspace.control.methods.sampling import Sampling
from planspace.control.plant import Plant
from planspace.control.runs import control_into

RESULTS = Path(__file__).parents[1] / "results" / "control" / "peer.csv"
COLUMNS = ("problem", "horizon_s", "samples", "success", "real_time")
NUM_STARTS, KNOTS = 20, 10


@dataclass(frozen=True)
class Peer:
    """The settings that MuJoCo MPC has for a task."""

    cost: Callable[[np.ndarray, np.ndarray], np.ndarray]
    """States [row, state] and controls [row, control] as fractions of their limits, to the cost."""
    horizon_s: float
    noise: float
    episode_s: float
    """Length of an episode [s], that of `control.py`."""


def main() -> None:
    """Run the cells that the results do not have yet."""
    parser = make_parser(__doc__, "where the episodes are kept")
    parser.add_argument("--only", default="", help="only problems whose name contains this")
    parser.add_argument("--samples", nargs="+", type=int, default=[10, 128], metavar="N")
    options, rows = parse(parser, RESULTS, table)
    for name in (name for name in PEERS if options.only in name):
        for samples in options.samples:
            key = {"problem": name, "samples": str(samples)}
            add_missing(RESULTS, COLUMNS, rows, key, partial(measure, options.folder, name, samples))


def measure(folder: Path, name: str, samples: int) -> dict[str, str]:
    """Control the starts of one problem."""
    peer, plant = PEERS[name], Plant.find(name)
    largest = np.abs(plant.model.actuator_ctrlrange).max(axis=1)

    def reward(before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray) -> np.ndarray:
        return -peer.cost(after, control / largest)

    plant = Plant.find(replace(plant.task, reward=reward))
    config = ControlConfig(
        Sampling(),
        horizon_s=peer.horizon_s,
        samples=samples,
        cost="reward",
        knots=KNOTS,
        spline="cubic",
        noise=peer.noise,
    )
    out = folder / f"{name}-{samples}"
    found = control_into(
        plant, None, config, out, num=NUM_STARTS, seed=0, episode_s=peer.episode_s, workers=1
    )
    return {
        "horizon_s": str(peer.horizon_s),
        "success": f"{found.success:.2f}",
        "real_time": f"{found.real_time:.2f}",
    }


def cartpole(states: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """The cost of the cart-pole: upright and centred, by a smooth absolute value; speed and control."""
    upright = smooth_abs(np.cos(states[:, 1]) - 1, 0.01)
    centred = smooth_abs(states[:, 0], 0.1)
    return 10 * upright + 10 * centred + 0.1 * half_square(states[:, 3:]) + 0.1 * half_square(controls)


def acrobot(states: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """The cost of the acrobot: distance of the tip from the top, speeds and control."""
    angles = np.cumsum(states[:, :2], axis=1)
    tip = np.stack([np.sin(angles).sum(axis=1), np.cos(angles).sum(axis=1) - 2], axis=1)
    return 50 * half_square(tip) + half_square(states[:, 2:]) + 0.05 * half_square(controls)


def smooth_abs(x: np.ndarray, width: float) -> np.ndarray:
    """An absolute value that is rounded within `width` of 0."""
    return np.sqrt(x**2 + width**2) - width


def half_square(x: np.ndarray) -> np.ndarray:
    """Half of the squared length of each row."""
    return 0.5 * (x**2).sum(axis=1)


PEERS = {
    "cartpole-swingup": Peer(cartpole, horizon_s=1.0, noise=0.5, episode_s=8.0),
    "acrobot-swingup": Peer(acrobot, horizon_s=2.0, noise=0.05, episode_s=10.0),
}


def table(rows: list[dict[str, str]]) -> str:
    """Success of each problem and number of candidates."""
    lines = ["| problem | horizon | candidates | success |", "|---|---|---|---|"]
    lines += [
        f"| {row['problem']} | {row['horizon_s']} s | {row['samples']} | {float(row['success']):.0%} |"
        for row in rows
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
