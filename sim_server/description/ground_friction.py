"""Friction of a model on level ground: how it moves for given targets of its actuators.

The ground has friction 1, so that a contact has the friction of its collision. Driven wheels turn
as commanded unless their torque is too small; passive wheels turn freely; casters that swivel
trail behind and slide nowhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.messages.model_messages import TURNING_KINDS, ZERO
from zensim.proto.se3 import FloatArray, wrap_angle
from zensim.sim_server.description.coulomb_motion import (
    CoulombMotion,
    SlipTerms,
    solve_coulomb_motion,
)
from zensim.sim_server.description.model_geometry import NO_MESHES, turns_freely
from zensim.sim_server.description.rest_pose import (
    LEVEL_AXIS_Z,
    RestPose,
    RestSolver,
    axis_of,
    is_upright,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zensim.proto.messages.model_messages import Model
    from zensim.sim_server.description.model_geometry import FindCorners


MAX_FRICTION = 20.0
"""Descriptions have 1e5 for 'does not slip'; such a number would drown the torque of motors."""
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
        spins: Joints that it rolls about, the nearest first, and the velocity (x, y) [m/rad] of
            the point of contact by the speed of each; a ball has several.
        is_trailing: Whether it is a wheel that swivels.
    """

    link: int
    place: tuple[float, float]
    load_n: float
    friction: tuple[float, float]
    along: tuple[float, float]
    spins: tuple[tuple[int, tuple[float, float]], ...]
    is_trailing: bool

    @property
    def wheel(self) -> int:
        """The nearest joint that it rolls about; -1 = none."""
        return self.spins[0][0] if self.spins else -1

    @property
    def radius_m(self) -> float:
        """Rolling radius; 0 without a wheel."""
        return float(np.hypot(*self.spins[0][1])) if self.spins else 0.0


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
        modes = {actuator.joint: actuator.mode for actuator in model.drive_actuators}
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
        own = min(shape.friction, MAX_FRICTION)
        along, friction = np.array([1.0, 0.0]), (own, own)
        if shape.contact.direction != ZERO:
            level = (rest.frames.turn[link] @ np.array(shape.contact.direction))[:2]
            across = min(shape.contact.friction_across, MAX_FRICTION)
            if (length := float(np.hypot(*level))) > MIN_DIRECTION:
                along, friction = level / length, (own, across)
            else:
                friction = ((own + across) / 2.0,) * 2
        spins = tuple(
            (joint, self._find_rolling(rest, joint, point))
            for joint in self._list_spins(rest, link)
        )
        return GroundContact(
            link,
            (float(point[0] - root[0]), float(point[1] - root[1])),
            float(rest.loads[at]),
            friction,
            (float(along[0]), float(along[1])),
            spins,
            bool(spins) and self._is_passive[spins[0][0]] and self._find_swivel(rest, at) >= 0,
        )

    def _list_spins(self, rest: RestPose, link: int) -> Iterator[int]:
        """List the joints that a link rolls about: that of a wheel, or those of a ball."""
        for joint in self.rest.tree.ancestors(link):
            one = self.model.joints[joint]
            is_level = abs(axis_of(rest.frames, one, joint)[2]) < LEVEL_AXIS_Z
            if joint in self._driven and one.kind in TURNING_KINDS:
                if is_level:
                    yield joint
                return
            if not turns_freely(one) or joint in self.rest.free or not self._is_passive[joint]:
                return
            if is_level:
                yield joint

    def _find_rolling(self, rest: RestPose, joint: int, point: FloatArray) -> tuple[float, float]:
        ax, ay, az = axis_of(rest.frames, self.model.joints[joint], joint).tolist()
        x, y, z = (point - rest.frames.place[joint + 1]).tolist()
        return ay * z - az * y, az * x - ax * z

    def _find_swivel(self, rest: RestPose, at: int) -> int:
        """Find the upright passive joint of a contact that trails behind it; -1 = none."""
        for joint in self.rest.tree.ancestors(int(rest.support.link[at])):
            one = self.model.joints[joint]
            if not turns_freely(one) or not self._is_passive[joint]:
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
            turn = wrap_angle(wanted - now)
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
        for joint, rolling in one.spins:
            if joint in unknown:
                row[:, unknown[joint]] = rolling
            else:
                offset -= targets.speeds.get(joint, 0.0) * np.array(rolling)
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
        for joint, rolling in one.spins:
            pull, most = grip.get(joint, (0.0, 0.0))
            radius = float(np.hypot(*rolling))
            torque = one.load_n * max(one.friction) * radius
            grip[joint] = pull + torque, max(most, radius)
    return {
        joint: (targets.efforts.get(joint, 0.0), radius)
        for joint, (torque, radius) in grip.items()
        if radius > 0.0 and targets.efforts.get(joint, 0.0) < torque
    }
