import mujoco
import numpy as np

from planspace.physics import quaternion


def test_a_quarter_turn_by_hand() -> None:
    half = np.sqrt(0.5)
    np.testing.assert_allclose(quaternion.exp(np.array([0, 0, np.pi / 2])), [half, 0, 0, half], atol=1e-15)
    # two quarter turns about z are a half turn: (0, 0, 0, 1)
    quarter = np.array([half, 0, 0, half])
    np.testing.assert_allclose(quaternion.multiply(quarter, quarter), [0, 0, 0, 1], atol=1e-15)


def test_log_inverts_exp_and_ignores_the_sign(rng: np.random.Generator) -> None:
    v = rng.normal(size=(100, 3))
    v *= rng.uniform(0, 3.1, (100, 1)) / np.linalg.norm(v, axis=1, keepdims=True)
    q = quaternion.exp(v)
    np.testing.assert_allclose(quaternion.log(q), v, atol=1e-12)
    np.testing.assert_allclose(quaternion.log(-q), v, atol=1e-12)
    np.testing.assert_array_equal(quaternion.log(np.array([1.0, 0, 0, 0])), np.zeros(3))


def test_multiply_and_log_agree_with_mujoco(rng: np.random.Generator) -> None:
    a, b = quaternion.sample(rng, 20), quaternion.sample(rng, 20)
    for x, y in zip(a, b, strict=True):
        product, difference = np.zeros(4), np.zeros(3)
        mujoco.mju_mulQuat(product, x, y)
        np.testing.assert_allclose(quaternion.multiply(x, y), product, atol=1e-14)
        mujoco.mju_subQuat(difference, x, y)
        np.testing.assert_allclose(
            quaternion.log(quaternion.multiply(quaternion.conjugate(y), x)), difference, atol=1e-12
        )


def test_a_zero_quaternion_becomes_the_identity() -> None:
    np.testing.assert_array_equal(quaternion.normalise(np.zeros(4)), [1, 0, 0, 0])
