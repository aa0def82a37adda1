"""Report entries on joints that cannot hold what hangs on them."""

import msgspec
import pytest

from tests.models import a_box_bot
from tests.sim_server.description.chain_models import ArmCase, MastCase
from zensim.proto.messages.model_messages import CommandInterface, Model, Shape
from zensim.sim_server.description.joint_load_notes import COST, UNEVEN, describe_joint_loads
from zensim.sim_server.description.pipeline import parse_description


def read(text: str) -> Model:
    return parse_description(text, assets={}, allow_missing=False, compat="fixed").model


def falling(model: Model) -> list[str]:
    entries = describe_joint_loads(model)
    return [one.subject for one in entries if one.subject.startswith("joint '")]


def test_strong_arm_has_an_entry_on_its_cost_only() -> None:
    assert describe_joint_loads(read(ArmCase(3, 5.0).write_urdf())) == (COST,)


def with_tray(model: Model, friction: float) -> Model:
    *others, last = model.links
    tray = Shape("box", (0.2, 0.2, 0.02), friction=friction)
    return msgspec.structs.replace(
        model, links=(*others, msgspec.structs.replace(last, collisions=(tray,)))
    )


@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_arm_that_can_touch_is_told_to_yield_in_pybullet(friction: float) -> None:
    model = with_tray(read(ArmCase(3, 5.0).write_urdf()), friction)

    bending, cost = describe_joint_loads(model)

    assert bending.reason.startswith("contacts bend 'j0', 'j1', 'j2' in PyBullet")
    assert cost == COST


@pytest.mark.parametrize(("held", "is_bent"), [("j0", True), ("j2", False)])
def test_only_joints_with_shapes_beyond_them_are_told_to_yield(held: str, *, is_bent: bool) -> None:
    model = with_tray(read(ArmCase(3, 5.0).write_urdf()), 1.0)
    place = next(one.child for one in model.joints if one.name == "j0")
    shapes = model.links[-1].collisions
    model = msgspec.structs.replace(
        model,
        links=tuple(
            msgspec.structs.replace(one, collisions=shapes if one.name == place else ())
            for one in model.links
        ),
        joint_controllers=tuple(
            msgspec.structs.replace(one, joints=(held,)) for one in model.joint_controllers
        ),
    )

    reasons = [one.reason for one in describe_joint_loads(model) if one.subject == "joints"]

    assert [one.split(" in ")[0] for one in reasons] == (["contacts bend 'j0'"] if is_bent else [])


def test_frictions_that_pybullet_multiplies_are_told() -> None:
    model = with_tray(read(ArmCase(3, 5.0).write_urdf()), 0.4)

    (entry,) = [one for one in describe_joint_loads(model) if one.subject == "friction"]

    assert (entry.status, entry.reason.split()[0]) == ("predicted", "0.4")


def test_robot_without_controlled_joints_gets_no_entry() -> None:
    assert describe_joint_loads(a_box_bot()) == ()


def test_joints_that_fall_are_named_with_limit_and_load() -> None:
    case = ArmCase(3, 5.0, strength=0.5)
    report = read(case.write_urdf()).report

    (first,) = [one for one in report if one.subject == "joint 'j0'" and one.status == "predicted"]

    assert f"{case.most_effort:.3g} N m" in first.reason
    assert f"{2.0 * case.most_effort:.3g} N m" in first.reason


@pytest.mark.parametrize(("strength", "is_foretold"), [(0.99, True), (1.01, False)])
def test_leader_of_a_mast_bears_its_followers(strength: float, *, is_foretold: bool) -> None:
    model = read(MastCase(3, 20.0, multiplier=0.5, strength=strength).write_urdf())

    assert falling(model) == (["joint 'j0'"] if is_foretold else [])


def test_load_is_that_of_the_initial_position() -> None:
    model = read(ArmCase(1, 5.0, strength=0.9).write_urdf())
    hanging = CommandInterface("j0", "position", initial=1.4)

    assert falling(model) == ["joint 'j0'"]
    assert falling(msgspec.structs.replace(model, command_interfaces=(hanging,))) == []


def test_links_without_weight_do_not_load_a_joint() -> None:
    model = read(ArmCase(2, 5.0, strength=0.5).write_urdf())
    links = tuple(msgspec.structs.replace(one, weightless=one.inertial) for one in model.links)

    assert falling(msgspec.structs.replace(model, links=links)) == []


def test_gravity_on_some_links_only_is_told() -> None:
    model = read(ArmCase(2, 5.0).write_urdf())
    *others, last = model.links
    last = msgspec.structs.replace(last, weightless=last.inertial)

    assert UNEVEN in describe_joint_loads(msgspec.structs.replace(model, links=(*others, last)))
