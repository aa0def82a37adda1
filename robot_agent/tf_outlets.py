"""Where transforms are told: on the robot's own topic, and on the one topic of all robots.

There frames begin with the robot's namespace, so that robots of one kind don't share frames.
"""

from collections.abc import Callable

import msgspec

from proto import keys
from proto.faces import Faces
from proto.geometry import TransformStamped
from proto.ros_graph import Topic
from proto.topics import TFMessage
from robot_agent.outlet import Outlet


def tf_outlets(
    faces: Faces, namespace: str, own_key: str, value: Callable[[], TFMessage | None]
) -> list[Outlet]:
    """Declare a robot's transforms that move."""
    return _outlets(faces, namespace, Topic(own_key, TFMessage), keys.TF, value)


def tf_static_outlets(
    faces: Faces, namespace: str, value: Callable[[], TFMessage | None]
) -> list[Outlet]:
    """Declare a robot's transforms that never change."""
    own = Topic(keys.robot(namespace, keys.TF_STATIC), TFMessage, is_latched=True)
    return _outlets(faces, namespace, own, keys.TF_STATIC, value)


def with_namespace(message: TFMessage, namespace: str) -> TFMessage:
    """Let frames begin with the namespace, but for those that do already."""
    return TFMessage(tuple(_moved(edge, f"{namespace}/") for edge in message.transforms))


def _outlets(
    faces: Faces,
    namespace: str,
    own: Topic,
    shared_key: str,
    value: Callable[[], TFMessage | None],
) -> list[Outlet]:
    def shared_value() -> TFMessage | None:
        message = value()
        return None if message is None else with_namespace(message, namespace)

    outlets = []
    if faces.settings.has_own_tf:
        outlets.append(Outlet(faces, own, value))
    if faces.settings.has_global_tf:
        shared = msgspec.structs.replace(own, key=shared_key)
        outlets.append(Outlet(faces, shared, shared_value, is_shared=True))
    return outlets


def _moved(edge: TransformStamped, prefix: str) -> TransformStamped:
    header = msgspec.structs.replace(edge.header, frame_id=_within(edge.header.frame_id, prefix))
    return TransformStamped(header, _within(edge.child_frame_id, prefix), edge.transform)


def _within(frame_id: str, prefix: str) -> str:
    return frame_id if frame_id.startswith(prefix) else prefix + frame_id
