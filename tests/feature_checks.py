"""Checks of each announced feature through a client, of fakes or of a real server."""

import math
from collections.abc import Callable

import pytest

from zensim.proto.messages.entity_messages import (
    BoundsType,
    Category,
    EntityCategory,
    EntityFilters,
    EntityInfo,
    EntityState,
    TagsFilter,
)
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import Feature, ResetScope, State
from zensim.proto.messages.spawn_messages import (
    Resource,
    SpawnEntitiesOrder,
    SpawnEntity,
    SpawnEntityOrder,
)
from zensim.proto.messages.standard_messages import Point, Pose, Vector3
from zensim.spawner.client.sim_client import SimClient

PROBE = "probe"
BOX = (
    '<robot name="box"><link name="base"><inertial><mass value="2"/>'
    '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
    '<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link></robot>'
)
WORLD = (
    '<sdf version="1.6"><world name="docks"><include><uri>model://ground_plane</uri></include>'
    '<frame name="dock_1"><pose>1 2 0 0 0 0</pose><zensim:tags>parking charging</zensim:tags>'
    "<zensim:size>0.8 0.6 1</zensim:size></frame>"
    '<frame name="gate"><pose relative_to="dock_1">1 0 0 0 0 0</pose></frame></world></sdf>'
)


def spawn(client: SimClient, name: str = PROBE, info: EntityInfo | None = None) -> None:
    client.spawn(
        SpawnEntityOrder(name, entity_resource=Resource("box_bot"), snap_to_ground=True, info=info)
    )


def spawning(client: SimClient) -> None:
    spawn(client)
    assert PROBE in client.entities()


def spawning_text(client: SimClient) -> None:
    client.spawn(SpawnEntityOrder(PROBE, entity_resource=Resource(resource_string=BOX)))
    assert client.models((PROBE,)).models[0].mass_kg == 2.0


def spawning_many(client: SimClient) -> None:
    orders = tuple(SpawnEntity(f"{PROBE}_{i}") for i in range(3))
    common = SpawnEntityOrder(entity_resource=Resource("box_bot"))
    answer = client.spawn_all(SpawnEntitiesOrder(orders, atomic=True, common=common))
    assert [one.entity_name for one in answer.results] == [one.name for one in orders]
    again = client.spawn_all(SpawnEntitiesOrder(orders, common=common))
    assert {one.result.result for one in again.results} == {101}


def deleting(client: SimClient) -> None:
    spawn(client)
    client.delete(PROBE)
    assert PROBE not in client.entities()


def named_poses(client: SimClient) -> None:
    client.load_world(text=WORLD)
    poses = {pose.name: pose for pose in client.named_poses()}
    assert poses["gate"].pose.position == Point(2.0, 2.0, 0.0)
    charging = client.named_poses(TagsFilter(("charging",)))
    assert [(pose.name, pose.tags) for pose in charging] == [("dock_1", ("parking", "charging"))]


def pose_bounds(client: SimClient) -> None:
    client.load_world(text=WORLD)
    bounds = client.named_pose_bounds("dock_1")
    assert bounds.points == (Vector3(0.4, 0.3, 0.5), Vector3(-0.4, -0.3, -0.5))
    assert client.named_pose_bounds("gate").type == BoundsType.EMPTY


def tags(client: SimClient) -> None:
    spawn(client, info=EntityInfo(tags=("probing",)))
    assert client.entities(EntityFilters(tags=TagsFilter(("probing",)))) == (PROBE,)


def categories(client: SimClient) -> None:
    spawn(client, info=EntityInfo(EntityCategory(Category.HUMAN)))
    human = EntityFilters(categories=(EntityCategory(Category.HUMAN),))
    assert client.entities(human) == (PROBE,)


def bounds_of(kind: BoundsType, count: int, reach: float) -> Callable[[SimClient], None]:
    def proof(client: SimClient) -> None:
        client.spawn(SpawnEntityOrder(PROBE, entity_resource=Resource(resource_string=BOX)))
        bounds = client.entity_bounds(PROBE, kind)
        assert (bounds.type, len(bounds.points)) == (kind, count)
        assert max(point.x for point in bounds.points) == pytest.approx(reach)

    return proof


def state_getting(client: SimClient) -> None:
    spawn(client)
    assert client.entity_state(PROBE).pose.position.z == pytest.approx(0.06, abs=5e-3)
    assert client.entity_state(PROBE, PROBE).pose.position == Point()
    assert PROBE in client.entity_states()


def state_setting(client: SimClient) -> None:
    client.set_simulation_state(State.PAUSED)
    spawn(client)
    client.set_entity_state(PROBE, EntityState(pose=Pose(Point(3.0, 4.0, 5.0))))
    assert client.entity_state(PROBE).pose.position == Point(3.0, 4.0, 5.0)


def info_getting(client: SimClient) -> None:
    spawn(client)
    assert client.entity_info(PROBE).category.category == Category.ROBOT


def info_setting(client: SimClient) -> None:
    spawn(client)
    info = EntityInfo(EntityCategory(Category.DYNAMIC_OBJECT), "it moves", ("a", "b"))
    client.set_entity_info(PROBE, info)
    assert client.entity_info(PROBE) == info


def spawnables(client: SimClient) -> None:
    found = {one.entity_resource.uri: one for one in client.spawnables()}
    box_bot = found["zensim://box_bot"]
    assert box_bot.spawn_bounds.type == BoundsType.BOX
    client.spawn(SpawnEntityOrder(PROBE, entity_resource=box_bot.entity_resource))


def reset_of(scope: ResetScope) -> Callable[[SimClient], None]:
    def proof(client: SimClient) -> None:
        client.set_simulation_state(State.PAUSED)
        spawn(client)
        client.step(3)
        epoch = client.info().epoch
        client.reset(scope)
        info = client.info()
        assert info.epoch == epoch + 1
        goes = scope in (ResetScope.SPAWNED, ResetScope.ALL)
        assert (PROBE in client.entities()) != goes
        assert (info.steps == 0) == (scope in (ResetScope.TIME, ResetScope.ALL))

    return proof


def simulation_state(client: SimClient) -> None:
    assert client.simulation_state() == State.PLAYING
    client.set_simulation_state(State.PAUSED)
    assert client.simulation_state() == State.PAUSED
    client.set_simulation_state(State.PLAYING)
    assert client.simulation_state() == State.PLAYING


def steps(count: int) -> Callable[[SimClient], None]:
    def proof(client: SimClient) -> None:
        client.set_simulation_state(State.PAUSED)
        before = client.info().steps
        client.step(count)
        assert client.info().steps == before + count

    return proof


def step_action(client: SimClient) -> None:
    client.set_simulation_state(State.PAUSED)
    before = client.info().steps
    client.simulate_steps(5)
    assert client.info().steps == before + 5


def world_loading(client: SimClient) -> None:
    client.load_world("walls")
    assert "outer_walls" in client.entities()


def world_text(client: SimClient) -> None:
    client.load_world(text=WORLD)
    world = client.current_world()
    assert (world.name, world.tags) == ("docks", ())


def world_unloading(client: SimClient) -> None:
    client.unload_world()
    assert client.simulation_state() == State.NO_WORLD
    with pytest.raises(ServiceError, match="INCORRECT_STATE"):
        spawn(client)


def available_worlds(client: SimClient) -> None:
    found = {world.world_resource.uri for world in client.available_worlds()}
    assert {"empty", "walls"} <= found


def world_tags(client: SimClient) -> None:
    named = client.available_worlds()
    tag = next(tag for world in named for tag in world.tags)
    found = client.available_worlds(TagsFilter((tag,)))
    assert [world for world in named if tag in world.tags] == list(found)


FEATURE_CHECKS: dict[Feature, Callable[[SimClient], None]] = {
    Feature.SPAWNING: spawning,
    Feature.DELETING: deleting,
    Feature.NAMED_POSES: named_poses,
    Feature.POSE_BOUNDS: pose_bounds,
    Feature.ENTITY_TAGS: tags,
    Feature.ENTITY_BOUNDS: bounds_of(BoundsType.SPHERE, 2, math.sqrt(0.03)),
    Feature.ENTITY_BOUNDS_BOX: bounds_of(BoundsType.BOX, 2, 0.1),
    Feature.ENTITY_BOUNDS_CONVEX: bounds_of(BoundsType.CONVEX_HULL, 8, 0.1),
    Feature.ENTITY_CATEGORIES: categories,
    Feature.SPAWNING_RESOURCE_STRING: spawning_text,
    Feature.ENTITY_STATE_GETTING: state_getting,
    Feature.ENTITY_STATE_SETTING: state_setting,
    Feature.ENTITY_INFO_GETTING: info_getting,
    Feature.ENTITY_INFO_SETTING: info_setting,
    Feature.SPAWNABLES: spawnables,
    Feature.SIMULATION_RESET: reset_of(ResetScope.ALL),
    Feature.SIMULATION_RESET_TIME: reset_of(ResetScope.TIME),
    Feature.SIMULATION_RESET_STATE: reset_of(ResetScope.STATE),
    Feature.SIMULATION_RESET_SPAWNED: reset_of(ResetScope.SPAWNED),
    Feature.SIMULATION_STATE_GETTING: simulation_state,
    Feature.SIMULATION_STATE_SETTING: simulation_state,
    Feature.SIMULATION_STATE_PAUSE: simulation_state,
    Feature.STEP_SIMULATION_SINGLE: steps(1),
    Feature.STEP_SIMULATION_MULTIPLE: steps(7),
    Feature.STEP_SIMULATION_ACTION: step_action,
    Feature.WORLD_LOADING: world_loading,
    Feature.WORLD_RESOURCE_STRING: world_text,
    Feature.WORLD_TAGS: world_tags,
    Feature.WORLD_UNLOADING: world_unloading,
    Feature.WORLD_INFO_GETTING: world_text,
    Feature.AVAILABLE_WORLDS: available_worlds,
    Feature.SPAWNING_ENTITIES: spawning_many,
}
"""Each check requires a playing world without entities."""
