"""Draw the diagrams of how-it-works.md, after the paper's figures, and of CONTRIBUTING.md.

python docs/diagrams.py
"""

from pathlib import Path

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyBboxPatch

FIGURES = Path(__file__).parent / "figures"
STATE, LATENT, STEP, TERM, INK = "#d9ead3", "#dce6f5", "#f2f2f2", "#b3261e", "#222222"
plt.rcParams["svg.hashsalt"] = "planspace"  # the same drawing is the same file
plt.rcParams["svg.fonttype"] = "none"


def canvas(width: float, height: float) -> Axes:
    """Make an empty sheet. One unit is half an inch."""
    figure = plt.figure(figsize=(width / 2, height / 2))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(0, height), aspect="equal")
    axes.axis("off")
    return axes


def save(axes: Axes, name: str) -> None:
    """Write the sheet, without a date."""
    axes.figure.savefig(FIGURES / f"{name}.svg", metadata={"Date": None}, facecolor="white")
    plt.close(axes.figure)


def box(
    axes: Axes, x: float, y: float, text: str, color: str = STEP, width: float = 2.6, height: float = 1.1
):
    """Draw a box around its centre."""
    corner, style = (x - width / 2, y - height / 2), "round,pad=0.02,rounding_size=0.15"
    axes.add_patch(FancyBboxPatch(corner, width, height, boxstyle=style, facecolor=color, edgecolor=INK))
    axes.text(x, y, text, ha="center", va="center", fontsize=11)


def node(axes: Axes, x: float, y: float, text: str, color: str) -> None:
    """Draw a random variable. Observed ones are filled."""
    axes.add_patch(Circle((x, y), 0.55, facecolor=color, edgecolor=INK))
    axes.text(x, y, text, ha="center", va="center", fontsize=13)


def arrow(
    axes: Axes,
    start: tuple,
    end: tuple,
    style: str = "-",
    color: str = INK,
    heads: str = "-|>",
    bend: float = 0,
) -> None:
    """Draw an arrow between two points."""
    look = {"arrowstyle": heads, "linestyle": style, "color": color, "shrinkA": 0, "shrinkB": 0}
    look |= {"mutation_scale": 13, "connectionstyle": f"arc3,rad={bend}", "linewidth": 1.2}
    axes.annotate("", xy=end, xytext=start, arrowprops=look)


def draw_triplet() -> None:
    """Draw the model: three states, two latent points, and their midpoint."""
    axes = canvas(12, 6.6)
    axes.add_patch(
        FancyBboxPatch((0.6, 0.7), 10.8, 5.1, boxstyle="round,pad=0", fill=False, edgecolor="#888888")
    )
    axes.text(11.2, 0.9, "every triplet", ha="right", va="bottom", fontsize=10, color="#555555")
    for x, name in ((2, "a"), (6, "t"), (10, "b")):
        node(axes, x, 4.6, f"$z_{name}$", "white")
        node(axes, x, 1.9, f"$x_{name}$", STATE)
        arrow(axes, (x, 4.05), (x, 2.45))
    axes.text(6.2, 3.2, "  $p(x|z)$", ha="left", va="center", fontsize=10)
    arrow(axes, (2.55, 4.6), (5.45, 4.6))
    arrow(axes, (9.45, 4.6), (6.55, 4.6))
    axes.text(6, 5.45, "$z_t = (z_a + z_b)/2$", ha="center", fontsize=11)
    for x in (2, 10):
        axes.text(x, 5.45, "$N(0, 1)$", ha="center", fontsize=11)
    save(axes, "triplet")


def draw_flow() -> None:
    """Draw what is computed from a triplet, and the terms of the bound."""
    axes = canvas(22, 11)
    rows = {"a": 8.6, "t": 5.4, "b": 2.2}
    for name, y in rows.items():
        box(axes, 1.6, y, f"$x_{name}$", STATE, 1.6)
        box(axes, 5, y, "encoder", width=2.2)
        box(axes, 8.8, y, f"$q(z|x_{name})$", LATENT)
        arrow(axes, (2.4, y), (3.9, y))
        arrow(axes, (6.1, y), (7.5, y))
        box(axes, 16.6, y, "decoder", width=2.2)
        box(axes, 20.2, y, f"$p(x_{name}|\\cdot)$", LATENT, 2.4)
        arrow(axes, (17.7, y), (19, y))
    box(axes, 12.9, rows["t"], "midpoint\n$\\tilde q(z_t|x_a, x_b)$", LATENT, 2.9, 1.5)
    for name in ("a", "b"):
        side = 1 if name == "a" else -1
        arrow(axes, (10.1, rows[name] - 0.3 * side), (12.2, rows["t"] + 0.75 * side))
        arrow(axes, (10.1, rows[name]), (15.5, rows[name]), style=":")
    arrow(axes, (14.35, rows["t"]), (15.5, rows["t"]), style=":")
    arrow(axes, (10.1, rows["t"]), (11.45, rows["t"]), color=TERM, heads="<|-|>")
    axes.text(10.78, rows["t"] + 0.3, "$\\lambda$ KL", ha="center", color=TERM, fontsize=10)
    for name, y in rows.items():
        side = -1 if name == "b" else 1
        ends = (1.6, y + 0.57 * side), (20.2, y + 0.57 * side)
        arrow(axes, *ends, color=TERM, heads="<|-|>", bend=-0.07 * side)
        axes.text(4.2, y + 1.3 * side, "log p", ha="center", va="center", color=TERM, fontsize=10)
    axes.text(15, 3.8, "dotted: sampled", ha="center", fontsize=9, color="#555555")
    save(axes, "information-flow")


def draw_system() -> None:
    """Draw the way from a robot model to an agent."""
    axes = canvas(21, 9)
    box(axes, 2.2, 5, "robot model\n(MJCF)", STATE, 3.2, 1.5)
    box(axes, 7.4, 5, "planner\nSST*, polish", STEP, 3.2, 1.5)
    box(axes, 7.4, 2.2, "MuJoCo\nin batches", STEP, 3.2, 1.5)
    box(axes, 12.2, 8, "people, controllers, Minari", STATE, 5.2, 1)
    box(axes, 12.2, 5, "demonstrations", LATENT, 3.4, 1.5)
    for offset, text in ((0.4, ""), (0.2, ""), (0.0, "embedding\nseeds 0, 1, ...")):
        box(axes, 17 + offset, 5 + offset, text, STEP, 3.2, 1.5)
    box(axes, 17, 2.2, "best embedding", LATENT, 3.2, 1.2)
    box(axes, 12.2, 2.2, "environment\n+ z", STEP, 3.0, 1.5)
    box(axes, 12.2, 0.4, "agent: TRPO, PPO, SAC, yours", STATE, 4.8, 0.7)
    arrow(axes, (3.8, 5), (5.8, 5))
    arrow(axes, (2.2, 4.25), (5.8, 2.2), bend=0.3)
    arrow(axes, (7.4, 4.25), (7.4, 2.95), heads="<|-|>")
    axes.text(7.6, 3.6, "simulates, checks", fontsize=9, va="center")
    arrow(axes, (9, 5), (10.5, 5))
    arrow(axes, (12.2, 7.5), (12.2, 5.75))
    arrow(axes, (13.9, 5), (15.4, 5))
    arrow(axes, (17, 4.25), (17, 2.8))
    axes.text(17.2, 3.6, "selected on validation\ndemonstrations", fontsize=9, va="center")
    arrow(axes, (15.4, 2.2), (13.7, 2.2))
    arrow(axes, (9, 2.2), (10.7, 2.2))
    arrow(axes, (12.2, 1.45), (12.2, 0.75), heads="<|-|>")
    save(axes, "system")


GROUND = {
    "errors, progress\nworkers, seams\nsummary": "",
    "storage": "atomic files,\ncheckpoints",
    "mjcf": "checks of\nMuJoCo models",
    "physics": "state spaces,\nsimulation",
}
"""The ground floor of the package, in import order."""
STAGES = {
    "tasks": ("problems, tasks", "Task"),
    "demos": ("datasets", "file format"),
    "plan": ("SST*, polish", "Planner"),
    "embed": ("networks, fit", "Objective"),
    "control": ("looking\nahead", "Method"),
    "envs": ("Gymnasium,\nwrappers", ""),
    "rl": ("TRPO, PPO, SAC", "Algorithm"),
}
"""The stages, in import order: what each holds, and what users can add to it."""
TOP = {"figures": "for all stages", "study": "arms, statistics, reports", "cli": "one file per verb"}
"""The packages above the stages, in import order."""


def draw_house() -> None:
    """Draw the packages, their import order, and the seams."""
    axes = canvas(26.4, 11.6)
    for i, (name, about) in enumerate(TOP.items()):
        box(axes, 6.0 + 7.2 * i, 10.5, f"{name}\n{about}", STEP, 6.4, 1.4)
    for i in range(2):
        arrow(axes, (10.0 + 7.2 * i, 10.5), (9.2 + 7.2 * i, 10.5))
    for i, (name, (about, seam)) in enumerate(STAGES.items()):
        x = 2.5 + 3.6 * i
        box(axes, x, 6.4, f"{name}\n{about}", LATENT, 2.8, 2.0)
        if seam:
            box(axes, x, 8.5, seam, STATE, 2.4, 0.8)
            arrow(axes, (x, 8.1), (x, 7.42), style="--")
        if i:
            arrow(axes, (x - 1.4, 6.4), (x - 2.2, 6.4))
    for i, (name, about) in enumerate(GROUND.items()):
        box(axes, 5.0 + 5.4 * i, 2.9, f"{name}\n{about}".strip(), STEP, 4.6, 1.9)
        if i:
            arrow(axes, (2.7 + 5.4 * i, 2.9), (1.9 + 5.4 * i, 2.9))
    arrow(axes, (13.2, 9.8), (13.2, 9.1))
    arrow(axes, (13.2, 5.38), (13.2, 3.87))
    note = (
        "solid arrows: imports, of the package and of all packages before it; dashed arrows: what you can add"
    )
    axes.text(13.2, 1.1, note, ha="center", fontsize=10, color="#555555")
    save(axes, "house")


if __name__ == "__main__":
    draw_triplet()
    draw_flow()
    draw_system()
    draw_house()
