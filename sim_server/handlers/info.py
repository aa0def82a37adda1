"""What this server is and can do."""

from importlib.metadata import version

from zensim.proto.messages import telemetry_messages
from zensim.proto.messages.simulation_messages import State
from zensim.sim_server.desk import Desk

VERSION = version("zensim")


def info(desk: Desk, _: telemetry_messages.InfoRequest) -> telemetry_messages.Info:
    """Say who this is, and how it goes."""
    world, is_playing = desk.world, desk.world.state == State.PLAYING
    return telemetry_messages.Info(
        world=world.name,
        version=VERSION,
        sim_time_s=world.time_ns * 1e-9,
        steps=world.steps,
        epoch=world.epoch,
        step_ns=world.step_ns,
        real_time_factor=desk.meter.real_time_factor if is_playing else 0.0,
        target_real_time_factor=desk.target_real_time_factor,
        entities=len(world.entities),
        agents=len(world.claims.agents),
        claimed=len(world.claims),
        state=world.state_name,
        engine=world.engine.name,
        world_model=desk.world_model,
        seed=desk.seed,
        is_lockstep=desk.lockstep.settings.is_on,
    )
