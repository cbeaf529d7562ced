"""Write the interactive plot of the gallery: ready-made plans in z, for several robots.

python docs/z_plots.py
"""

import json
from pathlib import Path

import numpy as np

import planspace as ps

ROBOTS = {
    "cartpole-swingup": "Cart-pole",
    "pendulum-swingup": "Pendulum",
    "quadrotor-planar": "Planar quadrotor",
    "reacher": "Reacher",
}
MAX_PLANS, MAX_POINTS = 20, 30
HERE = Path(__file__).parent
TEMPLATE, FILE = HERE / "z_plots_template.html", HERE / "figures" / "z-plots.html"


def plans_in_z(name: str) -> list[dict]:
    """The z of ready-made plans, with fewer points, and their durations [s]."""
    demos, embedding = ps.load_demos(name), ps.load_embedding(name)
    found = []
    for episode in map(demos.episode, range(min(len(demos), MAX_PLANS))):
        z = embedding.encode(episode.states)
        even = np.unique(np.linspace(0, len(z) - 1, MAX_POINTS).round().astype(int))
        found.append(
            {"z": np.round(z[even].astype(float), 2).tolist(), "seconds": round(float(episode.times[-1]), 2)}
        )
    return found


def main() -> None:
    """Write the plot."""
    data = {title: plans_in_z(name) for name, title in ROBOTS.items()}
    text = json.dumps(data, separators=(",", ":"))
    FILE.write_text(TEMPLATE.read_text().replace("DATA", text))


if __name__ == "__main__":
    main()
