"""Box_bots that drive circles as fast as possible: in an engine alone, and in `zensim.World`."""

import time
from collections.abc import Callable, Mapping
from functools import partial

import msgspec
import mujoco
import numpy as np

import zensim
from benchmarks.bodies import CONFIG
from benchmarks.pybullet_floor import PlainLoop
from benchmarks.ten_robots import CIRCLE, SPACING_M
from zensim.api.in_process_world import get_server
from zensim.proto.messages.model_messages import Dynamics
from zensim.sim_server.physics.mujoco.mujoco_replicas import MujocoReplicas

MUJOCO_HZ, KINEMATIC_HZ = 100.0, 20.0
CONTROL_HZ = 20.0
"""Control rate of `zensim.World`."""
WORLD_ROBOTS = 10
"""Robots of one MuJoCo model: several small worlds are faster than a large one."""
SETTLE_S = 1.0
STEADY = 1.01
"""Robots are steady when a further second of wall time makes them faster by less than this."""
WHEEL_SPEEDS = (4.93, 6.5)
COORDINATES = 8
"""Velocities of a box_bot: six of its base, and of two wheels."""


class Driven(msgspec.Struct, frozen=True):
    """Steps of a fleet, and their cost."""

    steps: int
    step_s: float
    wall_s: float
    cpu_s: float
    speed: float
    """Mean speed of the robots [m/s]."""


def drive_pybullet(robots: int, seconds: float) -> Driven:
    """Drive in a plain PyBullet loop with 10 solver iterations."""
    loop = PlainLoop(robots, step_ns=CONFIG.step_ns, control_steps=CONFIG.control_steps)
    try:
        loop.turn(SETTLE_S)
        speed = 0.0
        while (now := float(np.mean(loop.speeds()))) < CIRCLE[0] / 2.0 or now > speed * STEADY:
            speed = now
            loop.turn(SETTLE_S)
        speed = now
        turn = loop.turn(seconds)
    finally:
        loop.close()
    return Driven(turn.steps, CONFIG.step_ns * 1e-9, turn.wall_s, turn.cpu_s, speed)


def drive_mujoco(robots: int, seconds: float) -> Driven:
    """Drive in MuJoCo alone: worlds of ten robots that share a model, one after another."""
    count = min(robots, WORLD_ROBOTS)
    with zensim.World(engine="mujoco", step_hz=MUJOCO_HZ) as world:
        world.spawn_fleet("box_bot", count=count, spacing=SPACING_M)
        simulated = get_server(world).world
        bodies = tuple(entity.body for entity in simulated.entities)
        replicas = simulated.engine.replicate(bodies, max(1, robots // WORLD_ROBOTS))
        assert isinstance(replicas, MujocoReplicas)
        pairs = [(engine.model, engine.data) for engine in replicas.worlds]
    wheels = np.tile(WHEEL_SPEEDS, count) * MUJOCO_HZ

    def step() -> None:
        for model, data in pairs:
            mujoco.mj_step1(model, data)
            data.efc_aref[data.ne : data.ne + data.nf] += wheels
            mujoco.mj_step2(model, data)

    for _ in range(int(SETTLE_S * MUJOCO_HZ)):
        step()
    speeds = np.linalg.norm(pairs[0][1].qvel.reshape(-1, COORDINATES)[:, :2], axis=1)
    speed = float(np.sort(speeds)[-count:].mean())  # Without bodies that wait to be used.
    return _run(step, 1, 1.0 / MUJOCO_HZ, seconds, speed)


def drive_world(
    robots: int, seconds: float, *, engine: str, step_hz: float, dynamics: Dynamics = "full"
) -> Driven:
    """Drive in `zensim.World`, each robot by its drive and with odometry."""
    with zensim.World(engine=engine, step_hz=step_hz, control_hz=CONTROL_HZ) as world:
        world.spawn_fleet("box_bot", count=robots, spacing=SPACING_M, dynamics=dynamics)
        fleet = world.fleet(list(world.robots))
        fleet.drive(*CIRCLE)
        world.run_for(SETTLE_S)
        before = fleet.poses2d()
        world.run_for(0.1)
        speed = float(np.linalg.norm((fleet.poses2d() - before)[:, :2], axis=1).mean() / 0.1)
        steps = max(1, round(0.1 * step_hz))
        return _run(lambda: world.step(steps), steps, 1.0 / step_hz, seconds, speed)


KINDS: Mapping[str, Callable[[int, float], Driven]] = {
    "pybullet": drive_pybullet,
    "mujoco": drive_mujoco,
    "world_pybullet": partial(drive_world, engine="pybullet", step_hz=240.0),
    "world_mujoco": partial(drive_world, engine="mujoco", step_hz=MUJOCO_HZ),
    "world_kinematic": partial(
        drive_world, engine="mujoco", dynamics="kinematic", step_hz=KINEMATIC_HZ
    ),
}


def _run(
    advance: Callable[[], object], steps: int, step_s: float, seconds: float, speed: float
) -> Driven:
    """Advance by this number of steps, again and again for some wall time."""
    done, began_s, began_cpu_s = 0, time.perf_counter(), time.process_time()
    while (wall_s := time.perf_counter() - began_s) < seconds:
        advance()
        done += steps
    return Driven(done, step_s, wall_s, time.process_time() - began_cpu_s, speed)
