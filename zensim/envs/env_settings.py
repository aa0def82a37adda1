"""EnvSettings: the worlds, robots and steps of environments, and the task by its name."""

from __future__ import annotations

from copy import deepcopy
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

import msgspec
import numpy as np

from zensim.api.api_errors import Invalid
from zensim.api.argument_checks import check_range, check_whole
from zensim.api.in_process_world import World, get_server
from zensim.api.spawning import check_keywords
from zensim.envs.avoidance_task import AvoidEachOther
from zensim.envs.batch import Batch
from zensim.envs.batch_sensors import SensorName
from zensim.envs.coverage_task import CoverField
from zensim.envs.formation_task import FollowFormation
from zensim.envs.navigation_task import DeliverGoods, NavigateMaze
from zensim.envs.pursuit_task import CatchEvader
from zensim.envs.reaching_task import ReachGoal
from zensim.envs.robot_task import RobotTask, WorldStart
from zensim.proto.messages.world_messages import GetMapRequest
from zensim.proto.process_limits import count_usable_cores
from zensim.proto.settings.pace_settings import PaceKeywords, list_equal_rates
from zensim.spawner.client.service_client import ServiceClient

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

TASKS: dict[str, type[RobotTask]] = {
    "reach": ReachGoal,
    "avoid": AvoidEachOther,
    "formation": FollowFormation,
    "navigate": NavigateMaze,
    "pursue": CatchEvader,
    "cover": CoverField,
    "deliver": DeliverGoods,
}
KINDS_OF_DYNAMICS = ("", "kinematic", "full")
RATE_TOLERANCE = 1e-6
MIN_KINEMATIC_HZ = 10.0
"""Least rate of steps of kinematic robots, for the limits of their drives."""


class EnvKeywords(TypedDict, total=False):
    """Settings of environments, as keyword arguments."""

    world: str | Path | World
    """Name of a shipped world, an SDF file, or a world with robots, which is copied as it is:
    `model`, `count` and `spacing` have no effect then."""
    model: str
    """Model of the robots; name of a shipped model, or a file."""
    count: int
    """Robots in a world."""
    spacing: float
    """Distance of neighbours at the start [m]."""
    dynamics: Literal["", "kinematic", "full"]
    """kinematic = robots move by their drives, in arrays; full = by MuJoCo; "" = as the task."""
    sensors: Sequence[SensorName]
    """Sensors whose measurements follow the numbers of the task: scan, imu."""
    rate_hz: float
    """Steps of the environment per simulated second; it divides that of control steps."""
    time_limit_s: float
    """Simulated seconds after which an episode is truncated."""
    max_speed_m_s: float
    """Forward velocity of an action of 1."""
    max_turn_rad_s: float
    """Turn of an action of 1."""
    threads: int
    """Threads that step the worlds; 0 = one for each core, at most one for each world."""


class EnvSettings(msgspec.Struct, frozen=True, kw_only=True):
    """See `EnvKeywords`."""

    world: str | Path | World = "empty"
    model: str = "box_bot"
    count: int = 1
    spacing: float = 1.0
    dynamics: Literal["", "kinematic", "full"] = ""
    sensors: tuple[SensorName, ...] = ()
    rate_hz: float = 10.0
    time_limit_s: float = 30.0
    max_speed_m_s: float = 0.5
    max_turn_rad_s: float = 2.0
    threads: int = 0


def make_settings(given: Mapping[str, object], task: RobotTask, count: int = 1) -> EnvSettings:
    """Make settings from keyword arguments.

    Args:
        given: See `EnvKeywords`.
        task: With settings that count where none are given.
        count: Robots of a world, where neither says so.

    Raises:
        TypeError: A keyword is unknown.
        Invalid: A number is out of range.
    """
    check_keywords(given, EnvKeywords)
    settings = EnvSettings(**{"count": count, **task.settings, **given})  # type: ignore[arg-type]
    if settings.dynamics not in KINDS_OF_DYNAMICS:
        raise Invalid(f"`dynamics` '{settings.dynamics}' is unknown", hint="use kinematic or full")
    for name, least, most in (
        ("rate_hz", 1e-3, 1e4),
        ("time_limit_s", 1e-3, 1e9),
        ("max_speed_m_s", 1e-3, 1e3),
        ("max_turn_rad_s", 0.0, 1e3),
    ):
        check_range(name, getattr(settings, name), least, most)
    check_whole("count", settings.count, 1, 1000)
    check_whole("threads", settings.threads, 0, 1024)
    return settings


def find_task(task: str | RobotTask) -> RobotTask:
    """Find a task by its name; copy a given one, as each environment has goals of its own.

    Raises:
        Invalid: There is none of this name.
    """
    if isinstance(task, RobotTask):
        return deepcopy(task)
    if task not in TASKS:
        raise Invalid(f"task '{task}' is unknown", hint=f"use {', '.join(TASKS)}, or a RobotTask")
    return TASKS[task]()


def make_world_start(world: World) -> WorldStart:
    """Make what a task may need of a world before it is copied."""
    server = get_server(world)
    client = ServiceClient(server.network, server.world.name)
    return WorldStart(
        np.array([robot.pose[:2] for robot in world.robots.values()]).reshape(-1, 2),
        lambda resolution_m: client.map(GetMapRequest(resolution_m=resolution_m)),
    )


def make_batch(settings: EnvSettings, worlds: int, task: RobotTask) -> Batch:
    """Make the worlds; raises what `World`, `spawn_fleet` and `Batch` raise.

    Args:
        settings: See `EnvKeywords`.
        worlds: Their number.
        task: That is prepared with a world.
    """
    threads = settings.threads or min(count_usable_cores(), worlds)
    if isinstance(settings.world, World):
        task.prepare(make_world_start(settings.world))
        return Batch(settings.world, worlds, threads=threads, sensors=settings.sensors)
    dynamics, rates = settings.dynamics or task.dynamics, PaceKeywords()
    if dynamics == "kinematic":
        # Arcs are exact: one integration for each step of the environment.
        hz = settings.rate_hz * max(1, ceil(MIN_KINEMATIC_HZ / settings.rate_hz))
        rates = list_equal_rates(hz)
    with World(settings.world, **rates) as world:
        world.spawn_fleet(
            settings.model, count=settings.count, spacing=settings.spacing, dynamics=dynamics
        )
        task.prepare(make_world_start(world))
        return Batch(world, worlds, threads=threads, sensors=settings.sensors)


def count_control_steps(batch: Batch, rate_hz: float) -> int:
    """Count the control steps in a step of the environment.

    Raises:
        Invalid: The rate does not divide that of control steps.
    """
    steps = 1.0 / (batch.control_period * rate_hz)
    if round(steps) < 1 or abs(steps - round(steps)) > RATE_TOLERANCE * steps:
        control_hz = 1.0 / batch.control_period
        raise Invalid(
            f"rate_hz={rate_hz:g} does not divide {control_hz:g} control steps per second",
            hint=f"use {control_hz:g} divided by a whole number",
        )
    return round(steps)
