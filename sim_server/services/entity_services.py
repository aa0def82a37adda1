"""Services on entities: list, models, state, info, bounds, delete."""

from collections.abc import Sequence

import numpy as np

from zensim.proto.messages import entity_messages, telemetry_messages
from zensim.proto.messages.entity_messages import BoundsType
from zensim.proto.messages.result_messages import Result, SetEntityStateCode
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, DeleteEntityResponse
from zensim.proto.messages.standard_messages import Header, time_from_ns
from zensim.proto.se3 import IDENTITY_POSE, FloatArray
from zensim.sim_server.errors import PoseRefused, RequestRefused, UnsupportedFeature
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.queries.bounds_queries import BoundsUnsupported, make_bounds
from zensim.sim_server.queries.entity_filters import filter_entities
from zensim.sim_server.queries.frame_queries import (
    find_frame_pose,
    pose_to_world,
    states_to_frame,
    twist_to_world,
)
from zensim.sim_server.scene.scene import place_collision_shapes
from zensim.sim_server.service_parts import (
    CurrentWorld,
    DeferredResponse,
    Descriptions,
    Pacing,
    make_environment,
)
from zensim.sim_server.world.entity import check_entity_info
from zensim.sim_server.world.pose_conversion import (
    WORLD_FRAMES,
    pose_from_row,
    pose_to_row,
    twist_from_row,
    twist_to_row,
)
from zensim.sim_server.world.simulated_world import SimulatedWorld


def get_entity_bounds(
    world: SimulatedWorld, store: AssetStore, request: entity_messages.GetEntityBoundsOrder
) -> entity_messages.GetEntityBoundsResponse:
    """Compute the bounds of an entity's collision shapes, in the frame of its base link."""
    entity = world.entities.find(request.entity)
    wanted = BoundsType.BOX if request.type == entity_messages.ANY_BOUNDS else request.type
    if wanted not in set(BoundsType) or wanted == BoundsType.EMPTY:
        raise BoundsUnsupported(
            f"type {request.type} is not supported; use 1 (box), 2 (convex hull), 3 (sphere) "
            f"or {entity_messages.ANY_BOUNDS} (any)"
        )
    positions = world.states().joint_positions[world.entities.index.joints_of(entity.name)]
    shapes = place_collision_shapes(
        entity.model, IDENTITY_POSE[None], positions[None], store.vertices
    )
    return entity_messages.GetEntityBoundsResponse(bounds=make_bounds(shapes, BoundsType(wanted)))


def get_entity_info(
    world: SimulatedWorld, request: entity_messages.GetEntityInfoRequest
) -> entity_messages.GetEntityInfoReport:
    """Return category, tags, description and dynamics of an entity."""
    entity, engine = world.entities.find(request.entity), world.engine
    tier = engine.tier_of(entity.body)
    return entity_messages.GetEntityInfoReport(info=entity.info, dynamics=tier)


def set_entity_info(
    world: SimulatedWorld, request: entity_messages.SetEntityInfoRequest
) -> entity_messages.SetEntityInfoResponse:
    """Set category, tags and description of an entity."""
    world.entities.find(request.entity)
    world.set_info(request.entity, check_entity_info(request.info))
    return entity_messages.SetEntityInfoResponse()


def delete_entity(world: SimulatedWorld, request: DeleteEntityRequest) -> DeleteEntityResponse:
    """Delete an entity."""
    world.delete(request.entity)
    return DeleteEntityResponse()


def get_entities(
    world: SimulatedWorld,
    store: AssetStore,
    pacing: Pacing,
    request: entity_messages.GetEntitiesRequest,
) -> entity_messages.GetEntitiesResponse | DeferredResponse[entity_messages.GetEntitiesResponse]:
    """List the entities that pass the filters."""
    return filter_entities(
        world,
        store,
        pacing,
        request.filters,
        lambda names: entity_messages.GetEntitiesResponse(entities=names),
    )


def get_models(
    world: SimulatedWorld,
    current: CurrentWorld,
    descriptions: Descriptions,
    request: telemetry_messages.GetModelsRequest,
) -> telemetry_messages.GetModelsResponse:
    """Return the models of entities, each model once."""
    wanted = request.entities or world.entities.index.names
    entities = [world.entities.find(name) for name in wanted]
    # By identity first: entities of one description share a model, and hashing models is slow.
    distinct = {id(entity.model): entity.model for entity in entities}
    number = {model: i for i, model in enumerate(dict.fromkeys(distinct.values()))}
    model_of = {key: number[model] for key, model in distinct.items()}
    texts = [one.description if request.wants_descriptions else "" for one in entities]
    text_number = {text: i for i, text in enumerate(dict.fromkeys(texts))}
    return telemetry_messages.GetModelsResponse(
        Result(),
        world.entities.roster_number,
        tuple(
            telemetry_messages.EntityModel(
                entity.name,
                entity.namespace,
                model_of[id(entity.model)],
                world.claims.agent_of(entity.name),
                pose_from_row(entity.initial),
                entity.belongs_to_world,
                text_number[text],
                entity.name in world.fall_watch.falling,
            )
            for entity, text in zip(entities, texts, strict=True)
        ),
        tuple(number),
        current.model.scene,
        make_environment(world, current),
        tuple(text_number) if request.wants_descriptions else (),
        tuple(map(descriptions.list_files, number)) if request.wants_descriptions else (),
    )


def get_entity_state(
    world: SimulatedWorld, request: entity_messages.GetEntityStateOrder
) -> entity_messages.GetEntityStateResponse:
    """Return pose and twist of an entity; accelerations are 0, as they are not computed.

    In the world frame this is the state of the last control step, as published to agents.
    """
    if request.reference_frame in WORLD_FRAMES:
        row, time_ns = world.reported_state(request.entity)
        header = Header(time_from_ns(time_ns), "world")
        return entity_messages.GetEntityStateResponse(state=_make_entity_state(header, row))
    row = world.state_of(request.entity)
    (state,) = _FrameView(world, request.reference_frame).states(row[None])
    return entity_messages.GetEntityStateResponse(state=state)


def get_entities_states(
    world: SimulatedWorld,
    store: AssetStore,
    pacing: Pacing,
    request: entity_messages.GetEntitiesStatesOrder,
) -> (
    entity_messages.GetEntitiesStatesResponse
    | DeferredResponse[entity_messages.GetEntitiesStatesResponse]
):
    """Return the states of the entities that pass the filters, all at one step."""
    view = _FrameView(world, request.reference_frame)
    base, row = world.states().base, world.entities.index.row

    def respond(names: tuple[str, ...]) -> entity_messages.GetEntitiesStatesResponse:
        states = view.states(base[[row[name] for name in names]]) if names else []
        return entity_messages.GetEntitiesStatesResponse(entities=names, states=tuple(states))

    return filter_entities(world, store, pacing, request.filters, respond)


class _FrameView:
    """Entity states in a frame at one step; the motion of the frame itself is left out."""

    def __init__(self, world: SimulatedWorld, frame_id: str) -> None:
        self._frame = None if frame_id in WORLD_FRAMES else find_frame_pose(world, frame_id)
        name = "world" if self._frame is None else frame_id
        self._header = Header(time_from_ns(world.clock.time_ns), name)

    def states(self, rows: FloatArray) -> Sequence[entity_messages.EntityState]:
        """Convert state rows in the world, shape (n, 13)."""
        if self._frame is not None:
            rows = states_to_frame(self._frame, rows)
        return [_make_entity_state(self._header, row) for row in rows]


def _make_entity_state(header: Header, row: FloatArray) -> entity_messages.EntityState:
    return entity_messages.EntityState(header, pose_from_row(row), twist_from_row(row))


def set_entity_state(
    world: SimulatedWorld, request: entity_messages.SetEntityStateRequest
) -> entity_messages.SetEntityStateResponse:
    """Set pose and twist of an entity."""
    row = world.state_of(request.entity).copy()
    # A request of version 1 has no flags and sets both.
    is_version_1 = not (request.set_pose or request.set_twist or request.set_acceleration)
    if request.set_acceleration:
        raise UnsupportedFeature(
            "acceleration cannot be set: it follows from forces; set the pose or the twist"
        )
    frame_id = request.state.header.frame_id
    try:
        if request.set_pose or is_version_1:
            row[:7] = pose_to_world(world, frame_id, pose_to_row(request.state.pose))
        if request.set_twist or is_version_1:
            row[7:13] = twist_to_world(world, frame_id, twist_to_row(request.state.twist))
    except PoseRefused as error:
        raise RequestRefused(SetEntityStateCode.INVALID_POSE, str(error)) from error
    world.place(request.entity, np.asarray(row))
    return entity_messages.SetEntityStateResponse()
