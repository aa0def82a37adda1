"""Entities: which there are, what they look like, and taking one out."""

from zensim.proto.messages import entity_messages, telemetry_messages
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, DeleteEntityResponse
from zensim.sim_server.desk import Desk
from zensim.sim_server.later import Later
from zensim.sim_server.lookup.filters import passing
from zensim.sim_server.world.poses import pose_of


def delete(desk: Desk, request: DeleteEntityRequest) -> DeleteEntityResponse:
    """Take an entity out."""
    desk.world.delete(request.entity)
    return DeleteEntityResponse()


def get_entities(
    desk: Desk, request: entity_messages.GetEntitiesRequest
) -> entity_messages.GetEntitiesResponse | Later:
    """Name the entities that pass the filters."""
    return passing(
        desk, request.filters, lambda names: entity_messages.GetEntitiesResponse(entities=names)
    )


def get_models(
    desk: Desk, request: telemetry_messages.GetModelsRequest
) -> telemetry_messages.GetModelsResponse:
    """Tell how entities look."""
    wanted = request.entities or desk.world.roster().names
    entities = [desk.world.entity(name) for name in wanted]
    number = {model: i for i, model in enumerate(dict.fromkeys(e.model for e in entities))}
    return telemetry_messages.GetModelsResponse(
        Result(),
        desk.world.roster_number,
        tuple(
            telemetry_messages.EntityModel(
                entity.name,
                entity.namespace,
                number[entity.model],
                desk.world.claims.agent_of(entity.name),
                pose_of(entity.initial),
            )
            for entity in entities
        ),
        tuple(number),
        desk.source.scene,
    )
