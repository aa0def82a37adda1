"""Environments

A batch of worlds makes control steps with one thread; each world has ten box_bots that drive along
curves. Each repetition is compared with MuJoCo alone. It steps the same model in the same number of
worlds equally often, one world after another, in two ways: robots that drive (`mj_step1`, constant
target speeds of the wheels, `mj_step2`), and robots that stand (`mj_step`). All figures are CPU
times of this process, measured in turn. The restart is that of one world of ten robots in a batch
of 16. Kinematic robots take random actions through Gymnasium, with observations, rewards and
restarts; a step of an environment is 0.1 s. Memory is what Python and NumPy allocate for them.
"""

import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import mkdtemp

import mujoco
import numpy as np

import zensim
from benchmarks.figures import Figure, table
from zensim.api.in_process_world import get_server
from zensim.envs import EnvKeywords, ZensimEnv, ZensimVectorEnv
from zensim.envs.batch import Batch
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.physics.mujoco.mujoco_replicas import MujocoReplicas

__all__ = ["rows", "table"]

ROBOTS = 10
WORLDS = (16, 256)
REPEATS = 7
WORLD_STEPS = 1024
"""Control steps of all worlds in a repetition."""
SETTLING_STEPS = 20
ENGINE_STEPS = 3
"""Engine steps of a control step."""
RESTARTS = 50
KINEMATIC: tuple[tuple[int, EnvKeywords], ...] = (
    (1024, {"count": 4}),
    (256, {"count": 20, "spacing": 0.5}),
    (256, {"count": 4, "spacing": 0.6, "world": "maze", "sensors": ["scan"]}),
)
RAYS = ("<samples>360</samples>", "<samples>90</samples>")
ENV_STEPS, DRAWS = 100, 8
WHEEL_SPEEDS, STEP_HZ = (8.0, 9.0), 240.0
"""Left and right [rad/s]: 0.3 m/s."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure steps and restarts."""
    with zensim.World() as world:
        world.spawn_fleet("box_bot", count=ROBOTS)
        for worlds in (2,) if is_short else WORLDS:
            yield from _steps(world, worlds, repeats=1 if is_short else REPEATS)
        yield _restarts(world, 2 if is_short else RESTARTS)
    yield from _kinematic(repeats=1 if is_short else REPEATS)


def _steps(world: zensim.World, worlds: int, *, repeats: int) -> Iterator[Figure]:
    batch = Batch(world, worlds)
    alone, standing = _make_driven(world, worlds), _make_standing(world, worlds)
    phases = np.arange(worlds * ROBOTS, dtype=np.float64).reshape(worlds, ROBOTS)
    numbers = iter(range(10**9))

    def drive() -> None:
        turns = np.sin(0.05 * next(numbers) + phases)
        batch.step(np.stack([np.full_like(turns, 0.3), 0.0 * turns, turns], axis=-1))

    for _ in range(SETTLING_STEPS):
        drive()
        alone()
        standing()
    count = max(2, WORLD_STEPS // worlds)
    shares, rests, rates = [], [], []
    for _ in range(repeats):
        own_s = _measure(drive, count)
        shares.append(100.0 * _measure(alone, count) / own_s)
        rests.append(100.0 * _measure(standing, count) / own_s)
        rates.append(count * worlds / own_s)
    batch.close()
    what = f"{worlds} worlds of {ROBOTS} robots"
    shown = f"{what}, speed against MuJoCo alone"
    yield Figure(what=shown, unit="%", samples=tuple(shares))
    shown = f"{what}, speed against MuJoCo with robots that stand"
    yield Figure(what=shown, unit="%", samples=tuple(rests))
    yield Figure(what=f"{what}, control steps of a world", unit="1/s of CPU", samples=tuple(rates))


def _kinematic(*, repeats: int) -> Iterator[Figure]:
    draw = np.random.default_rng(1).uniform
    for worlds, given in KINEMATIC:
        robots, options = given["count"], given
        task = what = "avoid" if robots > ROBOTS else "reach"
        if "sensors" in given:
            options, what = {**given, "model": _write_lidar()}, "reach in a maze with 90 rays"
        tracemalloc.start()
        env = ZensimVectorEnv(worlds, task=task, **options)
        actions = draw(-1.0, 1.0, (DRAWS, worlds, robots, 2))
        env.reset(seed=1)
        env.step(actions[0])
        kib = (tracemalloc.get_traced_memory()[0] - actions.nbytes) / worlds / robots / 1024.0
        tracemalloc.stop()
        what = f"{what}, {worlds} worlds of {robots} kinematic robots"
        rate = _rate(lambda n, env=env, actions=actions: env.step(actions[n % DRAWS]), repeats)  # type: ignore[misc]
        samples = tuple(worlds * robots * one for one in rate)
        yield Figure(what=f"{what}, steps of a robot", unit="1/s of CPU", samples=samples)
        yield Figure(what=f"{what}, memory of a robot", unit="KiB", samples=(kib,))
    single, one = ZensimEnv("reach"), draw(-1.0, 1.0, (DRAWS, 2))
    single.reset(seed=1)

    def step(number: int) -> None:
        if any(single.step(one[number % DRAWS])[2:4]):
            single.reset()

    what = "one world of one kinematic robot, steps of gymnasium.Env"
    yield Figure(what=what, unit="1/s of CPU", samples=_rate(step, repeats))


def _write_lidar() -> str:
    """Write the model of a robot with a lidar of fewer rays."""
    path = Path(mkdtemp()) / "lidar.urdf"
    path.write_text(read_builtin_model("box_bot_lidar").replace(*RAYS))
    return str(path)


def _rate(step: Callable[[int], object], repeats: int) -> tuple[float, ...]:
    """Measure the steps per second of CPU, some times."""
    numbers = iter(range(10**9))
    return tuple(
        ENV_STEPS / _measure(lambda: step(next(numbers)), ENV_STEPS) for _ in range(repeats)
    )


Pairs = list[tuple[mujoco.MjModel, mujoco.MjData]]


def _copy(world: zensim.World, worlds: int) -> Pairs:
    simulated = get_server(world).world
    bodies = tuple(entity.body for entity in simulated.entities)
    replicas = simulated.engine.replicate(bodies, worlds)
    assert isinstance(replicas, MujocoReplicas)
    return [(engine.model, engine.data) for engine in replicas.worlds]


def _make_driven(world: zensim.World, worlds: int) -> Callable[[], None]:
    """Make the control step of MuJoCo alone, with robots that drive along circles."""
    pairs = _copy(world, worlds)
    wheels = np.tile(WHEEL_SPEEDS, ROBOTS) * STEP_HZ

    def step() -> None:
        for model, data in pairs:
            for _ in range(ENGINE_STEPS):
                mujoco.mj_step1(model, data)
                data.efc_aref[data.ne : data.ne + data.nf] += wheels
                mujoco.mj_step2(model, data)

    return step


def _make_standing(world: zensim.World, worlds: int) -> Callable[[], None]:
    """Make the control step of MuJoCo alone, with robots that stand."""
    pairs = _copy(world, worlds)

    def step() -> None:
        for model, data in pairs:
            for _ in range(ENGINE_STEPS):
                mujoco.mj_step(model, data)

    return step


def _measure(call: Callable[[], object], count: int) -> float:
    began_s = time.process_time()
    for _ in range(count):
        call()
    return time.process_time() - began_s


def _restarts(world: zensim.World, count: int) -> Figure:
    batch = Batch(world, 16)
    mask = np.arange(16) == 0
    twists = np.full((16, ROBOTS, 3), 0.2)
    samples = []
    for _ in range(count):
        batch.step(twists)
        samples.append(1e3 * _measure(lambda: batch.restart(mask), 1))
    batch.close()
    what = f"restart of a world of {ROBOTS} robots"
    return Figure(what=what, unit="ms", samples=tuple(samples))
