"""Compare a plan space that is learned from pictures alone with encoders that are taught by states.

    planspace plan cartpole-swingup --num 200 --seed 3 --out runs/plans
    python benchmarks/pixels_alone.py runs/plans runs/alone

All encoders are trained on the same plans of the swing-up:

- `pictures`: the paper's objective on pictures of plans, without states,
- `auto-encoder`: the same networks as a variational auto-encoder,
- `z` and `state`: the network learns z, or the state, from an embedding of the same plans.

`states` reads the state: it is that embedding itself. `pictures, twin` and `auto-encoder, twin` read it, too:
they are the embeddings of states that were fitted to those encoders. The policies have their own z.

A row has the geometry of z on the plans of the test split; the mean returns of the three ready-made policies,
which see the state that the encoder estimates, with a Kalman filter; and control by distance in the encoder's
z, from the same estimates. All start from ten states that nothing else uses.

Encoders and episodes are kept in the folder, so the same command goes on. The results are in
results/pixels/alone.csv.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from csv_rows import Row, add_missing, make_parser, parse
from pixels import FIRST_START, METRICS, POLICY_SEEDS

from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.control.runs import control_into
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.resample import resample
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_embedding
from planspace.embed.geometry import Geometry
from planspace.embed.geometry import measure as measure_states
from planspace.embed.objectives.vae import AutoEncoder
from planspace.embed.pixels.config import ImageFitConfig, PictureSpaceConfig
from planspace.embed.pixels.encoder import ImageEncoder
from planspace.embed.pixels.fit import fit_image_encoder
from planspace.embed.pixels.measure import measure_images
from planspace.embed.pixels.stacks import default_frame_s
from planspace.rl.play import play
from planspace.rl.saved_policy import load_policy

RESULTS = Path(__file__).parents[1] / "results" / "pixels" / "alone.csv"
TASK = "cartpole-swingup"
ALONE = ImageFitConfig(target="pictures", batch=128)
CONFIGS = {
    "pictures": ALONE,
    "auto-encoder": replace(ALONE, space=PictureSpaceConfig(AutoEncoder(), warm_up=0.0)),
    "z": ImageFitConfig(target="z"),
    "state": ImageFitConfig(target="state"),
}
"""How each encoder of pictures is trained."""
TWIN = ", twin"
KINDS = ("states", "z", "state", "pictures", "auto-encoder", "pictures, twin", "auto-encoder, twin")
EPISODES = 10
COLUMNS = ("reads", "plans", "seed", *METRICS, "returns", "control_return", "control_success")


def main() -> None:
    """Run the rows that the results do not have yet."""
    parser = make_parser(__doc__)
    parser.add_argument("plans", type=Path, nargs="?", help="plans of the swing-up")
    parser.add_argument("folder", type=Path, nargs="?", help="where encoders and episodes are kept")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    options, rows = parse(parser, RESULTS, table)
    demos = load_demos(options.plans)
    for seed in options.seeds:
        for kind in options.kinds:
            key = {"reads": kind, "plans": str(len(demos)), "seed": str(seed)}
            add_missing(
                RESULTS, COLUMNS, rows, key, lambda k=kind, s=seed: measure(k, s, demos, options.folder)
            )


def measure(kind: str, seed: int, demos: Demos, folder: Path) -> Row:
    """Train an encoder, and measure it."""
    name = kind.removesuffix(TWIN)
    embedding = encoder = None
    if name in ("states", "z", "state"):
        embedding = fit_embedding(demos, num_seeds=5, seed=seed, out=folder / f"embedding-{seed}")
    if name in CONFIGS:
        out = folder / f"{name}-{seed}"
        encoder = fit_image_encoder(demos, embedding, config=CONFIGS[name], out=out, seed=seed)
        embedding, encoder = encoder.teacher, None if kind.endswith(TWIN) else encoder
    assert embedding is not None
    policies = (
        []
        if kind.endswith(TWIN)
        else [play(load_policy(TASK, s), EPISODES, FIRST_START, encoder=encoder)[0] for s in POLICY_SEEDS]
    )
    out = folder / f"control-{kind.replace(', ', '-')}-{seed}"
    found = control_into(
        Plant.find(TASK), embedding, ControlConfig(), out, num=EPISODES, seed=0, encoder=encoder
    )
    geometry = geometry_of(embedding, encoder, demos, seed)
    return {
        **{name: f"{getattr(geometry, name):.3f}" for name in METRICS},
        "returns": f"{np.mean(policies):.1f}" if policies else "",
        "control_return": f"{found.return_mean:.1f}",
        "control_success": f"{found.success:.2f}",
    }


def geometry_of(embedding: Embedding, encoder: ImageEncoder | None, demos: Demos, seed: int) -> Geometry:
    """The geometry of z on the plans of the test split, which is the same for all kinds."""
    test = demos.split(seed)["test"]
    if encoder is not None:
        return measure_images(encoder, demos, test).pixels
    step, info = default_frame_s(demos), demos.info
    seen = [resample(demos.episode(int(i)), info, step) for i in test]  # as often as pictures are taken
    return measure_states(embedding, Demos.from_episodes(info, seen), np.arange(len(seen)))


def table(rows: list[Row]) -> str:
    """The rows as a table of docs/pixels.md."""
    titles = {"returns": "policies", "control_return": "control", "control_success": "succeeds"}
    shown = [name for name in COLUMNS if name not in ("plans", "seed")]
    head = " | ".join(titles.get(name, name.replace("_", " ")) for name in shown)
    lines = [f"| {head} |", "|---" * len(shown) + "|"]
    for row in sorted(rows, key=lambda row: KINDS.index(row["reads"])):
        lines.append(f"| {' | '.join(row[name] for name in shown)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
