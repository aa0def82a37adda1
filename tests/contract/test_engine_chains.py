"""Contract of chains of joints under load: held arms, and followers that bear weights."""

import math
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.engines import REAL_ENGINES, STEP_NS, MakeEngine, advance, running
from tests.models import a_body, a_box, a_box_bot, a_state, box_bot_at
from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import (
    Inertial,
    Joint,
    JointController,
    Link,
    Mimic,
    Model,
    Origin,
    Shape,
)
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import Engine, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig

GRAVITY = 9.81
LINK_M, LINK_KG = 0.25, 1.5
STAGE_KG = 2.0
STEPS_S = 240


@pytest.fixture(params=REAL_ENGINES, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def a_long_arm(
    count: int, payload_kg: float = 0.0, *, effort: float = 1000.0, base_kg: float = 0.0
) -> Model:
    """Links one after another along x, on joints about y; the last has a ball at its end.

    Args:
        count: Of links.
        payload_kg: At the end of the last one.
        effort: Limit of each joint.
        base_kg: Of its root; 0 = fixed.
    """
    root = a_body(base_kg, 0.02 * base_kg) if base_kg else a_body()
    links, joints = [Link("base", root)], []
    for i in range(count):
        mass = LINK_KG + payload_kg * (i == count - 1)
        com = (LINK_KG * LINK_M / 2.0 + (mass - LINK_KG) * LINK_M) / mass
        moment = LINK_KG * LINK_M**2 / 12.0
        inertial = Inertial(mass, (com, 0.0, 0.0), (0.001, 0.0, 0.0, moment, 0.0, moment))
        ball = Shape("sphere", (0.03, 0.0, 0.0), Origin((LINK_M, 0.0, 0.0)))
        links.append(Link(f"l{i}", inertial, (ball,) if i == count - 1 else ()))
        joints.append(
            Joint(
                f"j{i}",
                "revolute",
                links[-2].name,
                f"l{i}",
                Origin((LINK_M if i else 0.0, 0.0, 0.0)),
                axis=(0.0, 1.0, 0.0),
                lower=-3.0,
                upper=3.0,
                effort=effort,
                velocity=2.0,
            )
        )
    controller = JointController("c", tuple(joint.name for joint in joints))
    return Model(
        "long_arm",
        tuple(links),
        tuple(joints),
        is_static=not base_kg,
        joint_controllers=(controller,),
    )


def find_loads(count: int, payload_kg: float) -> FloatArray:
    """Find the efforts that hold a level `a_long_arm`."""
    centres = LINK_M * (np.arange(count) + 0.5)
    pivots = LINK_M * np.arange(count)
    arms = np.maximum(centres - pivots[:, None], 0.0)
    tip = count * LINK_M - pivots
    return np.asarray(-GRAVITY * (LINK_KG * arms.sum(axis=1) + payload_kg * tip))


def a_mast(followers: int, payload_kg: float, *, multiplier: float = 1.0) -> Model:
    """Stages that slide up on each other; each but the first mimics the first."""
    links, joints = [Link("base", a_body())], []
    for stage in range(followers + 1):
        mass = STAGE_KG + payload_kg * (stage == followers)
        links.append(Link(f"s{stage}", a_body(mass, 0.05)))
        joints.append(
            Joint(
                f"j{stage}",
                "prismatic",
                links[-2].name,
                f"s{stage}",
                Origin((0.0, 0.0, 0.2)),
                axis=(0.0, 0.0, 1.0),
                lower=-1.0,
                upper=1.0,
                effort=20_000.0,
                velocity=0.5,
                mimic=Mimic("j0", multiplier) if stage else None,
            )
        )
    controller = JointController("c", ("j0",))
    return Model(
        "mast", tuple(links), tuple(joints), is_static=True, joint_controllers=(controller,)
    )


def hold(engine: Engine, body: int, positions: list[float]) -> None:
    kind = float(JointTargetKind.POSITION)
    engine.command((body,), np.array([number for one in positions for number in (kind, one)]))


@pytest.mark.parametrize(("count", "payload_kg"), [(1, 10.0), (3, 5.0), (6, 5.0), (7, 10.0)])
def test_arm_holds_its_load(engine: Engine, count: int, payload_kg: float) -> None:
    arm = engine.add(a_long_arm(count, payload_kg), a_state((0.0, 0.0, 2.0)))
    hold(engine, arm, [0.0] * count)

    advance(engine, 2 * STEPS_S)

    loads = find_loads(count, payload_kg)
    assert engine.read((arm,)).joint_positions == pytest.approx(np.zeros(count), abs=2e-3)
    assert engine.read_joint_efforts((arm,)) == pytest.approx(loads, abs=0.01 * abs(loads[0]))


def test_arm_that_is_too_weak_falls_and_exerts_its_limit(engine: Engine) -> None:
    limit = 0.5 * abs(float(find_loads(3, 5.0)[0]))
    arm = engine.add(a_long_arm(3, 5.0, effort=limit), a_state((0.0, 0.0, 2.0)))
    hold(engine, arm, [0.0] * 3)

    most = 0.0
    for _ in range(STEPS_S // 2):
        engine.step()
        most = max(most, float(np.abs(engine.read_joint_efforts((arm,))).max()))

    assert engine.read((arm,)).joint_positions[0] > 0.3
    assert 0.99 * limit < most <= limit * (1.0 + 1e-9)


def test_arm_that_presses_the_ground_exerts_no_more_than_its_limit(engine: Engine) -> None:
    arm = engine.add(a_long_arm(3, effort=40.0), a_state((0.0, 0.0, 0.4)))
    hold(engine, arm, [0.9, 0.6, 0.3])

    most = 0.0
    for _ in range(2 * STEPS_S):
        engine.step()
        most = max(most, float(np.abs(engine.read_joint_efforts((arm,))).max()))

    assert most <= 40.0 * (1.0 + 1e-9)
    assert engine.read((arm,)).joint_velocities == pytest.approx(np.zeros(3), abs=0.01)


@pytest.mark.parametrize("base_kg", [0.3, 2.0, 20.0])
def test_arm_on_a_falling_base_follows_its_targets(engine: Engine, base_kg: float) -> None:
    arm = engine.add(a_long_arm(3, base_kg=base_kg), a_state((0.0, 0.0, 50.0)))
    hold(engine, arm, [0.5, -0.6, 0.4])

    advance(engine, 2 * STEPS_S)

    assert engine.read((arm,)).joint_positions == pytest.approx([0.5, -0.6, 0.4], abs=5e-3)


def with_last_joint_between(arm: Model, lower: float, upper: float) -> Model:
    last = msgspec.structs.replace(arm.joints[-1], lower=lower, upper=upper)
    return msgspec.structs.replace(arm, joints=(*arm.joints[:-1], last))


@pytest.mark.parametrize("base_kg", [0.0, 20.0], ids=["fixed", "falling"])
@pytest.mark.parametrize(
    ("kind", "number"),
    [(JointTargetKind.VELOCITY, 1.0), (JointTargetKind.POSITION, 1.0)],
    ids=["velocity", "position"],
)
@pytest.mark.parametrize("effort", [40.0, 200.0])
def test_motor_pushes_a_stop_with_its_limit_and_stays_at_it(
    engine: Engine, effort: float, base_kg: float, kind: JointTargetKind, number: float
) -> None:
    arm = with_last_joint_between(a_long_arm(3, effort=effort, base_kg=base_kg), -1.0, 0.2)
    body = engine.add(arm, a_state((0.0, 0.0, 50.0)))
    held = [float(JointTargetKind.POSITION), 0.0] * 2
    engine.command((body,), np.array([*held, float(kind), number]))
    advance(engine, STEPS_S)

    efforts, positions = [], []
    for _ in range(STEPS_S // 2):
        engine.step()
        efforts.append(engine.read_joint_efforts((body,))[-1])
        positions.append(engine.read((body,)).joint_positions[-1])

    assert efforts == pytest.approx([effort] * len(efforts), rel=0.01)
    assert positions == pytest.approx([0.2] * len(positions), abs=2e-3)
    assert max(positions) - min(positions) < 3e-4


def test_effort_that_is_commanded_at_a_stop_is_reported(engine: Engine) -> None:
    body = engine.add(
        with_last_joint_between(a_long_arm(1, effort=40.0), -1.0, 0.2), a_state((0.0, 0.0, 2.0))
    )
    engine.command((body,), np.array([float(JointTargetKind.VELOCITY), 1.0]))
    advance(engine, STEPS_S)
    engine.command((body,), np.array([float(JointTargetKind.EFFORT), 6.0]))

    advance(engine, STEPS_S // 10)

    assert engine.read_joint_efforts((body,)) == pytest.approx([6.0], rel=0.01)


@pytest.mark.parametrize("effort", [0.0, 1e5], ids=["unlimited", "strong"])
@pytest.mark.parametrize("kind", [JointTargetKind.VELOCITY, JointTargetKind.POSITION])
def test_no_motor_moves_a_joint_through_its_stop(
    engine: Engine, effort: float, kind: JointTargetKind
) -> None:
    arm = with_last_joint_between(a_long_arm(3, effort=effort, base_kg=20.0), -1.0, 0.2)
    body = engine.add(arm, a_state((0.0, 0.0, 50.0)))
    held = [float(JointTargetKind.POSITION), 0.0] * 2
    engine.command((body,), np.array([*held, float(kind), 1.0]))

    advance(engine, 2 * STEPS_S)

    assert engine.read((body,)).joint_positions[-1] == pytest.approx(0.2, abs=2e-3)


def test_limits_in_the_wrong_order_stop_nothing(engine: Engine) -> None:
    arm = with_last_joint_between(a_long_arm(3, effort=40.0, base_kg=20.0), 0.2, -0.2)
    body = engine.add(arm, a_state((0.0, 0.0, 50.0)))
    hold(engine, body, [0.0, 0.0, 1.0])

    advance(engine, STEPS_S)

    assert engine.read((body,)).joint_positions[-1] == pytest.approx(1.0, abs=0.01)


def test_locked_joint_is_pushed_with_the_limit_of_its_motor(engine: Engine) -> None:
    body = engine.add(
        with_last_joint_between(a_long_arm(3, effort=200.0, base_kg=20.0), 0.0, 0.0),
        a_state((0.0, 0.0, 50.0)),
    )
    hold(engine, body, [0.0, 0.0, -1.0])

    advance(engine, STEPS_S)

    assert engine.read_joint_efforts((body,))[-1] == pytest.approx(-200.0, rel=0.01)
    assert engine.read((body,)).joint_positions[-1] == pytest.approx(0.0, abs=5e-3)


@pytest.mark.parametrize("payload_kg", [0.1, 5.0, 20.0, 60.0])
@pytest.mark.parametrize(("followers", "multiplier"), [(1, 1.0), (4, 1.0), (2, -0.5)])
def test_follower_bears_a_load_and_its_leader_all_of_it(
    engine: Engine, payload_kg: float, followers: int, multiplier: float
) -> None:
    """Virtual work: the first motor bears each weight times its rise, g (m1 + 2 m2) for two."""
    mast = engine.add(a_mast(followers, payload_kg, multiplier=multiplier), a_state())
    hold(engine, mast, [0.2])

    advance(engine, 3 * STEPS_S)

    first, *rest = engine.read((mast,)).joint_positions.tolist()
    rises = 1.0 + multiplier * np.arange(followers + 1)
    load = GRAVITY * (STAGE_KG * rises.sum() + payload_kg * rises[-1])
    assert first == pytest.approx(0.2, abs=2e-3)
    assert rest == pytest.approx([multiplier * first] * followers, abs=2e-3)
    assert engine.read_joint_efforts((mast,))[0] == pytest.approx(load, rel=0.01, abs=0.01)


def test_follower_of_a_free_leader_moves_with_it(engine: Engine) -> None:
    mast = engine.add(a_mast(1, 20.0), a_state((0.0, 0.0, 5.0)))

    advance(engine, STEPS_S // 4)

    first, second = engine.read((mast,)).joint_positions
    assert first < -0.05
    assert second == pytest.approx(first, abs=2e-3)


def a_robot_with_fingers() -> Model:
    """A box_bot on wheels of 20 g whose axles are along z, and two fingers that slide apart."""
    robot, mast = a_box_bot(), a_mast(1, 0.0)
    base, light = robot.links[0], Inertial(0.02, inertia=(1e-5, 0.0, 0.0, 1e-5, 0.0, 1e-5))
    replace = msgspec.structs.replace
    wheels = {joint.child for joint in robot.joints}
    links = [
        replace(
            link,
            inertial=light,
            collisions=tuple(replace(shape, origin=Origin()) for shape in link.collisions),
        )
        if link.name in wheels
        else link
        for link in robot.links
    ]
    axles = [
        replace(
            joint,
            origin=Origin(joint.origin.position, (-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))),
            axis=(0.0, 0.0, 1.0),
        )
        for joint in robot.joints
    ]
    first, second = mast.joints
    side = {"axis": (0.0, 1.0, 0.0), "origin": Origin((0.0, 0.0, 0.2)), "parent": base.name}
    fingers = (replace(first, **side), replace(second, mimic=Mimic("j0", -1.0), **side))
    tips = [Link(joint.child, light) for joint in fingers]
    return replace(robot, links=(*links, *tips), joints=(*axles, *fingers))


def test_followers_move_on_a_robot_whose_wheels_are_heavier_about_their_axles(
    engine: Engine,
) -> None:
    robot = engine.add(a_robot_with_fingers(), box_bot_at())

    advance(engine, STEPS_S // 2)

    *_, first, second = engine.read((robot,)).joint_positions
    assert np.isfinite(engine.read((robot,)).base).all()
    assert second == pytest.approx(-first, abs=2e-3)


@pytest.mark.parametrize("make", [PyBulletEngine, *REAL_ENGINES[1:2]], ids=lambda make: make.name)
def test_chains_repeat_their_bits(make: MakeEngine) -> None:
    def run() -> bytes:
        with running(make, EngineConfig(STEP_NS)) as engine:
            arm = engine.add(a_long_arm(4, 3.0), a_state((0.0, 0.0, 0.7)))
            mast = engine.add(a_mast(2, 5.0), a_state((0.0, 5.0, 0.0)))
            box = engine.add(a_box(), a_state((0.8, 0.0, 0.1)))
            hold(engine, arm, [0.6, 0.4, -0.3, 0.2])
            hold(engine, mast, [0.3])
            advance(engine, STEPS_S)
            states = engine.read((arm, mast, box))
            return states.base.tobytes() + states.joint_positions.tobytes()

    assert run() == run()


def a_hinged_bar(height_m: float) -> Model:
    """Make a bar of 0.5 m with flat sides, on a free hinge about y above the ground."""
    bar = Shape("box", (0.4, 0.05, 0.05), Origin((0.3, 0.0, 0.0)))
    inertial = Inertial(2.0, (0.25, 0.0, 0.0), (0.002, 0.0, 0.0, 0.042, 0.0, 0.042))
    hinge = Joint(
        *("hinge", "continuous", "base", "bar"), Origin((0.0, 0.0, height_m)), axis=(0.0, 1.0, 0.0)
    )
    links = (Link("base", a_body()), Link("bar", inertial, (bar,)))
    return Model("hinged", links, (hinge,), is_static=True)


@pytest.mark.parametrize("height_m", [0.15, 0.23, 0.25, 0.28])
def test_hinged_bar_rests_with_its_edge_on_the_ground(engine: Engine, height_m: float) -> None:
    bar = engine.add(a_hinged_bar(height_m), a_state((0.0, 0.0, 0.0)))

    advance(engine, 4 * STEPS_S)

    found = engine.read((bar,))
    angle = float(found.joint_positions[0])
    tip_m = height_m - 0.5 * math.sin(angle) - 0.025 * math.cos(angle)
    assert tip_m == pytest.approx(0.0, abs=4e-4)
    assert found.joint_velocities[0] == pytest.approx(0.0, abs=1e-2)
