"""Saves the policies of a run as plain arrays, with the embeddings that they need."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from planspace.embed.embedding import Embedding
from planspace.embed.saved_embedding import DESCRIPTION
from planspace.rl.arm import Arm
from planspace.rl.history import finite_or_none
from planspace.rl.normalise import ObsStatistics
from planspace.rl.policy_network import PolicyNetwork, log_stds
from planspace.rl.saved_policy import EMBEDDING, PoliciesInfo, save_policies
from planspace.rl.stack import stacked_layers
from planspace.storage.arrays import Arrays
from planspace.storage.provenance import Provenance
from planspace.tasks.catalog import shipped_tasks
from planspace.tasks.stored_task import task_content


def export_policies(
    out: Path,
    arm: Arm,
    networks: Sequence[PolicyNetwork],
    embeddings: Sequence[Embedding],
    returns: Sequence[float],
) -> None:
    """Write policies and embeddings where `load_policy` finds them.

    Args:
        out: the run's folder.
        arm: what was trained on.
        networks: one per seed.
        embeddings: the embeddings that make z; seed `s` takes number `s` modulo their count.
        returns: the return of each seed in the last evaluation.
    """
    config, observer = arm.config, arm.observer
    folders = [EMBEDDING] if len(embeddings) == 1 else [f"{EMBEDDING}-{i}" for i in range(len(embeddings))]
    if config.needs_embedding:
        for embedding, folder in zip(embeddings, folders, strict=True):
            if not (out / folder / DESCRIPTION).exists():
                embedding.save(out / folder)
    columns = observer.policy_columns
    content = task_content(arm.task)
    low, high = arm.episodes.action_limits
    about = PoliciesInfo(
        task=arm.task.name,
        env_id=None if content else shipped_tasks()[arm.task.name].env_id,
        obs=config.obs,
        reward=config.task_reward,
        z=config.z,
        z_to=config.z_to,
        num_obs=observer.num_obs,
        columns=[columns.start, columns.stop],
        layer_norm=networks[0].layer_norm,
        action_low=finite_or_none(low.tolist()),
        action_high=finite_or_none(high.tolist()),
        seeds=list(config.seeds),
        embeddings=[folders[seed % len(folders)] for seed in config.seeds if config.needs_embedding],
        returns=finite_or_none(returns),
        versions=Provenance.current().plain(),
        **content,
    )
    if config.needs_embedding:
        each = [embeddings[seed % len(embeddings)].hash for seed in config.seeds]
        about["embedding_hashes"] = each
    if config.action_repeat != 1:
        about["action_repeat"] = config.action_repeat
    if config.goal != "raw":
        about["goal"] = config.goal
    if networks[0].activation != "tanh":
        about["activation"] = networks[0].activation
    if networks[0].limits is not None:
        about["squashed"] = True
    save_policies(out, _arrays(networks), about)


def _arrays(networks: Sequence[PolicyNetwork]) -> Arrays:
    weights, biases = stacked_layers(networks)
    arrays = {f"{n}.weight": weight for n, weight in enumerate(weights)}
    arrays |= {f"{n}.bias": bias for n, bias in enumerate(biases)}
    if logs := log_stds(networks):
        arrays["log_std"] = np.stack(logs)
    if statistics := [n.statistics for n in networks if n.statistics is not None]:
        arrays |= ObsStatistics.stacked(statistics)._asdict()
    return arrays
