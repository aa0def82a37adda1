"""What entities are: category, description, tags."""

from proto import entities
from sim_server.desk import Desk
from sim_server.world.infos import checked


def get_info(desk: Desk, request: entities.GetEntityInfoRequest) -> entities.GetEntityInfoResponse:
    """Tell what an entity is."""
    return entities.GetEntityInfoResponse(info=desk.world.entity(request.entity).info)


def set_info(desk: Desk, request: entities.SetEntityInfoRequest) -> entities.SetEntityInfoResponse:
    """Say what an entity is."""
    desk.world.entity(request.entity)
    desk.world.describe(request.entity, checked(request.info))
    return entities.SetEntityInfoResponse()
