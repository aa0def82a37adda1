"""Which joints of a model are in joint states, and which have a frame of their own in tf."""

from zensim.proto.messages.model_messages import MOVABLE_KINDS, Model


def list_published_joints(model: Model) -> tuple[int, ...]:
    """List the joints in joint states: of the model's publisher and controllers, else all."""
    names = None
    if model.joint_state is not None:
        controlled = (name for one in model.joint_controllers for name in one.joints)
        names = {*model.joint_state.joints, *controlled}
    return tuple(
        index
        for index, joint in enumerate(model.joints)
        if joint.kind in MOVABLE_KINDS and (names is None or joint.name in names)
    )


def list_hidden_joints(model: Model) -> frozenset[str]:
    """List the joints without a frame in tf: wheels, but on request.

    Wheels are in tf if the drive has publish_wheel_tf, or if their joint states are published, from
    which robot_state_publisher would make their transforms.
    """
    published = {model.joints[index].name for index in list_published_joints(model)}
    has_wheels = model.drive is not None and model.drive.publish_wheel_tf
    wheels = () if has_wheels or model.drive is None else model.drive.joints
    return frozenset(wheels) - published
