"""State sensors

CPU time of the thread of a pool that publishes what 100 box_bots with an IMU at 200 Hz feel, for
one state, with noise; a separate router forwards everything to a subscriber in this process that
discards it. 1 ms is a fifth of a core. Contacts: CPU time of the server for one control step of 100
standing box_bot_lidars, all of whose collisions a contact sensor watches, and for the same step
without the reading.
"""

import time
from collections.abc import Callable, Iterator

import msgspec
import numpy as np

from benchmarks.bench_pools import make_buses, measure_cpu_ms
from benchmarks.figures import Figure, Limit, table
from zensim.proto.bus import Bus
from zensim.proto.messages.agent_messages import STATE_COLUMNS, Claim, DriveState
from zensim.proto.messages.model_messages import Model, Sensor
from zensim.proto.messages.sensor_messages import (
    ContactSensor,
    Environment,
    ImuSensor,
    Noise,
    SensorTopic,
)
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.runtime.contact_telemetry import ContactTelemetry
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world.spawn_request import ValidatedSpawn

__all__ = ["rows", "table"]

ROBOTS, ROBOTS_WHEN_SHORT = 100, 5
ROUNDS, ROUNDS_WHEN_SHORT = 200, 5
STEP_NS = 5_000_000
ENVIRONMENT = Environment(seed=1, step_ns=STEP_NS, control_steps=1)
SPACING_M = 1.0
BODY_HEIGHT_M = 0.06
SETTLING_STEPS = 100
DECLARED_IN = 100
"""Rounds until all publishers are declared."""
ENGINES: tuple[Callable[[EngineConfig], Engine], ...] = (PyBulletEngine, MujocoEngine)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure IMUs of a pool, and contacts in each engine."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    rounds = ROUNDS_WHEN_SHORT if is_short else ROUNDS
    with make_buses() as (bus, listener):
        yield from _imu_figures(bus, listener, robots, rounds)
    for make in ENGINES:
        yield from _contact_figures(make, robots, rounds)


def _imu_figures(bus: Bus, listener: Bus, robots: int, rounds: int) -> Iterator[Figure]:
    model = _with_sensor(_read_box_bot(), _make_imu())
    states = _make_states(robots, len(model.joints))
    pool = PooledRobots(bus, 0)
    pool.add_claims(
        [
            Claim(number + 1, f"r{number}", f"r{number}", model, environment=ENVIRONMENT)
            for number in range(robots)
        ]
    )
    pool.advance(next(states))

    def advance() -> None:
        pool.advance(next(states))

    quiet = measure_cpu_ms(rounds, pool.publish, before=advance)
    yield _make_figure(f"{robots} IMUs at 200 Hz, no subscriber", quiet)
    received = listener.subscribe("*/imu", 8)
    for _ in range(DECLARED_IN):
        pool.reply_to_queries()
        time.sleep(0.001)
    measured = measure_cpu_ms(rounds, pool.publish, before=advance)
    limit = Limit("median", "<=", 1.0, is_timed=True)
    yield _make_figure(f"{robots} IMUs at 200 Hz, one subscriber to all", measured, limit)
    received.close()


def _contact_figures(
    make: Callable[[EngineConfig], Engine], robots: int, rounds: int
) -> Iterator[Figure]:
    box_bot = _read_box_bot()
    watched = tuple((0, number) for number in range(len(box_bot.links[0].collisions)))
    wheels = tuple((link, 0) for link in range(1, len(box_bot.links)))
    names = tuple("collision" for _ in (*watched, *wheels))
    settings = ContactSensor((*watched, *wheels), names)
    model = _with_sensor(box_bot, _make_sensor("contact", "bumper_states", settings))
    engine = make(EngineConfig(STEP_NS))
    try:
        world = SimulatedWorld(engine, name="bench", step_ns=STEP_NS, control_steps=1)
        for number in range(robots):
            world.spawn(_make_spawn(f"r{number}", model, number))
        for _ in range(SETTLING_STEPS):
            world.step()
        telemetry = ContactTelemetry(world, lambda _: np.zeros((1, 3)))

        def step() -> None:
            world.step()
            world.states()

        stepped = measure_cpu_ms(rounds, step)
        read = measure_cpu_ms(rounds, telemetry.read, before=step)
        yield _make_figure(f"{engine.name}: a step of {robots} robots, states read", stepped)
        yield _make_figure(f"{engine.name}: contacts of {robots} robots read and encoded", read)
    finally:
        engine.close()


def _read_box_bot() -> Model:
    return read_urdf(read_builtin_model("box_bot"))


def _make_imu() -> Sensor:
    noise = (Noise("gaussian", stddev=0.01),) * 3
    return _make_sensor("imu", "imu", ImuSensor(noise, noise))


def _make_sensor(kind: str, topic: str, settings: ImuSensor | ContactSensor) -> Sensor:
    return Sensor(
        *(kind, kind, "base_link", "base_link"),
        settings=settings,
        topics=(SensorTopic(topic, topic),),
        frame_id="base_link",
    )


def _with_sensor(model: Model, sensor: Sensor) -> Model:
    return msgspec.structs.replace(model, sensors=(sensor,))


def _make_spawn(name: str, model: Model, number: int) -> ValidatedSpawn:
    x, y = divmod(number, 10)
    base = np.array([x * SPACING_M, y * SPACING_M, BODY_HEIGHT_M, 0, 0, 0, 1.0, *(0.0,) * 6])
    return ValidatedSpawn(name=name, namespace=name, model=model, base=base, description="")


def _make_states(robots: int, joint_count: int) -> Iterator[DriveState]:
    draws = np.random.default_rng(1)
    base = draws.uniform(-1.0, 1.0, (robots, STATE_COLUMNS))
    base[:, 3:7] /= np.linalg.norm(base[:, 3:7], axis=1, keepdims=True)
    claims = np.arange(1, robots + 1, dtype="<u4").tobytes()
    joints = np.zeros(robots * joint_count).tobytes()
    step = 0
    while True:
        step += 1
        yield DriveState(0, step, step * STEP_NS, claims, base.tobytes(), joints, joints)


def _make_figure(what: str, samples: tuple[float, ...], limit: Limit | None = None) -> Figure:
    return Figure(what=what, unit="CPU ms", samples=samples, limit=limit)
