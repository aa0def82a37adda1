"""Updates of scene nodes that move often, with less work for each message than those of viser."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import viser
from viser._messages import SceneNodeUpdateMessage, SetPositionMessage

from zensim.proto.se3 import FloatArray

WXYZ_COLUMNS: Final = [6, 3, 4, 5]
"""Columns of a pose in the quaternion order of viser."""
MOVED: Final = 1e-4
"""Change of a coordinate [m] or of a component of a quaternion that is not drawn."""


class InstanceUpdateMessage(SceneNodeUpdateMessage):
    """Update of a scene node; viser copies the arrays of each node, this one refers to them."""

    def as_serializable_dict(
        self, binary_buffers: list[memoryview] | None = None
    ) -> dict[str, Any]:
        """Make the fields of the message; arrays are appended to the buffers, but only once."""
        if binary_buffers is None:
            return super().as_serializable_dict() | {"type": SceneNodeUpdateMessage.__name__}
        updates = {name: _refer(array, binary_buffers) for name, array in self.updates.items()}
        return {
            "name": self.name,
            "updates": updates,
            "owner": self.owner,
            "type": SceneNodeUpdateMessage.__name__,
        }


class PlaceMessage(SetPositionMessage):
    """Position of a scene node; viser reads the types of all fields again for each message."""

    def as_serializable_dict(
        self,
        binary_buffers: list[memoryview] | None = None,  # noqa: ARG002  a position has no arrays
    ) -> dict[str, Any]:
        """Make the fields of the message."""
        return {
            "name": self.name,
            "position": self.position,
            "owner": self.owner,
            "type": SetPositionMessage.__name__,
        }


def _refer(array: np.ndarray, buffers: list[memoryview]) -> dict[str, Any]:
    """Refer to a contiguous array by its place among the buffers of a message."""
    place = next((i for i, one in enumerate(buffers) if _is_of(one, array)), len(buffers))
    if place == len(buffers):
        buffers.append(array.data)
    return {"__binary_index": place, "dtype": array.dtype.str}


def _is_of(buffer: memoryview, owner: object) -> bool:
    found: object = buffer.obj
    return found is owner


def move_instances(scene: viser.SceneApi, paths: Sequence[str], poses: FloatArray) -> None:
    """Move all instances of batched nodes to the same poses (k, 7)."""
    updates = {
        "batched_positions": np.ascontiguousarray(poses[:, :3], dtype=np.float32),
        "batched_wxyzs": np.ascontiguousarray(poses[:, WXYZ_COLUMNS], dtype=np.float32),
    }
    for path in paths:
        scene._queue_scene_message(InstanceUpdateMessage(path, dict(updates)))  # noqa: SLF001


def place_node(scene: viser.SceneApi, path: str, position: FloatArray) -> None:
    """Move a node to a position (3,) [m]; without the comparison of viser, which costs more."""
    x, y, z = position.tolist()
    scene._queue_scene_message(PlaceMessage(path, (x, y, z)))  # noqa: SLF001


def has_moved(before: FloatArray, after: FloatArray) -> bool:
    """Whether any of the poses (k, 7) differs visibly, or their number does."""
    if before.shape != after.shape:
        return True
    return bool(np.abs(after - before).max(initial=0.0) > MOVED)
