"""Wheels guessed by geometry."""

import pytest

from tests.sim_server.description.plugins.driven_robots import (
    BALLS,
    BODY,
    FOUR_STEERER,
    a_base,
    a_car,
    a_diff_robot,
    a_four_steerer,
    a_four_wheeler,
    a_steering,
    a_tyre,
)
from tests.sim_server.description.robots import a_collision, a_joint, a_link, a_reference, a_robot
from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.sim_server.description.joint_reduction import LumpedModel
from zensim.sim_server.description.plugins.wheel_guess import (
    find_wheels,
    find_wheels_rolling_aside,
    has_wheels,
    list_drives,
    lower_suspensions,
)
from zensim.sim_server.description.urdf.urdf_parser import read_urdf


def lump(text: str) -> LumpedModel:
    model = read_urdf(text)
    return LumpedModel(model.links, model.joints, model.frames)


AXIS = '<axis xyz="0 1 0"/>'
KNEE_LIMIT = '<limit lower="-9.42" upper="9.42" effort="1" velocity="1"/>'
WHEEL_LIMIT = '<limit lower="-180" upper="180" effort="1" velocity="1"/>'
FEET = a_link("foot", a_collision(origin='<origin xyz="0 0 -0.3"/>')) + a_joint(
    "ankle", ("base_link", "foot")
)
SHANK = a_link("shank", a_collision(BODY)) + a_joint("knee", ("left_tyre", "shank"), "continuous")
RING_ROBOT = a_robot(
    a_base(),
    a_link("ring") + a_joint("spin", ("base_link", "ring"), "continuous", AXIS),
    a_tyre("left", 0.0, 0.2, parent="ring"),
    a_tyre("right", 0.0, -0.2, parent="ring"),
)
SWIVEL = a_steering("swivel", -0.3, 0.0).replace("revolute", "continuous").replace("0.7", "0")
CASTER = SWIVEL + a_tyre("caster", -0.05, 0.0, parent="swivel_knuckle")
LIDAR = a_tyre("lidar", 0.1, 0.0).replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/>')
HIGH = a_tyre("roller_left", 0.0, 0.3).replace('xyz="0.0 0.3 0"', 'xyz="0 0.3 0.5"') + a_tyre(
    "roller_right", 0.0, -0.3
).replace('xyz="0.0 -0.3 0"', 'xyz="0 -0.3 0.5"')


@pytest.mark.parametrize(
    ("text", "order"),
    [
        (a_diff_robot(), DriveOrder("diff", ("left", "right"))),
        (a_diff_robot(CASTER, LIDAR, HIGH), DriveOrder("diff", ("left", "right"))),
        (a_four_wheeler(), DriveOrder("diff", ("fl", "fr", "rl", "rr"))),
        (
            a_four_wheeler(names=("mecanum_fl", "mecanum_fr", "mecanum_rl", "mecanum_rr")),
            DriveOrder("mecanum", ("mecanum_fl", "mecanum_fr", "mecanum_rl", "mecanum_rr")),
        ),
        (
            a_car(),
            DriveOrder("ackermann", ("rear_left", "rear_right", "steer_left", "steer_right")),
        ),
        (
            a_car().replace("revolute", "continuous"),
            DriveOrder("ackermann", ("rear_left", "rear_right", "steer_left", "steer_right")),
        ),
        (a_four_steerer(), parse_drive_order(FOUR_STEERER)),
        (a_diff_robot().replace('<origin rpy="1', '<origin xyz="0 0 -0.3" rpy="1'), None),
        (a_diff_robot(FEET), None),
        (a_diff_robot(SHANK), None),
        (RING_ROBOT, None),
        (a_diff_robot().replace("continuous", "revolute").replace(AXIS, AXIS + KNEE_LIMIT), None),
        (
            a_diff_robot().replace("continuous", "revolute").replace(AXIS, AXIS + WHEEL_LIMIT),
            DriveOrder("diff", ("left", "right")),
        ),
        (
            a_four_steerer().replace('lower="-0.7" upper="0.7"', 'lower="0" upper="0"'),
            DriveOrder("diff", ("fl", "fr", "rl", "rr")),
        ),
        (a_robot(a_base()), None),
        (a_robot(a_base(), a_tyre("one", 0.0, 0.2)), None),
        (a_robot(a_base(), CASTER), None),
    ],
    ids=[
        "diff",
        "caster, lidar, roller",
        "skid",
        "mecanum",
        "car",
        "car with void limits",
        "two steered axles",
        "round parts off their axles",
        "feet lower than round joints",
        "motors of legs",
        "wheels on a ring that turns",
        "knees of two turns",
        "wheels with limits",
        "locked steering",
        "box",
        "one wheel",
        "caster",
    ],
)
def test_drive_is_suggested_for_the_wheels_on_the_ground(
    text: str, order: DriveOrder | None
) -> None:
    found = list_drives(lump(text))

    assert (found[0] if found else None) == order


def test_wheels_of_casters_are_no_wheels_to_drive() -> None:
    assert [wheel.joint for wheel in find_wheels(lump(a_diff_robot(CASTER)))] == ["left", "right"]


def test_wheels_that_roll_aside_have_axles_along_x_and_collisions() -> None:
    aside = a_diff_robot().replace(AXIS, '<axis xyz="1 0 0"/>')
    aside = aside.replace('rpy="1.5707963267948966 0 0"', 'rpy="0 1.5707963267948966 0"')

    assert len(find_wheels_rolling_aside(lump(aside))) == 2
    assert find_wheels_rolling_aside(lump(a_diff_robot())) == []


def a_mesh_free_wheel(name: str, x: float, y: float, *, axis: str, spin: str) -> str:
    """A wheel of radius 0.1 m on an axle that points to the middle of the robot."""
    tyre = '<geometry><cylinder radius="0.1" length="0.04"/></geometry>'
    place = f'<origin xyz="0 0 0" rpy="{spin}"/>'
    return a_link(f"{name}_link", a_collision(tyre, origin=place)) + (
        f'<joint name="{name}" type="continuous"><parent link="base_link"/>'
        f'<child link="{name}_link"/><origin xyz="{x} {y} 0"/><axis xyz="{axis}"/></joint>'
    )


OMNI_BASE = a_robot(
    a_base(),
    a_mesh_free_wheel("front", 0.2, 0.0, axis="1 0 0", spin="0 1.5707963 0"),
    a_mesh_free_wheel("left", -0.1, 0.1732, axis="-0.5 0.866 0", spin="1.5707963 0 0.5235988"),
    a_mesh_free_wheel("right", -0.1, -0.1732, axis="-0.5 -0.866 0", spin="1.5707963 0 -0.5235988"),
)
TYRE_MU = "<mu1>1</mu1><mu2>0</mu2><fdir1>{}</fdir1>"


def test_wheels_about_a_middle_are_an_omni_drive() -> None:
    assert list_drives(lump(OMNI_BASE))[0] == DriveOrder("omni", ("front", "left", "right"))


def test_wheels_are_mecanum_when_their_friction_is_oblique() -> None:
    directions = {"fl": "1 0 -1", "fr": "1 0 1", "rl": "1 0 1", "rr": "1 0 -1"}
    blocks = (a_reference(f"{n}_tyre", TYRE_MU.format(d)) for n, d in directions.items())

    found = list_drives(lump(a_four_wheeler(*blocks)))

    assert found[0] == DriveOrder("mecanum", ("fl", "fr", "rl", "rr"))


def test_wheels_are_mecanum_when_the_robot_is_named_so() -> None:
    assert list_drives(lump(a_four_wheeler()), "my_mecanum")[0].kind == "mecanum"


def test_wheels_with_rollers_reach_to_their_outside() -> None:
    rollers = "".join(
        a_link(f"{wheel}_roller_{i}", a_collision('<geometry><sphere radius="0.02"/></geometry>'))
        + f'<joint name="{wheel}_r{i}" type="continuous"><parent link="{wheel}_tyre"/>'
        f'<child link="{wheel}_roller_{i}"/><origin xyz="{x} 0 {z}"/><axis xyz="1 0 0"/></joint>'
        for wheel in ("fl", "fr", "rl", "rr")
        for i, (x, z) in enumerate(((0.1, 0), (0, 0.1), (-0.1, 0), (0, -0.1)))
    )

    found = list_drives(lump(a_four_wheeler(rollers)))

    assert (found[0].kind, found[0].joints) == ("mecanum", ("fl", "fr", "rl", "rr"))
    assert found[0].diameter_m == pytest.approx(0.24)


SUSPENDED = a_robot(
    a_base(),
    BALLS,
    *(
        a_link(f"{side}_arm", a_collision('<geometry><sphere radius="0.001"/></geometry>'))
        + f'<joint name="{side}_slide" type="prismatic"><parent link="base_link"/>'
        f'<child link="{side}_arm"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        + a_tyre(side, 0.0, y, parent=f"{side}_arm")
        for side, y in (("left", 0.2), ("right", -0.2))
    ),
)


def test_wheels_on_suspensions_reach_the_ground() -> None:
    assert list_drives(lump(SUSPENDED)) == []

    assert list_drives(lower_suspensions(lump(SUSPENDED))) == [
        DriveOrder("diff", ("left", "right"))
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (a_diff_robot(), True),
        (RING_ROBOT, True),
        (a_robot(a_base(), CASTER), False),
        (a_robot(a_base()), False),
        (a_robot(a_base(), SWIVEL, a_tyre("below", 0.0, 0.0, parent="swivel_knuckle")), True),
    ],
    ids=["diff", "ring", "caster", "box", "wheel below its swivel"],
)
def test_robot_is_mobile_when_wheels_touch_the_ground(text: str, *, expected: bool) -> None:
    assert has_wheels(lump(text)) is expected
