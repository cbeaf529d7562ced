import numpy as np
import pytest

from planspace.embed.embedding import Embedding
from planspace.rl.observe import Observer
from planspace.tasks.catalog import TASKS


@pytest.mark.parametrize("z_to", ["both", "policy", "critic"])
@pytest.mark.parametrize("z", ["augment", "replace"])
def test_policy_and_critic_observe_z_as_z_to_says(
    embedding: Embedding, z: str, z_to: str, rng: np.random.Generator
) -> None:
    task = TASKS["cartpole-swingup"]
    observer = Observer(task, "trig", z, z_to, (embedding,))  # pyright: ignore
    states, targets = task.sample_starts(5, rng)
    obs = observer(states, targets)
    own, latent = task.observe_as("trig", states, targets), embedding.encode(states)
    with_z = latent if z == "replace" else np.concatenate([own, latent], axis=1)
    seen = {"policy": obs[:, observer.policy_columns], "critic": obs[:, observer.critic_columns]}
    for reader, columns in seen.items():
        expected = with_z if z_to in ("both", reader) else own
        np.testing.assert_allclose(columns, expected, atol=1e-5)
