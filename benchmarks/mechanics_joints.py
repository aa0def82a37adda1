"""Pendulums, arms that hold, mimic chains, lifts and gears, against the textbook."""

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import zensim
from benchmarks.figures import Figure, Limit
from tests.sim_server.description.chain_models import (
    WEAK,
    ArmCase,
    GearCase,
    MastCase,
    PendulumCase,
    write_followed_wheels,
)
from zensim.api.robot import Robot
from zensim.proto.messages.standard_messages import JointState
from zensim.proto.se3 import FloatArray

STEP_RATES_HZ = (100.0, 240.0, 1000.0)
SPACING_M = 8.0
SETTLE_S = 4.0
SWINGS = 5
MOST_SAG_MRAD, MOST_SAG_MM = 2.0, 2.0
MOST_OFF_PERCENT = 1.0
MOST_PERIOD_OFF_PERCENT = 0.5
LEAST_FALL_RAD = 0.3
MILLI, PERCENT = 1e3, 100.0
JOINTS = (1, 2, 3, 4, 5, 6, 7)
PAYLOADS_KG = (0.0, 5.0, 10.0)
BENT = (-0.6, 0.8, -0.7, 0.5, 0.9, -0.4, 0.3)
PENDULUMS = (
    PendulumCase(rod_kg=1.0, rod_m=1.0, ball_kg=0.0),
    PendulumCase(rod_kg=0.5, rod_m=0.6, ball_kg=2.0),
    PendulumCase(rod_kg=3.0, rod_m=2.0, ball_kg=0.5),
)
MASTS = (
    *(MastCase(1, payload) for payload in (0.1, 5.0, 20.0, 60.0)),
    *(MastCase(followers, 20.0) for followers in (2, 3, 4)),
    MastCase(1, 20.0, multiplier=0.5, offset=0.1),
    MastCase(2, 20.0, multiplier=-0.5, offset=-0.05),
)
LIFTS = tuple(MastCase(0, payload) for payload in (0.1, 5.0, 20.0, 60.0))
GEARS = tuple(GearCase(ratio, mass) for ratio in (10.0, 0.1, -1.0) for mass in (0.5, 5.0))
LIFTED_M, SHAFT_RAD = 0.4, 0.3
WHEEL_SPEED = 0.5


def rows(engine: str, *, is_short: bool) -> Iterator[Figure]:
    """Measure each situation in one engine."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        yield from _measure_pendulums(engine, folder, PENDULUMS[:1] if is_short else PENDULUMS)
        for what, cases in _list_arms(is_short=is_short):
            for hz in STEP_RATES_HZ[1:2] if is_short else STEP_RATES_HZ:
                yield from _measure_arms(engine, folder, f"{what}, {hz:g} Hz", cases, hz)
        yield from _measure_weak_arm(engine, folder)
        yield from _measure_masts(engine, folder, "lifts", LIFTS[:1] if is_short else LIFTS)
        yield from _measure_masts(engine, folder, "mimic masts", MASTS[:1] if is_short else MASTS)
        yield from _measure_gears(engine, folder, GEARS[:1] if is_short else GEARS)
        yield _measure_followed_wheels(engine, folder)


def _list_arms(*, is_short: bool) -> Iterator[tuple[str, list[ArmCase]]]:
    sizes = (6,) if is_short else JOINTS
    loads = (5.0,) if is_short else PAYLOADS_KG
    pairs = [(n, load) for n in sizes for load in loads]
    yield "arms stretched", [ArmCase(n, load) for n, load in pairs]
    yield "arms bent", [ArmCase(n, load, targets=BENT[:n]) for n, load in pairs]
    yield (
        "arms of crossing axes",
        [
            ArmCase(n, load, turns_parallel=False, targets=BENT[:n])
            for n, load in pairs
            if n > 1  # the first joint is upright: it bears nothing
        ],
    )


def _spawn_all(
    world: zensim.World, folder: Path, texts: Iterable[str], z: float = 0.0
) -> list[Robot]:
    """Spawn robots of these descriptions in a row; their joint states are subscribed."""
    robots = []
    for number, text in enumerate(texts):
        file = folder / f"robot_{number}.urdf"
        file.write_text(text)
        name, y = f"r{number}", SPACING_M * number
        robots.append(world.spawn(str(file), name=name, y=y, z=z))
    for robot in robots:
        _ = robot.joints
    return robots


def _command(robot: Robot, names: Sequence[str], positions: Sequence[float]) -> None:
    order = JointState(name=tuple(names), position=tuple(positions))
    robot.topic("joint_commands").put(order)


def _read(robot: Robot, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Read positions and efforts of some joints."""
    states = robot.joints
    at = [states.name.index(name) for name in names]
    return np.array(states.position)[at], np.array(states.effort)[at]


def _measure_pendulums(
    engine: str, folder: Path, cases: Sequence[PendulumCase]
) -> Iterator[Figure]:
    with zensim.World(engine=engine, step_hz=240.0) as world:
        robots = _spawn_all(world, folder, (case.write_urdf() for case in cases))
        longest = max(case.period_s for case in cases)
        times: list[float] = []
        angles: list[list[float]] = []
        while world.time < (SWINGS + 1) * longest:
            world.step(8)
            times.append(world.time)
            angles.append([float(robot.joints.position[0]) for robot in robots])
    found = np.array(angles)
    yield Figure(
        what=f"{engine}: period of pendulums, off",
        unit="%",
        samples=tuple(
            PERCENT * abs(_find_period(times, found[:, i] + case.tilt_rad) / case.period_s - 1.0)
            for i, case in enumerate(cases)
        ),
        limit=Limit("max", "<=", MOST_PERIOD_OFF_PERCENT),
    )


def _find_period(times: Sequence[float], angles: FloatArray) -> float:
    """Find the mean time between rises through 0, interpolated between samples."""
    rising = np.flatnonzero((angles[:-1] < 0.0) & (angles[1:] >= 0.0))
    at = np.array(times)
    shares = angles[rising] / (angles[rising] - angles[rising + 1])
    crossings = at[rising] + shares * (at[rising + 1] - at[rising])
    return float(crossings[-1] - crossings[0]) / (len(crossings) - 1)


def _measure_arms(
    engine: str, folder: Path, what: str, cases: Sequence[ArmCase], step_hz: float
) -> Iterator[Figure]:
    with zensim.World(engine=engine, step_hz=step_hz) as world:
        robots = _spawn_all(world, folder, (case.write_urdf() for case in cases))
        for robot, case in zip(robots, cases, strict=True):
            _command(robot, case.names, case.aims.tolist())
        world.run_for(SETTLE_S)
        states = [_read(robot, case.names) for robot, case in zip(robots, cases, strict=True)]
    pairs = list(zip(cases, states, strict=True))
    yield _limited(
        f"{engine}: {what}: worst joint off its target",
        "mrad",
        (MILLI * _greatest(at - case.aims) for case, (at, _) in pairs),
        MOST_SAG_MRAD,
    )
    loads = [(case.find_loads(at.tolist()), efforts) for case, (at, efforts) in pairs]
    yield _limited(
        f"{engine}: {what}: efforts off gravity's, of the arm's greatest",
        "%",
        (PERCENT * _greatest(efforts - load) / _greatest(load) for load, efforts in loads),
        MOST_OFF_PERCENT,
    )


def _measure_weak_arm(engine: str, folder: Path) -> Iterator[Figure]:
    case = ArmCase(3, 5.0, strength=WEAK)
    with zensim.World(engine=engine, step_hz=240.0) as world:
        (robot,) = _spawn_all(world, folder, [case.write_urdf()])
        _command(robot, case.names, case.aims.tolist())
        world.run_for(SETTLE_S / 4.0)
        at, efforts = _read(robot, case.names)
        foretold = [one for one in robot.report.entries if one.subject.startswith("joint '")]
    yield Figure(
        what=f"{engine}: an arm of half the effort falls",
        unit="rad",
        samples=(_greatest(at - case.aims),),
        limit=Limit("min", ">=", LEAST_FALL_RAD),
    )
    yield _limited(
        f"{engine}: and no effort is over its limit by more than",
        "%",
        [PERCENT * (_greatest(efforts) / case.most_effort - 1.0)],
        0.01,
    )
    yield Figure(
        what=f"{engine}: and the report of the spawn predicts it",
        unit="entries",
        samples=(float(sum("'j0'" in one.subject for one in foretold)),),
        limit=Limit("min", ">=", 1.0),
    )


def _measure_masts(
    engine: str, folder: Path, what: str, cases: Sequence[MastCase]
) -> Iterator[Figure]:
    with zensim.World(engine=engine, step_hz=240.0) as world:
        robots = _spawn_all(world, folder, (case.write_urdf() for case in cases))
        for robot in robots:
            _command(robot, ("j0",), (LIFTED_M,))
        world.run_for(SETTLE_S)
        states = [
            _read(robot, [f"j{i}" for i in range(case.followers + 1)])
            for robot, case in zip(robots, cases, strict=True)
        ]
    pairs = list(zip(cases, states, strict=True))
    yield _limited(
        f"{engine}: {what}: first joint off its target",
        "mm",
        (MILLI * abs(float(at[0]) - LIFTED_M) for _, (at, _) in pairs),
        MOST_SAG_MM,
    )
    yield _limited(
        f"{engine}: {what}: effort off the virtual work of the weights",
        "%",
        (PERCENT * abs(float(own[0]) / case.lifts_per_leader - 1.0) for case, (_, own) in pairs),
        MOST_OFF_PERCENT,
    )
    led = [(case, at) for case, (at, _) in pairs if case.followers]
    if led:
        yield _limited(
            f"{engine}: {what}: followers off their leader",
            "mm",
            (MILLI * _greatest(at[1:] - case.multiplier * at[0] - case.offset) for case, at in led),
            MOST_SAG_MM,
        )


def _measure_gears(engine: str, folder: Path, cases: Sequence[GearCase]) -> Iterator[Figure]:
    with zensim.World(engine=engine, step_hz=240.0) as world:
        robots = _spawn_all(world, folder, (case.write_urdf() for case in cases))
        for robot, case in zip(robots, cases, strict=True):
            _command(robot, ("motor",), (SHAFT_RAD / case.multiplier,))
        world.run_for(SETTLE_S)
        states = [_read(robot, ("motor", "out")) for robot in robots]
    pairs = list(zip(cases, states, strict=True))
    yield _limited(
        f"{engine}: gears: lever off its shaft",
        "mrad",
        (MILLI * abs(float(at[1] - case.multiplier * at[0])) for case, (at, _) in pairs),
        MOST_SAG_MRAD,
    )
    yield _limited(
        f"{engine}: gears: effort of the shaft off the lever's load",
        "%",
        (
            PERCENT * abs(float(own[0]) / (case.shaft_effort * math.cos(float(at[1]))) - 1.0)
            for case, (at, own) in pairs
        ),
        MOST_OFF_PERCENT,
    )


def _measure_followed_wheels(engine: str, folder: Path) -> Figure:
    names = [f"{end}_{side}_joint" for side in ("left", "right") for end in ("front", "rear")]
    with zensim.World(engine=engine, step_hz=240.0) as world:
        (robot,) = _spawn_all(world, folder, [write_followed_wheels()])
        robot.drive(v=WHEEL_SPEED)
        world.run_for(SETTLE_S)
        at, _ = _read(robot, names)
    return _limited(
        f"{engine}: rear wheels that mimic driven ones off them after {SETTLE_S:g} s",
        "mrad",
        (MILLI * abs(float(at[i + 1] - at[i])) for i in (0, 2)),
        MOST_SAG_MRAD,
    )


def _greatest(numbers: FloatArray) -> float:
    return float(np.abs(numbers).max())


def _limited(what: str, unit: str, samples: Iterable[float], most: float) -> Figure:
    limit = Limit("max", "<=", most)
    return Figure(what=what, unit=unit, samples=tuple(samples), limit=limit)
