"""Joints in each engine: mimic, damping, planar and floating chains, fixed roots."""

import math
import re
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pybullet
import pytest

from tests.engines import PHYSICAL, STEP_NS, advance, running
from tests.models import a_box_bot, a_state, an_arm
from tests.sim_server.description.robots import a_collision, a_joint, a_link, a_robot, an_inertial
from tests.sim_server.description.wheel_models import list_robots
from tests.sim_server.physics.bullet_probe import client_of, dynamics_of
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.joint_reduction import MAX_JOINTS
from zensim.sim_server.description.pipeline import parse_description
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.bullet.bullet_bodies import (
    COLLISION_SHAPE_KINDS,
    CollisionShapeCache,
)
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import EngineConfig


def test_equal_shapes_are_created_once() -> None:
    made: list[object] = []

    def make(**solids: object) -> int:
        made.append(solids)
        return len(made)

    exact: list[int] = []
    shapes = CollisionShapeCache(
        make,
        make_exact=exact.append,
        folder="",
        kinds=dict.fromkeys(COLLISION_SHAPE_KINDS, 1),
        concave=8,
    )
    plan = make_blueprint(a_box_bot())
    _, left, right, _ = plan.parts

    first, second = shapes.find(plan, left.shapes), shapes.find(plan, right.shapes)

    assert first == second == len(made) == 1
    assert exact == []
    assert left not in shapes.find_missing(plan)
    assert shapes.find(plan, ()) == -1


def test_robot_with_feet_of_meshes_drives_on_its_wheels(tmp_path: Path) -> None:
    urdf = next(one for one in list_robots() if one.name == "mass_ratio_10").urdf
    feet = re.compile(r"<sphere radius=[^>]*>")
    found = parse_description(
        feet.sub('<ellipsoid radii="0.02 0.021 0.02"/>', urdf),
        assets={},
        allow_missing=False,
        compat="fixed",
    )
    for name, data in found.meshes.items():
        (tmp_path / f"{name}.stl").write_bytes(data)
    engine = PyBulletEngine(EngineConfig(STEP_NS, mesh_folder=str(tmp_path)))
    body = engine.add(found.model, a_state((0.0, 0.0, 0.05)))

    engine.command([body], np.array([4.0, 4.0]))
    advance(engine, 480)

    assert found.meshes
    assert engine.read([body]).base[0, 7] == pytest.approx(0.2, rel=0.01)
    engine.close()


LIMIT = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'


@pytest.fixture(params=PHYSICAL, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def a_finger(number: int, kind: str, mimic: str = "", tip: str = "0.1 0 0") -> str:
    body = an_inertial("0.2", "0.001", f'<origin xyz="{tip}"/>')
    place = f'<origin xyz="0 {0.1 * number} 0"/><axis xyz="0 1 0"/>'
    return a_link(f"f{number}", body) + a_joint(
        f"j{number}", ("palm", f"f{number}"), kind, place + LIMIT + mimic
    )


def a_gripper(mimic: str, kind: str = "continuous") -> Model:
    """A fixed palm; j1 falls, and j2, which is light, mimics it."""
    return read_urdf(
        a_robot(
            a_link("world"),
            a_link("palm", an_inertial()),
            a_joint("nail", ("world", "palm")),
            a_finger(1, "revolute"),
            a_finger(2, kind, mimic, tip="0 0 0"),
        )
    )


@pytest.mark.parametrize(
    ("kind", "multiplier", "offset"),
    [("continuous", 1.0, 0.0), ("continuous", -1.0, 0.2), ("revolute", 0.5, 0.0)],
)
def test_mimic_joint_follows_its_leader(
    engine: Engine, kind: str, multiplier: float, offset: float
) -> None:
    mimic = f'<mimic joint="j1" multiplier="{multiplier}" offset="{offset}"/>'
    body = engine.add(a_gripper(mimic, kind), a_state((0.0, 0.0, 2.0)))

    for _ in range(4):
        advance(engine, 60)
        leader, follower = engine.read([body]).joint_positions.tolist()
        assert follower == pytest.approx(multiplier * leader + offset, abs=0.02)


def test_prismatic_joint_mimics_a_revolute_one(engine: Engine) -> None:
    body = engine.add(
        a_gripper('<mimic joint="j1" multiplier="0.1"/>', "prismatic"), a_state((0.0, 0.0, 2.0))
    )

    advance(engine, 40)

    leader, follower = engine.read([body]).joint_positions.tolist()
    assert leader > 0.1
    assert follower == pytest.approx(0.1 * leader, abs=5e-3)


def test_engine_removes_and_adds_bodies_with_mimic_joints(engine: Engine) -> None:
    model = a_gripper('<mimic joint="j1"/>')
    for _ in range(20):
        engine.remove(engine.add(model, a_state((0.0, 0.0, 2.0))))
    body = engine.add(model, a_state((0.0, 0.0, 2.0)))

    advance(engine, 60)

    leader, follower = engine.read([body]).joint_positions.tolist()
    assert follower == pytest.approx(leader, abs=0.02)


@pytest.mark.parametrize("damping", [0.01, 1.0, 100.0, 1e6])
def test_joint_comes_to_rest_however_strong_its_damping(engine: Engine, damping: float) -> None:
    arm = an_arm("continuous", damping=damping)
    body = engine.add(arm, a_state((0.0, 0.0, 5.0)))

    speeds = []
    for _ in range(240):
        engine.step()
        speeds.append(float(engine.read([body]).joint_velocities[0]))

    torque = 1.0 * 9.81 * 0.2
    assert max(map(abs, speeds)) < min(10.0, 1.05 * torque / damping + 0.2)
    assert np.isfinite(speeds).all()


def test_damped_wheel_without_much_inertia_slows_down(engine: Engine) -> None:
    wheel = a_link("wheel", an_inertial("0.01", "1e-6"))
    spin = '<axis xyz="0 0 1"/><dynamics damping="0.7"/>'
    text = a_robot(
        a_link("base", an_inertial() + a_collision()),
        wheel,
        a_joint("j", ("base", "wheel"), "continuous", spin),
    )
    body = engine.add(read_urdf(text), a_state((0.0, 0.0, 0.1)))

    advance(engine, 240)

    assert abs(float(engine.read([body]).joint_velocities[0])) < 1e-3


def test_body_with_the_most_damped_joints_is_simulated(engine: Engine) -> None:
    spines = "".join(
        a_link(f"s{i}", an_inertial("0.1", "0.001"))
        + a_joint(f"j{i}", ("body", f"s{i}"), "continuous", '<dynamics damping="0.5"/>')
        for i in range(MAX_JOINTS)
    )
    body = engine.add(read_urdf(a_robot(a_link("body", an_inertial()), spines)), a_state())

    advance(engine, 5)

    assert np.isfinite(engine.read([body]).joint_positions).all()


def a_free_pair(kind: str, axis: str = "0 0 1") -> Model:
    place = f'<origin xyz="0 0 1"/><axis xyz="{axis}"/>'
    return read_urdf(
        a_robot(
            a_link("world"),
            a_link("post", an_inertial()),
            a_link("b", an_inertial("1", "0.01")),
            a_joint("nail", ("world", "post")),
            a_joint("j", ("post", "b"), kind, place),
        )
    )


def test_link_falls_freely_when_its_joint_floats(engine: Engine) -> None:
    body = engine.add(a_free_pair("floating"), a_state((0.0, 0.0, 100.0)))

    advance(engine, 240)

    x, y, z, *turns = engine.read([body]).joint_positions.tolist()
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert z == pytest.approx(-9.81 / 2.0, rel=0.01)
    assert turns == pytest.approx([0.0] * 3, abs=1e-6)


@pytest.mark.parametrize(("axis", "falls"), [("0 0 1", False), ("1 0 0", True)])
def test_link_stays_in_its_plane_when_its_joint_is_planar(
    engine: Engine, axis: str, *, falls: bool
) -> None:
    body = engine.add(a_free_pair("planar", axis), a_state((0.0, 0.0, 100.0)))

    advance(engine, 240)

    x, y, turn = engine.read([body]).joint_positions.tolist()
    assert math.hypot(x, y) == pytest.approx(9.81 / 2.0 if falls else 0.0, rel=0.01, abs=1e-6)
    assert turn == pytest.approx(0.0, abs=1e-6)


def test_arm_on_a_fixed_root_has_the_inertia_of_its_model() -> None:
    engine = PyBulletEngine(EngineConfig(STEP_NS))
    body = engine.add(an_arm("continuous"), a_state((0.0, 0.0, 5.0)))

    _, hanging = dynamics_of(engine, body)
    engine.close()

    assert sorted(hanging.inertia) == pytest.approx([0.01] * 3)


def test_fixed_root_stays_in_place(engine: Engine) -> None:
    place = a_state((1.0, 2.0, 3.0), turn=(0.1, 0.2, 0.3))
    body = engine.add(a_gripper(""), place)

    advance(engine, 120)

    assert engine.read([body]).base[0] == pytest.approx(place, abs=1e-9)


def test_body_starts_with_the_twist_that_it_is_given(engine: Engine) -> None:
    model = msgspec.structs.replace(an_arm("fixed"), is_static=False)
    start = a_state((0.0, 0.0, 5.0), linear=(1.0, 0.0, 0.0), angular=(0.0, 0.0, 2.0))

    body = engine.add(model, start)

    assert engine.read([body]).base[0] == pytest.approx(start, abs=1e-9)


def test_removed_body_with_gears_is_not_kept_for_the_next_one() -> None:
    engine = PyBulletEngine(EngineConfig(STEP_NS))
    gripper, arm = a_gripper('<mimic joint="j1"/>'), an_arm("revolute")

    counts = []
    for model in (gripper, arm):
        body = engine.add(model, a_state((0.0, 0.0, 2.0)))
        before = pybullet.getNumBodies(physicsClientId=client_of(engine))
        engine.remove(body)
        counts.append(before - pybullet.getNumBodies(physicsClientId=client_of(engine)))

    engine.close()
    assert counts == [1, 0]
