"""Friction of a model on level ground: how it moves for given targets of its actuators.

The ground has friction 1, so that a contact has the friction of its collision. Driven wheels turn
as commanded unless their torque is too small; passive wheels turn freely; casters that swivel
trail behind and slide nowhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import ZERO
from zensim.sim_server.description.coulomb_motion import (
    CoulombMotion,
    SlipTerms,
    solve_coulomb_motion,
)
from zensim.sim_server.description.model_geometry import NO_MESHES
from zensim.sim_server.description.rest_pose import (
    LEVEL_AXIS_Z,
    RestPose,
    RestSolver,
    axis_of,
    is_upright,
)

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Model
    from zensim.sim_server.description.model_geometry import FindCorners

FloatArray = npt.NDArray[np.float64]

MIN_TRAIL_M = 1e-3
"""Casters with less trail keep their direction."""
SWIVEL_PASSES = 2
MIN_DIRECTION = 0.1
"""Length on the ground from which a friction direction counts."""
NO_LINKS: frozenset[int] = frozenset()


@dataclass(frozen=True)
class JointTargets:
    """What actuators make of the joints.

    Attributes:
        positions: (j,) of all joints; those that no actuator holds are at 0.
        speeds: Target speed [rad/s] of each driven wheel, by index of its joint.
        efforts: Their greatest torques [N m].
    """

    positions: FloatArray
    speeds: dict[int, float]
    efforts: dict[int, float]


@dataclass(frozen=True)
class GroundContact:
    """A contact at rest.

    Attributes:
        link: Index among `Model.links`.
        place: (x, y) [m] from the root link.
        load_n: >= 0.
        friction: Along `along` and across it.
        along: Unit (x, y).
        wheel: Joint that it rolls about; -1 = none.
        rolling: (x, y) [m/rad] velocity over the ground by the speed of the wheel.
        is_trailing: Whether it is a wheel that swivels.
    """

    link: int
    place: tuple[float, float]
    load_n: float
    friction: tuple[float, float]
    along: tuple[float, float]
    wheel: int
    rolling: tuple[float, float]
    is_trailing: bool

    @property
    def radius_m(self) -> float:
        """Rolling radius; 0 without a wheel."""
        return float(np.hypot(*self.rolling))


@dataclass(frozen=True)
class GroundMotion:
    """Steady motion on level ground.

    Attributes:
        motion: The first three unknowns are the twist of the root link.
        contacts: Those that bear load.
        rest: The pose.
    """

    motion: CoulombMotion
    contacts: tuple[GroundContact, ...]
    rest: RestPose

    @property
    def twist(self) -> tuple[float, float, float]:
        """vx, vy [m/s] and wz [rad/s] of the root link."""
        return self.motion.twist


class GroundFriction:
    """Contacts and motion of one model.

    Args:
        model: The robot.
        corners: Needed for meshes.
    """

    def __init__(self, model: Model, corners: FindCorners = NO_MESHES) -> None:
        self.model = model
        self.rest = RestSolver(model, corners)
        self._rests: dict[bytes, RestPose] = {}
        modes = {actuator.joint: actuator.mode for actuator in model.actuators}
        found = [modes.get(joint.name) for joint in model.joints]
        self._driven = {i for i, mode in enumerate(found) if mode == "velocity"}
        self._is_passive = [
            mode is None and joint.mimic is None
            for mode, joint in zip(found, model.joints, strict=True)
        ]

    def move(self, targets: JointTargets, *, smooth: frozenset[int] = NO_LINKS) -> GroundMotion:
        """Find the motion under constant targets.

        Args:
            targets: Of the actuators.
            smooth: Links whose friction is left out.
        """
        positions = targets.positions.copy()
        found = self._move(targets, positions, smooth)
        for _ in range(SWIVEL_PASSES):
            if not self._turn_swivels(positions, found):
                break
            found = self._move(targets, positions, smooth)
        return found

    def list_contacts(self, rest: RestPose) -> tuple[GroundContact, ...]:
        """List the contacts of a rest pose."""
        return tuple(self._make_contact(rest, at) for at in range(len(rest.loads)))

    def _move(
        self, targets: JointTargets, positions: FloatArray, smooth: frozenset[int]
    ) -> GroundMotion:
        key = positions.tobytes()
        if key not in self._rests:
            self._rests[key] = self.rest.solve(positions)
        rest = self._rests[key]
        contacts = self.list_contacts(rest)
        rubbing = [one for one in contacts if not one.is_trailing and one.link not in smooth]
        terms = _make_slip_terms(self.model, rubbing, targets)
        return GroundMotion(solve_coulomb_motion(terms), contacts, rest)

    def _make_contact(self, rest: RestPose, at: int) -> GroundContact:
        support, link = rest.support, int(rest.support.link[at])
        shape = support.shapes[int(support.shape[at])]
        point, root = rest.points[at], rest.frames.place[0]
        along, friction = np.array([1.0, 0.0]), (shape.friction, shape.friction)
        if shape.contact.direction != ZERO:
            level = (rest.frames.turn[link] @ np.array(shape.contact.direction))[:2]
            across = shape.contact.friction_across
            if (length := float(np.hypot(*level))) > MIN_DIRECTION:
                along, friction = level / length, (shape.friction, across)
            else:
                friction = ((shape.friction + across) / 2.0,) * 2
        wheel = self._find_wheel(rest, link)
        rolling = np.zeros(2)
        if wheel >= 0:
            axis = axis_of(rest.frames, self.model.joints[wheel], wheel)
            x, y, z = (point - rest.frames.place[wheel + 1]).tolist()
            rolling = np.array([axis[1] * z - axis[2] * y, axis[2] * x - axis[0] * z])
        return GroundContact(
            link,
            (float(point[0] - root[0]), float(point[1] - root[1])),
            float(rest.loads[at]),
            friction,
            (float(along[0]), float(along[1])),
            wheel,
            (float(rolling[0]), float(rolling[1])),
            wheel >= 0 and self._is_passive[wheel] and self._find_swivel(rest, at) >= 0,
        )

    def _find_wheel(self, rest: RestPose, link: int) -> int:
        """Find the joint that a link rolls about; -1 = none."""
        joint = link - 1
        if link == 0 or joint in self.rest.free:
            return -1
        one = self.model.joints[joint]
        is_level = abs(axis_of(rest.frames, one, joint)[2]) < LEVEL_AXIS_Z
        is_turned = one.kind == "continuous" or (one.kind == "revolute" and joint in self._driven)
        return joint if is_turned and is_level else -1

    def _find_swivel(self, rest: RestPose, at: int) -> int:
        """Find the upright passive joint of a contact that trails behind it; -1 = none."""
        for joint in self.rest.tree.ancestors(int(rest.support.link[at])):
            one = self.model.joints[joint]
            if one.kind != "continuous" or not self._is_passive[joint]:
                continue
            if is_upright(axis_of(rest.frames, one, joint)):
                trail = rest.points[at] - rest.frames.place[joint + 1]
                return joint if np.hypot(trail[0], trail[1]) > MIN_TRAIL_M else -1
        return -1

    def _turn_swivels(self, positions: FloatArray, found: GroundMotion) -> bool:
        """Turn each swivel so that its contacts trail behind; return whether one turned."""
        rest, (vx, vy, wz) = found.rest, found.twist
        has_turned = False
        trails: dict[int, FloatArray] = {}
        for at in range(len(rest.loads)):
            if (joint := self._find_swivel(rest, at)) >= 0:
                trail = rest.points[at] - rest.frames.place[joint + 1]
                trails[joint] = trails.get(joint, np.zeros(3)) + trail
        for joint, trail in trails.items():
            x, y, _ = (rest.frames.place[joint + 1] - rest.frames.place[0]).tolist()
            speed = np.array([vx - wz * y, vy + wz * x])
            if np.hypot(*speed) < MIN_TRAIL_M:
                continue
            now, wanted = np.arctan2(trail[1], trail[0]), np.arctan2(-speed[1], -speed[0])
            turn = (wanted - now + np.pi) % (2.0 * np.pi) - np.pi
            positions[joint] += turn * np.sign(
                axis_of(rest.frames, self.model.joints[joint], joint)[2]
            )
            has_turned |= bool(abs(turn) > MIN_TRAIL_M)
        return has_turned


def _make_slip_terms(
    model: Model, contacts: list[GroundContact], targets: JointTargets
) -> SlipTerms:
    """Make the slips of contacts; unknown are the twist and the speeds of some wheels."""
    turning = _list_turning_wheels(contacts, targets)
    unknown = {joint: 3 + at for at, joint in enumerate(turning)}
    count = 3 + len(unknown)
    rows, offsets, scales, damping = [], [], [], np.zeros(count)
    for one in contacts:
        if one.load_n * max(one.friction) == 0.0:
            continue
        row, offset = np.zeros((2, count)), np.zeros(2)
        x, y = one.place
        row[:, :3] = [[1.0, 0.0, -y], [0.0, 1.0, x]]
        if one.wheel in unknown:
            row[:, unknown[one.wheel]] = one.rolling
        elif one.wheel >= 0:
            offset = -targets.speeds.get(one.wheel, 0.0) * np.array(one.rolling)
        ahead, aside = one.along
        scale = one.load_n * np.array(one.friction)[:, None] * [[ahead, aside], [-aside, ahead]]
        rows.append(scale @ row)
        offsets.append(scale @ offset)
        scales.append(one.load_n * max(one.friction))
    for joint, (effort, radius) in turning.items():
        is_driven = joint in targets.speeds
        damping[unknown[joint]] = 0.0 if is_driven else model.joints[joint].damping
        torque = effort if is_driven else model.joints[joint].friction
        if torque > 0.0:
            row = np.zeros((2, count))
            row[0, unknown[joint]] = torque
            rows.append(row)
            offsets.append(np.array([torque * targets.speeds.get(joint, 0.0), 0.0]))
            scales.append(torque / radius)
    return SlipTerms(
        np.array(rows).reshape(-1, 2, count),
        np.array(offsets).reshape(-1, 2),
        np.array(scales),
        damping,
    )


def _list_turning_wheels(
    contacts: list[GroundContact], targets: JointTargets
) -> dict[int, tuple[float, float]]:
    """List the wheels that friction can turn: their torque [N m] and radius [m]."""
    grip: dict[int, tuple[float, float]] = {}
    for one in contacts:
        if one.wheel >= 0 and one.radius_m > 0.0:
            pull, radius = grip.get(one.wheel, (0.0, 0.0))
            torque = one.load_n * max(one.friction) * one.radius_m
            grip[one.wheel] = pull + torque, max(radius, one.radius_m)
    return {
        joint: (targets.efforts.get(joint, 0.0), radius)
        for joint, (torque, radius) in grip.items()
        if targets.efforts.get(joint, 0.0) < torque
    }
