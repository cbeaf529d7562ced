"""The shipped algorithms, one file each. Imports no JAX, so that `--help` answers at once."""

from planspace.errors import unknown
from planspace.rl.algorithm import Algorithm
from planspace.rl.algorithms.on_policy import MODERN
from planspace.rl.algorithms.ppo import PPO
from planspace.rl.algorithms.sac import SAC
from planspace.rl.algorithms.trpo import TRPO

PRESETS: dict[tuple[str, str], Algorithm] = {
    ("trpo", "paper"): TRPO(),
    ("ppo", "paper"): PPO(),
    ("sac", "paper"): SAC(),
    ("trpo", "modern"): TRPO(MODERN, max_kl=0.02),
    ("ppo", "modern"): PPO(
        MODERN, learning_rate=5e-4, minibatch=125, of_steps=True, tolerance=0.0, clip_norm=0.5
    ),
    ("sac", "modern"): SAC(layer_norm=True, normalise_obs=True),
}
"""Settings of each (algorithm, preset). `paper`: the paper and, where it is silent, the garage release that
the 2020 runs used; the paper has no SAC, whose settings are the defaults of Stable-Baselines3. `modern`: what
measured best; that of SAC was not compared with its `paper`. The two are never mixed in one table."""

ALGORITHMS: dict[str, Algorithm] = {name: x for (name, preset), x in PRESETS.items() if preset == "paper"}
"""The default settings of each shipped algorithm, by name."""


def find_algorithm(name: str, preset: str = "paper") -> Algorithm:
    """Return a shipped algorithm.

    Args:
        name: a key of `ALGORITHMS`.
        preset: `paper` or `modern`.

    Raises:
        UsageError: the algorithm has no such preset, or is unknown.
    """
    if name not in ALGORITHMS:
        raise unknown("algorithm", name, ALGORITHMS)
    if (name, preset) not in PRESETS:
        raise unknown(f"preset of {name}", preset, [known for algo, known in PRESETS if algo == name])
    return PRESETS[name, preset]
