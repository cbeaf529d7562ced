import pytest

from planspace.errors import UsageError
from planspace.mjcf.compile import load_model
from planspace.physics.supported import check_supported

BODY = '<body name="b"><joint name="j"/><geom size="0.1"/></body>'
CLOTH = '<body name="c"><flexcomp name="cloth" count="3 3 1" dim="2" spacing="1 1 1"/></body>'
USER = '<motor joint="j"/><general joint="j" dyntype="user" actdim="2"/>'
LATE = '<motor name="late" joint="j" delay="0.02" nsample="20"/>'


@pytest.mark.parametrize(
    ("body", "actuator", "message"),
    [
        (CLOTH, "", "the flexible body 'cloth'"),
        (
            BODY,
            USER,
            "the actuator 1 has an activation that .* use one of integrator, filter, filterexact, muscle",
        ),
        (BODY, LATE, "the actuator 'late' has a delay of 0.02 s"),
    ],
)
def test_a_hidden_state_is_refused_by_name(body: str, actuator: str, message: str) -> None:
    text = f"<mujoco><worldbody>{body}</worldbody><actuator>{actuator}</actuator></mujoco>"
    with pytest.raises(UsageError, match=message):
        check_supported(load_model(text))


def test_what_is_part_of_the_state_is_accepted() -> None:
    servo = '<actuator><position joint="j" kp="3"/><motor joint="j"/><muscle joint="j" lengthrange="0 1"/>'
    servo += '<general joint="j" dyntype="filter" dynprm="0.1"/><cylinder joint="j"/></actuator>'
    check_supported(load_model(f"<mujoco><worldbody>{BODY}</worldbody>{servo}</mujoco>"))
