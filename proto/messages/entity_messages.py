"""Services about existing entities: list, filter, info, bounds, state (simulation_interfaces 2.1)."""

from enum import IntEnum
from typing import ClassVar, Final

import msgspec

from zensim.proto.messages.model_messages import TierName
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt8
from zensim.proto.messages.standard_messages import Accel, Header, Pose, Twist, Vector3

MAX_TAGS = 64
MAX_TAG_LENGTH = 128
"""Characters of one tag."""
MAX_DESCRIPTION_LENGTH = 4096


class Category(IntEnum):
    """Kinds of entities. Source: simulation_interfaces/msg/EntityCategory."""

    OBJECT = 0
    ROBOT = 1
    HUMAN = 2
    DYNAMIC_OBJECT = 4
    STATIC_OBJECT = 5


class EntityCategory(msgspec.Struct, frozen=True):
    """What kind of thing. Source: simulation_interfaces/msg/EntityCategory."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityCategory"

    category: UInt8 = Category.OBJECT


class EntityInfo(msgspec.Struct, frozen=True):
    """Category, a word for people, tags for filters. Source: simulation_interfaces/msg/EntityInfo.

    At most `MAX_TAGS` tags of `MAX_TAG_LENGTH` characters, and a description of `MAX_DESCRIPTION_LENGTH`.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityInfo"

    category: EntityCategory = EntityCategory()
    description: str = ""
    tags: tuple[str, ...] = ()


class FilterMode(IntEnum):
    """How many of the tags must be there. Source: simulation_interfaces/msg/TagsFilter."""

    ANY = 0
    ALL = 1


class TagsFilter(msgspec.Struct, frozen=True):
    """Any or all of these tags. Source: simulation_interfaces/msg/TagsFilter."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/TagsFilter"

    tags: tuple[str, ...] = ()
    filter_mode: UInt8 = FilterMode.ANY


class BoundsType(IntEnum):
    """Shapes of a region. Source: simulation_interfaces/msg/Bounds."""

    EMPTY = 0
    BOX = 1
    CONVEX_HULL = 2
    SPHERE = 3


class Bounds(msgspec.Struct, frozen=True):
    """A region, in the frame that its owner names. Source: simulation_interfaces/msg/Bounds.

    By type: empty (unbounded), no points; box along the axes, its upper and its lower corner;
    convex hull, 3 points or more that are not on one line; sphere, its centre, and its radius as
    the x of a second point.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/msg/Bounds"

    type: UInt8 = BoundsType.EMPTY
    points: tuple[Vector3, ...] = ()


class EntityFilters(msgspec.Struct, frozen=True):
    """Which entities: those that pass all filters; an empty one lets all pass.

    `filter` is a POSIX extended regular expression found anywhere in the name; `bounds`, in the
    world frame, are overlapped by the entity. Source: simulation_interfaces/msg/EntityFilters.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityFilters"

    filter: str = ""
    categories: tuple[EntityCategory, ...] = ()
    tags: TagsFilter = TagsFilter()
    bounds: Bounds = Bounds()


class GetEntitiesRequest(msgspec.Struct, frozen=True):
    """Name the entities. Source: simulation_interfaces/srv/GetEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntities_Request"

    filters: EntityFilters = EntityFilters()


class GetEntitiesResponse(msgspec.Struct, frozen=True):
    """Names, in the order of spawning. Source: simulation_interfaces/srv/GetEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntities_Response"

    result: Result = Result()
    entities: tuple[str, ...] = ()


class EntityState(msgspec.Struct, frozen=True):
    """Pose and twist of an entity's base. Source: simulation_interfaces/msg/EntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityState"

    header: Header = Header()
    pose: Pose = Pose()
    twist: Twist = Twist()
    acceleration: Accel = Accel()


class GetEntityStateRequest(msgspec.Struct, frozen=True):
    """Ask where one entity is. Source: simulation_interfaces/srv/GetEntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityState_Request"

    entity: str = ""


class GetEntityStateResponse(msgspec.Struct, frozen=True):
    """State in the world frame. Source: simulation_interfaces/srv/GetEntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityState_Response"

    result: Result = Result()
    state: EntityState = EntityState()


class SetEntityStateRequest(msgspec.Struct, frozen=True):
    """Put an entity somewhere. Source: simulation_interfaces/srv/SetEntityState, 2.1."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityState_Request"

    entity: str = ""
    state: EntityState = EntityState()
    set_pose: bool = False
    set_twist: bool = False
    set_acceleration: bool = False


class SetEntityStateResponse(msgspec.Struct, frozen=True):
    """How it went. Source: simulation_interfaces/srv/SetEntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityState_Response"

    result: Result = Result()


ANY_BOUNDS: Final = 255
"""As the type of bounds that are asked for: the server chooses."""


class GetEntitiesStatesRequest(msgspec.Struct, frozen=True):
    """Ask where entities are. Source: simulation_interfaces/srv/GetEntitiesStates."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntitiesStates_Request"

    filters: EntityFilters = EntityFilters()


class GetEntitiesStatesOrder(GetEntitiesStatesRequest, frozen=True):
    """The same in a frame of choice."""

    reference_frame: str = ""
    """Empty = the world's."""


class GetEntitiesStatesResponse(msgspec.Struct, frozen=True):
    """Names and states of one step. Source: simulation_interfaces/srv/GetEntitiesStates."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntitiesStates_Response"

    result: Result = Result()
    entities: tuple[str, ...] = ()
    states: tuple[EntityState, ...] = ()


class GetEntityStateOrder(GetEntityStateRequest, frozen=True):
    """Ask where an entity is, in a frame of choice."""

    reference_frame: str = ""
    """Empty = the world's."""


class GetEntityInfoRequest(msgspec.Struct, frozen=True):
    """Ask what an entity is. Source: simulation_interfaces/srv/GetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityInfo_Request"

    entity: str = ""


class GetEntityInfoResponse(msgspec.Struct, frozen=True):
    """What it is. Source: simulation_interfaces/srv/GetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityInfo_Response"

    result: Result = Result()
    info: EntityInfo = EntityInfo()


class GetEntityInfoReport(GetEntityInfoResponse, frozen=True):
    """The same, and how it moves now."""

    dynamics: TierName = "full"
    """full: by forces and contacts; kinematic: as its drive says."""


class SetEntityInfoRequest(msgspec.Struct, frozen=True):
    """Say what an entity is, all of it anew. Source: simulation_interfaces/srv/SetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityInfo_Request"

    entity: str = ""
    info: EntityInfo = EntityInfo()


class SetEntityInfoResponse(msgspec.Struct, frozen=True):
    """How it went. Source: simulation_interfaces/srv/SetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityInfo_Response"

    result: Result = Result()


class GetEntityBoundsRequest(msgspec.Struct, frozen=True):
    """Ask how much room an entity takes. Source: simulation_interfaces/srv/GetEntityBounds."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityBounds_Request"

    entity: str = ""


class GetEntityBoundsOrder(GetEntityBoundsRequest, frozen=True):
    """The same in a shape of choice."""

    type: UInt8 = ANY_BOUNDS
    """One of `BoundsType`; 255 = a box."""


class GetEntityBoundsResponse(msgspec.Struct, frozen=True):
    """Of its collisions as the joints stand, in the frame of its base link.

    Empty when it collides with nothing. Source: simulation_interfaces/srv/GetEntityBounds.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityBounds_Response"

    result: Result = Result()
    bounds: Bounds = Bounds()
