"""What this server offers: each service, what answers it, and the features that it backs.

A feature is announced if and only if it stands here beside a service.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec

from zensim.proto import service_catalog
from zensim.proto.messages.simulation_messages import (
    Feature,
    GetSimulatorFeaturesRequest,
    GetSimulatorFeaturesResponse,
    SimulatorFeatures,
)
from zensim.proto.service_catalog import Request, Response, Service
from zensim.sim_server.desk import Desk
from zensim.sim_server.handlers import (
    agents,
    bounds,
    entities,
    files,
    fleets,
    gazebo,
    gazebo_forces,
    gazebo_properties,
    info,
    infos,
    pacing,
    places,
    simulation,
    states,
    transitions,
    worlds,
)
from zensim.sim_server.later import Later
from zensim.sim_server.spawning import spawn_when_read

SPAWN_FORMATS = ("urdf", "sdf")


@dataclass(frozen=True)
class Offer:
    """One service of this server."""

    service: Service[Any, Any]
    handler: Callable[[Desk, Any], msgspec.Struct | Later]
    features: tuple[Feature, ...] = ()


def offer(
    service: Service[Request, Response],
    handler: Callable[[Desk, Request], Response | Later],
    *features: Feature,
) -> Offer:
    """Pair a service with what answers it; the types of both must fit."""
    return Offer(service, handler, features)


def features(_: Desk, __: GetSimulatorFeaturesRequest) -> GetSimulatorFeaturesResponse:
    """List what this server can do."""
    numbers = tuple(int(feature) for feature in FEATURES)
    about = SimulatorFeatures(numbers, SPAWN_FORMATS, f"zensim {info.VERSION}")
    return GetSimulatorFeaturesResponse(about)


OFFERS = (
    offer(
        service_catalog.SPAWN_ENTITY,
        spawn_when_read,
        Feature.SPAWNING,
        Feature.SPAWNING_RESOURCE_STRING,
    ),
    offer(service_catalog.SPAWN_ENTITIES, fleets.spawn_entities, Feature.SPAWNING_ENTITIES),
    offer(service_catalog.DELETE_ENTITY, entities.delete, Feature.DELETING),
    offer(
        service_catalog.GET_ENTITIES,
        entities.get_entities,
        Feature.ENTITY_TAGS,
        Feature.ENTITY_CATEGORIES,
    ),
    offer(service_catalog.GET_ENTITIES_STATES, states.get_states),
    offer(service_catalog.GET_ENTITY_STATE, states.get_state, Feature.ENTITY_STATE_GETTING),
    offer(service_catalog.SET_ENTITY_STATE, states.set_state, Feature.ENTITY_STATE_SETTING),
    offer(service_catalog.GET_ENTITY_INFO, infos.get_info, Feature.ENTITY_INFO_GETTING),
    offer(service_catalog.SET_ENTITY_INFO, infos.set_info, Feature.ENTITY_INFO_SETTING),
    offer(
        service_catalog.GET_ENTITY_BOUNDS,
        bounds.get_bounds,
        Feature.ENTITY_BOUNDS,
        Feature.ENTITY_BOUNDS_BOX,
        Feature.ENTITY_BOUNDS_CONVEX,
    ),
    offer(service_catalog.GET_SPAWNABLES, places.get_spawnables, Feature.SPAWNABLES),
    offer(service_catalog.GET_NAMED_POSES, places.get_named_poses, Feature.NAMED_POSES),
    offer(service_catalog.GET_NAMED_POSE_BOUNDS, places.get_named_pose_bounds, Feature.POSE_BOUNDS),
    offer(
        service_catalog.GET_SIMULATION_STATE,
        transitions.get_simulation_state,
        Feature.SIMULATION_STATE_GETTING,
    ),
    offer(
        service_catalog.SET_SIMULATION_STATE,
        transitions.set_simulation_state,
        Feature.SIMULATION_STATE_SETTING,
        Feature.SIMULATION_STATE_PAUSE,
    ),
    offer(
        service_catalog.STEP_SIMULATION,
        pacing.step,
        Feature.STEP_SIMULATION_SINGLE,
        Feature.STEP_SIMULATION_MULTIPLE,
    ),
    offer(service_catalog.SIMULATE_STEPS, pacing.simulate_steps, Feature.STEP_SIMULATION_ACTION),
    offer(service_catalog.CANCEL_STEPS, pacing.cancel_steps),
    offer(service_catalog.RUN_TO, pacing.run_to),
    offer(service_catalog.SET_SPEED, pacing.set_speed),
    offer(
        service_catalog.RESET_SIMULATION,
        simulation.reset,
        Feature.SIMULATION_RESET,
        Feature.SIMULATION_RESET_TIME,
        Feature.SIMULATION_RESET_STATE,
        Feature.SIMULATION_RESET_SPAWNED,
    ),
    offer(
        service_catalog.LOAD_WORLD,
        worlds.load_world,
        Feature.WORLD_LOADING,
        Feature.WORLD_RESOURCE_STRING,
    ),
    offer(service_catalog.UNLOAD_WORLD, worlds.unload_world, Feature.WORLD_UNLOADING),
    offer(service_catalog.GET_CURRENT_WORLD, worlds.get_current_world, Feature.WORLD_INFO_GETTING),
    offer(
        service_catalog.GET_AVAILABLE_WORLDS,
        worlds.get_available_worlds,
        Feature.AVAILABLE_WORLDS,
        Feature.WORLD_TAGS,
    ),
    offer(service_catalog.GAZEBO_GET_ENTITY_STATE, gazebo.get_entity_state),
    offer(service_catalog.GAZEBO_SET_ENTITY_STATE, gazebo.set_entity_state),
    offer(service_catalog.PAUSE_PHYSICS, gazebo.pause_physics),
    offer(service_catalog.UNPAUSE_PHYSICS, gazebo.unpause_physics),
    offer(service_catalog.RESET_WORLD, gazebo.reset_world),
    offer(service_catalog.APPLY_LINK_WRENCH, gazebo_forces.apply_link_wrench),
    offer(service_catalog.CLEAR_LINK_WRENCHES, gazebo_forces.clear_link_wrenches),
    offer(service_catalog.APPLY_JOINT_EFFORT, gazebo_forces.apply_joint_effort),
    offer(service_catalog.CLEAR_JOINT_EFFORTS, gazebo_forces.clear_joint_efforts),
    offer(service_catalog.GET_JOINT_PROPERTIES, gazebo_properties.get_joint_properties),
    offer(service_catalog.SET_JOINT_PROPERTIES, gazebo_properties.set_joint_properties),
    offer(service_catalog.GET_LINK_PROPERTIES, gazebo_properties.get_link_properties),
    offer(service_catalog.SET_LINK_PROPERTIES, gazebo_properties.set_link_properties),
    offer(service_catalog.GET_SIMULATOR_FEATURES, features),
    offer(service_catalog.CLAIM_ENTITY, agents.claim),
    offer(service_catalog.CLAIM_SHARE, agents.claim_share),
    offer(service_catalog.GET_MODELS, entities.get_models),
    offer(service_catalog.MISSING_ASSETS, files.missing_assets),
    offer(service_catalog.PUT_ASSET, files.put_asset),
    offer(service_catalog.GET_ASSET, files.get_asset),
    offer(service_catalog.INFO, info.info),
)
FEATURES = tuple(sorted(feature for one in OFFERS for feature in one.features))
