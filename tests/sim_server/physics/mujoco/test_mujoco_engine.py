"""MujocoEngine beyond the contract: slots and recompiled models."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.engines import STEP_NS, advance
from tests.models import a_body, a_box, a_box_bot, a_cart, a_state, an_arm, box_bot_at, on_ground
from tests.sim_server.physics.mujoco.test_convex_pieces import a_room
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.stl import write_corners
from zensim.sim_server.physics.engine import Engine, EngineRefused, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine, find_near_geometries

CONFIG = EngineConfig(STEP_NS)
WHEEL_RADIUS_M, TRACK_M = 0.035, 0.11
"""Of a box_bot."""


@pytest.mark.parametrize(("x", "is_near"), [(2.9, True), (3.1, False), (-1.9, True), (-2.1, False)])
def test_geometry_is_near_when_its_sphere_meets_that_of_a_body(x: float, *, is_near: bool) -> None:
    centres = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [x, 0.0, 0.0]])
    radii = np.array([0.5, 0.5, 1.4])

    found = find_near_geometries(centres, radii, np.array([0, 1]))

    assert found.tolist() == ([0, 1, 2] if is_near else [0, 1])


def test_nothing_is_near_what_has_no_geometry() -> None:
    found = find_near_geometries(np.zeros((3, 3)), np.ones(3), np.zeros(0, np.intp))

    assert found.tolist() == []


A_DAMPED = msgspec.structs.replace(an_arm("continuous", damping=0.5), is_static=False)


@pytest.fixture
def engine() -> Iterator[Engine]:
    made = MujocoEngine(EngineConfig(STEP_NS))
    yield made
    made.close()


def drive_pair(*, with_others: bool) -> bytes:
    """Drive two box_bots into each other while other archetypes are added and removed."""
    engine = MujocoEngine(EngineConfig(STEP_NS))
    model = a_box_bot()
    pair = [engine.add(model, box_bot_at(0.0)), engine.add(model, box_bot_at(0.3, 0.01, np.pi))]
    engine.command(pair, np.array([5.0, 5.5, 5.0, 4.5]))
    for turn in range(12):
        advance(engine, 20)
        if with_others:
            added = engine.add(
                (a_cart(), a_box(), a_box_bot(), A_DAMPED)[turn % 4], on_ground(9.0, turn)
            )
            advance(engine, 5)
            if turn % 2:
                engine.remove(added)
        else:
            advance(engine, 5)
    reading = engine.read(pair)
    engine.close()
    return reading.base.tobytes() + reading.joint_positions.tobytes()


def test_robots_continue_exactly_when_their_model_is_recompiled() -> None:
    assert drive_pair(with_others=True) == drive_pair(with_others=False)


def drive_row(engine: Engine, *, robots: int, removed: int) -> tuple[bytes, FloatArray, FloatArray]:
    """Drive the first robots of a row; return their bits, states, and speeds of their wheels."""
    every = [engine.add(a_box_bot(), box_bot_at(3.0 * i)) for i in range(robots + removed)]
    for body in every[robots:]:
        engine.remove(body)
    bodies = every[:robots]
    engine.command(bodies, np.tile([4.93, 6.5], robots))
    advance(engine, 240)
    reading = engine.read(bodies)
    return reading.base.tobytes(), reading.base, reading.joint_velocities.reshape(-1, 2)


def test_empty_slots_change_no_bit_of_robots(engine: Engine) -> None:
    other = MujocoEngine(EngineConfig(STEP_NS))

    beside_empty = drive_row(engine, robots=4, removed=9)
    alone = drive_row(other, robots=4, removed=0)

    assert beside_empty[0] == alone[0]
    other.close()


def test_wheels_and_base_agree_beside_empty_slots(engine: Engine) -> None:
    _, base, wheels = drive_row(engine, robots=9, removed=0)

    rims = wheels * WHEEL_RADIUS_M
    assert np.hypot(base[:, 7], base[:, 8]) == pytest.approx(rims.mean(axis=1), rel=5e-3)
    turn_rates = (rims[:, 1] - rims[:, 0]) / TRACK_M
    assert base[:, 12] == pytest.approx(turn_rates, rel=5e-3)
    assert wheels[0] == pytest.approx([4.93, 6.5], rel=5e-3)


def test_robots_of_different_archetypes_collide(engine: Engine) -> None:
    box = engine.add(a_box(), a_state((0.5, 0.0, 0.1)))
    cart = engine.add(a_cart(), on_ground())

    engine.command([cart], np.array([6.0, 6.0]))
    advance(engine, 480)

    x_cart, x_box = engine.read([cart, box]).base[:, 0].tolist()
    assert x_box > 0.52
    assert x_box - x_cart > 0.2


@pytest.mark.parametrize("places", [(0.0, 0.01, 0.02), (0.0, 0.05)])
def test_robots_spawned_inside_each_other_separate_slowly(
    engine: Engine, places: tuple[float, ...]
) -> None:
    bodies = [engine.add(a_box_bot(), box_bot_at(x)) for x in places]

    speeds = []
    for _ in range(360):
        engine.step()
        speeds.append(np.linalg.norm(engine.read(bodies).base[:, 7:10], axis=1).max())

    base = engine.read(bodies).base
    assert max(speeds) < 1.5
    assert np.abs(base[:, 0] - places).max() < 0.4
    assert np.abs(base[:, 2] - 0.06).max() < 0.06


def test_engine_reports_a_diverged_body_and_the_others_continue(engine: Engine) -> None:
    model = a_box_bot()
    diverged, other = engine.add(model, box_bot_at()), engine.add(model, box_bot_at(0.101))
    engine.command([other], np.array([4.0, 4.0]))

    state = box_bot_at()
    state[7] = np.nan
    engine.set_base_state(diverged, state)

    assert not engine.step()
    advance(engine, 240)
    base = engine.read([diverged, other]).base
    assert np.isnan(base[0]).any()
    assert base[1, 0] == pytest.approx(0.101 + 4.0 * 0.035, abs=0.01)
    engine.set_base_state(diverged, box_bot_at(-1.0))
    assert engine.step()
    assert engine.read([diverged]).base[0, 0] == pytest.approx(-1.0, abs=1e-3)


def test_forget_removed_drops_empty_slots(engine: Engine) -> None:
    bodies = [engine.add(a_box(), a_state((float(i), 0.0, 0.1))) for i in range(9)]
    for body in bodies[:8]:
        engine.remove(body)
    before = engine.read(bodies[8:])

    engine.forget_removed()

    assert engine.read(bodies[8:]).base.tobytes() == before.base.tobytes()
    assert engine.add(a_cart(), on_ground(5.0)) != bodies[8]


def blocks(count: int) -> list[Model]:
    """Make models that all differ."""
    return [a_box(f"block{i}", side_m=0.2 + 0.01 * i) for i in range(count)]


def drop(engine: Engine, models: Sequence[Model]) -> bytes:
    """Drop models beside each other, and read all states after a while."""
    bodies = [engine.add(model, a_state((i, 0.0, 0.3))) for i, model in enumerate(models)]
    advance(engine, 60)
    return engine.read(bodies).base.tobytes()


def test_expected_models_are_compiled_together(engine: Engine) -> None:
    models = blocks(5)
    engine.expect(models)
    engine.add(models[0], a_state())

    # Otherwise, the first call starts a compilation and does not wait for it.
    assert all(engine.prepare(model) for model in models[1:])


def test_expected_models_move_as_those_that_were_not_announced(engine: Engine) -> None:
    engine.expect(blocks(5))

    assert drop(engine, blocks(5)) == drop(MujocoEngine(CONFIG), blocks(5))


def an_uncompilable() -> Model:
    """Make a model with a box that has no size."""
    return Model("flat", (Link("flat", a_body(), (Shape("box", (0.0, 0.0, 0.0)),)),))


def test_model_that_cannot_be_compiled_does_not_keep_out_those_announced_with_it(
    engine: Engine,
) -> None:
    good, bad = a_box(), an_uncompilable()
    engine.expect([good, bad])

    engine.add(good, a_state())

    with pytest.raises(EngineRefused, match=bad.name):
        engine.add(bad, a_state((2.0, 0.0, 0.0)))


def test_announced_models_need_not_come(engine: Engine) -> None:
    engine.expect([a_cart(), a_box_bot()])

    assert drop(engine, blocks(2)) == drop(MujocoEngine(CONFIG), blocks(2))


def a_mesh(folder: Path, corners: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Shape:
    (folder / "room.stl").write_bytes(write_corners(corners.reshape(-1, 3, 3)))
    return Shape("mesh", (1.0, 1.0, 1.0), mesh="room")


def test_robot_drives_inside_a_concave_mesh(tmp_path: Path) -> None:
    engine = MujocoEngine(EngineConfig(STEP_NS, has_ground=False, mesh_folder=str(tmp_path)))
    room = Model("room", (Link("room", collisions=(a_mesh(tmp_path, a_room()),)),), is_static=True)
    engine.add(room, a_state())
    robot = engine.add(a_box_bot(), a_state((3.7, 2.0, 0.06)))

    engine.command([robot], np.array([10.0, 10.0]))
    advance(engine, 480)

    x, y, z = engine.read([robot]).base[0, :3].tolist()
    engine.close()
    assert x == pytest.approx(3.95, abs=0.01)
    assert y == pytest.approx(2.0, abs=0.05)
    assert z == pytest.approx(0.06, abs=0.01)


def test_missing_mesh_is_refused(engine: Engine) -> None:
    body = Model("m", (Link("m", collisions=(Shape("mesh", mesh="gone"),)),))

    with pytest.raises(EngineRefused, match="gone"):
        engine.add(body, a_state())


def test_place_and_rotation_that_are_set_are_read() -> None:
    engine = MujocoEngine(CONFIG)
    body = engine.add(a_box(), a_state())
    state = a_state((1.0, 2.0, 3.0), turn=(0.1, 0.2, 0.3))

    engine.set_base_state(body, state)
    found = engine.read([body]).base[0]

    engine.close()
    assert found == pytest.approx(state)


@pytest.mark.parametrize(("height_m", "is_touching"), [(0.299, True), (-0.099, False)])
def test_copy_touches_what_is_fixed_above_it_and_not_what_carries_it(
    height_m: float, *, is_touching: bool
) -> None:
    engine = MujocoEngine(CONFIG)
    engine.add(a_box("block", is_static=True), a_state((0.0, 0.0, height_m)))
    replicas = engine.replicate([engine.add(a_box(), a_state((0.0, 0.0, 0.1)))], 2)

    for group in replicas.make_groups(1):
        group.step()

    assert replicas.find_touching().tolist() == [[is_touching]] * 2
    engine.close()


def test_restored_copy_touches_nothing_and_keeps_no_loads() -> None:
    engine = MujocoEngine(CONFIG)
    bodies = [engine.add(a_box(), a_state((0.25 * at, 0.0, 0.1))) for at in range(2)]
    for body, push in zip(bodies, (20.0, -20.0), strict=True):
        engine.apply_link_wrench(body, 0, np.array([push, 0.0, 0.0, 0.0, 0.0, 0.0]))
    replicas = engine.replicate(bodies, 1)
    (group,) = replicas.make_groups(1)
    states = []
    for _ in range(2):
        for _ in range(60):
            group.step()
        states.append(replicas.read().base.tobytes())
        replicas.restore([0])

        assert not replicas.find_touching().any()

    assert states[0] == states[1]
    engine.close()
