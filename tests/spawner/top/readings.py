"""Readings of a world with two robots, for tests of `zensim top`."""

import numpy as np

from zensim.proto.messages.drive_messages import DiffDrive, OmniDrive
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.process_messages import AgentStats, ProcessUsage
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse, Snapshot, Stats
from zensim.spawner.top.fleet_figures import FleetReading

MODELS = GetModelsResponse(
    entities=(
        EntityModel("r1", "r1", 0, agent="pool"),
        EntityModel("crate", "", 1),
        EntityModel("r2", "team/r2", 2, agent="pool"),
    ),
    models=(
        Model("box_bot", (), drive=DiffDrive()),
        Model("crate", ()),
        Model("omni[/]bot", (), drive=OmniDrive()),
    ),
)


def a_usage(second: int) -> ProcessUsage:
    """What a process uses that takes half a core."""
    return ProcessUsage("host", 7, float(second), second / 2.0, 64 << 20)


def a_snapshot() -> Snapshot:
    base = np.zeros((3, 13))
    base[0, :2], base[0, 7:9] = (1.0, 2.0), (3.0, 4.0)
    names = ("r1", "crate", "r2")
    return Snapshot(0, 0, 0, 1, names, base.astype("<f8").tobytes(), b"")


def a_reading(second: int, *, is_stale: bool = False) -> FleetReading:
    """What is reported at a second of wall time, of a world in real time."""
    return FleetReading(
        stats=Stats(
            "default",
            sim_time_s=float(second),
            steps=240 * second,
            real_time_factor=0.98,
            target_real_time_factor=1.0,
            state="playing",
            entities=3,
            usage=a_usage(second),
        ),
        agents={"pool": AgentStats("pool", 2, 100 * second, 0, a_usage(second))},
        snapshot=a_snapshot(),
        models=MODELS,
        odom_hz={"r1": 50.0},
        is_stale=is_stale,
    )
