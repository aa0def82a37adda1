"""The tf tree of one robot: fixed and moving frames and their transforms."""

from collections.abc import Sequence

import msgspec

from zensim.proto.messages.drive_messages import DiffDrive, Drive
from zensim.proto.messages.model_messages import (
    MOVABLE_KINDS,
    Joint,
    JointStatePublisher,
    Model,
    Origin,
)
from zensim.proto.messages.standard_messages import (
    Header,
    Quaternion,
    Time,
    Transform,
    TransformStamped,
    Vector3,
)
from zensim.proto.rigid_transforms import (
    add,
    compose,
    from_axis_angle,
    invert,
    multiply,
    normalize,
    rotate,
)
from zensim.proto.tf_joints import list_hidden_joints
from zensim.proto.topic_catalog import JOINT_STATES
from zensim.robot_agent.odometry import BaseMotion

DEFAULT_JOINT_STATE_PUBLISHER = JointStatePublisher(update_rate_hz=JOINT_STATES.rate_hz)
"""Joint state publisher of models that specify none."""


class FrameEdge(msgspec.Struct, frozen=True):
    """Pose of `child` in `parent`."""

    parent: str
    child: str
    origin: Origin

    def to_message(self, stamp: Time) -> TransformStamped:
        """Make the message of the transform."""
        return _make_transform_stamped(self.parent, self.child, self.origin, stamp)


class BaseFrame(msgspec.Struct, frozen=True):
    """Child frame of odometry, and its fixed pose in the root link."""

    name: str
    pose_in_root: Origin


def find_base_frame(model: Model) -> BaseFrame:
    """Find the child frame of odometry.

    It is the drive's robot_base_frame. An unknown name has the pose of the root link, as in Gazebo;
    a frame that moves relative to the root link is replaced by the root link.
    """
    root = model.links[0].name
    if model.drive is None:
        return BaseFrame(root, Origin())
    name = model.drive.robot_base_frame
    path = _find_path_to_root(name, _index_fixed_edges(model), root)
    if path is None:
        return BaseFrame(root if name in _list_frame_names(model) else name, Origin())
    in_root = Origin()
    for edge in path:
        in_root = compose(edge.origin, in_root)
    return BaseFrame(name, in_root)


def list_fixed_edges(model: Model, base: BaseFrame) -> tuple[FrameEdge, ...]:
    """List the fixed transforms, with the base as root; parents come before children.

    An unknown base is connected to the root link, so that there is one tree.
    """
    root = model.links[0].name
    edges = _index_fixed_edges(model)
    path = _find_path_to_root(base.name, edges, root)
    if path is None:
        has_parent = model.drive is not None and model.drive.publish_odom_tf
        joint = (FrameEdge(base.name, root, Origin()),) if has_parent else ()
        return joint + tuple(edges.values())
    turned = tuple(FrameEdge(e.child, e.parent, invert(e.origin)) for e in path)
    return turned + tuple(edge for edge in edges.values() if edge not in path)


class MovingJoint:
    """One joint's transform at any position [rad or m]."""

    def __init__(self, joint: Joint, index: int) -> None:
        self.index = index
        self._joint = joint
        self._axis = normalize(joint.axis)

    def to_message(self, position: float, stamp: Time) -> TransformStamped:
        """Make the message of the child's pose."""
        joint = self._joint
        return _make_transform_stamped(joint.parent, joint.child, self._origin(position), stamp)

    def pose(self, position: float) -> tuple[float, ...]:
        """Find the child's pose in the parent: x y z, then the quaternion x y z w."""
        origin = self._origin(position)
        return (*origin.position, *origin.orientation)

    def _origin(self, position: float) -> Origin:
        origin = self._joint.origin
        if self._joint.kind != "prismatic":
            turned = multiply(origin.orientation, from_axis_angle(self._axis, position))
            return Origin(origin.position, turned)
        x, y, z = self._axis
        shift = rotate(origin.orientation, (x * position, y * position, z * position))
        return Origin(add(origin.position, shift), origin.orientation)


def list_moving_joints(model: Model) -> tuple[MovingJoint, ...]:
    """List the joints in tf: all that move, but wheels only on request."""
    hidden = list_hidden_joints(model)
    return tuple(
        MovingJoint(joint, index)
        for index, joint in enumerate(model.joints)
        if joint.kind in MOVABLE_KINDS and joint.name not in hidden
    )


def make_odometry_edge(frame_id: str, child_frame_id: str, motion: BaseMotion) -> FrameEdge:
    """Make the transform of odometry."""
    return FrameEdge(frame_id, child_frame_id, Origin(motion.position, motion.orientation))


def make_moving_transforms(
    joints: Sequence[MovingJoint], positions: Sequence[float], stamp: Time
) -> tuple[TransformStamped, ...]:
    """Make the transforms of joints; positions are of all joints of the model."""
    return tuple(joint.to_message(positions[joint.index], stamp) for joint in joints)


def _index_fixed_edges(model: Model) -> dict[str, FrameEdge]:
    edges = [FrameEdge(frame.parent, frame.name, frame.origin) for frame in model.frames]
    edges += [
        FrameEdge(j.parent, j.child, j.origin) for j in model.joints if j.kind not in MOVABLE_KINDS
    ]
    return {edge.child: edge for edge in edges}


def _find_path_to_root(
    name: str, edges: dict[str, FrameEdge], root: str
) -> tuple[FrameEdge, ...] | None:
    path: list[FrameEdge] = []
    while name != root:
        edge = edges.get(name)
        if edge is None or edge in path:
            return None
        path.append(edge)
        name = edge.parent
    return tuple(path)


def _list_frame_names(model: Model) -> set[str]:
    return {link.name for link in model.links} | {frame.name for frame in model.frames}


def _make_transform_stamped(
    parent: str, child: str, origin: Origin, stamp: Time
) -> TransformStamped:
    transform = Transform(Vector3(*origin.position), Quaternion(*origin.orientation))
    return TransformStamped(Header(stamp, parent), child, transform)


NO_DRIVE = DiffDrive(update_rate_hz=30.0)
"""Drive of models that have none, without wheels and topics."""


def get_drive(model: Model) -> Drive:
    """Get the drive of a model, `NO_DRIVE` if it has none."""
    return model.drive or NO_DRIVE
