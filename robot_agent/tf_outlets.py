"""Where transforms are told: on the robot's own topic, and on the one topic of all robots.

There frames begin with the robot's namespace, so that robots of one kind don't share frames.
"""

from collections.abc import Callable
from typing import TypeAlias

import msgspec

from zensim.proto import keys
from zensim.proto.messages.standard_messages import TFMessage, TransformStamped
from zensim.proto.ros2.ros_graph import Topic
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.outlet import Outlet, Value

ValueOf: TypeAlias = Callable[[TFMessage], Value]


def tf_outlets(
    faces: TopicFactory, namespace: str, own_key: str, *, template: TFMessage, value_of: ValueOf
) -> list[Outlet]:
    """Declare a robot's transforms that move.

    Args:
        faces: Where.
        namespace: Of the robot.
        own_key: Of its own topic.
        template: The transforms before they have moved, with frames as described.
        value_of: Makes what is told of a template: of that one, or with other names of frames.
    """
    outlets = []
    if faces.settings.has_namespaced_tf:
        outlets.append(Outlet(faces, Topic(own_key, TFMessage), value_of(template)))
    if faces.settings.has_global_tf:
        shared = value_of(with_namespace(template, namespace))
        outlets.append(Outlet(faces, Topic(keys.TF, TFMessage), shared, is_shared=True))
    return outlets


def with_namespace(message: TFMessage, namespace: str) -> TFMessage:
    """Let frames begin with the namespace, but for those that do already."""
    return TFMessage(tuple(_moved(edge, f"{namespace}/") for edge in message.transforms))


def _moved(edge: TransformStamped, prefix: str) -> TransformStamped:
    header = msgspec.structs.replace(edge.header, frame_id=_within(edge.header.frame_id, prefix))
    return TransformStamped(header, _within(edge.child_frame_id, prefix), edge.transform)


def _within(frame_id: str, prefix: str) -> str:
    return frame_id if frame_id.startswith(prefix) else prefix + frame_id
