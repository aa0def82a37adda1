"""What entities are: category, description, tags."""

from zensim.proto.messages import entity_messages
from zensim.sim_server.desk import Desk
from zensim.sim_server.physics.engine import SupportsTiers
from zensim.sim_server.world.infos import checked


def get_info(
    desk: Desk, request: entity_messages.GetEntityInfoRequest
) -> entity_messages.GetEntityInfoReport:
    """Tell what an entity is."""
    entity, engine = desk.world.entity(request.entity), desk.world.engine
    tier = engine.tier_of(entity.body) if isinstance(engine, SupportsTiers) else "full"
    return entity_messages.GetEntityInfoReport(info=entity.info, dynamics=tier)


def set_info(
    desk: Desk, request: entity_messages.SetEntityInfoRequest
) -> entity_messages.SetEntityInfoResponse:
    """Say what an entity is."""
    desk.world.entity(request.entity)
    desk.world.describe(request.entity, checked(request.info))
    return entity_messages.SetEntityInfoResponse()
