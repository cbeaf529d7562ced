"""Which unlimited hinges are circles."""

import pytest

from planspace.mjcf.compile import load_model
from planspace.physics.space import StateSpace

MODEL = """<mujoco><worldbody>
  <body><joint name="h" axis="0 1 0" {spring}/><geom size="0.1" pos="0.3 0 0"/></body>
  <body pos="1 0 0"><joint name="g" axis="0 1 0"/><geom size="0.1" pos="0.3 0 0"/></body>
</worldbody>{more}</mujoco>"""
TENDON = '<tendon><fixed name="t" {spring}><joint joint="h" coef="1"/></fixed></tendon>'


@pytest.mark.parametrize(
    ("spring", "more", "kind"),
    [
        ("", "", "circle"),
        ('damping="1" armature="1"', "", "circle"),
        ("", '<actuator><motor joint="h"/><velocity joint="h" kv="2"/></actuator>', "circle"),
        ("", TENDON.format(spring="") + '<actuator><motor tendon="t"/></actuator>', "circle"),
        ("", '<equality><joint joint1="g"/></equality>', "circle"),
        ('stiffness="1"', "", "hinge"),
        ("", '<actuator><position joint="h" kp="10"/></actuator>', "hinge"),
        ("", '<actuator><general joint="h" gaintype="affine" gainprm="1 2 0"/></actuator>', "hinge"),
        ("", TENDON.format(spring='stiffness="1"'), "hinge"),
        ("", TENDON.format(spring='limited="true" range="-1 1"'), "hinge"),
        ("", TENDON.format(spring="") + '<actuator><position tendon="t"/></actuator>', "hinge"),
        ("", TENDON.format(spring="") + '<equality><tendon tendon1="t"/></equality>', "hinge"),
        ("", '<equality><joint joint1="h" joint2="g"/></equality>', "hinge"),
    ],
)
def test_a_hinge_that_counts_its_turns_is_no_circle(spring: str, more: str, kind: str) -> None:
    model = load_model(MODEL.format(spring=spring, more=more))
    space = StateSpace.from_model(model, ("h",))
    assert space.kinds == (kind,)
    if kind == "hinge":  # a turn in each direction, unless the user gives other bounds
        assert space.low[0] == pytest.approx(-6.2832, abs=1e-4)
        wider = StateSpace.from_model(model, ("h",), position_bounds={"h": ((-20.0,), (20.0,))})
        assert (wider.low[0], wider.high[0]) == (-20.0, 20.0)
