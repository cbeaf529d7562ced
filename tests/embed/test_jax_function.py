import jax
import jax.numpy as jnp
import numpy as np
import pytest

import planspace as ps
from planspace.embed.embedding import Embedding
from planspace.errors import PlanspaceError

from .random_encoder import ENCODERS, jacobian, random_states

TOLERANCE = 1e-5


@pytest.mark.parametrize("e", ENCODERS)
def test_same_numbers_as_numpy_in_batches_of_any_shape(e: Embedding) -> None:
    states, encode = random_states(e, 24), ps.jax_function(e)
    for shape in ((24, 4), (2, 3, 4, 4), (0, 4), (4,)):
        batch = np.resize(states, shape)
        for z in (encode(batch), jax.jit(encode)(batch)):
            assert z.dtype == jnp.float32 and z.shape == (*shape[:-1], 3)
            np.testing.assert_allclose(z, e.encode(batch), rtol=TOLERANCE, atol=TOLERANCE)
    np.testing.assert_allclose(jax.vmap(encode)(states), encode(states), rtol=TOLERANCE, atol=TOLERANCE)


def test_a_trained_embedding(embedding: Embedding, demos) -> None:
    states = demos.states.astype(np.float32)
    z = jax.jit(ps.jax_function(embedding))(states)
    np.testing.assert_allclose(z, embedding.encode(states), rtol=TOLERANCE, atol=TOLERANCE)


@pytest.mark.parametrize("e", ENCODERS)
def test_gradients_agree_with_finite_differences(e: Embedding) -> None:
    state = random_states(e, 1)[0]
    found = jax.jit(jax.jacobian(ps.jax_function(e)))(state)
    np.testing.assert_allclose(found, jacobian(e, state.astype(float)), rtol=1e-4, atol=1e-4)


def test_products_are_not_rounded_on_accelerators() -> None:
    """By default, JAX multiplies with 10 bits on GPUs and 8 bits on TPUs."""
    encode = ps.jax_function(ENCODERS[0])
    for program in (encode, jax.grad(lambda x: encode(x).sum())):
        text = str(jax.make_jaxpr(program)(np.zeros(4, np.float32)))
        assert text.count("dot_general") == text.count("precision=(Precision.HIGHEST, Precision.HIGHEST)") > 0


@pytest.mark.parametrize("shape", [(3,), (7, 5)])
def test_a_wrong_number_of_columns_is_refused_as_in_numpy(shape: tuple[int, ...]) -> None:
    with pytest.raises(PlanspaceError) as by_numpy:
        ENCODERS[0].encode(np.zeros(shape))
    for encode in (ps.jax_function(ENCODERS[0]), jax.jit(ps.jax_function(ENCODERS[0]))):
        with pytest.raises(PlanspaceError) as caught:
            encode(np.zeros(shape))
        assert str(caught.value) == str(by_numpy.value)
