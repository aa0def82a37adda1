"""Contacts of contact sensors, in worlds with real engines."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.engines import PHYSICAL, STEP_NS, running
from tests.models import a_body, a_box, a_box_bot, a_state, box_bot_at
from tests.sim_server.fakes import ServerFixture, a_server, a_spawn
from zensim.proto.messages.model_messages import Link, Model, Origin, Sensor, Shape
from zensim.proto.messages.sensing_messages import Contacts
from zensim.proto.messages.sensor_messages import ContactSensor, SensorTopic
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.se3 import FloatArray
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.runtime.contact_telemetry import GROUND_COLLISION, ContactTelemetry
from zensim.sim_server.world.simulated_world import SimulatedWorld

CONTROL_STEPS = 3
WEIGHT_N = 9.81


def no_meshes(name: str) -> np.ndarray:
    raise AssertionError(name)


@pytest.fixture(params=PHYSICAL, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def a_bumper(*collisions: tuple[int, int], name: str = "bumper") -> Sensor:
    return Sensor(
        *(name, "contact", "base", "base"),
        settings=ContactSensor(collisions, tuple(f"c{link}_{one}" for link, one in collisions)),
        topics=(SensorTopic("bumper_states", "bumper_states"),),
        frame_id="world",
    )


def a_touchy_box(*collisions: tuple[int, int]) -> Model:
    """A cube with a thin plate on its front, each a collision of its own."""
    cube = Shape("box", (0.2, 0.2, 0.2), name="cube")
    plate = Shape("box", (0.02, 0.1, 0.1), Origin((0.11, 0.0, 0.0)), name="plate")
    link = Link("base", a_body(), (cube, plate))
    return Model("touchy", (link,), sensors=(a_bumper(*collisions),))


def a_world_with(engine: Engine) -> SimulatedWorld:
    return SimulatedWorld(engine, name="default", step_ns=STEP_NS, control_steps=CONTROL_STEPS)


def advance(world: SimulatedWorld, steps: int) -> None:
    for _ in range(steps):
        world.step()


def bodies_of(contacts: Contacts) -> list[list[int]]:
    found: list[list[int]] = np.frombuffer(contacts.bodies, "<u4").reshape(-1, 4).tolist()
    return found


def points_of(contacts: Contacts) -> FloatArray:
    return np.frombuffer(contacts.points, "<f8").reshape(-1, 10)


def events_in(world: SimulatedWorld) -> list[Event]:
    return [event for event in world.clock.take_events() if event.kind == "touched"]


def test_resting_box_feels_its_weight_within_five_percent(engine: Engine) -> None:
    world = a_world_with(engine)
    telemetry = ContactTelemetry(world, no_meshes)
    world.spawn(a_spawn("r1", model=a_touchy_box((0, 0)), base=a_state((0.0, 0.0, 0.1))))
    advance(world, 480)

    found = telemetry.read()

    assert (found.step, found.time_ns) == (480, 480 * STEP_NS)
    assert (found.entities, found.collisions) == (("r1",), (GROUND_COLLISION,))
    assert {tuple(row) for row in bodies_of(found)} == {(0, 0, 0, 0)}
    assert points_of(found)[:, 9].sum() == pytest.approx(WEIGHT_N, rel=0.05)


def test_only_the_collisions_of_a_sensor_are_told(engine: Engine) -> None:
    world = a_world_with(engine)
    telemetry = ContactTelemetry(world, no_meshes)
    world.spawn(a_spawn("r1", model=a_touchy_box((0, 1)), base=a_state((0.0, 0.0, 0.1))))
    wall = a_state((1.0, 0.0, 0.1))
    world.spawn(a_spawn("wall", model=a_box(is_static=True), base=wall))
    advance(world, 48)
    assert telemetry.read().entities == ()

    world.place("r1", a_state((0.775, 0.0, 0.1), linear=(0.5, 0.0, 0.0)))
    advance(world, 4)

    found = telemetry.read()
    assert found.collisions == ("wall::base::collision",)
    assert {tuple(row) for row in bodies_of(found)} == {(0, 0, 1, 0)}
    assert points_of(found)[:, 3:6] == pytest.approx(
        np.array([[-1.0, 0.0, 0.0]] * len(bodies_of(found))), abs=0.05
    )
    assert points_of(found)[:, 7].sum() < 0.0


def test_touch_is_told_within_one_control_step_and_not_before_or_after(engine: Engine) -> None:
    """Source: a fall of 0.05 m takes sqrt(2 h / g) = 0.101 s, 24.2 steps."""
    world = a_world_with(engine)
    telemetry = ContactTelemetry(world, no_meshes)
    world.spawn(a_spawn("r1", model=a_touchy_box((0, 0)), base=a_state((0.0, 0.0, 0.15))))
    told = {}
    while world.clock.steps < 60:
        advance(world, CONTROL_STEPS)
        told[world.clock.steps] = bool(telemetry.read().entities)

    first = min(step for step, is_touching in told.items() if is_touching)
    assert 24 - CONTROL_STEPS < first <= 25 + CONTROL_STEPS
    assert events_in(world)[0].step == first

    world.place("r1", a_state((0.0, 0.0, 2.0)))
    advance(world, CONTROL_STEPS)
    assert telemetry.read().entities == ()


def test_touching_is_an_event_once_until_it_ends(engine: Engine) -> None:
    world = a_world_with(engine)
    telemetry = ContactTelemetry(world, no_meshes)
    world.spawn(a_spawn("r1", model=a_touchy_box((0, 0), (0, 1)), base=a_state((0, 0, 0.1))))
    for _ in range(50):
        advance(world, CONTROL_STEPS)
        telemetry.read()

    (event,) = events_in(world)
    assert event.entity == "r1"
    assert "'bumper'" in event.message
    assert GROUND_COLLISION in event.message

    world.place("r1", a_state((0.0, 0.0, 0.5)))
    advance(world, CONTROL_STEPS)
    telemetry.read()
    world.place("r1", a_state((0.0, 0.0, 0.1)))
    advance(world, 2 * CONTROL_STEPS)
    telemetry.read()
    assert len(events_in(world)) == 1


def test_kinematic_robot_tells_what_blocks_it() -> None:
    model = a_box_bot()
    watched = tuple((0, one) for one in range(len(model.links[0].collisions)))
    model = msgspec.structs.replace(model, sensors=(a_bumper(*watched),))
    with running(lambda one: TieredEngine(MujocoEngine(one), one, "kinematic")) as engine:
        world = a_world_with(engine)
        telemetry = ContactTelemetry(world, no_meshes)
        world.spawn(a_spawn("r1", model=model, base=box_bot_at()))
        wall = a_box("wall", side_m=0.4, is_static=True)
        world.spawn(a_spawn("wall", model=wall, base=a_state((0.6, 0.0, 0.2))))
        engine.command((world.entities.find("r1").body,), np.array([10.0, 10.0]))
        advance(world, 24)
        assert telemetry.read().entities == ()
        advance(world, 300)

        found = telemetry.read()

        assert (found.entities, found.collisions) == (("r1",), ("wall::base::collision",))
        assert not points_of(found)[:, 6:].any()


def test_server_tells_contacts_only_to_those_who_listen() -> None:
    quiet, listening = a_touching_server(), a_touching_server()
    quiet.publisher.unwanted |= {"contacts", "events"}

    for server in (quiet, listening):
        server.turn_for(0.1)

    assert quiet.publisher.on("contacts") == []
    told = listening.publisher.on("contacts")
    steps = [one.step for one in told if isinstance(one, Contacts)]
    assert steps[:3] == [CONTROL_STEPS, 2 * CONTROL_STEPS, 3 * CONTROL_STEPS]


def a_touching_server() -> ServerFixture:
    server = a_server()
    server.world.spawn(a_spawn("r1", model=a_touchy_box((0, 0)), base=a_state((0.0, 0.0, 0.1))))
    return server


def test_server_without_contact_sensors_tells_no_contacts() -> None:
    server = a_server("r0")

    server.turn_for(0.1)

    assert server.publisher.on("contacts") == []
