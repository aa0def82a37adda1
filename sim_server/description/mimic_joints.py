"""Joints that mimic others, with the ends of their chains."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from zensim.proto.messages.model_messages import Joint


class FollowingJoint(NamedTuple):
    """A joint at `place` whose position is that of the joint at `leader` times ratio, + offset."""

    place: int
    leader: int
    ratio: float
    offset: float


def list_following_joints(moving: Sequence[Joint]) -> Iterator[FollowingJoint]:
    """List the joints that mimic another one of these, by their places among them."""
    places = {joint.name: place for place, joint in enumerate(moving)}
    for place, own in enumerate(moving):
        joint, at, ratio, offset = own, place, 1.0, 0.0
        while (mimic := joint.mimic) is not None and mimic.joint in places:
            offset += ratio * mimic.offset
            ratio *= mimic.multiplier
            at = places[mimic.joint]
            joint = moving[at]
        if at != place:
            yield FollowingJoint(place, at, ratio, offset)
