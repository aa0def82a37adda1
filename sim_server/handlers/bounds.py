"""How much room entities take."""

from zensim.proto.messages import entity_messages
from zensim.proto.messages.entity_messages import BoundsType
from zensim.sim_server.desk import Desk
from zensim.sim_server.lookup.regions import BoundsUnsupported, Sight, bounds_of
from zensim.sim_server.scene.convex_shapes import place_collision_shapes


def get_bounds(
    desk: Desk, request: entity_messages.GetEntityBoundsOrder
) -> entity_messages.GetEntityBoundsResponse:
    """Tell the bounds of an entity's collisions, in the frame of its base link."""
    entity = desk.world.entity(request.entity)
    wanted = BoundsType.BOX if request.type == entity_messages.ANY_BOUNDS else request.type
    if wanted not in set(BoundsType) or wanted == BoundsType.EMPTY:
        raise BoundsUnsupported(
            f"type {request.type} cannot be asked for; use 1 (box), 2 (convex hull), 3 (sphere) "
            f"or {entity_messages.ANY_BOUNDS} (any)"
        )
    sight = Sight(desk.world.roster(), desk.world.reading(), desk.store.corners)
    links = sight.links_in_base(entity.model, entity.name)
    solids = list(place_collision_shapes(entity.model, links, desk.store.corners))
    return entity_messages.GetEntityBoundsResponse(bounds=bounds_of(solids, BoundsType(wanted)))
