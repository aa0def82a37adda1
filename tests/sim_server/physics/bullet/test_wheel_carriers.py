"""Carriers of sliding wheels: which robots get them, and how these turn."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.engines import STEP_NS, advance
from tests.models import a_box_bot, a_cart, a_state
from tests.sim_server.description.wheel_models import list_robots
from zensim.proto.messages.model_messages import Contact, Inertial, Joint, Link, Model, Origin
from zensim.proto.rigid_transforms import rotate
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.model_geometry import find_ground_clearance
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.blueprint import Blueprint, make_blueprint, order_depth_first
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.bullet.wheel_carriers import add_wheel_carriers, list_carriers
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.joint_inertia import find_part_poses, make_mass_matrix

SMALL = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
WHEEL_SPEEDS = np.array([-2.0, 2.0, -2.0, 2.0])


@pytest.fixture
def engine() -> Iterator[PyBulletEngine]:
    made = PyBulletEngine(EngineConfig(STEP_NS))
    yield made
    made.close()


def a_skid_bot() -> Model:
    return read_urdf(read_builtin_model("skid_bot"))


def turn_of(engine: PyBulletEngine, heading: float) -> float:
    model = a_skid_bot()
    place = (0.0, 0.0, -find_ground_clearance(model))
    body = engine.add(model, a_state(place, turn=(0.0, 0.0, heading)))
    engine.command([body], WHEEL_SPEEDS)
    advance(engine, 60)
    turn = float(engine.read([body]).base[0, 12])
    engine.remove(body)
    return turn


def list_axes(blueprint: Blueprint) -> list[bool]:
    """List whether each carrier turns about the vertical."""
    poses = find_part_poses(blueprint.parts)
    joints = [(i + 1, blueprint.parts[i + 1].joint) for i in list_carriers(blueprint)]
    return [abs(rotate(poses[i].orientation, joint.axis)[2]) > 0.99 for i, joint in joints if joint]


def carried(name: str) -> Blueprint:
    robot = next(one for one in list_robots() if one.name == name)
    return add_wheel_carriers(order_depth_first(make_blueprint(robot.model())))


def test_each_wheel_of_a_skid_steered_robot_has_a_carrier() -> None:
    model = a_skid_bot()
    found = add_wheel_carriers(order_depth_first(make_blueprint(model)))

    assert len(list_carriers(found)) == 4
    assert sum(part.mass_kg for part in found.parts) == pytest.approx(model.mass_kg, rel=1e-2)
    names = [found.parts[part].joint for part in found.link_parts[1:]]
    assert [joint.name for joint in names if joint] == [joint.name for joint in model.joints]


@pytest.mark.parametrize("model", [a_cart(), a_box_bot()], ids=lambda model: model.name)
def test_robot_with_two_driven_wheels_has_none(model: Model) -> None:
    blueprint = order_depth_first(make_blueprint(model))

    assert add_wheel_carriers(blueprint) is blueprint


@pytest.mark.parametrize(
    ("name", "count"), [("passive_front_wheels", 2), ("ball_mu_0.5", 0), ("car_20_kg", 0)]
)
def test_robot_with_two_driven_wheels_has_carriers_if_it_drags(name: str, count: int) -> None:
    assert len(list_carriers(carried(name))) == count


def test_robot_whose_links_collide_with_each_other_has_none() -> None:
    model = a_skid_bot()
    base = msgspec.structs.replace(model.links[0], self_collides=True)
    blueprint = order_depth_first(
        make_blueprint(msgspec.structs.replace(model, links=(base, *model.links[1:])))
    )

    assert add_wheel_carriers(blueprint) is blueprint


def test_axes_are_upright_but_those_of_wheels_abeam_of_the_centre_of_mass() -> None:
    found = carried("skid_six_wheels")

    assert list_axes(found).count(True) == 4
    assert list_axes(found).count(False) == 2


def test_axes_of_wheels_that_have_to_yield_much_sideways_are_level() -> None:
    assert not any(list_axes(carried("skid_fdir1_ahead")))


@pytest.mark.parametrize("name", ["skid_square", "skid_eight_wheels", "skid_heavy_wheels"])
def test_wheels_on_carriers_yield_alike_in_all_directions(name: str) -> None:
    found = carried(name)
    mass = make_mass_matrix(found.parts)
    inverse = mass.invert(is_static=False)
    places = find_part_poses(found.parts)
    for i, wheel in enumerate(found.parts):
        if wheel.reflected_inertia == 0.0:
            continue
        point = np.array(places[i].position) - [0.0, 0.0, wheel.shapes[0].size[0]]
        efforts = np.zeros((2, len(inverse)))
        for effort, way in zip(efforts, np.eye(3)[:2], strict=True):
            wrench = np.concatenate([np.cross(point, way), way])
            effort[:6] = wrench
            for part in (i, wheel.parent):
                effort[mass.rows[part]] = mass.axes[part] @ wrench
        yielding = efforts @ inverse @ efforts.T

        assert yielding == pytest.approx(yielding[0, 0] * np.eye(2), abs=0.01 * yielding[0, 0])


def test_wheel_is_carried_by_the_sphere_of_any_of_its_surfaces() -> None:
    found = a_skid_bot()
    links = [
        msgspec.structs.replace(
            link,
            collisions=(
                *link.collisions,
                msgspec.structs.replace(link.collisions[0], size=(0.01, 0.0, 0.0), friction=0.5),
            )[:: -1 if number % 2 else 1],
        )
        for number, link in enumerate(found.links[1:])
    ]
    model = msgspec.structs.replace(found, links=(found.links[0], *links))

    carriers = list_carriers(add_wheel_carriers(order_depth_first(make_blueprint(model))))

    assert len(carriers) == 4


def with_wheel_moments(model: Model, share: float) -> Model:
    """Give wheels a moment across their axles: a share of mass times radius squared."""
    links = [
        msgspec.structs.replace(
            link,
            inertial=msgspec.structs.replace(
                link.inertial, inertia=(across, 0.0, 0.0, link.inertial.inertia[3], 0.0, across)
            ),
        )
        for link in model.links[1:]
        for across in (share * link.inertial.mass_kg * link.collisions[0].size[0] ** 2,)
    ]
    return msgspec.structs.replace(model, links=(model.links[0], *links))


@pytest.mark.filterwarnings("error")
def test_robot_whose_wheel_is_far_away_has_none() -> None:
    found = a_skid_bot()
    joints = [
        msgspec.structs.replace(
            joint, origin=msgspec.structs.replace(joint.origin, position=(1e9, 0.1 * number, 0.0))
        )
        for number, joint in enumerate(found.joints)
    ]
    model = msgspec.structs.replace(with_wheel_moments(found, 0.0), joints=tuple(joints))
    blueprint = order_depth_first(make_blueprint(model))

    assert add_wheel_carriers(blueprint) is blueprint


def test_great_moments_of_wheels_across_the_axle_move_to_the_body() -> None:
    before = order_depth_first(make_blueprint(with_wheel_moments(a_skid_bot(), 50.0)))

    after = add_wheel_carriers(before)

    assert len(list_carriers(after)) == 4
    root = make_mass_matrix(before.parts).matrix[:3, :3]
    held = make_mass_matrix(after.parts).matrix[:3, :3]
    carried = sum(after.parts[i + 1].inertia[0] for i in list_carriers(after))
    assert held == pytest.approx(root, abs=1.01 * carried)
    wheels = [part for part in after.parts if part.reflected_inertia > 0.0]
    assert all(max(part.inertia) < 0.2 * max(before.parts[1].inertia) for part in wheels)


def test_wheels_on_arms_are_carried_and_steered_ones_are_not() -> None:
    found = a_skid_bot()
    assert found.drive is not None
    joints = {joint.name: joint for joint in found.joints}
    wheel = joints[found.drive.wheel_joints[0]]
    for axis, count in (((0.0, 0.0, -1.0), 0), ((1.0, 0.0, 0.0), 4)):
        arm = Joint("arm_joint", "revolute", wheel.parent, "arm", wheel.origin, axis=axis)
        moved = msgspec.structs.replace(wheel, parent="arm", origin=Origin())
        others = [joint for joint in found.joints if joint is not wheel]
        at = [link.name for link in found.links].index(wheel.child)
        links = [link for link in found.links if link.name != wheel.child]
        model = msgspec.structs.replace(
            found,
            links=(*links, Link("arm", Inertial(mass_kg=0.1, inertia=SMALL)), found.links[at]),
            joints=(*others, arm, moved),
        )

        carriers = list_carriers(add_wheel_carriers(order_depth_first(make_blueprint(model))))

        assert len(carriers) == count


def test_skid_steered_robot_turns_alike_at_any_heading(engine: PyBulletEngine) -> None:
    turns = [turn_of(engine, heading) for heading in (0.0, 0.4, 0.8, 1.2)]

    assert turns == pytest.approx([turns[0]] * 4, rel=0.01)
    assert abs(turns[0]) > 0.1


@pytest.mark.parametrize("aside", [0.0, 1e-4, 1.0])
def test_wheels_push_whatever_their_friction_aside(engine: PyBulletEngine, aside: float) -> None:
    found = a_skid_bot()
    model = msgspec.structs.replace(
        found, links=tuple(_slide_aside(one, aside) for one in found.links)
    )
    start = a_state((0.0, 0.0, -find_ground_clearance(model)))
    body = engine.add(model, start)
    engine.command([body], np.full(4, 2.0))
    advance(engine, 480)

    radius = abs(find_ground_clearance(model))
    moved = float(engine.read([body]).base[0, 0])

    assert moved == pytest.approx(2.0 * radius * 480 * STEP_NS * 1e-9, rel=0.03)


def _slide_aside(link: Link, friction: float) -> Link:
    """Give all collisions of a link another friction across the direction ahead."""
    contact = Contact(direction=(1.0, 0.0, 0.0), friction_across=friction)
    shapes = tuple(
        msgspec.structs.replace(shape, friction=1.0, contact=contact) for shape in link.collisions
    )
    return msgspec.structs.replace(link, collisions=shapes)


def test_carriers_stay_in_place_and_are_reset(engine: PyBulletEngine) -> None:
    model = a_skid_bot()
    start = a_state((0.0, 0.0, -find_ground_clearance(model)))
    body = engine.add(model, start)
    paths = []
    for _ in range(2):
        engine.set_at_rest(body, start)
        engine.command([body], WHEEL_SPEEDS)
        advance(engine, 240)
        paths.append(engine.read([body]).base[0])

    assert len(engine.read([body]).joint_positions) == len(model.joints)
    assert paths[0][:2] == pytest.approx(paths[1][:2], abs=2e-3)
    assert paths[0][12] == pytest.approx(paths[1][12], rel=0.02)
