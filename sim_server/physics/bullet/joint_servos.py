"""Efforts of motors and `<mimic>` couplings, by the equations of motion of a body.

Bullet's solver goes from row to row and stops after some iterations, so that heavy chains of joints
yield. What its rows have to do is found here directly, and applied before each step; the rows are
left with contacts and with the motion of the root.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import LIMITED_KINDS, Joint
from zensim.sim_server.description.mimic_joints import list_following_joints
from zensim.sim_server.physics.actuation import MAX_EFFORT, JointMotor
from zensim.sim_server.physics.engine import BoolArray, FloatArray, IntArray

POSITION_GAIN = 0.1
"""Share of the error of a position that a step corrects; Bullet's for its motors."""
COUPLING_ERP = 0.2
"""Share of the error of a follower that a step corrects."""
RESERVED_SHARE = 1e-3
"""Share of a motor's limit that is kept for Bullet's motor, or it could not move back."""


class JointDynamics(NamedTuple):
    """Equations of motion of the joints of a body: efforts = bias + mass accelerations.

    Attributes:
        bias: (k,) efforts without acceleration, while the root is at rest: gravity is in them.
        mass: (k, k) mass matrix; of a root that is not fixed, while it yields freely. That is the
            least that the joints feel, and the solver adds what the ground does to the root. More
            than what they feel would not be stable.
    """

    bias: FloatArray
    mass: FloatArray


def make_free_mass(matrix: FloatArray) -> FloatArray:
    """Make the mass matrix (k, k) of joints whose root yields, from that of all (6 + k, 6 + k)."""
    root, across = matrix[:6, :6], matrix[:6, 6:]
    return np.asarray(matrix[6:, 6:] - across.T @ np.linalg.solve(root, across))


@dataclass(frozen=True)
class Couplings:
    """Moving joints of a model, and the independent ones whose efforts are found.

    Attributes:
        joints: Bullet's numbers of all moving joints, whose places are used below.
        leaders: (m,) places of the independent joints.
        ratios: (k, m) speed of each joint per speed of an independent one; 0 for other joints.
        followers: (f,) places of joints with a `<mimic>`.
        offsets: (f,) of each, from its ratio times the position of the independent joint.
        bounds: (2, m) lowest and highest position of each independent joint.
        motors: Of each independent joint; None without.
        applied: Places of the joints that get an effort.
    """

    joints: tuple[int, ...]
    leaders: IntArray
    ratios: FloatArray
    followers: IntArray
    offsets: FloatArray
    bounds: FloatArray
    motors: tuple[JointMotor | None, ...]
    applied: IntArray

    @cached_property
    def applied_joints(self) -> list[int]:
        """Bullet's numbers of the joints that get an effort."""
        return [self.joints[place] for place in self.applied]


def find_couplings(
    moving: Sequence[tuple[int, Joint]], motors: Sequence[JointMotor], driven: Sequence[int]
) -> Couplings | None:
    """Find the joints of controllers, and those that lead or follow; None without any.

    Args:
        moving: Moving joints by Bullet's numbers.
        motors: Of controllers.
        driven: Bullet's numbers of joints of the drive. The ground holds their wheels, so that
            they, and what mimics them, are left to the solver.
    """
    numbers = [number for number, _ in moving]
    motor_of = {numbers.index(motor.joint): motor for motor in motors}
    left_out = {numbers.index(number) for number in driven}
    found = list_following_joints([joint for _, joint in moving])
    followers = [one for one in found if one.leader not in left_out]
    following = {one.place for one in followers}
    leaders = sorted((motor_of.keys() | {one.leader for one in followers}) - following - left_out)
    if not leaders:
        return None
    ratios = np.zeros((len(moving), len(leaders)))
    ratios[leaders, range(len(leaders))] = 1.0
    for one in followers:
        ratios[one.place, leaders.index(one.leader)] = one.ratio
    return Couplings(
        tuple(numbers),
        np.array(leaders, dtype=np.intp),
        ratios,
        np.array([one.place for one in followers], dtype=np.intp),
        np.array([one.offset for one in followers]),
        np.array([_find_bounds(moving[place][1]) for place in leaders]).T,
        tuple(motor_of.get(place) for place in leaders),
        np.flatnonzero(ratios.any(axis=1)),
    )


def _find_bounds(joint: Joint) -> tuple[float, float]:
    is_limited = joint.kind in LIMITED_KINDS and joint.lower <= joint.upper
    return (joint.lower, joint.upper) if is_limited else (-np.inf, np.inf)


class ServoTargets(NamedTuple):
    """What each independent joint is to do, (m,) each.

    The speed at the end of a step is `speed + slope (position - own position)`, limited; a joint
    without a motor that moves it has the effort.
    """

    is_moved: BoolArray
    slope: FloatArray
    position: FloatArray
    most_speed: FloatArray
    speed: FloatArray
    effort: FloatArray
    most_effort: FloatArray


def make_servo_targets(
    motors: Sequence[JointMotor | None], targets: list[float], dt_s: float
) -> ServoTargets:
    """Make the targets of independent joints from those of their body."""
    found = ServoTargets(np.zeros(len(motors), np.bool_), *np.zeros((6, len(motors))))
    for row, motor in enumerate(motors):
        if motor is None:
            continue
        kind, number = motor.find_target(targets)
        found.most_effort[row] = motor.effort
        if kind == JointTargetKind.POSITION:
            found.slope[row], found.position[row] = POSITION_GAIN / dt_s, number
            found.most_speed[row] = motor.velocity
        elif kind == JointTargetKind.VELOCITY:
            found.speed[row] = number
        elif kind == JointTargetKind.EFFORT:
            found.effort[row] = max(-motor.effort, min(number, motor.effort))
        found.is_moved[row] = kind in (JointTargetKind.POSITION, JointTargetKind.VELOCITY)
    return found


class JointServos:
    """Motors and couplings of one body."""

    def __init__(self, couplings: Couplings, dt_s: float) -> None:
        """Let all joints be free."""
        self.couplings = couplings
        self._dt_s = dt_s
        self._numbers: list[float] = []
        self._rest: FloatArray = np.zeros(len(couplings.leaders))
        self._motor_efforts: FloatArray = np.zeros(len(couplings.leaders))
        self._pushing: FloatArray = np.zeros(len(couplings.leaders))
        self._sent: FloatArray = self._pushing  # by the last call of `take_limits`
        self._set_targets(make_servo_targets((None,) * len(couplings.leaders), [], dt_s))

    def command(self, targets: list[float]) -> None:
        """Set the targets of the body; its motors in Bullet have their whole limits."""
        self._numbers = targets
        self._set_targets(make_servo_targets(self.couplings.motors, targets, self._dt_s))

    def list_efforts(self) -> Iterator[tuple[int, float, bool]]:
        """List Bullet's numbers of joints, efforts in the last step, and which are all of them.

        The others come on top of what Bullet's motor exerts. A motor that pushes a stop exerts its
        limit: what holds the joint is applied, and the stop bears the rest.
        """
        most = (1.0 - RESERVED_SHARE) * self.targets.most_effort
        is_whole = (self._pushing != 0.0) & (self.targets.most_effort < MAX_EFFORT)
        efforts = np.where(is_whole, self._pushing * most, self._motor_efforts)
        rows = zip(self.couplings.motors, efforts.tolist(), is_whole.tolist(), strict=True)
        for motor, effort, one in rows:
            if motor is not None:
                yield motor.joint, effort, one

    def take_limits(self) -> Iterator[tuple[JointMotor, int, float, float]]:
        """List motors with kind and number of their targets, and the rest of their limits.

        Only those are listed for which the rest in the last call is too much, or much too little,
        or that have reached or left a stop, which is their target then.
        """
        most = self.targets.most_effort
        found = most - np.abs(self._motor_efforts)
        changed = (self._rest > found) | (self._rest < found - RESERVED_SHARE * most)
        changed &= most < MAX_EFFORT
        is_due = changed | (self._pushing != self._sent)
        self._sent = self._pushing
        if not (is_due & self.targets.is_moved).any():
            return
        self._rest = np.where(changed, found - RESERVED_SHARE * most / 2.0, self._rest)
        for row in np.flatnonzero(is_due & self.targets.is_moved).tolist():
            motor = self.couplings.motors[row]
            assert motor is not None
            kind, number = motor.find_target(self._numbers)
            if side := int(self._pushing[row]):
                kind = JointTargetKind.POSITION
                number = float(self.couplings.bounds[int(side > 0), row])
            yield motor, kind, number, float(self._rest[row])

    def _set_targets(self, targets: ServoTargets) -> None:
        self.targets = targets
        self.is_active = bool(targets.is_moved.any()) or len(self.couplings.followers) > 0
        self._motor_efforts = np.where(targets.is_moved, self._motor_efforts, 0.0)
        self._pushing = np.where(targets.is_moved, self._pushing, 0.0)
        self._sent = np.zeros(len(self._sent))
        self._rest = targets.most_effort

    def find_efforts(
        self, positions: Sequence[float], speeds: Sequence[float], dynamics: JointDynamics
    ) -> list[float]:
        """Find the efforts of `Couplings.applied` in the next step.

        Args:
            positions: (k,) of all moving joints.
            speeds: Likewise.
            dynamics: Of the body.
        """
        couplings, targets = self.couplings, self.targets
        at, moving = np.array(positions), np.array(speeds)
        aim, self._pushing = self._find_aim(at[couplings.leaders], moving[couplings.leaders])
        wish = self._find_accelerations(at, moving, aim)
        efforts = dynamics.bias + dynamics.mass @ wish
        sums = efforts @ couplings.ratios
        is_over = np.abs(sums) > (1.0 - RESERVED_SHARE) * targets.most_effort
        if (is_over & targets.is_moved).any() or not targets.is_moved.all():
            own = couplings.ratios.T @ dynamics.mass @ couplings.ratios
            sums, change = limit_efforts(own, sums, targets)
            efforts = efforts + dynamics.mass @ (couplings.ratios @ change)
        self._motor_efforts = np.where(targets.is_moved, sums, 0.0)
        # The engine applies commanded efforts by itself.
        efforts[couplings.leaders] -= targets.effort
        applied: list[float] = efforts[couplings.applied].tolist()
        return applied

    def _find_aim(self, at: FloatArray, moving: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find the speeds (m,) at the end of the step, and the signs of motors that push stops.

        A motor neither brakes a joint before its stop nor moves it beyond.
        """
        targets, (least, most) = self.targets, self.couplings.bounds
        aim = targets.slope * (targets.position - at)
        aim = np.minimum(np.maximum(aim, -targets.most_speed), targets.most_speed) + targets.speed
        lowest = np.minimum((least - at) / self._dt_s, moving)
        highest = np.maximum((most - at) / self._dt_s, moving)
        is_at = ((aim > 0.0) & (at >= most)) | ((aim < 0.0) & (at <= least))
        is_stopped = targets.is_moved & (is_at | (aim > highest) | (aim < lowest))
        back = POSITION_GAIN / self._dt_s * (np.where(aim > 0.0, most, least) - at)
        pushing = np.where(is_stopped, np.sign(aim), 0.0)
        return np.where(is_at, back, np.clip(aim, lowest, highest)), pushing

    def _find_accelerations(
        self, at: FloatArray, moving: FloatArray, aim: FloatArray
    ) -> FloatArray:
        """Find the accelerations (k,) that reach the speeds; 0 of joints without a motor."""
        couplings, is_moved = self.couplings, self.targets.is_moved
        own = moving[couplings.leaders]
        wish = couplings.ratios @ np.where(is_moved, (aim - own) / self._dt_s, 0.0)
        if len(followers := couplings.followers):
            ratios = couplings.ratios[followers]
            ahead = at[followers] - ratios @ at[couplings.leaders] - couplings.offsets
            missing = ratios @ own - moving[followers] - COUPLING_ERP * ahead / self._dt_s
            wish[followers] += missing / self._dt_s
        return wish


def limit_efforts(
    mass: FloatArray, efforts: FloatArray, targets: ServoTargets
) -> tuple[FloatArray, FloatArray]:
    """Keep the efforts of independent joints within the limits of their motors.

    Args:
        mass: (m, m) mass matrix of the independent joints.
        efforts: (m,) that give the accelerations which are wished.
        targets: With the efforts of joints that are not moved.

    Returns:
        Efforts (m,), and the change of the accelerations (m,) that they mean.
    """
    most = (1.0 - RESERVED_SHARE) * targets.most_effort
    given = np.where(targets.is_moved, np.clip(efforts, -most, most), targets.effort)
    is_given = ~targets.is_moved | (np.abs(efforts) > most)
    found, change = efforts, np.zeros(len(efforts))
    for _ in range(2 * len(efforts) + 2):
        rows = np.flatnonzero(is_given)
        change = np.zeros(len(efforts))
        change[rows] = np.linalg.solve(mass[np.ix_(rows, rows)], (given - efforts)[rows])
        found = efforts + mass @ change
        is_over = targets.is_moved & ~is_given & (np.abs(found) > most)
        # A motor at its limit that moves its joint beyond the wish can do with less.
        is_beyond = targets.is_moved & is_given & (given * change > 0.0)
        if not (is_over | is_beyond).any():
            break
        given = np.where(is_over, np.clip(found, -most, most), given)
        is_given = (is_given | is_over) & ~is_beyond
    return np.clip(
        found, np.where(targets.is_moved, -most, found), np.where(targets.is_moved, most, found)
    ), change
