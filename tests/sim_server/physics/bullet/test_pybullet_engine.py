"""PyBulletEngine beyond the contract: masses, frictions, limits, pool, sleep."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import msgspec
import numpy as np
import pybullet
import pytest

from tests.engines import STEP_NS, advance, running
from tests.models import (
    a_body,
    a_box,
    a_box_bot,
    a_cart,
    a_lopsided_box,
    a_state,
    an_arm,
    angle_between,
    box_bot_at,
    on_ground,
)
from tests.sim_server.physics.bullet_probe import (
    bodies_in,
    client_of,
    dynamics_of,
    next_shape,
    touching,
)
from zensim.api.world_snapshots import SnapshotPlace, read_snapshot, write_snapshot
from zensim.proto.messages.drive_messages import RosBlock
from zensim.proto.messages.model_messages import (
    Inertial,
    Joint,
    JointKind,
    Link,
    Mimic,
    Model,
    Shape,
)
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.bullet.pybullet_engine import MAX_PARTS, PyBulletEngine
from zensim.sim_server.physics.engine import EngineRefused
from zensim.sim_server.physics.engine_config import EngineConfig


def a_static_scene(friction: float = 0.5) -> Model:
    """A floor with a plinth of another surface, which is a part of its own."""
    floor = Shape("box", (4.0, 4.0, 0.2))
    plinth = Shape("box", (1.0, 1.0, 1.0), friction=friction)
    return Model("scene", (Link("base", collisions=(floor, plinth)),), is_static=True)


def test_contacts_between_models_that_do_not_move_are_not_searched() -> None:
    post, hand = an_arm("revolute").links
    hand = msgspec.structs.replace(hand, collisions=(Shape("box", (0.3, 0.3, 0.3)),))
    arm = msgspec.structs.replace(an_arm("revolute"), links=(post, hand))
    with running(PyBulletEngine) as engine:
        assert isinstance(engine, PyBulletEngine)
        one = engine.add(a_static_scene(), a_state((0.0, 0.0, 0.0)))
        other = engine.add(a_static_scene(), a_state((0.3, 0.0, 0.1)))
        engine.sleep([one, other])
        advance(engine, 2)
        assert touching(engine, one, other) == 0
        assert other in engine.find_overlaps(one)

        engine.hide(other)
        engine.show([other])
        advance(engine, 2)
        assert touching(engine, one, other) == 0

        box = engine.add(a_box("box", 1.0), a_state((0.3, 0.0, 0.9)))
        swinging = engine.add(arm, a_state((0.0, 0.0, -0.5)))
        advance(engine, 2)
        assert touching(engine, box, one) > 0
        assert touching(engine, swinging, one) > 0


DT_S = STEP_NS * 1e-9


@pytest.fixture
def engine() -> Iterator[PyBulletEngine]:
    made = PyBulletEngine(EngineConfig(STEP_NS))
    yield made
    made.close()


@pytest.fixture
def space() -> Iterator[PyBulletEngine]:
    made = PyBulletEngine(EngineConfig(STEP_NS, gravity=(0.0, 0.0, 0.0), has_ground=False))
    yield made
    made.close()


def a_many_legged(legs: int, kind: JointKind = "revolute") -> Model:
    links = [Link("base", a_body()), *(Link(f"leg{i}", a_body(0.1)) for i in range(legs))]
    joints = [Joint(f"hip{i}", kind, "base", f"leg{i}") for i in range(legs)]
    return Model("many_legged", tuple(links), tuple(joints))


def a_model_of(shape: Shape) -> Model:
    ball = Shape("sphere", (0.123, 0.0, 0.0))
    return Model("m", (Link("base", a_body(), (ball,)), Link("tip", a_body(), (shape,))), (_pin(),))


def _pin() -> Joint:
    return Joint("pin", "continuous", "base", "tip")


def in_namespace(model: Model, namespace: str) -> Model:
    assert model.drive is not None
    drive = msgspec.structs.replace(model.drive, ros=RosBlock(namespace))
    return msgspec.structs.replace(model, drive=drive)


@pytest.mark.parametrize("make_model", [a_box_bot, a_cart, a_lopsided_box])
def test_body_weighs_what_its_model_weighs(
    engine: PyBulletEngine, make_model: Callable[[], Model]
) -> None:
    model = make_model()
    body = engine.add(model, a_state((0.0, 0.0, 1.0)))

    total = sum(part.mass_kg for part in dynamics_of(engine, body))

    assert total == pytest.approx(model.mass_kg, abs=1e-6)


@pytest.mark.parametrize("make_model", [a_box_bot, a_cart, a_lopsided_box])
def test_body_has_the_inertia_of_its_model(
    engine: PyBulletEngine, make_model: Callable[[], Model]
) -> None:
    model = make_model()
    body = engine.add(model, a_state((0.0, 0.0, 1.0)))

    reflected = [part.reflected_inertia for part in make_blueprint(model).parts]
    for part, link, least in zip(dynamics_of(engine, body), model.links, reflected, strict=False):
        ixx, ixy, ixz, iyy, iyz, izz = link.inertial.inertia
        moments = np.linalg.eigvalsh([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        if least:  # about y, which is the axle
            assert part.inertia[1] == pytest.approx(max(least, iyy))
            assert (part.inertia[0], part.inertia[2]) == pytest.approx((ixx, izz))
        else:
            assert sorted(part.inertia) == pytest.approx(moments, rel=1e-9)
        assert part.com == pytest.approx(link.inertial.com_in_link, abs=1e-9)


def test_body_casters_are_a_massless_part(engine: PyBulletEngine) -> None:
    body = engine.add(a_box_bot(), box_bot_at())

    chassis, left, right, casters = dynamics_of(engine, body)

    assert [part.friction for part in (chassis, left, right)] == [1.0, 1.0, 1.0]
    assert (casters.friction, casters.mass_kg) == (0.0, 0.0)


def test_body_that_is_driven_neither_bounces_nor_brakes_by_rolling(engine: PyBulletEngine) -> None:
    body = engine.add(a_cart(), on_ground())

    engine.command([body], np.array([1.0, 0.0]))

    for part in dynamics_of(engine, body):
        assert (part.restitution, part.rolling_friction, part.spinning_friction) == (0, 0, 0)


def test_body_with_offset_mass_falls_by_gravity(engine: PyBulletEngine) -> None:
    start = a_state((1.0, 2.0, 100.0), turn=(0.3, -0.2, 1.0))
    body = engine.add(a_lopsided_box(), start)
    steps = 240

    advance(engine, steps)

    row = engine.read([body]).base[0]
    fallen = 9.81 * DT_S**2 * steps * (steps + 1) / 2.0
    assert row[:3] == pytest.approx([1.0, 2.0, 100.0 - fallen], abs=1e-9)
    assert angle_between(row[3:7], start[3:7]) < 1e-7
    assert row[7:] == pytest.approx([0.0, 0.0, -9.81 * DT_S * steps, 0.0, 0.0, 0.0], abs=1e-9)


def test_body_root_circles_its_mass_centre_when_it_spins(space: PyBulletEngine) -> None:
    centre = np.array([0.3, -0.2, 0.1])
    inertia = (0.05, 0.0, 0.0, 0.05, 0.0, 0.05)
    model = Model("m", (Link("base", Inertial(1.0, (0.3, -0.2, 0.1), inertia)),))
    spin = np.array([0.0, 0.0, 2.0])
    root_velocity = np.cross(spin, -centre)
    body = space.add(model, a_state(linear=tuple(root_velocity), angular=tuple(spin)))

    advance(space, 240)

    row = space.read([body]).base[0]
    angle = 2.0 * DT_S * 240
    turn = np.array(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )
    assert row[:3] == pytest.approx(centre - turn @ centre, abs=1e-6)
    assert row[7:10] == pytest.approx(np.cross(spin, -turn @ centre), abs=1e-6)
    assert row[10:13] == pytest.approx(spin, abs=1e-9)


def test_body_falls_for_ever_when_there_is_no_ground() -> None:
    engine = PyBulletEngine(EngineConfig(STEP_NS, has_ground=False))
    body = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))

    advance(engine, 480)

    assert engine.read([body]).base[0, 2] < -10.0
    engine.close()


@pytest.mark.parametrize("friction", [0.0, 0.3, 0.8])
def test_body_is_slowed_by_the_friction_of_its_shape(
    engine: PyBulletEngine, friction: float
) -> None:
    body = engine.add(a_box(friction=friction), a_state((0.0, 0.0, 0.1), linear=(3.0, 0.0, 0.0)))

    advance(engine, 60)

    slowed = 3.0 - engine.read([body]).base[0, 7]
    assert slowed == pytest.approx(friction * 9.81 * DT_S * 60, rel=0.03, abs=1e-3)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_joint_stops_at_its_limit(engine: PyBulletEngine, kind: JointKind) -> None:
    body = engine.add(an_arm(kind), a_state((0.0, 0.0, 5.0)))

    advance(engine, 720)

    found = float(engine.read([body]).joint_positions[0])
    assert abs(found) == pytest.approx(0.5, abs=0.02)


def test_joint_swings_freely_when_nothing_drives_it(engine: PyBulletEngine) -> None:
    body = engine.add(an_arm("continuous"), a_state((0.0, 0.0, 5.0)))

    angles = []
    for _ in range(720):
        engine.step()
        angles.append(float(engine.read([body]).joint_positions[0]))

    # It hangs along x and falls: it goes through the bottom and comes up on the other side.
    assert max(angles) > 0.95 * math.pi
    assert min(angles[360:]) < 0.1 * math.pi


def test_joint_is_held_by_its_friction(engine: PyBulletEngine) -> None:
    body = engine.add(an_arm("continuous", friction=3.0), a_state((0.0, 0.0, 5.0)))

    advance(engine, 480)

    assert engine.read([body]).joint_positions[0] == pytest.approx(0.0, abs=0.01)


def test_joint_is_slowed_by_its_damping(engine: PyBulletEngine) -> None:
    free, damped = (
        engine.add(an_arm("continuous", damping=damping), a_state((x, 0.0, 5.0)))
        for x, damping in ((0.0, 0.0), (5.0, 1.0))
    )

    advance(engine, 60)

    fast, slow = engine.read([free, damped]).joint_velocities
    assert 0.0 < slow < 0.6 * fast


@pytest.mark.parametrize(
    "shape", [Shape("mesh", mesh="a.stl"), Shape("plane")], ids=lambda shape: shape.kind
)
def test_engine_refuses_a_shape_that_it_cannot_make(engine: PyBulletEngine, shape: Shape) -> None:
    with pytest.raises(EngineRefused, match=f"'{shape.kind}'"):
        engine.add(a_model_of(shape), a_state())

    assert bodies_in(engine) == 1


def test_engine_refuses_a_robot_with_too_many_parts(engine: PyBulletEngine) -> None:
    with pytest.raises(EngineRefused, match=rf"{MAX_PARTS + 1}.*{MAX_PARTS}"):
        engine.add(a_many_legged(MAX_PARTS), a_state())

    assert bodies_in(engine) == 1


def test_engine_simulates_a_robot_with_the_most_parts(engine: PyBulletEngine) -> None:
    body = engine.add(a_many_legged(MAX_PARTS - 1), a_state((0.0, 0.0, 5.0)))

    engine.step()

    assert engine.read([body]).joint_positions.shape == (MAX_PARTS - 1,)


def test_body_that_cannot_be_completed_is_removed(engine: PyBulletEngine) -> None:
    arm = an_arm("continuous")
    mimic = Mimic("missing", 1.0, 0.0)
    joints = tuple(msgspec.structs.replace(joint, mimic=mimic) for joint in arm.joints)

    with pytest.raises(KeyError):
        engine.add(msgspec.structs.replace(arm, joints=joints), a_state())

    assert bodies_in(engine) == 1


@pytest.mark.parametrize(
    "model",
    [a_model_of(Shape("mesh", mesh="a.stl")), an_arm("planar"), a_many_legged(MAX_PARTS)],
    ids=["shape", "joint", "parts"],
)
def test_engine_leaks_nothing_of_a_refused_model(engine: PyBulletEngine, model: Model) -> None:
    before = next_shape(engine)

    for _ in range(3):
        with pytest.raises(EngineRefused):
            engine.add(model, a_state())

    assert next_shape(engine) == before
    assert bodies_in(engine) == 1


def test_engine_shares_shapes_among_robots_that_differ_by_namespace(engine: PyBulletEngine) -> None:
    engine.add(in_namespace(a_box_bot(), "r0"), box_bot_at(0.0))
    before = next_shape(engine)

    for i in range(1, 5):
        engine.add(in_namespace(a_box_bot(), f"r{i}"), box_bot_at(float(i)))

    assert next_shape(engine) == before


def test_engine_reuses_shapes_when_robots_are_respawned(engine: PyBulletEngine) -> None:
    engine.remove(engine.add(a_box_bot(), box_bot_at()))
    before = next_shape(engine)

    for i in range(20):
        engine.remove(engine.add(in_namespace(a_box_bot(), f"r{i}"), box_bot_at()))

    assert next_shape(engine) == before
    # The ground, and the one that is parked.
    assert bodies_in(engine) == 2


def test_engine_reuses_a_parked_body_as_new(engine: PyBulletEngine) -> None:
    fresh = engine.add(a_box_bot(), box_bot_at())
    engine.command([fresh], np.array([5.0, 3.0]))
    advance(engine, 240)
    driven = engine.read([fresh])
    engine.remove(fresh)
    advance(engine, 240)

    again = engine.add(a_box_bot(), box_bot_at())
    assert again == fresh
    assert engine.read([again]).base[0] == pytest.approx(box_bot_at(), abs=1e-9)
    engine.command([again], np.array([5.0, 3.0]))
    advance(engine, 240)

    assert engine.read([again]).base == pytest.approx(driven.base, abs=1e-6)
    assert engine.read([again]).joint_positions == pytest.approx(driven.joint_positions, abs=1e-6)


def test_engine_body_moves_on_when_its_twin_is_parked(space: PyBulletEngine) -> None:
    space.remove(space.add(a_box(), a_state()))
    advance(space, 600)

    body = space.add(a_box(), a_state(linear=(2.0, 0.0, 0.0)))
    advance(space, 240)

    assert space.read([body]).base[0, 0] == pytest.approx(2.0, abs=1e-3)


def test_engine_parked_body_collides_with_nothing(engine: PyBulletEngine) -> None:
    gone = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
    engine.remove(gone)
    falling = engine.add(a_lopsided_box(), a_state((0.0, 0.0, 0.5)))

    advance(engine, 480)

    assert engine.find_overlaps(falling) == []
    assert engine.read([falling]).base[0, 2] < 0.3


def test_engine_robot_still_collides_when_its_twin_was_removed(engine: PyBulletEngine) -> None:
    twin = engine.add(a_box(), a_state((5.0, 0.0, 0.1)))
    lower = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
    upper = engine.add(a_box(), a_state((0.0, 0.0, 0.31)))

    engine.remove(twin)
    advance(engine, 240)

    assert touching(engine, lower, upper) > 0
    assert engine.read([lower, upper]).base[:, 2] == pytest.approx([0.1, 0.3], abs=2e-3)


def test_engine_reads_more_bodies_than_the_initial_capacity(space: PyBulletEngine) -> None:
    bodies = [space.add(a_lopsided_box(), a_state((float(x), 0.0, 0.0))) for x in range(200)]

    assert space.read(bodies).base[:, :3] == pytest.approx(
        np.array([[x, 0.0, 0.0] for x in range(200)]), abs=1e-9
    )


@pytest.mark.parametrize("target", [1e3, -1e9, 1e300])
def test_engine_stays_finite_when_a_target_is_huge(engine: PyBulletEngine, target: float) -> None:
    mad = engine.add(a_box_bot(), box_bot_at())
    calm = engine.add(a_box_bot(), box_bot_at(0.0, 5.0))

    engine.command([mad], np.full(2, target))
    advance(engine, 240)
    engine.command([mad], np.zeros(2))
    advance(engine, 480)

    row, other = engine.read([mad, calm]).base
    assert np.isfinite(row).all()
    assert abs(row[7:]).max() < 0.02
    assert other[:3] == pytest.approx([0.0, 5.0, 0.06], abs=1e-4)


def test_engine_prints_nothing(engine: PyBulletEngine, capfd: pytest.CaptureFixture[str]) -> None:
    for model in (a_box_bot(), a_lopsided_box(), an_arm("prismatic")):
        body = engine.add(model, a_state((0.0, 0.0, 1.0)))
        advance(engine, 5)
        engine.remove(body)
    for refused in (a_model_of(Shape("mesh", mesh="a.stl")), an_arm("planar")):
        with pytest.raises(EngineRefused):
            engine.add(refused, a_state())

    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")


def test_engine_disconnects_when_closed() -> None:
    engine = PyBulletEngine(EngineConfig(STEP_NS))

    engine.close()

    assert not pybullet.isConnected(client_of(engine))


def test_body_woken_in_a_step_has_the_last_state_set_in_it() -> None:
    with running(PyBulletEngine) as engine:
        engine.remove(engine.add(a_cart(), on_ground()))
        advance(engine, 10)
        body = engine.add(a_cart(), on_ground())
        flying = a_state((0.0, 0.0, 50.0), angular=(0.0, 0.0, 1.0))

        engine.set_state(body, on_ground(3.0), np.zeros(2), np.full(2, 4.0))
        engine.set_at_rest(body, flying)
        advance(engine, 3)

        reading = engine.read([body])
        assert reading.base[0, 12] == pytest.approx(1.0, abs=0.01)
        assert reading.joint_velocities == pytest.approx([0.0, 0.0], abs=0.01)


def test_awake_pooled_body_is_reused_with_a_velocity() -> None:
    with running(partial(PyBulletEngine, awake=1)) as engine:
        first = [engine.add(a_cart(), on_ground(5.0 * x)) for x in range(3)]
        for body in first:
            engine.remove(body)
        advance(engine, 2)
        moving = on_ground()
        moving[7] = 0.5

        for x in range(3):  # each is awake, or was woken when the previous was reused
            moving[0] = 5.0 * x
            body = engine.add(a_cart(), moving)
            engine.set_state(body, moving, np.zeros(2), np.full(2, 10.0))
            engine.command([body], np.full(2, 10.0))
            engine.step()

            assert body in first
            found = engine.read([body]).base[0]
            assert found[0] == pytest.approx(5.0 * x + 0.5 * STEP_NS * 1e-9, abs=2e-4)
            assert found[7] == pytest.approx(0.5, rel=0.02)


def test_body_that_slept_when_a_state_was_taken_sleeps_when_it_is_restored() -> None:
    with running(PyBulletEngine) as engine:
        box = engine.add(a_box(), a_state((0.0, 0.0, 3.0)))
        engine.sleep([box])
        advance(engine, 5)
        height = engine.read((box,)).base[0, 2]
        saved = write_snapshot(SnapshotPlace(engine.name, {}, ""), engine)
        engine.wake([box])
        advance(engine, 5)
        assert engine.read((box,)).base[0, 2] < height - 0.001

        restored = read_snapshot(SnapshotPlace(engine.name, {}, ""), saved)
        assert isinstance(restored, PyBulletEngine)
        restored.resume()
        advance(restored, 50)

        # Bullet lets a body fall for one more step before it sleeps.
        assert restored.read((box,)).base[0, 2] == pytest.approx(height, abs=0.001)


def drive_beside(sleepers: int, steps: int) -> np.ndarray:
    """Drive a robot among others that sleep; return the states (steps, 13) of its base."""
    with running(PyBulletEngine) as engine:
        driven = engine.add(a_box_bot(), box_bot_at())
        asleep = [engine.add(a_box_bot(), box_bot_at(100.0 + 3.0 * at)) for at in range(sleepers)]
        engine.sleep(asleep)
        engine.command([driven], np.array([5.0, 4.0]))
        return np.array([engine.step() and engine.read([driven]).base[0] for _ in range(steps)])


def placed_bodies(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Collect the bodies that are placed from now on."""
    placed: list[int] = []
    place = pybullet.resetBasePositionAndOrientation

    def note(body: int, at: Sequence[float], facing: Sequence[float], **client: int) -> None:
        placed.append(body)
        place(body, at, facing, **client)

    monkeypatch.setattr(pybullet, "resetBasePositionAndOrientation", note)
    return placed


def test_ground_is_placed_anew_in_steps_beside_sleeping_bodies_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    placed = placed_bodies(monkeypatch)

    drive_beside(0, 3)
    without = len(placed)
    drive_beside(2, 3)

    assert (without, len(placed)) == (0, 3)
    assert len(set(placed)) == 1


def test_placing_the_ground_anew_changes_no_bit_of_a_motion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = drive_beside(3, 60)
    monkeypatch.setattr(pybullet, "resetBasePositionAndOrientation", lambda *_, **__: None)

    assert np.array_equal(seen, drive_beside(3, 60))


def test_sleeping_body_keeps_its_pose_while_the_ground_is_placed_anew() -> None:
    with running(PyBulletEngine) as engine:
        box = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
        advance(engine, 60)
        engine.sleep([box])
        advance(engine, 2)
        before = engine.read([box]).base
        advance(engine, 60)

        assert np.array_equal(engine.read([box]).base, before)
