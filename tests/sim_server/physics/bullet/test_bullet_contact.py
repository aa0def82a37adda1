"""Contact parameters, self-collision and rolling resistance."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from tests.engines import STEP_NS, advance
from tests.models import a_body, a_box, a_box_bot, a_cart, a_puck, box_bot_at
from tests.sim_server.description.plugins.driven_robots import read_driven
from tests.sim_server.physics.bullet_probe import dynamics_of
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.model_messages import Contact, Joint, Link, Model, Shape
from zensim.sim_server.physics.blueprint import RigidPart, make_blueprint
from zensim.sim_server.physics.bullet.bullet_contact import (
    CONTACT_PROCESSING_M,
    FIRMNESS_SHARE,
    RIGID_ERP,
    ROLLING_RESISTANCE,
    find_firmness,
    find_rolling_frictions,
    has_self_collision,
    limit_static_body_friction,
    list_self_collision_pairs,
    make_contact_arguments,
)
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine_config import EngineConfig

DT_S = 0.004
RIGID = Contact()
BALL = Shape("sphere", (0.1, 0.0, 0.0))


def a_part(contact: Contact = RIGID, friction: float = 0.5) -> RigidPart:
    return RigidPart(
        mass_kg=1.0,
        com=(0.0, 0.0, 0.0),
        principal=(0.0, 0.0, 0.0, 1.0),
        inertia=(1.0, 1.0, 1.0),
        shapes=(BALL,),
        friction=friction,
        contact=contact,
        parent=-1,
        link=0,
    )


def test_rigid_part_has_its_friction_and_nothing_else() -> None:
    arguments = make_contact_arguments(a_part(), DT_S, is_static=False, moves=True)

    assert arguments == {
        "lateralFriction": 0.5,
        "spinningFriction": 0.0,
        "rollingFriction": 0.0,
        "restitution": 0.0,
        "contactProcessingThreshold": CONTACT_PROCESSING_M,
    }


@pytest.mark.parametrize(("damping", "used"), [(1.0, 16.0), (100.0, 100.0)])
def test_compliant_part_has_the_least_damping(damping: float, used: float) -> None:
    arguments = make_contact_arguments(
        a_part(Contact(1000.0, damping)), DT_S, is_static=False, moves=True
    )

    assert arguments["contactStiffness"] == 1000.0
    assert arguments["contactDamping"] == pytest.approx(used)


def test_rigid_part_of_a_robot_yields_by_its_firmness() -> None:
    arguments = make_contact_arguments(a_part(), DT_S, is_static=False, moves=True, firmness=100.0)

    kp, kd = arguments["contactStiffness"], arguments["contactDamping"]
    assert kp * DT_S + kd == pytest.approx(100.0)
    assert kp * DT_S == pytest.approx(RIGID_ERP * 100.0)


@pytest.mark.parametrize(("firmness", "scale"), [(1e9, 1.0), (100.0, 0.1), (1000.0, 1.0)])
def test_compliant_part_yields_at_least_by_the_firmness(firmness: float, scale: float) -> None:
    soft = Contact(500.0 / DT_S / 5.0, 900.0)

    arguments = make_contact_arguments(
        a_part(soft), DT_S, is_static=False, moves=True, firmness=firmness
    )

    assert arguments["contactStiffness"] == pytest.approx(scale * soft.stiffness)
    assert arguments["contactDamping"] == pytest.approx(scale * 900.0)


def test_robot_with_driven_wheels_has_a_firmness() -> None:
    assert find_firmness(make_blueprint(a_cart()), DT_S) == pytest.approx(
        2.4 / (FIRMNESS_SHARE * DT_S)
    )
    assert find_firmness(make_blueprint(a_box()), DT_S) == math.inf
    assert find_firmness(make_blueprint(a_puck()), DT_S) == math.inf


@pytest.mark.parametrize(
    ("along", "across", "most", "shares"),
    [(0.5, 0.25, 0.5, (1.0, 0.5, 0.5)), (0.2, 0.8, 0.8, (0.25, 1.0, 1.0)), (0, 0, 0, (1, 1, 1))],
)
def test_frictions_of_two_directions_are_shares_of_the_greater(
    along: float, across: float, most: float, shares: tuple[float, float, float]
) -> None:
    contact = Contact(direction=(1.0, 0.0, 0.0), friction_across=across)

    arguments = make_contact_arguments(a_part(contact, along), DT_S, is_static=False, moves=True)

    assert arguments["lateralFriction"] == most
    assert arguments["anisotropicFriction"] == pytest.approx(shares)


@pytest.mark.parametrize(("written", "used"), [(0.3, 0.3), (1.0, 1.0), (100.0, 1.0)])
def test_friction_of_static_bodies_is_limited(written: float, used: float) -> None:
    assert limit_static_body_friction(written) == used
    assert (
        make_contact_arguments(a_part(friction=written), DT_S, is_static=True, moves=False)[
            "lateralFriction"
        ]
        == used
    )
    assert (
        make_contact_arguments(a_part(friction=written), DT_S, is_static=False, moves=True)[
            "lateralFriction"
        ]
        == written
    )


def a_row(count: int, *asking: int) -> Model:
    """A chain of links; each but the first has a second, slippery surface."""
    slick = Shape("sphere", (0.1, 0.0, 0.0), friction=0.0)
    links = tuple(
        Link(f"l{i}", a_body(), (BALL, slick) if i else (BALL,), self_collides=i in asking)
        for i in range(count)
    )
    joints = tuple(Joint(f"j{i}", "continuous", f"l{i - 1}", f"l{i}") for i in range(1, count))
    return Model("row", links, joints)


def touching_of(model: Model) -> set[tuple[int, int]]:
    return {
        (i, j) for i, j, do_touch in list_self_collision_pairs(make_blueprint(model)) if do_touch
    }


def test_parts_collide_if_either_link_enables_it_and_no_joint_joins_them() -> None:
    # Parts -1 to 2 are the links, 3 to 5 the second surfaces of the last three.
    assert touching_of(a_row(4, 0)) == {(-1, 1), (-1, 2), (-1, 4), (-1, 5)}
    assert touching_of(a_row(4)) == set()


def test_self_collision_needs_a_link_that_enables_it() -> None:
    assert has_self_collision(a_row(2, 1).links)
    assert not has_self_collision(a_row(2).links)


@pytest.fixture
def engine() -> Iterator[PyBulletEngine]:
    found = PyBulletEngine(EngineConfig(STEP_NS))
    yield found
    found.close()


def test_rolling_resistance_scales_with_the_radius() -> None:
    model = a_box_bot()

    frictions = dict(find_rolling_frictions(model, make_blueprint(model)))

    assert frictions == {
        0: pytest.approx(ROLLING_RESISTANCE * 0.035),
        1: pytest.approx(ROLLING_RESISTANCE * 0.035),
    }


def test_wheels_without_motors_have_no_rolling_resistance() -> None:
    assert find_rolling_frictions(a_box(), make_blueprint(a_box())) == ()


def test_rolling_resistance_is_on_while_targets_are_zero(engine: PyBulletEngine) -> None:
    body = engine.add(a_box_bot(), box_bot_at())
    born = [part.rolling_friction for part in dynamics_of(engine, body)]

    engine.command([body], np.array([5.0, 5.0]))
    driven = [part.rolling_friction for part in dynamics_of(engine, body)]
    engine.command([body], np.zeros(2))
    stopped = [part.rolling_friction for part in dynamics_of(engine, body)]

    assert born == stopped == [0.0, *[pytest.approx(ROLLING_RESISTANCE * 0.035)] * 2, 0.0]
    assert driven == [0.0] * 4


def test_box_bot_that_has_stopped_does_not_rock(engine: PyBulletEngine) -> None:
    body = engine.add(a_box_bot(), box_bot_at())
    engine.command([body], np.array([10.0, 10.0]))
    advance(engine, 240)

    engine.command([body], np.zeros(2))
    advance(engine, 240)
    turns = []
    for _ in range(120):
        engine.step()
        turns.append(np.abs(engine.read([body]).base[0, 10:13]).max())

    assert max(turns) < 2e-3


def a_heavy_wheel(name: str, x: float, y: float) -> str:
    return (
        f'<link name="{name}_tyre"><inertial><mass value="2.6"/><inertia ixx="0.09" iyy="0.09" '
        'izz="0.09" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry>'
        f'<sphere radius="0.32"/></geometry></collision></link><joint name="{name}" '
        f'type="continuous"><parent link="base"/><child link="{name}_tyre"/>'
        f'<origin xyz="{x} {y} 0.32"/><axis xyz="0 1 0"/></joint>'
    )


CART_OF_46_KG = (
    '<robot name="cart"><link name="base"><inertial><origin xyz="-0.51 0.02 0.11"/>'
    '<mass value="36"/><inertia ixx="4.7" iyy="9.7" izz="10.5" ixy="0" ixz="0" iyz="0"/>'
    "</inertial></link>"
    + "".join(
        a_heavy_wheel(name, *place)
        for name, place in {
            "front_left": (1.03, 0.6),
            "front_right": (1.03, -0.6),
            "rear_left": (-0.85, 0.6),
            "rear_right": (-0.85, -0.6),
        }.items()
    )
    + "</robot>"
)


def test_four_wheels_that_slide_share_the_load_as_equal_springs_do() -> None:
    order = DriveOrder("diff", ("front_left", "front_right", "rear_left", "rear_right"))
    model = read_driven(CART_OF_46_KG, order=order)
    engine = PyBulletEngine(EngineConfig(STEP_NS))
    body = engine.add(model, np.array([0.0] * 6 + [1.0] + [0.0] * 6))

    for _ in range(240):
        engine.step()

    found = engine.read_contacts([body])
    loads = dict(zip(found.bodies[:, 1].tolist(), found.points[:, 9].tolist(), strict=True))
    engine.close()
    weight, length, width = 9.81 * 46.4, 1.88, 1.2
    ahead = (36.0 * (0.85 - 0.51) + 5.2 * length) / 46.4 / length
    left = 36.0 * 0.02 / 46.4 / width
    expected = [
        weight * (share + side * left) / 2.0 for share in (ahead, 1.0 - ahead) for side in (1, -1)
    ]
    assert model.drags
    assert [loads[link] for link in (1, 2, 3, 4)] == pytest.approx(expected, abs=0.01 * weight)
