import copy
import subprocess
import sys

import numpy as np
import pytest

import planspace as ps
from planspace.embed.embedding import Embedding
from planspace.errors import PlanspaceError

from .random_encoder import ENCODERS, jacobian, random_encoder, random_states

torch = pytest.importorskip("torch")

TOLERANCE = 1e-5


@pytest.mark.parametrize("e", ENCODERS)
def test_same_numbers_as_numpy_in_batches_of_any_shape(e: Embedding) -> None:
    states, module = random_states(e, 24), ps.torch_module(e)
    assert (module.state_dim, module.z_dim) == (4, 3)
    for shape in ((24, 4), (2, 3, 4, 4), (0, 4), (4,)):
        batch = np.resize(states, shape)
        z = module(torch.tensor(batch))
        assert z.dtype == torch.float32 and z.shape == (*shape[:-1], 3)
        np.testing.assert_allclose(z.numpy(), e.encode(batch), rtol=TOLERANCE, atol=TOLERANCE)


def test_a_trained_embedding(embedding: Embedding, demos) -> None:
    states = demos.states.astype(np.float32)
    z = ps.torch_module(embedding)(torch.tensor(states)).numpy()
    np.testing.assert_allclose(z, embedding.encode(states), rtol=TOLERANCE, atol=TOLERANCE)


@pytest.mark.parametrize("e", ENCODERS)
def test_gradients_agree_with_finite_differences(e: Embedding) -> None:
    state, module = random_states(e, 1)[0], ps.torch_module(e)
    found = torch.autograd.functional.jacobian(module, torch.tensor(state)).numpy()
    np.testing.assert_allclose(found, jacobian(e, state.astype(float)), rtol=1e-4, atol=1e-4)


def test_weights_are_frozen_unless_trainable() -> None:
    e = ENCODERS[2]
    states = torch.tensor(random_states(e, 5), requires_grad=True)
    frozen, trained = ps.torch_module(e), ps.torch_module(e, trainable=True)
    frozen(states).sum().backward()
    assert states.grad is not None and states.grad.abs().sum() > 0
    assert all(p.grad is None and not p.requires_grad for p in frozen.parameters())
    before = trained(states).detach()
    optimiser = torch.optim.SGD(trained.parameters(), lr=0.1)
    trained(states).sum().backward()
    optimiser.step()
    assert len(list(trained.parameters())) == 6 and not torch.equal(trained(states), before)


def test_weights_do_not_change_when_an_agent_initialises_its_linear_layers() -> None:
    """Stable-Baselines3 makes each `nn.Linear` of a features extractor orthogonal."""
    assert not any(isinstance(m, torch.nn.Linear) for m in ps.torch_module(ENCODERS[0]).modules())


def test_state_dict_and_copies() -> None:
    e, other = random_encoder("trig", (1,)), random_encoder("trig", (3,))
    states = torch.tensor(random_states(e, 5))
    module, loaded = ps.torch_module(e), ps.torch_module(other)
    assert not torch.equal(module(states), loaded(states))
    loaded.load_state_dict(module.state_dict())
    assert torch.equal(module(states), loaded(states))
    assert torch.equal(module(states), copy.deepcopy(module)(states))


def test_device_and_type() -> None:
    e = ENCODERS[2]
    assert {a.device.type for a in ps.torch_module(e, device="meta").state_dict().values()} == {"meta"}
    assert {a.device.type for a in ps.torch_module(e).to("meta").state_dict().values()} == {"meta"}
    states = random_states(e, 5)
    z = ps.torch_module(e).double()(torch.tensor(states))
    assert z.dtype == torch.float64
    np.testing.assert_allclose(z.numpy(), e.encode(states), rtol=TOLERANCE, atol=TOLERANCE)
    assert ps.torch_module(e)(torch.tensor(states.astype(float))).dtype == torch.float32


def test_vmap_and_export() -> None:
    e = ENCODERS[2]
    module, states = ps.torch_module(e), torch.tensor(random_states(e, 5))
    z = module(states)
    torch.testing.assert_close(torch.func.vmap(module)(states), z)
    torch.testing.assert_close(torch.export.export(module, (states,)).module()(states), z)


@pytest.mark.parametrize("shape", [(3,), (7, 5)])
def test_a_wrong_number_of_columns_is_refused_as_in_numpy(shape: tuple[int, ...]) -> None:
    with pytest.raises(PlanspaceError) as by_numpy:
        ENCODERS[0].encode(np.zeros(shape))
    with pytest.raises(PlanspaceError, match=r"^the embedding reads states of 4 numbers[^\n]*$") as caught:
        ps.torch_module(ENCODERS[0])(torch.zeros(shape))
    assert str(caught.value) == str(by_numpy.value)


def test_without_torch_the_error_names_the_extra() -> None:
    code = "import sys; sys.modules['torch'] = None; import planspace as ps\n"
    code += "try: ps.torch_module(None)\nexcept ps.PlanspaceError as error: print(error)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "[torch]'" in done.stdout and done.stdout.count("\n") == 1
