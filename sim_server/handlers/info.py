"""What this server is and can do."""

from importlib.metadata import version

from proto import services, telemetry
from proto.services import Feature, State
from sim_server.desk import Desk

FEATURES = (
    Feature.SPAWNING,
    Feature.DELETING,
    Feature.SPAWNING_RESOURCE_STRING,
    Feature.ENTITY_STATE_GETTING,
    Feature.ENTITY_STATE_SETTING,
    Feature.SIMULATION_RESET,
    Feature.SIMULATION_RESET_TIME,
    Feature.SIMULATION_RESET_STATE,
    Feature.SIMULATION_RESET_SPAWNED,
    Feature.SIMULATION_STATE_GETTING,
    Feature.SIMULATION_STATE_SETTING,
    Feature.SIMULATION_STATE_PAUSE,
    Feature.STEP_SIMULATION_SINGLE,
    Feature.STEP_SIMULATION_MULTIPLE,
    Feature.STEP_SIMULATION_ACTION,
)
VERSION = version("zensim")


def features(
    _: Desk, __: services.GetSimulatorFeaturesRequest
) -> services.GetSimulatorFeaturesResponse:
    """List what this server can do."""
    return services.GetSimulatorFeaturesResponse(
        services.SimulatorFeatures(
            tuple(int(feature) for feature in FEATURES), ("urdf", "sdf"), f"zensim {VERSION}"
        )
    )


def info(desk: Desk, _: telemetry.InfoRequest) -> telemetry.Info:
    """Say who this is, and how it goes."""
    world, is_playing = desk.world, desk.world.state == State.PLAYING
    return telemetry.Info(
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
        engine=world.engine_name,
        world_model=desk.world_model,
        seed=desk.seed,
        is_lockstep=desk.lockstep.settings.is_on,
    )
