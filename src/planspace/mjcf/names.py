"""Names for the joints and bodies of a model that have none, so that problems can refer to them."""

from collections.abc import Iterable

import mujoco


def name_elements(spec: mujoco.MjSpec) -> None:
    """Name every joint and body that has no name; named ones keep theirs.

    A body is called `body1`, `body2`, ... by its place in the model. A joint is called like its body, or
    `BODY_2`, `BODY_3`, ... if that name is taken.
    """
    bodies = {body.name for body in spec.bodies}
    for number, body in enumerate(spec.bodies):
        if not body.name:
            body.name = _free_name(f"body{number}", bodies)
            bodies.add(body.name)
    joints = {joint.name for joint in spec.joints}
    for joint in spec.joints:
        if not joint.name:
            joint.name = _free_name(joint.parent.name, joints)
            joints.add(joint.name)


def _free_name(name: str, taken: Iterable[str]) -> str:
    number, free = 1, name
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free
