"""Many spawns in one request, all or nothing when asked for. simulation_interfaces 2.1.

What the Order adds to the Request travels in MessagePack and JSON only.
"""

from typing import ClassVar, Final

import msgspec

from zensim.proto.geometry import PoseStamped
from zensim.proto.result import Result
from zensim.proto.services import Resource, SpawnEntityOrder

MAX_SPAWNS: Final = 10_000
"""In one request."""
HELD_BACK: Final = "not spawned because of"
"""How the messages begin of those that could have been spawned, when all or none were."""


class SpawnEntity(msgspec.Struct, frozen=True):
    """One entity of many. Source: simulation_interfaces/msg/SpawnEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/SpawnEntity"

    name: str = ""
    allow_renaming: bool = False
    entity_resource: Resource = Resource()
    entity_namespace: str = ""
    initial_pose: PoseStamped = PoseStamped()


class SpawnEntitiesRequest(msgspec.Struct, frozen=True):
    """Put entities into the world. Source: simulation_interfaces/srv/SpawnEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntities_Request"

    spawn_requests: tuple[SpawnEntity, ...] = ()


class SpawnEntitiesOrder(SpawnEntitiesRequest, frozen=True):
    """The same with wishes that simulation_interfaces has no field for."""

    atomic: bool = False
    """All of them between two steps, or none of them."""
    common: SpawnEntityOrder = SpawnEntityOrder()
    """What holds for all: the resource of those that name none, and every wish of a single spawn.

    Its name, namespace and pose count for nothing.
    """


class SpawnResult(msgspec.Struct, frozen=True):
    """What became of one entity. Source: simulation_interfaces/msg/SpawnResult."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/SpawnResult"

    result: Result = Result()
    entity_name: str = ""


class SpawnEntitiesResponse(msgspec.Struct, frozen=True):
    """One result for each request, in order. Source: simulation_interfaces/srv/SpawnEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntities_Response"

    result: Result = Result()
    results: tuple[SpawnResult, ...] = ()
