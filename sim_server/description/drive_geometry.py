"""Whether a drive's numbers agree with the robot's shape; they are used as written all the same."""

from collections.abc import Iterable, Mapping

import msgspec

from zensim.proto.messages.drive_messages import DiffDrive, Drive, WheelPair
from zensim.proto.messages.model_messages import Joint, Link, Origin, Shape, Vec3
from zensim.sim_server.description.lumping import Lumped
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.transforms import link_poses, placed, turned

TOLERANCE = 0.05
"""Share by which a written length may differ from the measured one."""
BACKWARD = -0.5
"""y of an axis that points to the right rather than the left."""
ROUND = ("sphere", "cylinder", "capsule")


class Wheel(msgspec.Struct, frozen=True):
    """A wheel as the links have it, in the root link, all joints at zero."""

    joint: str
    centre: Vec3
    axis: Vec3
    radius_m: float
    """0 where no collision is round."""


def check_drive(drive: Drive, lumped: Lumped, *, subject: str, report: Report) -> None:
    """Note diameters, separations, sides, axes and frames that the robot's links contradict."""
    if isinstance(drive, DiffDrive):
        for pair in drive.pairs:
            left, right = wheels_of((pair.left_joint, pair.right_joint), lumped)
            for fault in _faults(pair, left, right):
                report.suspicious(subject, fault)
    _check_base_frame(drive.robot_base_frame, lumped, subject, report)


def wheels_of(names: Iterable[str], lumped: Lumped) -> list[Wheel]:
    """Find the wheels that joints move."""
    joints = {joint.name: joint for joint in lumped.joints}
    links = {link.name: link for link in lumped.links}
    poses = link_poses(lumped.links[0].name, lumped.joints)
    return [_wheel(joints[name], links, poses) for name in names]


def apart_m(left: Wheel, right: Wheel) -> float:
    """Measure how far two wheels are apart along the axis of the first."""
    across = [a - b for a, b in zip(left.centre, right.centre, strict=True)]
    return abs(sum(part * axis for part, axis in zip(across, left.axis, strict=True)))


def _wheel(joint: Joint, links: Mapping[str, Link], poses: Mapping[str, Origin]) -> Wheel:
    pose = poses[joint.child]
    tyre = _tyre(links[joint.child])
    return Wheel(
        joint=joint.name,
        centre=placed(pose, tyre.origin.position),
        axis=turned(pose, joint.axis),
        radius_m=tyre.size[0],
    )


def _tyre(link: Link) -> Shape:
    rounds = [shape for shape in link.collisions if shape.kind in ROUND]
    return max(rounds, key=lambda shape: shape.size[0], default=Shape("sphere"))


def _faults(pair: WheelPair, left: Wheel, right: Wheel) -> list[str]:
    faults = []
    for wheel in (left, right):
        measured = 2.0 * wheel.radius_m
        if measured and _differ(pair.diameter_m, measured):
            faults.append(
                f"wheel_diameter {pair.diameter_m:g} m, but the wheel of {wheel.joint!r} has "
                f"{measured:g} m; used as written"
            )
        if wheel.axis[1] < BACKWARD:
            faults.append(f"the axis of {wheel.joint!r} points to -y: it rolls backward")
    across = [a - b for a, b in zip(left.centre, right.centre, strict=True)]
    apart = apart_m(left, right)
    if _differ(pair.separation_m, apart):
        faults.append(
            f"wheel_separation {pair.separation_m:g} m, but {left.joint!r} and {right.joint!r} "
            f"are {apart:g} m apart; used as written"
        )
    if across[1] < 0.0:
        faults.append(f"left_joint {left.joint!r} is on the right side: turns are reversed")
    elif "right" in left.joint.lower() and "left" in right.joint.lower():
        faults.append(f"left_joint is {left.joint!r}, right_joint {right.joint!r}: names swapped?")
    return faults


def _differ(written: float, measured: float) -> bool:
    return abs(written - measured) > TOLERANCE * measured


def _check_base_frame(frame: str, lumped: Lumped, subject: str, report: Report) -> None:
    root = lumped.links[0].name
    if frame == root or frame in {merged.name for merged in lumped.frames if merged.parent == root}:
        return
    named = {link.name for link in lumped.links} | {merged.name for merged in lumped.frames}
    fault = "moves on the root link" if frame in named else "is no link"
    report.suspicious(subject, f"robot_base_frame {frame!r} {fault}; it stands for {root!r}")
