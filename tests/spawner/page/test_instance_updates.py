"""Updates of batched scene nodes: what is sent of poses, and how often."""

import numpy as np
import pytest
from viser._messages import SetPositionMessage

from zensim.spawner.page.instance_updates import (
    MOVED,
    InstanceUpdateMessage,
    PlaceMessage,
    has_moved,
    move_instances,
    place_node,
)


class Scene:
    """Keeps the messages that would be sent."""

    def __init__(self) -> None:
        self.messages: list[InstanceUpdateMessage | PlaceMessage] = []

    def _queue_scene_message(self, message: InstanceUpdateMessage | PlaceMessage) -> None:
        self.messages.append(message)


def make_poses(count: int) -> np.ndarray:
    return np.arange(7.0 * count).reshape(count, 7)


def test_nodes_at_the_same_poses_share_the_arrays_of_a_message() -> None:
    scene, buffers = Scene(), list[memoryview]()
    move_instances(scene, ["/a", "/b", "/c"], make_poses(2))  # type: ignore[arg-type]

    sent = [message.as_serializable_dict(buffers) for message in scene.messages]

    assert [one["name"] for one in sent] == ["/a", "/b", "/c"]
    assert sent[0]["updates"] == sent[1]["updates"] == sent[2]["updates"]
    assert [one.nbytes for one in buffers] == [2 * 3 * 4, 2 * 4 * 4]


def test_arrays_are_positions_and_quaternions_that_begin_with_w() -> None:
    scene, buffers = Scene(), list[memoryview]()
    move_instances(scene, ["/a"], make_poses(2))  # type: ignore[arg-type]

    (message,) = (message.as_serializable_dict(buffers) for message in scene.messages)

    places = [one["__binary_index"] for one in message["updates"].values()]
    positions, wxyzs = (np.frombuffer(buffers[i].tobytes(), "<f4") for i in places)
    assert [one["dtype"] for one in message["updates"].values()] == ["<f4", "<f4"]
    assert positions.tolist() == [0, 1, 2, 7, 8, 9]
    assert wxyzs.tolist() == [6, 3, 4, 5, 13, 10, 11, 12]


def test_message_is_one_of_viser_with_and_without_buffers() -> None:
    scene = Scene()
    move_instances(scene, ["/a"], make_poses(1))  # type: ignore[arg-type]
    (message,) = scene.messages

    assert message.as_serializable_dict([])["type"] == "SceneNodeUpdateMessage"
    assert message.as_serializable_dict()["type"] == "SceneNodeUpdateMessage"


def test_a_later_update_of_a_node_replaces_an_earlier_one() -> None:
    scene = Scene()
    for _ in range(2):
        move_instances(scene, ["/a", "/b"], make_poses(1))  # type: ignore[arg-type]

    assert len({message.redundancy_key() for message in scene.messages}) == 2


def test_a_place_is_the_message_that_viser_would_send() -> None:
    scene = Scene()
    place_node(scene, "/names/r1", np.array([1.0, -2.0, 0.5]))  # type: ignore[arg-type]
    (message,) = scene.messages

    assert message.as_serializable_dict([]) == (
        SetPositionMessage("/names/r1", (1.0, -2.0, 0.5)).as_serializable_dict([])
    )
    assert message.entity_state_key() == ("scene", "/names/r1")


@pytest.mark.parametrize(("change", "is_visible"), [(0.9 * MOVED, False), (1.1 * MOVED, True)])
def test_poses_have_moved_when_a_difference_is_visible(change: float, is_visible: bool) -> None:  # noqa: FBT001
    before = make_poses(3)
    after = before.copy()
    after[2, 1] += change

    assert has_moved(before, after) == is_visible


def test_another_number_of_poses_has_moved() -> None:
    assert has_moved(make_poses(2), make_poses(3))
    assert not has_moved(make_poses(0), make_poses(0))
