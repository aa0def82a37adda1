"""What can be spawned, and where: shipped robots, named poses of the world."""

from zensim.proto.messages import spawn_messages
from zensim.proto.messages.entity_messages import BoundsType
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.sim_server.description.builtin_models import list_builtin_models
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import Refused
from zensim.sim_server.later import Later
from zensim.sim_server.lookup.filters import tags_test
from zensim.sim_server.lookup.regions import bounds_of, links_at_zero
from zensim.sim_server.scene.convex_shapes import place_collision_shapes

SHIPPED = "zensim://"


def get_spawnables(
    desk: Desk, request: spawn_messages.GetSpawnablesRequest
) -> spawn_messages.GetSpawnablesResponse | Later:
    """List the robots that come with the server, once all of them are read."""
    if unknown := [source for source in request.sources if source != SHIPPED]:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"source {unknown[0][:80]!r} is not known; use {SHIPPED} or none",
        )
    orders = [
        SpawnEntityOrder(entity_resource=Resource(SHIPPED + name)) for name in list_builtin_models()
    ]

    def answer() -> spawn_messages.GetSpawnablesResponse:
        found = tuple(_spawnable(desk, order) for order in orders)
        return spawn_messages.GetSpawnablesResponse(spawnables=found)

    def is_read() -> bool:
        # Not by all(): each has to be asked for, so that all are read meanwhile.
        return sum(desk.descriptions.is_read(order) for order in orders) == len(orders)

    return answer() if is_read() else Later(lambda: desk.has_read and is_read(), answer)


def _spawnable(desk: Desk, order: SpawnEntityOrder) -> spawn_messages.Spawnable:
    model, _ = desk.descriptions.model(order)
    solids = list(place_collision_shapes(model, links_at_zero(model), desk.store.corners))
    bounds = bounds_of(solids, BoundsType.BOX)
    return spawn_messages.Spawnable(order.entity_resource, _in_words(model), bounds)


def _in_words(model: Model) -> str:
    drive = type(model.drive).__name__ if model.drive else "no drive"
    return f"{model.name}: {drive}, {model.mass_kg:.3g} kg"


def get_named_poses(
    desk: Desk, request: spawn_messages.GetNamedPosesRequest
) -> spawn_messages.GetNamedPosesResponse:
    """List the named poses of the world whose tags pass."""
    passes = tags_test(request.tags)
    found = (place.pose for place in desk.source.places if passes(place.pose.tags))
    return spawn_messages.GetNamedPosesResponse(poses=tuple(found))


def get_named_pose_bounds(
    desk: Desk, request: spawn_messages.GetNamedPoseBoundsRequest
) -> spawn_messages.GetNamedPoseBoundsResponse:
    """Tell how much room a named pose has."""
    for place in desk.source.places:
        if place.pose.name == request.name:
            return spawn_messages.GetNamedPoseBoundsResponse(bounds=place.bounds)
    raise Refused(
        ResultCode.NOT_FOUND,
        f"no pose {request.name[:80]!r} in this world; 'get_named_poses' lists those there are",
    )
