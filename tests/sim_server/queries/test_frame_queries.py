"""Poses of frames by name, and conversions between frames and the world."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.models import TRACK_M, WHEEL_RADIUS_M, on_ground
from tests.sim_server.fakes import a_spawn, a_world
from zensim.proto.messages.model_messages import Frame, Link, Model, Origin
from zensim.proto.se3 import from_rpy
from zensim.sim_server.queries.frame_queries import (
    FrameAmbiguous,
    FrameNotFound,
    find_frame_pose,
    pose_to_world,
    states_to_frame,
    twist_to_world,
)

numbers = st.floats(-3.0, 3.0)
LIDAR = Model("r", (Link("base"),), frames=(Frame("lidar", "base", Origin((0.5, 0.0, 0.2))),))


@pytest.mark.parametrize("frame_id", ["", "world", "map", "/map", "/world"])
def test_world_frame_has_several_names(frame_id: str) -> None:
    assert find_frame_pose(a_world("r0"), frame_id).tolist() == [0, 0, 0, 0, 0, 0, 1]


@pytest.mark.parametrize("frame_id", ["r1", "/r1", "r1::base", "r1/base"])
def test_entity_is_the_frame_of_its_root_link(frame_id: str) -> None:
    found = find_frame_pose(a_world("r0", "r1"), frame_id)

    assert found[:3] == pytest.approx([1.0, 0.0, WHEEL_RADIUS_M])


@pytest.mark.parametrize("frame_id", ["r1::left", "r1/left", "/r1/left"])
def test_link_is_a_frame_in_the_notations_of_gazebo_and_tf(frame_id: str) -> None:
    world = a_world("r0", "r1")
    world.place("r1", on_ground(2.0, 0.0, math.pi / 2.0))

    found = find_frame_pose(world, frame_id)

    assert found[:3] == pytest.approx([2.0 - TRACK_M / 2.0, 0.0, WHEEL_RADIUS_M])


def test_merged_link_is_a_frame() -> None:
    world = a_world()
    world.spawn(a_spawn("r", "team/a", model=LIDAR, base=on_ground(1.0)))

    assert find_frame_pose(world, "team/a/lidar")[:3] == pytest.approx([1.5, 0.0, 0.25])
    assert find_frame_pose(world, "r::lidar")[:3] == pytest.approx([1.5, 0.0, 0.25])


@pytest.mark.parametrize("frame_id", ["r9", "r0::nose", "r0/nose", "::", "/", "left", "r0::", "\n"])
def test_unknown_frame_is_refused(frame_id: str) -> None:
    with pytest.raises(FrameNotFound):
        find_frame_pose(a_world("r0"), frame_id)


def test_ambiguous_frame_is_refused() -> None:
    world = a_world()
    deep = Model("d", (Link("b/lidar"),))
    world.spawn(a_spawn("one", "a", model=deep))
    world.spawn(a_spawn("two", "a/b", model=LIDAR))

    with pytest.raises(FrameAmbiguous):
        find_frame_pose(world, "a/b/lidar")


@settings(max_examples=25)
@given(numbers, numbers, numbers, numbers, numbers)
def test_state_in_a_frame_converts_back_to_the_world(
    x: float, y: float, yaw: float, speed: float, rate: float
) -> None:
    world = a_world("r0")
    world.place("r0", on_ground(x, y, yaw))
    row = np.concatenate([[y, x, 1.0], from_rpy(0.1, 0.2, rate), [speed, 1.0, 0.0, 0.0, 0.0, rate]])

    in_frame = states_to_frame(find_frame_pose(world, "r0"), row[None])[0]

    assert pose_to_world(world, "r0", in_frame[:7])[:3] == pytest.approx(row[:3])
    assert twist_to_world(world, "r0", in_frame[7:]) == pytest.approx(row[7:])
