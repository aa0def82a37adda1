import msgspec
import pytest

from tests.models import a_body, a_box, a_cart
from tests.sim_server.description.plugins.driven_robots import BALLS, a_base, a_tyre, read_driven
from tests.sim_server.description.robots import a_joint, a_link, a_robot, an_inertial
from tests.sim_server.description.wheel_models import (
    DIFF_PLUGIN,
    Chassis,
    UrdfText,
    WheelRobot,
    a_diff,
    diff_tags,
    list_robots,
)
from tests.sim_server.description.wheel_models import a_box as box_collision
from zensim.proto.messages.drive_messages import DiffDrive, DriveOrder, WheelPair
from zensim.proto.messages.model_messages import Inertial, JointController, Link, Model
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.driving_notes import describe_driving
from zensim.sim_server.description.model_geometry import FALL, falls_without_end
from zensim.sim_server.description.motion_prediction import predict_nominal_motions
from zensim.sim_server.description.pipeline import parse_description
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

ROBOTS = {robot.name: robot for robot in list_robots()}
AS_COMMANDED = ("mass_ratio_1000", "swivels_all_around", "car_20_kg", "tricycle_20_kg", "mover_box")


def a_leg(name: str, x: float, y: float) -> str:
    """A hip above the body, and a wheel 0.8 m below and 0.1 m behind it."""
    hip = (
        f'<origin xyz="{x} {y} 0.2"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="100" velocity="1"/>'
    )
    tyre = a_tyre(name, -0.1, 0.0, parent=f"{name}_leg").replace('"-0.1 0.0 0"', '"-0.1 0 -0.8"')
    joint = a_joint(f"{name}_hip", ("base_link", f"{name}_leg"), "revolute", hip)
    return a_link(f"{name}_leg", an_inertial()) + joint + tyre


LEGS = {"fl": (0.35, 0.2), "fr": (0.35, -0.2), "rl": (-0.15, 0.2), "rr": (-0.15, -0.2)}
LEGGED_BODY = a_base() + "".join(a_leg(name, *place) for name, place in LEGS.items())


def reasons(model: Model) -> list[str]:
    entries = describe_driving(model).entries
    return [entry.reason for entry in entries if entry.subject == "driving"]


@pytest.mark.parametrize("name", ["box_bot", "omni_bot", "car_bot", "trike_bot"])
def test_builtin_robot_that_drives_as_commanded_gets_no_entry(name: str) -> None:
    assert reasons(read_urdf(read_builtin_model(name))) == []


@pytest.mark.parametrize("robot", [ROBOTS[name] for name in AS_COMMANDED], ids=AS_COMMANDED)
def test_robot_that_drives_as_commanded_gets_no_entry(robot: WheelRobot) -> None:
    assert reasons(robot.model()) == []


def test_entry_of_a_skid_steered_robot_names_cause_and_multiplier() -> None:
    (reason,) = reasons(ROBOTS["skid_long"].model())

    assert "0.34" in reason
    assert "skid steering" in reason
    assert "wheel_separation_multiplier 2.96" in reason


def test_multiplier_of_the_entry_makes_the_robot_turn_as_commanded() -> None:
    model = ROBOTS["skid_square"].model()
    drive = model.drive
    assert isinstance(drive, DiffDrive)
    _, turn = predict_nominal_motions(model)
    share = turn.twist[2] / turn.nominal[2]
    pairs = tuple(
        msgspec.structs.replace(pair, separation_m=pair.separation_m / share)
        for pair in drive.pairs
    )

    corrected = msgspec.structs.replace(model, drive=msgspec.structs.replace(drive, pairs=pairs))

    assert predict_nominal_motions(corrected)[1].twist[2] == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("ball_under_most_of_the_load_mu_1", ("does not drive", "'base_link'")),
        ("diameter_10_percent_off", ("drives and turns", "0.91", "wheel_diameter")),
        ("track_10_off", ("turns", "1.10", "wheel_separation")),
    ],
)
def test_entry_names_what_is_off(name: str, words: tuple[str, ...]) -> None:
    first = reasons(ROBOTS[name].model())[0]

    assert all(word in first for word in words)


def test_robot_whose_wheels_hang_in_the_air_is_told_so() -> None:
    model = a_cart()
    wheels = tuple(
        msgspec.structs.replace(
            joint, origin=msgspec.structs.replace(joint.origin, position=(0.0, y, 0.02))
        )
        for joint, y in zip(model.joints, (-0.15, 0.15), strict=True)
    )
    base = model.links[0]
    wide = tuple(
        msgspec.structs.replace(
            shape, origin=msgspec.structs.replace(shape.origin, position=(x, y, -0.03))
        )
        for shape, x, y in (
            (base.collisions[1], 0.1, 0.1),
            (base.collisions[1], 0.1, -0.1),
            (base.collisions[2], -0.1, 0.0),
        )
    )
    lifted = msgspec.structs.replace(
        model,
        joints=wheels,
        links=(msgspec.structs.replace(base, collisions=wide), *model.links[1:]),
    )

    assert "no load" in reasons(lifted)[0]
    assert "'left_joint' (it ends 20 mm above the ground)" in reasons(lifted)[0]


def test_robot_that_tips_over_is_told_so_and_nothing_else() -> None:
    model = a_cart()
    base = model.links[0]
    heavy = msgspec.structs.replace(base.inertial, com_in_link=(0.3, 0.0, 0.3))
    tipping = msgspec.structs.replace(
        model, links=(msgspec.structs.replace(base, inertial=heavy), *model.links[1:])
    )

    (reason,) = reasons(tipping)

    assert "falls over" in reason


def test_robot_that_falls_over_is_told_which_wheels_have_no_collisions() -> None:
    urdf = UrdfText("bare")
    top = box_collision((0.05, 0.05, 0.02), (0.1, 0.0, 0.3))
    urdf.link("base_link", 7.0, (0.05, 0.15, 0.2), top)
    for side, y in (("left0", 0.11), ("right0", -0.11)):
        urdf.link(side, 6.5, (0.06, 0.12, 0.06))
        urdf.joint(f"{side}_joint", "continuous", ("base_link", side), (0.0, y, 0.0))
    urdf.plugin(DIFF_PLUGIN, diff_tags(Chassis()))

    (reason,) = reasons(WheelRobot("bare", urdf.text()).model())

    assert reason.startswith("it falls over")
    assert "'left0'" in reason
    assert "'right0'" in reason


def test_link_whose_centre_of_mass_is_in_the_ground_is_named() -> None:
    (reason,) = reasons(a_diff("buried", Chassis(com=(0.0, 0.0, -2.0))).model())

    assert reason.startswith("it swings")
    assert "'base_link' is 1.9 m below the ground" in reason


def test_robot_that_rests_tilted_is_told_the_angle() -> None:
    model = a_cart()
    base = model.links[0]
    front = base.collisions[1]
    raised = msgspec.structs.replace(
        front, origin=msgspec.structs.replace(front.origin, position=(0.1, 0.0, -0.02))
    )
    ahead = msgspec.structs.replace(base.inertial, com_in_link=(0.03, 0.0, 0.0))
    tilted = msgspec.structs.replace(
        model,
        links=(
            msgspec.structs.replace(base, inertial=ahead, collisions=(base.collisions[0], raised)),
            *model.links[1:],
        ),
    )

    assert "tilted by 5.8 degrees" in reasons(tilted)[0]


def test_model_without_a_drive_gets_no_entry() -> None:
    assert describe_driving(a_box()) == ((), False)


def a_ghost(*, is_static: bool = False, weightless: Inertial | None = None) -> Model:
    """Make a model without collisions."""
    link = Link("base", a_body(), weightless=weightless or Inertial())
    return Model("ghost", (link,), is_static=is_static)


def test_model_without_collisions_falls_whether_it_has_a_drive_or_not() -> None:
    cart = a_cart()
    links = tuple(msgspec.structs.replace(link, collisions=()) for link in cart.links)

    assert falls_without_end(a_ghost())
    assert falls_without_end(Model("massless", (Link("base"),)))
    assert reasons(msgspec.structs.replace(cart, links=links)) == [FALL.reason]


def test_model_without_collisions_that_nothing_pulls_down_gets_no_entry() -> None:
    assert not falls_without_end(a_ghost(is_static=True))
    assert not falls_without_end(a_ghost(weightless=a_body()))


GHOST = """<robot name="ghost"><link name="base">
  <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  {collision}</link></robot>"""
LOST_MESH = "<collision><geometry><mesh filename='package://gone/a.stl'/></geometry></collision>"


@pytest.mark.parametrize("collision", ["", LOST_MESH])
def test_report_of_a_description_without_usable_collisions_says_that_it_falls(
    collision: str,
) -> None:
    parsed = parse_description(
        GHOST.format(collision=collision), assets={}, allow_missing=True, compat="fixed"
    )

    assert FALL.reason in [entry.reason for entry in parsed.model.report]


def with_front_limits(limit: float) -> Model:
    """Give the passive front wheels of a robot revolute joints with limits."""
    model = ROBOTS["passive_front_wheels"].model()
    driven = {actuator.joint for actuator in model.actuators}
    joints = tuple(
        joint
        if joint.name in driven
        else msgspec.structs.replace(joint, kind="revolute", lower=-limit, upper=limit)
        for joint in model.joints
    )
    return msgspec.structs.replace(model, joints=joints)


def test_wheel_with_wide_limits_rolls_as_one_without() -> None:
    wide = predict_nominal_motions(with_front_limits(180.0))

    free = predict_nominal_motions(ROBOTS["passive_front_wheels"].model())
    assert [one.twist for one in wide] == [one.twist for one in free]


def test_wheel_between_equal_limits_is_named_as_what_drags() -> None:
    (drags, *_) = reasons(with_front_limits(0.0))

    assert "cannot turn" in drags
    assert "left1" in drags or "right1" in drags


def test_parsed_description_has_the_prediction_in_its_report() -> None:
    parsed = parse_description(
        ROBOTS["skid_square"].urdf, assets={}, allow_missing=False, compat="fixed"
    )

    entries = [entry for entry in parsed.model.report if entry.status == "predicted"]
    assert [entry.subject for entry in entries] == ["driving", "cost"]
    assert parsed.model.drags


@pytest.mark.parametrize(
    ("name", "drags"),
    [
        ("skid_short", True),
        ("passive_front_wheels", True),
        ("ball_under_most_of_the_load_mu_1", True),
        ("ball_mu_0.5", False),
        ("car_20_kg", False),
        ("mover_on_wheels", False),
    ],
)
def test_robot_drags_if_friction_takes_much_of_what_its_wheels_transmit(
    name: str, *, drags: bool
) -> None:
    notes = describe_driving(ROBOTS[name].model())

    assert notes.drags is drags
    assert any(entry.subject == "cost" for entry in notes.entries) is drags


def with_steering_limits(limit: float) -> Model:
    """Limit the steering joints of a car."""
    model = ROBOTS["car_20_kg"].model()
    assert model.drive
    joints = tuple(
        msgspec.structs.replace(joint, kind="revolute", lower=-limit, upper=limit)
        if joint.name in model.drive.steering_joints
        else joint
        for joint in model.joints
    )
    return msgspec.structs.replace(model, joints=joints)


def test_steering_that_ends_before_the_angle_of_a_turn_is_named() -> None:
    (reason,) = reasons(with_steering_limits(0.15))

    assert reason.startswith("it turns at about 0.5")
    assert "'left_steering_joint'" in reason
    assert "0.15 rad" in reason


def test_steering_that_reaches_the_angle_of_a_turn_gets_no_entry() -> None:
    assert reasons(with_steering_limits(0.4)) == []


def test_car_with_an_arm_whose_wheels_are_reversed_gets_an_entry() -> None:
    car = with_steering_limits(0.4)
    joints = tuple(
        msgspec.structs.replace(one, axis=(0.0, -1.0, 0.0)) if "rear" in one.name else one
        for one in car.joints
    )
    arm = JointController("arm", (car.joints[0].name,))

    assert reasons(msgspec.structs.replace(car, joints=joints, joint_controllers=(arm,)))


def a_reversed_cart(left: str, right: str) -> Model:
    text = a_robot(
        a_base(), a_tyre("left", 0.0, 0.2, axis=left), a_tyre("right", 0.0, -0.2, axis=right), BALLS
    )
    model = read_urdf(text)
    pairs = (WheelPair("left", "right", 0.4, 0.2),)
    return msgspec.structs.replace(model, drive=DiffDrive(pairs=pairs, max_torque_nm=50.0))


@pytest.mark.parametrize(
    ("left", "right", "words"),
    [
        ("0 1 0", "0 -1 0", ("turns", "'right' is reversed", "axis 0 1 0")),
        ("0 -1 0", "0 1 0", ("turns", "'left' is reversed", "axis 0 1 0")),
        ("0 -1 0", "0 -1 0", ("backward", "'left', 'right' are reversed", "axis 0 1 0")),
    ],
)
def test_entry_of_reversed_wheels_names_them(left: str, right: str, words: tuple[str, ...]) -> None:
    (reason,) = reasons(a_reversed_cart(left, right))

    assert all(word in reason for word in words)
    assert "friction" not in reason


def test_reversed_wheels_that_the_drive_knows_get_no_entry() -> None:
    model = a_reversed_cart("0 1 0", "0 -1 0")
    pairs = (WheelPair("left", "right", 0.4, 0.2, is_right_reversed=True),)

    assert reasons(msgspec.structs.replace(model, drive=DiffDrive(pairs=pairs))) == []


def test_robot_whose_wheels_are_on_legs_that_nothing_holds_sinks() -> None:
    model = read_driven(a_robot(LEGGED_BODY), order=DriveOrder("diff", tuple(LEGS)))

    (reason,) = reasons(model)

    assert reason.startswith("it sinks: nothing holds 'fl_hip', 'fr_hip', 'rl_hip' and 1 more")


def test_legs_that_a_controller_holds_carry_the_robot() -> None:
    hips = "".join(
        f'<joint name="{name}_hip"><command_interface name="position"/></joint>' for name in LEGS
    )
    control = f'<ros2_control name="c" type="system">{hips}</ros2_control>'
    model = read_driven(a_robot(LEGGED_BODY, control), order=DriveOrder("diff", tuple(LEGS)))

    straight, _ = predict_nominal_motions(model)

    assert straight.twist == pytest.approx(straight.nominal, abs=1e-3)
    assert not any(reason.startswith("it sinks") for reason in reasons(model))
