"""What a user may well type, seen without the type checks that run in the other tests."""

import json
import subprocess
import sys
from pathlib import Path

SCRIPT = """
import json, sys
import gymnasium, numpy as np
import planspace
from planspace.envs.wrappers import PlanSpaceObservation, PlanSpaceShaping

folder = sys.argv[1]
embedding = planspace.load_embedding(folder)
make = lambda **kwargs: gymnasium.make("planspace/CartPoleSwingUp-v0", **kwargs)
show = lambda **kwargs: PlanSpaceObservation(make(), **{"embedding": folder, **kwargs})
shape = lambda **kwargs: PlanSpaceShaping(make(), folder, **{"goal": [0.0] * 4, **kwargs})
policy = planspace.load_policy("cartpole-swingup")
control = lambda **kwargs: planspace.Controller("pendulum", **kwargs)
steer = control(config=planspace.ControlConfig(cost="reward", samples=8, horizon_s=0.1, regulator=False))
train = lambda **kwargs: planspace.train_policies("cartpole", planspace.TrainConfig(z="augment"), **kwargs)
many = lambda **kwargs: gymnasium.make_vec(
    "planspace/CartPole-v0", num_envs=2, vectorization_mode="vector_entry_point", **kwargs
)
told = []
for code in json.loads(sys.argv[2]):
    try:
        eval(code)
        told.append("accepted")
    except Exception as error:
        told.append(f"{type(error).__name__}: {error}")
print(json.dumps(told))
"""

CASES = {
    "make(reward=2020)": "UsageError: unknown reward type of cartpole-swingup 2020.",
    "make(obs=None)": "UsageError: unknown observation type None.",
    "many(autoreset_mode=None)": "UsageError: unknown autoreset mode None.",
    "show(mode=None)": "UsageError: unknown mode None.",
    "show(columns=[0.0, 1.0, 2.0, 3.0])": "UsageError: columns must be whole numbers, or names such as",
    "show(columns=[True] * 4)": "UsageError: columns must be whole numbers, or names such as",
    "show(columns='abcd')": "UsageError: columns must be a list of numbers or names, got 'abcd'.",
    "show(columns=3)": "UsageError: columns must be a list of numbers or names, got 3.",
    "show(columns=list(np.arange(4))).spec.to_json()": "accepted",
    "show(embedding=folder + '/embedding.json')": "PlanspaceError: ",
    "show(embedding=None)": "UsageError: expected the path of an embedding's folder, got None.",
    "show(embedding=embedding)": "accepted",
    "planspace.make_env({})": "UsageError: expected a task or its name, got {}. See docs/howto/own-task.md.",
    "planspace.make_env('cartpole', obs=3)": "UsageError: unknown observation type 3.",
    "planspace.wrap(3, folder)": "UsageError: wrap takes a gymnasium.Env or a gymnasium.vector.VectorEnv",
    "embedding.encode(3.0)": "PlanspaceError: the embedding reads states of 4 numbers",
    "shape(goal='upright')": "UsageError: the goal must be a state of 4 finite numbers",
    "shape(goal=[np.float32(0)] * 4, scale=np.float32(2)).spec.to_json()": "accepted",
    "shape(scale='1')": "UsageError: scale must be a number above 0, got '1'.",
    "shape(discount=None)": "UsageError: discount must be a number above 0 and at most 1, got None.",
    "many().reset(seed=np.int64(3))": "accepted",
    "make().reset(options={'sate': [0.0] * 4})": "UsageError: unknown option of reset 'sate'.",
    "many().reset(options={'reset_masks': [True] * 2})": "UsageError: unknown option of reset 'reset_masks'.",
    "many().reset(options={'minari_autoseed': False})": "accepted",
    "planspace.make_env('cartpole', num_envs=2.5)": "UsageError: `num_envs` must be a whole number",
    "planspace.make_env('gym:Pendulum-v1', num_envs='2')": "UsageError: `num_envs` must be a whole number of",
    "planspace.make_env('cartpole', num_envs=np.int64(2))": "accepted",
    "planspace.plan_demos('pendulum', num='3')": "UsageError: `num` must be a whole number of at least 1",
    "planspace.plan_demos('pendulum', 1, seed=0.5)": "UsageError: `seed` must be a whole number",
    "embedding.encode({'slider': 0.0})": "UsageError: states must be an array of numbers, got {'sli",
    "make().reset(options={'state': {'hinge': 1}})": "UsageError: a start state must be numbers",
    "embedding.encode([0, 1, 0, 0])": "accepted",
    "policy([0.5] * 9)": "accepted",
    "policy(0.5)": "PlanspaceError: the policy was trained on observations of 9 numbers",
    "policy([])": "PlanspaceError: the policy was trained on observations of 9 numbers",
    "planspace.load_policy(None)": "UsageError: expected a folder or a ready-made name, got None.",
    "planspace.load_demos(None)": "UsageError: expected a folder or a ready-made name, got None.",
    "train(embedding=[3])": "UsageError: expected the path of an embedding's folder, got 3.",
    "steer([0.1, 0.0])": "accepted",
    "steer(np.zeros((1, 2)))": "UsageError: the state must be 2 finite numbers (hinge, hingevel), got array",
    "steer(0.0)": "UsageError: the state must be 2 finite numbers (hinge, hingevel), got 0.0.",
    "steer(None)": "UsageError: the state must be 2 finite numbers (hinge, hingevel), got None.",
    "steer('ab')": "UsageError: the state must be 2 finite numbers (hinge, hingevel), got 'ab'.",
    "steer.reset(0, 'ab')": "UsageError: the target must be 0 finite numbers, got 'ab'.",
    "control(embedding='pendulum')": "UsageError: `embedding` must be an Embedding, got 'pendulum'",
    "planspace.ControlConfig(samples=16.5)": "UsageError: `samples` must be a whole number, got 16.5.",
    "planspace.ControlConfig(knots=True)": "UsageError: `knots` must be a whole number, got True.",
    "planspace.ControlConfig(horizon_s=None)": "UsageError: `horizon_s` must be a number, got None.",
    "planspace.ControlConfig(cost='zz')": "UsageError: unknown cost 'zz'.",
    "planspace.ControlConfig(spline='x')": "UsageError: unknown spline 'x'.",
    "control(config={})": "UsageError: `config` must be a ControlConfig, got {}.",
    "control(plans='pendulum')": "UsageError: `plans` must be a Demos, got 'pendulum': load them first.",
    "planspace.fit_embedding('plans')": "UsageError: `demos` must be a Demos, got 'plans': load them first.",
    "planspace.measure_embedding(folder, None)": "UsageError: `embedding` must be an Embedding, got '",
    "planspace.measure_embedding(embedding, [])": "UsageError: `demos` must be a Demos, got []: load them",
    "np.testing.assert_array_equal(*map(embedding.encode, ([0, 1, 0, 0], [0.0, 1.0, 0.0, 0.0])))": "accepted",
}


def test_wrong_types_are_reported_in_one_line(embedding_folder: Path) -> None:
    command = [sys.executable, "-c", SCRIPT, str(embedding_folder), json.dumps(list(CASES))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    for (code, wanted), got in zip(CASES.items(), json.loads(done.stdout), strict=True):
        assert got.startswith(wanted), f"{code}: {got[:200]}"
        assert "\n" not in got
