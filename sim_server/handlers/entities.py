"""Entities: which there are, what they look like, and taking one out."""

from zensim.proto import services, telemetry
from zensim.proto.result import Result
from zensim.sim_server.desk import Desk
from zensim.sim_server.later import Later
from zensim.sim_server.lookup.filters import passing
from zensim.sim_server.world.poses import pose_of


def delete(desk: Desk, request: services.DeleteEntityRequest) -> services.DeleteEntityResponse:
    """Take an entity out."""
    desk.world.delete(request.entity)
    return services.DeleteEntityResponse()


def get_entities(
    desk: Desk, request: services.GetEntitiesRequest
) -> services.GetEntitiesResponse | Later:
    """Name the entities that pass the filters."""
    return passing(
        desk, request.filters, lambda names: services.GetEntitiesResponse(entities=names)
    )


def get_models(desk: Desk, request: telemetry.GetModelsRequest) -> telemetry.GetModelsResponse:
    """Tell how entities look."""
    wanted = request.entities or desk.world.roster().names
    entities = [desk.world.entity(name) for name in wanted]
    number = {model: i for i, model in enumerate(dict.fromkeys(e.model for e in entities))}
    return telemetry.GetModelsResponse(
        Result(),
        desk.world.roster_number,
        tuple(
            telemetry.EntityModel(
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
