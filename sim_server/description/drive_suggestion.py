"""The option that would drive a robot without a drive: guessed by geometry, and tried.

A trial predicts what friction makes of the drive on level ground, as for robots with a drive.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np

from zensim.proto.drive_orders import format_drive_order
from zensim.proto.messages.drive_messages import PAIR_SIZE, DriveOrder
from zensim.proto.messages.model_messages import TURNING_KINDS
from zensim.proto.rigid_transforms import rotate
from zensim.sim_server.description.ground_friction import GroundFriction
from zensim.sim_server.description.model_geometry import find_link_poses, turns_freely
from zensim.sim_server.description.motion_prediction import (
    STRAIGHT,
    is_moved_by_twist,
    predict_motion,
    turn_command,
)
from zensim.sim_server.description.plugins.drive_plugin import UnusableDrive
from zensim.sim_server.description.plugins.drive_selection import SUBJECT, make_drive
from zensim.sim_server.description.plugins.wheel_guess import (
    UPRIGHT_AXIS_Z,
    find_wheels_rolling_aside,
    has_wheels,
    list_drives,
    lower_suspensions,
)

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Model
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.motion_prediction import PredictedMotion
    from zensim.sim_server.description.report import ParseReport

PLANAR = DriveOrder("planar")
"""Moves the body, whatever its wheels do."""
ROLLER_KINDS = ("mecanum", "omni")
GOOD_SHARE = 0.1
"""Deviation of a speed or a turn, as a share of the command, up to which a drive is right."""
MOVES_SHARE = 0.5
"""Share of the commanded speed below which a drive does not move the robot."""
TURNS_SHARE = 0.1
"""Share of the commanded turn below which a drive does not turn the robot."""
MAX_DRIFT_RAD_S = 0.1
NOT_PREDICTED, STANDS = 2, 3


class TriedDrive(NamedTuple):
    """A drive, and what it makes of commands, as shares of them.

    Attributes:
        speed, turn: None where they cannot be predicted.
    """

    order: DriveOrder
    speed: float | None
    turn: float | None

    @property
    def rank(self) -> int:
        """Order of preference: as commanded, moving and turning, not predicted, neither."""
        if self.speed is None or self.turn is None:
            return NOT_PREDICTED
        if abs(self.speed - 1.0) <= GOOD_SHARE and abs(self.turn - 1.0) <= GOOD_SHARE:
            return 0
        return 1 if self.speed >= MOVES_SHARE and self.turn >= TURNS_SHARE else STANDS

    def describe(self) -> str:
        """Say what a trial gave."""
        if self.order == PLANAR:
            return "no wheels fit; it moves the body"
        if self.order.kind in ROLLER_KINDS:
            return "wheels by geometry, with rollers; the twist is applied to the body"
        if self.speed is None or self.turn is None:
            return "wheels by geometry; their motion is not predicted"
        if self.rank == 0:
            return "wheels by geometry; tried: as commanded"
        return (
            f"wheels by geometry; tried: {self.speed:.2f} of the commanded speed, "
            f"{self.turn:.2f} of the turn"
        )


def report_missing_drive(
    model: Model, lumped: LumpedModel, report: ParseReport, *, is_controlled: bool
) -> None:
    """Report that there is no drive, and the option that would give one.

    Args:
        model: A robot that may move, without a drive.
        lumped: Its links and joints, with the corners of meshes.
        report: Gets the entry, if the robot has wheels or interfaces for them.
        is_controlled: Whether controllers' files were given.
    """
    lowered = lower_suspensions(lumped)
    suggested = suggest_drive(model, lowered)
    wheels = {joint.name for joint in model.joints if turns_freely(joint)}
    has_interfaces = any(
        one.kind == "velocity" and one.joint in wheels for one in model.command_interfaces
    )
    if suggested is None and len(find_wheels_rolling_aside(lowered)) >= PAIR_SIZE:
        report.suspicious(
            SUBJECT, "no drive: its wheels roll along y, a drive goes along x; turn its links"
        )
        return
    if suggested is None and has_wheels(lowered):
        suggested = TriedDrive(PLANAR, 1.0, 1.0)
    if suggested is None and not has_interfaces:
        return
    hints = [] if is_controlled or not has_interfaces else ["the controllers' --controllers FILE"]
    if suggested is not None:
        hints.append(f"--drive {format_drive_order(suggested.order)} ({suggested.describe()})")
    advice = f"; use {' or '.join(hints)}, or --drive none" if hints else ""
    report.suspicious(SUBJECT, f"no drive: nothing moves the wheels{advice}")


def suggest_drive(model: Model, lumped: LumpedModel) -> TriedDrive | None:
    """Find the first drive that moves a robot as commanded, or else the best; None if none does.

    Args:
        model: Without a drive.
        lumped: Its links and joints, with suspensions where they rest.
    """
    best: TriedDrive | None = None
    for order in list_drives(lumped, model.name):
        tried = try_drive(model, order, lumped)
        if tried is not None and (best is None or tried.rank < best.rank):
            best = tried
        if best is not None and best.rank == 0:
            break
    return best if best is not None and best.rank < STANDS else None


def try_drive(model: Model, order: DriveOrder, lumped: LumpedModel) -> TriedDrive | None:
    """Predict the motion of a robot with a drive; None if the drive does not fit it."""
    try:
        drive = make_drive(order, lumped)
    except UnusableDrive:
        drive = None
    if drive is None:
        return None
    driven = msgspec.structs.replace(model, drive=drive, joints=lumped.joints)
    if is_moved_by_twist(driven):
        return TriedDrive(order, 1.0, 1.0)
    if _stands_on_joints(order, lumped):
        return TriedDrive(order, None, None)
    try:
        # A description may have any numbers up to 1e12.
        with np.errstate(all="ignore"):
            friction = GroundFriction(driven, lumped.corners)
            straight = predict_motion(driven, STRAIGHT, friction)
            turn = predict_motion(driven, turn_command(drive), friction)
    except (ArithmeticError, np.linalg.LinAlgError):
        return TriedDrive(order, None, None)
    return _judge(order, straight, turn)


def _stands_on_joints(order: DriveOrder, lumped: LumpedModel) -> bool:
    """Whether joints that tilt, such as those of legs or rockers, carry wheels of a drive."""
    by_child = {joint.child: joint for joint in lumped.joints}
    by_name = {joint.name: joint for joint in lumped.joints}
    poses = find_link_poses(lumped.links[0].name, lumped.joints)
    for name in order.joints:
        above = by_child.get(by_name[name].parent)
        while above is not None:
            axis = rotate(poses[above.child].orientation, above.axis)
            if above.kind in TURNING_KINDS and abs(axis[2]) < UPRIGHT_AXIS_Z:
                return True
            above = by_child.get(above.parent)
    return False


def _judge(order: DriveOrder, straight: PredictedMotion, turn: PredictedMotion) -> TriedDrive:
    motions = (straight, turn)
    if not all(one.ground.rest.is_stable and one.ground.motion.is_converged for one in motions):
        return TriedDrive(order, None, None)
    if abs(straight.twist[2]) > MAX_DRIFT_RAD_S or not (straight.nominal[0] and turn.nominal[2]):
        return TriedDrive(order, 0.0, 0.0)
    speed, rate = straight.twist[0] / straight.nominal[0], turn.twist[2] / turn.nominal[2]
    return TriedDrive(order, speed, rate)
