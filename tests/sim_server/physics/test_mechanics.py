"""Frictions of pairs, rebounds, moments and spin: answers of the textbook, in each engine."""

import math
import pickle
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.engines import PHYSICAL, STEP_NS, advance, running
from tests.models import a_state
from zensim.proto.messages.model_messages import Contact, Inertial, Link, Model, Origin, Shape
from zensim.proto.se3 import FloatArray, rotate
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import GROUND, Engine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine

DT_S = STEP_NS * 1e-9
G = 9.81


@pytest.fixture(params=PHYSICAL, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def a_block(friction: float, size: tuple[float, float, float] = (0.6, 0.6, 0.1)) -> Model:
    shape = Shape("box", size, friction=friction)
    return Model("block", (Link("base", Inertial(1.0, inertia=FLAT), (shape,)),))


FLAT = (0.03, 0.0, 0.0, 0.03, 0.0, 0.06)


def a_slab(friction: float, *, is_static: bool, height_m: float = 0.2) -> Model:
    moments = Inertial(500.0, inertia=(200.0, 0.0, 0.0, 200.0, 0.0, 400.0))
    shape = Shape("box", (8.0, 2.0, height_m), friction=friction)
    return Model("slab", (Link("base", moments, (shape,)),), is_static=is_static)


def find_friction(engine: Engine, block: int, start_x: float) -> float:
    """Find the friction that stops a block, by its distance."""
    engine.set_base_state(block, with_speed(engine, block, 2.0))
    advance(engine, 600)
    way = float(engine.read([block]).base[0, 0]) - start_x + 2.0 * DT_S / 2.0
    return 4.0 / (2.0 * G * way)


def with_speed(engine: Engine, body: int, speed: float) -> FloatArray:
    base: FloatArray = engine.read([body]).base[0].copy()
    base[7] = speed
    return base


@pytest.mark.parametrize("is_static", [True, False], ids=["static", "moving"])
@pytest.mark.parametrize("pair", [(0.4, 0.4), (0.5, 1.0), (1.0, 0.5), (5.0, 0.5)])
def test_pair_takes_the_lesser_friction(
    engine: Engine, pair: tuple[float, float], *, is_static: bool
) -> None:
    engine.add(a_slab(pair[1], is_static=is_static), a_state((0.0, 0.0, 0.1)))
    block = engine.add(a_block(pair[0]), a_state((-3.0, 0.0, 0.25)))
    advance(engine, 120)

    assert find_friction(engine, block, -3.0) == pytest.approx(min(pair), abs=0.01)


def test_unequal_frictions_on_a_static_body_take_the_lesser(engine: Engine) -> None:
    engine.add(a_slab(0.6, is_static=True), a_state((0.0, 0.0, 0.1)))
    rough, smooth = (
        engine.add(a_block(friction), a_state((-3.0, y, 0.25)))
        for friction, y in ((0.9, -0.5), (0.3, 0.5))
    )
    advance(engine, 120)

    assert find_friction(engine, rough, -3.0) == pytest.approx(0.6, abs=0.01)
    assert find_friction(engine, smooth, -3.0) == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("make", PHYSICAL, ids=lambda make: make.name)
def test_ground_of_low_friction_takes_the_lesser(make: type[Engine]) -> None:
    with running(make, EngineConfig(STEP_NS, ground_friction=0.3)) as engine:
        block = engine.add(a_block(0.5), a_state((0.0, 0.0, 0.05)))
        advance(engine, 120)

        assert find_friction(engine, block, 0.0) == pytest.approx(0.3, abs=0.01)


def test_slab_of_low_friction_is_the_same_body_after_it_was_moved(engine: Engine) -> None:
    slab = engine.add(a_slab(0.3, is_static=True), a_state((0.0, 0.0, 0.1)))
    block = engine.add(a_block(0.5), a_state((5.0, 0.0, 1.25)))
    engine.set_base_state(slab, a_state((8.0, 0.0, 1.1)))
    advance(engine, 120)

    touched = engine.read_contacts([block]).bodies
    assert set(touched[:, 2].tolist()) == {slab}
    assert find_friction(engine, block, 5.0) == pytest.approx(0.3, abs=0.01)


def test_removed_slab_of_low_friction_leaves_nothing(engine: Engine) -> None:
    slab = engine.add(a_slab(0.3, is_static=True), a_state((0.0, 0.0, 1.0)))
    block = engine.add(a_block(0.5), a_state((0.0, 0.0, 1.15)))
    advance(engine, 60)

    engine.remove(slab)
    advance(engine, 360)

    assert float(engine.read([block]).base[0, 2]) == pytest.approx(0.05, abs=1e-3)
    assert set(engine.read_contacts([block]).bodies[:, 2].tolist()) == {GROUND}


def test_copies_of_slippery_bodies_survive_a_restored_state() -> None:
    with running(PyBulletEngine) as engine:
        slab = engine.add(a_slab(0.3, is_static=True), a_state((0.0, 0.0, 0.1)))
        block = engine.add(a_block(0.5), a_state((-3.0, 0.0, 0.25)))
        advance(engine, 120)
        assert list(engine.find_contacts(block)) == [slab]
        restored = pickle.loads(pickle.dumps(engine))
        restored.resume()

        assert find_friction(restored, block, -3.0) == pytest.approx(0.3, abs=0.01)


def a_ball(restitution: float | None, threshold: float = 0.0) -> Model:
    contact = Contact(restitution=restitution, bounce_threshold=threshold)
    shape = Shape("sphere", (0.1, 0.0, 0.0), contact=contact)
    moments = (0.004, 0.0, 0.0, 0.004, 0.0, 0.004)
    return Model("ball", (Link("base", Inertial(1.0, inertia=moments), (shape,)),))


def find_rebound(engine: Engine, ball: Model, height_m: float = 0.1) -> float:
    """Drop a ball by 1 m; find its speed after the impact over that before."""
    body = engine.add(ball, a_state((0.0, 0.0, height_m + 1.0)))
    before, after = 0.0, 0.0
    for _ in range(140):
        engine.step()
        speed = float(engine.read([body]).base[0, 9])
        before, after = min(before, speed), max(after, speed)
    return -after / before


@pytest.mark.parametrize("restitution", [0.2, 0.5, 0.8, 1.0])
def test_ball_rebounds_by_its_coefficient(engine: Engine, restitution: float) -> None:
    assert find_rebound(engine, a_ball(restitution)) == pytest.approx(restitution, rel=0.03)


@pytest.mark.parametrize("restitution", [0.2, 0.5, 0.8])
@pytest.mark.parametrize(
    "shape",
    [
        Shape("box", (0.2, 0.2, 0.2)),
        Shape("box", (0.4, 0.2, 0.2), origin=Origin((0.05, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))),
        Shape("cylinder", (0.1, 0.2, 0.0)),
    ],
)
def test_flat_bodies_rebound_by_their_coefficient(shape: Shape, restitution: float) -> None:
    """In PyBullet they tumble: docs/surfaces.md."""
    contact = Contact(restitution=restitution)
    body = a_ball(restitution)
    link = msgspec.structs.replace(
        body.links[0], collisions=(msgspec.structs.replace(shape, contact=contact),)
    )
    with running(MujocoEngine) as engine:
        found = find_rebound(engine, msgspec.structs.replace(body, links=(link,)))

    assert found == pytest.approx(restitution, rel=0.03)


@pytest.mark.parametrize("ball", [a_ball(None), a_ball(0.0), a_ball(0.8, threshold=5.0)])
def test_ball_does_not_rebound_without_coefficient_or_below_its_threshold(
    engine: Engine, ball: Model
) -> None:
    assert find_rebound(engine, ball) < 0.03


def test_static_body_limits_the_rebound_by_its_own_coefficient(engine: Engine) -> None:
    plate = Shape("box", (2.0, 2.0, 0.2), contact=Contact(restitution=0.5))
    engine.add(Model("plate", (Link("base", collisions=(plate,)),), is_static=True), a_state())

    assert find_rebound(engine, a_ball(1.0), 0.2) == pytest.approx(0.5, rel=0.03)


def test_dropped_ball_of_the_textbook(engine: Engine) -> None:
    body = engine.add(a_ball(0.8), a_state((0.0, 0.0, 1.1)))

    advance(engine, 240)

    # Down in 0.452 s, at 4.43 m/s; up with 3.54 m/s.
    assert float(engine.read([body]).base[0, 2]) == pytest.approx(0.569, abs=0.03)


def spin_freely(engine: Engine, moments: FloatArray, spin: FloatArray, com: float) -> float:
    """Let a body without gravity turn for 5 s; find the change of its energy, as a share."""
    inertia = (moments[0], 0.0, 0.0, moments[1], 0.0, moments[2])
    inertial = Inertial(1.0, (com, 0.0, 0.0), inertia)
    link = Link("base", inertial, (Shape("box", (0.1,) * 3),), weightless=inertial)
    body = engine.add(Model("top", (link,)), a_state((0.0, 0.0, 20.0), angular=tuple(spin)))
    advance(engine, 1200)
    state = engine.read([body]).base[0]
    turn = state[3:7] * np.array([-1.0, -1.0, -1.0, 1.0])
    own = rotate(turn, state[10:])
    return float(moments @ own**2 / (moments @ spin**2)) - 1.0


@pytest.mark.parametrize("com", [0.0, 0.05])
@pytest.mark.parametrize(
    ("moments", "spin"),
    [((0.01, 0.02, 0.028), (0.2, 20.0, 0.2)), ((0.01, 0.01, 0.018), (2.0, 0.0, 20.0))],
    ids=["middle axis", "top"],
)
def test_tumbling_body_keeps_its_energy(
    engine: Engine, moments: tuple[float, ...], spin: tuple[float, ...], com: float
) -> None:
    assert abs(spin_freely(engine, np.array(moments), np.array(spin), com)) < 0.01


def test_sliding_speed_of_the_textbook(engine: Engine) -> None:
    tilt = math.atan(0.5)
    engine.add(a_slab(0.4, is_static=True), a_state((0.0, 0.0, 3.0), turn=(0.0, tilt, 0.0)))
    place = (0.15 * math.sin(tilt), 0.0, 3.0 + 0.15 * math.cos(tilt))
    block = engine.add(a_block(0.4), a_state(place, turn=(0.0, tilt, 0.0)))
    advance(engine, 48)
    before = np.linalg.norm(engine.read([block]).base[0, 7:10])
    advance(engine, 120)
    after = np.linalg.norm(engine.read([block]).base[0, 7:10])

    # g (sin - mu cos), for half a second.
    assert after - before == pytest.approx(
        120 * DT_S * G * (math.sin(tilt) - 0.4 * math.cos(tilt)), rel=0.02
    )
