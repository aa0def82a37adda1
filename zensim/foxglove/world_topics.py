"""Follows which topics and entities a world has, while clients are connected."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final, TypeAlias

from zensim.foxglove.live_topics import LiveTopic, list_live_topics
from zensim.foxglove.merged_transforms import Transform, make_transform
from zensim.foxglove.scene_entities import WORLD_FRAME, make_scene
from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages.entity_messages import EntityFilters, EntityState, GetEntitiesStatesOrder
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import Vector3
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse
from zensim.proto.rigid_transforms import from_rpy, to_rpy
from zensim.proto.ros2.liveliness_tokens import TOKEN_SPACE, AnnouncedEndpoint, parse_endpoint_token
from zensim.proto.service_catalog import GET_ENTITIES_STATES
from zensim.proto.topic_catalog import TF
from zensim.proto.topic_discovery import PUBLISHER, TopicFacts, list_robot_topics, merge_endpoints
from zensim.spawner.client.world_follower import FAILURES, Fetch, WorldFollower

if TYPE_CHECKING:
    from zensim.foxglove.scene_messages import SceneEntity

CALL_TIMEOUT_S: Final = 2.0
POSES_PERIOD_S: Final = 0.5
"""Least time between two calls for poses of entities without an agent, while one of them moves."""
MOVING_M_S, MOVING_RAD_S = 0.01, 0.01
MAX_PATTERN: Final = 500
"""Characters of a filter by names; instead of a longer one, the states of all are requested."""
TOKENS_DEPTH: Final = 65_536
Update: TypeAlias = Callable[[], None]
"""What remains to be done in the thread of the hub."""


class WorldTopics:
    """Tokens, events and models of one world."""

    def __init__(self, bus: Bus, world: str, domain: int | None) -> None:
        """Subscribe.

        Args:
            bus: Open session.
            world: Its name.
            domain: Of ROS 2, whose endpoints are watched; None = none.
        """
        self._bus, self._world, self._domain = bus, world, domain
        self._follower = WorldFollower(bus, world)
        tokens = f"{TOKEN_SPACE}/{domain}/**"
        self._tokens = None if domain is None else bus.watch_tokens(tokens, TOKENS_DEPTH)
        self._endpoints: dict[str, AnnouncedEndpoint] = {}
        self._is_changed = True
        self._needs_poses = False
        self._next_poses_s = 0.0
        self.scene: Mapping[str, SceneEntity] = {}
        """See `WorldFacts`."""
        self.own_tf: frozenset[str] = frozenset()
        """See `WorldFacts`."""
        self.odometry_frames: tuple[Transform, ...] = ()
        """See `WorldFacts`."""

    def take(self) -> dict[str, LiveTopic] | None:
        """Take changes; return all topics by name, if they may have changed."""
        self._follower.take()
        self._take_tokens()
        if not self._is_changed:
            return None
        self._is_changed = False
        self._find_own_tf()
        return list_live_topics(self._world, self._list_facts(), self._domain)

    def take_jobs(self) -> Sequence[Callable[[], Update | None]]:
        """Take the work that blocks and is due; what it returns is to be called in this thread."""
        if (fetch := self._follower.take_fetch()) is not None:
            return [partial(self._fetch_all, fetch)]
        now_s, models = time.monotonic(), self._follower.models
        if self._needs_poses and models is not None and now_s >= self._next_poses_s:
            self._needs_poses, self._next_poses_s = False, now_s + POSES_PERIOD_S
            return [partial(self._fetch_scene, models)]
        return []

    def _fetch_all(self, fetch: Fetch) -> Update | None:
        """Get the entities from the server; blocks for two timeouts at most."""
        models = fetch()
        if models is None:
            return None
        update = self._fetch_scene(models)

        def replace() -> None:
            self._is_changed = True
            self._follower.accept(models)
            update()

        return replace

    def _fetch_scene(self, models: GetModelsResponse) -> Update:
        """Get where entities without an agent are; without a reply, they are where they began."""
        try:
            states = self._get_states(find_unled(models))
        except FAILURES:
            states = {}
        poses = {name: state.pose for name, state in states.items()}
        scene, is_moving = make_scene(models, poses), any(map(is_in_motion, states.values()))

        def update() -> None:
            if models is self._follower.models:
                self.scene, self._needs_poses = scene, is_moving

        return update

    def _get_states(self, names: Sequence[str]) -> Mapping[str, EntityState]:
        if not names:
            return {}
        pattern = f"^({'|'.join(names)})$"
        filters = EntityFilters(pattern if len(pattern) <= MAX_PATTERN else "")
        found = self._bus.call(
            GET_ENTITIES_STATES,
            GetEntitiesStatesOrder(filters),
            world=self._world,
            timeout_s=CALL_TIMEOUT_S,
        )
        return dict(zip(found.entities, found.states, strict=False))

    def close(self) -> None:
        """End the subscriptions."""
        self._follower.close()
        if self._tokens is not None:
            self._tokens.close()

    def _take_tokens(self) -> None:
        for key, is_alive in self._tokens.take() if self._tokens is not None else ():
            if not is_alive:
                self._is_changed |= self._endpoints.pop(key, None) is not None
                continue
            endpoint = parse_endpoint_token(key)
            if endpoint is not None and endpoint.kind == PUBLISHER:
                self._endpoints[key] = endpoint
                self._is_changed = True

    def _find_own_tf(self) -> None:
        """Find the robots whose node in ROS 2 does not publish the shared transforms."""
        found = self._follower.models or GetModelsResponse()
        robots = [one for one in found.entities if one.agent and one.namespace]
        ends = self._endpoints.values()
        nodes = {one.node for one in ends if one.key == TF.suffix}
        sharing = {one.key.rpartition("/")[0] for one in ends if one.node in nodes}
        own = frozenset(one.namespace for one in robots) - sharing
        if own != self.own_tf:
            made = (
                make_odometry_frame(one, found.models[one.model])
                for one in robots
                if one.namespace in own
            )
            self.odometry_frames = tuple(one for one in made if one is not None)
            self.own_tf = own

    def _list_facts(self) -> list[TopicFacts]:
        announced = merge_endpoints(self._endpoints.values())
        return [*announced, *list_robot_topics(self._follower.models or GetModelsResponse())]


def find_unled(models: GetModelsResponse) -> list[str]:
    """List the entities without an agent, but not what is fixed in the world."""
    return [
        one.entity
        for one in models.entities
        if not (one.agent and one.namespace) and not models.models[one.model].is_static
    ]


def is_in_motion(state: EntityState) -> bool:
    """Whether an entity moves or turns."""
    twist = state.twist
    return _measure(twist.linear) > MOVING_M_S or _measure(twist.angular) > MOVING_RAD_S


def _measure(vector: Vector3) -> float:
    return math.hypot(vector.x, vector.y, vector.z)


def make_odometry_frame(entity: EntityModel, model: Model) -> Transform | None:
    """Make the transform from the world to the odometry frame of a robot; None if it has none.

    Odometry of encoders begins at zero where the robot was spawned.
    """
    drive = model.drive
    if drive is None or not drive.publish_odom_tf:
        return None
    at, turn = entity.initial_pose.position, entity.initial_pose.orientation
    pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    if drive.encoder is not None:
        upright = from_rpy(0.0, 0.0, to_rpy((turn.x, turn.y, turn.z, turn.w))[2])
        pose = (at.x, at.y, at.z, *upright)
    return make_transform(WORLD_FRAME, f"{entity.namespace}/{drive.odometry_frame}", pose)
