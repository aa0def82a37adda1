"""Joints that mimic others: whom they can follow, and what is wrong with those that cannot."""

from collections.abc import Iterable, Mapping

import msgspec

from zensim.proto.messages.model_messages import Joint
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.wording import shown

FOLLOWING = ("revolute", "continuous", "prismatic")


def with_true_mimics(joints: Iterable[Joint], report: Report) -> tuple[Joint, ...]:
    """Keep each <mimic> that can be followed; note the others, whose joints then move freely.

    Args:
        joints: Of the robot once lumped.
        report: Where oddities go.
    """
    by_name = {joint.name: joint for joint in joints}
    checked = []
    for joint in by_name.values():
        if joint.mimic is None:
            checked.append(joint)
        elif fault := _fault(joint, by_name):
            report.suspicious(f"joint {shown(joint.name)}: <mimic>", f"{fault}; it moves freely")
            checked.append(msgspec.structs.replace(joint, mimic=None))
        else:
            report.applied(f"joint {shown(joint.name)}: <mimic>", f"follows {joint.mimic.joint!r}")
            checked.append(joint)
    return tuple(checked)


def _fault(joint: Joint, by_name: Mapping[str, Joint]) -> str:
    leader, seen = joint, {joint.name}
    while leader.mimic is not None:
        name = leader.mimic.joint
        if name not in by_name:
            return f"joint {shown(name)} does not exist or is fixed"
        if name in seen:
            return f"joint {shown(name)} would follow itself"
        seen.add(name)
        leader = by_name[name]
        if leader.kind not in FOLLOWING:
            return f"joint {shown(name)} is {leader.kind}"
    if joint.kind not in FOLLOWING:
        return f"a {joint.kind} joint follows none"
    if joint.mimic is not None and joint.mimic.multiplier == 0.0:
        return "its multiplier is 0"
    return ""
