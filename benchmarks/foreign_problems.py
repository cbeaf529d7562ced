"""The problems of `foreign_models.py`: start and goal of each were fixed before it was planned for."""

from dataclasses import dataclass

import numpy as np

SUITE, ROBOTS = "dm_control/suite", "robosuite/models/assets/robots"
ASSETS = "gymnasium_robotics/envs/assets"


@dataclass(frozen=True)
class Foreign:
    """One problem."""

    model: str
    """The model file, relative to the folder of models, or `gym:FILE`."""
    joints: str
    """Names of the joints that move."""
    start: tuple[float, ...]
    """Positions of the start; velocities are 0."""
    goal: tuple[float, ...]
    """Positions of the goal; velocities are 0."""
    why: str
    """How far the goal is from the start, and why it was chosen."""
    weights: str = ""
    """`positions` leaves velocities free; otherwise the columns that count, separated by spaces."""
    more: tuple[tuple[str, object], ...] = ()
    """Other keys of the problem file."""


def arm(
    model: str, joints: str, start: tuple[float, ...], move: tuple[float, ...], **more: object
) -> Foreign:
    goal = tuple(round(a + b, 4) for a, b in zip(start, move, strict=True))
    return Foreign(
        model, joints, start, goal, f"{np.abs(move).sum():.1f} rad in all joints", more=tuple(more.items())
    )


def numbered(name: str, first: int = 1) -> str:
    """The seven joints of an arm: the name and a number."""
    return " ".join(f"{name}{i}" for i in range(first, first + 7))


PI = 3.14159
CART, DOUBLE_PENDULUM = "slider hinge", "slider hinge hinge2"
CHEETAH = "rootx rootz rooty bthigh bshin bfoot fthigh fshin ffoot"
PROBLEMS = {
    "dmc-acrobot": Foreign(
        f"{SUITE}/acrobot.xml", "shoulder elbow", (PI, 0.0), (0.0, 0.0), "swing-up, its own task"
    ),
    "dmc-cartpole": Foreign(
        f"{SUITE}/cartpole.xml", "slider hinge_1", (0.0, PI), (0.0, 0.0), "swing-up, its own task"
    ),
    "dmc-pendulum": Foreign(f"{SUITE}/pendulum.xml", "hinge", (PI,), (0.0,), "swing-up, its own task"),
    "dmc-reacher": Foreign(f"{SUITE}/reacher.xml", "shoulder wrist", (0.0, 0.0), (2.0, 1.5), "3.5 rad"),
    "dmc-point-mass": Foreign(f"{SUITE}/point_mass.xml", "root_x root_y", (-0.2, -0.2), (0.2, 0.2), "0.57 m"),
    "dmc-finger": Foreign(
        f"{SUITE}/finger.xml",
        "proximal distal hinge",
        (0.0, -1.0, 0.0),
        (0.0, 0.0, 1.57),
        "turns the spinner by 90 degrees",
        "hinge",
        (("hold", False),),
    ),
    "dmc-ball-in-cup": Foreign(
        f"{SUITE}/ball_in_cup.xml",
        "cup_x cup_z ball_x ball_z",
        (0.0, 0.0, 0.0, -0.008),
        (0.0, 0.0, 0.0, 0.333),
        "the hanging ball into the cup, its own task",
        weights="cup_x cup_z ball_x ball_z",
        more=(
            ("hold", False),
            (
                "position_bounds",
                {
                    "cup_x": {"low": [-0.3], "high": [0.3]},
                    "cup_z": {"low": [-0.3], "high": [0.3]},
                    "ball_x": {"low": [-0.5], "high": [0.5]},
                    "ball_z": {"low": [-0.3], "high": [0.7]},
                },
            ),
        ),
    ),
    "dmc-hopper-ahead": Foreign(
        f"{SUITE}/hopper.xml",
        "rootx rootz rooty waist hip knee ankle",
        (0, -0.05, 0, 0, -0.6, 1.2, -0.6),
        (0.5, 0, 0, 0, -0.6, 1.2, -0.6),
        "0.5 m ahead",
        "rootx",
        (("hold", False),),
    ),
    "dmc-cheetah-ahead": Foreign(
        f"{SUITE}/cheetah.xml",
        CHEETAH,
        (0.0,) * 9,
        (0.5, *(0.0,) * 8),
        "0.5 m ahead",
        "rootx",
        (("hold", False),),
    ),
    "dmc-walker-ahead": Foreign(
        f"{SUITE}/walker.xml",
        "rootz rootx rooty right_hip right_knee right_ankle left_hip left_knee left_ankle",
        (0.0,) * 9,
        (0.0, 0.5, *(0.0,) * 7),
        "0.5 m ahead",
        "rootx",
        (("hold", False),),
    ),
    "dmc-manipulator-arm": arm(
        f"{SUITE}/manipulator.xml",
        "arm_root arm_shoulder arm_elbow arm_wrist",
        (0.0, 0.3, 0.3, 0.0),
        (1.5, 0.5, 0.5, 0.5),
        held="all",
    ),
    "dmc-cartpole-no-names": Foreign(
        "dm_control/mujoco/testing/assets/cartpole_no_names.xml",
        CART,
        (0.0, PI),
        (0.0, 0.0),
        "swing-up",
    ),
    "gym-inverted-pendulum": Foreign(
        "gym:inverted_pendulum.xml",
        CART,
        (-0.4, 0.0),
        (0.4, 0.0),
        "0.8 m along the rail, balancing",
    ),
    "gym-double-pendulum": Foreign(
        "gym:inverted_double_pendulum.xml", DOUBLE_PENDULUM, (0.0, PI, 0.0), (0.0, 0.0, 0.0), "swing-up"
    ),
    "gym-double-pendulum-balanced": Foreign(
        "gym:inverted_double_pendulum.xml",
        DOUBLE_PENDULUM,
        (-0.4, 0.0, 0.0),
        (0.4, 0.0, 0.0),
        "0.8 m along the rail, balancing",
    ),
    "gym-reacher": Foreign("gym:reacher.xml", "joint0 joint1", (0.0, 0.0), (1.5, 1.5), "3.0 rad"),
    "gym-pusher-arm": arm(
        "gym:pusher_v5.xml",
        "r_shoulder_pan_joint r_shoulder_lift_joint r_upper_arm_roll_joint r_elbow_flex_joint "
        "r_forearm_roll_joint r_wrist_flex_joint r_wrist_roll_joint",
        (0.0, 0.3, 0.0, -0.5, 0.0, -0.3, 0.0),
        (-0.9, -0.3, 0.4, -0.6, 0.4, 0.0, 0.4),
    ),
    "gym-swimmer": Foreign(
        "gym:swimmer.xml",
        "slider1 slider2 free_body_rot motor1_rot motor2_rot",
        (0.0,) * 5,
        (0.3, *(0.0,) * 4),
        "0.3 m ahead",
        "slider1",
        (("hold", False),),
    ),
    "gym-hopper-ahead": Foreign(
        "gym:hopper.xml",
        "rootx rootz rooty thigh_joint leg_joint foot_joint",
        (0, 1.25, 0, -0.2, -0.4, 0.2),
        (0.5, 1.25, 0, -0.2, -0.4, 0.2),
        "0.5 m ahead",
        "rootx",
        (("hold", False),),
    ),
    "gym-cheetah-ahead": Foreign(
        "gym:half_cheetah.xml",
        CHEETAH,
        (0.0,) * 9,
        (0.5, *(0.0,) * 8),
        "0.5 m ahead",
        "rootx",
        (("hold", False),),
    ),
    "gym-walker-ahead": Foreign(
        "gym:walker2d_v5.xml",
        "rootx rootz rooty thigh_joint leg_joint foot_joint thigh_left_joint leg_left_joint foot_left_joint",
        (0.0, 1.25, *(0.0,) * 7),
        (0.5, 1.25, *(0.0,) * 7),
        "0.5 m ahead",
        "rootx",
        (("hold", False),),
    ),
    "gymrob-hand": Foreign(
        f"{ASSETS}/hand/reach.xml",
        "robot0:WRJ1 robot0:WRJ0",
        (0.0, 0.0),
        (-0.4, -0.6),
        "1.0 rad in the wrist",
        more=(("held", "all"),),
    ),
    "gymrob-adroit-arm": Foreign(
        f"{ASSETS}/adroit_hand/adroit_door.xml",
        "ARTz ARRx ARRy ARRz",
        (0.0, 0.0, 0.0, 0.0),
        (0.25, -0.4, 0.4, 0.8),
        "0.25 m and 1.6 rad",
        more=(("held", "all"),),
    ),
    "gymrob-franka-servos": arm(
        f"{ASSETS}/kitchen_franka/kitchen_assets/kitchen_env_model.xml",
        numbered("robot:panda0_joint"),
        (0.15, -1.76, 1.84, -2.47, 0.25, 0.6, 1.57),
        (0.8, 0.5, -0.5, 0.6, 0.3, 0.2, -0.6),
        held="all",
    ),
    "gymrob-point": Foreign(f"{ASSETS}/point/point.xml", "ball_x ball_y", (0.0, 0.0), (1.0, 1.0), "1.4 m"),
    "robosuite-panda": arm(
        f"{ROBOTS}/panda/robot.xml",
        numbered("joint"),
        (0.0, 0.2, 0.0, -2.4, 0.0, 2.6, 0.8),
        (1.4, 0.6, 0.4, 0.6, 0.4, -0.4, 0.6),
    ),
    "robosuite-iiwa": arm(
        f"{ROBOTS}/iiwa/robot.xml",
        numbered("joint_"),
        (0.0, 0.6, 0.0, -1.5, 0.0, 1.0, 0.0),
        (1.4, 0.4, 0.4, 0.6, 0.4, -0.4, 0.6),
    ),
    "robosuite-sawyer": arm(
        f"{ROBOTS}/sawyer/robot.xml",
        numbered("right_j", 0),
        (0.0, -1.0, 0.0, 1.8, 0.0, 0.7, 1.5),
        (1.4, 0.5, 0.4, -0.6, 0.4, -0.4, 0.6),
    ),
    "robosuite-jaco": arm(
        f"{ROBOTS}/jaco/robot.xml",
        numbered("j2s7s300_joint_"),
        (3.1, 3.6, 0.0, 1.3, 0.0, 2.6, -1.5),
        (1.4, -0.5, 0.4, 0.6, 0.4, 0.4, 0.6),
    ),
    "robosuite-kinova3": arm(
        f"{ROBOTS}/kinova3/robot.xml",
        numbered("Actuator"),
        (0.0, 0.6, 0.0, 1.4, 0.0, 0.9, 0.0),
        (1.4, 0.4, 0.4, -0.6, 0.4, -0.4, 0.6),
    ),
    "robosuite-ur5e": arm(
        f"{ROBOTS}/ur5e/robot.xml",
        "shoulder_pan_joint shoulder_lift_joint elbow_joint wrist_1_joint wrist_2_joint wrist_3_joint",
        (-0.4, -1.7, 2.0, -1.8, -1.5, 0.0),
        (1.4, 0.5, -0.6, 0.4, 0.4, 0.6),
    ),
    "robosuite-xarm7": arm(
        f"{ROBOTS}/xarm7/robot.xml",
        numbered("joint"),
        (0.0, -0.2, 0.0, 0.8, 0.0, 1.0, 0.0),
        (1.4, 0.5, 0.4, 0.6, 0.4, -0.4, 0.6),
    ),
    "robosuite-spot-arm": arm(
        f"{ROBOTS}/spot_arm/robot.xml",
        "arm_sh0 arm_sh1 arm_el0 arm_el1 arm_wr0 arm_wr1",
        (0.0, -2.0, 1.8, 0.0, 0.5, 0.0),
        (1.4, 0.6, -0.6, 0.4, -0.4, 0.6),
    ),
    "robosuite-baxter-arm": arm(
        f"{ROBOTS}/baxter/robot.xml",
        "right_s0 right_s1 right_e0 right_e1 right_w0 right_w1 right_w2",
        (0.4, -0.5, 0.0, 1.0, 0.0, 0.7, 0.0),
        (-0.9, 0.4, 0.4, 0.6, 0.4, -0.4, 0.6),
        held="all",
    ),
}


def half(name: str, start: tuple[float, ...], goal: tuple[float, ...]) -> Foreign:
    """The arm of another problem, from a quarter to three quarters of the range of each joint."""
    known = PROBLEMS[name]
    length = np.abs(np.subtract(goal, start)).sum()
    return Foreign(known.model, known.joints, start, goal, f"half of each range, {length:.0f} rad")


PROBLEMS |= {
    "robosuite-panda-half": half(
        "robosuite-panda",
        (-1.45, -0.88, -1.45, -2.32, -1.45, 0.92, -1.45),
        (1.45, 0.88, 1.45, -0.82, 1.45, 2.81, 1.45),
    ),
    "robosuite-iiwa-half": half(
        "robosuite-iiwa",
        (-1.48, -1.05, -1.48, -1.05, -1.48, -1.05, -1.53),
        (1.48, 1.05, 1.48, 1.05, 1.48, 1.05, 1.53),
    ),
    "robosuite-sawyer-half": half(
        "robosuite-sawyer",
        (-1.53, -2.29, -1.52, -1.52, -1.49, -1.49, -2.36),
        (1.53, 0.75, 1.52, 1.52, 1.49, 1.49, 2.36),
    ),
    "robosuite-jaco-half": half(
        "robosuite-jaco",
        (-3.14, 1.98, -3.14, 1.83, -3.14, 2.14, -3.14),
        (3.14, 4.3, 3.14, 4.45, 3.14, 4.15, 3.14),
    ),
    "robosuite-kinova3-half": half(
        "robosuite-kinova3",
        (-1.57, -1.2, -1.57, -1.33, -1.57, -1.12, -1.57),
        (1.57, 1.2, 1.57, 1.33, 1.57, 1.11, 1.57),
    ),
    "robosuite-ur5e-half": half(
        "robosuite-ur5e",
        (-3.14, -3.14, -1.57, -3.14, -3.14, -3.14),
        (3.14, 3.14, 1.57, 3.14, 3.14, 3.14),
    ),
    "robosuite-xarm7-half": half(
        "robosuite-xarm7",
        (-3.14, -1.02, -3.14, 0.84, -3.14, -0.48, -3.14),
        (3.14, 1.06, 3.14, 2.9, 3.14, 1.93, 3.14),
    ),
    "robosuite-spot-arm-half": half(
        "robosuite-spot-arm",
        (-1.18, -2.23, 0.79, -1.4, -0.92, -1.44),
        (1.7, -0.39, 2.36, 1.4, 0.92, 1.44),
    ),
}
