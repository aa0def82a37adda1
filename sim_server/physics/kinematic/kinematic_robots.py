"""All kinematic robots as arrays: motors, twists, rolling wheels and arcs of one step."""

from dataclasses import dataclass, field

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.kinematic.collision_limits import STOPPING_GAP_M, DiscMotions
from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarVehicle
from zensim.sim_server.physics.kinematic.tier_body_table import (
    ArrayPool,
    RowSelection,
    Tier,
    TierBodyTable,
    rotate_by_heading,
    select_rows,
)
from zensim.sim_server.scene.broad_phase import IntArray

MIN_TURN_RAD = 1e-300
"""Stands for no turn [rad], of which an arc has no radius."""


def ramp_towards(now: FloatArray, wanted: FloatArray, most: FloatArray | float) -> FloatArray:
    """Bring numbers nearer to what is wanted, by so much at most."""
    return np.minimum(np.maximum(wanted, now - most), now + most)


def compute_steered_twists(
    vehicle: PlanarVehicle, speeds: FloatArray, angles: FloatArray
) -> FloatArray:
    """Find root twists (3, n) of cars and tricycles, which turn about their unsteered axle.

    Args:
        vehicle: Of all of them.
        speeds: (n, k) of the driven wheels [rad/s].
        angles: (n, s) of the steering joints [rad].
    """
    ahead, turn = np.zeros(len(speeds)), np.zeros(len(speeds))
    for wheel in vehicle.wheels:
        if wheel.steering >= 0:
            x, y = _offset_from_axle(vehicle, wheel.place)
            sin, cos = np.sin(angles[:, wheel.steering]), np.cos(angles[:, wheel.steering])
            ahead += x * cos + y * sin
            turn += sin
    pulled, square = np.zeros(len(speeds)), np.full(len(speeds), 1e-12)
    for number, wheel in enumerate(vehicle.wheels[: speeds.shape[1]]):
        rim = _rim_speeds(vehicle, number, ahead, turn, angles)
        pulled += rim * speeds[:, number] * wheel.radius_m
        square += rim * rim
    share = pulled / square
    x, y = vehicle.axle
    spin = share * turn
    return np.stack([share * ahead + spin * y, -spin * x, spin])


def compute_rolling_speeds(
    vehicle: PlanarVehicle, twists: FloatArray, angles: FloatArray
) -> FloatArray:
    """Find how fast wheels (n, w) turn [rad/s] that roll along with root twists (3, n).

    Those that are driven are left out: w counts the others.
    """
    turn = twists[2]
    ahead = twists[0] - turn * vehicle.axle[1]
    driven = len(vehicle.driven.joints)
    found = np.zeros((twists.shape[1], len(vehicle.wheels) - driven))
    for at, wheel in enumerate(vehicle.wheels[driven:]):
        rim = _rim_speeds(vehicle, driven + at, ahead, turn, angles)
        found[:, at] = rim / wheel.radius_m
    return found


def _rim_speeds(
    vehicle: PlanarVehicle, number: int, ahead: FloatArray, turn: FloatArray, angles: FloatArray
) -> FloatArray:
    """Find how fast [m/s] rims go when the axle goes ahead and turns."""
    wheel = vehicle.wheels[number]
    x, y = _offset_from_axle(vehicle, wheel.place)
    forward, aside = ahead - turn * y, turn * x
    if wheel.steering >= 0:
        angle = angles[:, wheel.steering]
        forward = np.cos(angle) * forward + np.sin(angle) * aside
    return np.asarray(forward * wheel.ahead[0])


def _offset_from_axle(vehicle: PlanarVehicle, place: tuple[float, float]) -> tuple[float, float]:
    return place[0] - vehicle.axle[0], place[1] - vehicle.axle[1]


def integrate_arcs(
    heading: tuple[FloatArray, FloatArray], twists: FloatArray, dt_s: FloatArray | float
) -> FloatArray:
    """Find the ways (3, n) in the world: x, y, yaw of who keeps a twist (3, n) for a time.

    Args:
        heading: Its cosines and sines (n,) at the beginning.
        twists: vx, vy [m/s] along the heading and to its left, wz [rad/s].
        dt_s: How long; (n,) or one for all.
    """
    turn = twists[2] * dt_s
    half = turn * 0.5
    half[half == 0.0] = MIN_TURN_RAD
    sin = np.sin(half)
    chord = sin / half * dt_s
    along, across = chord * np.cos(half), chord * sin
    ahead = twists[0] * along - twists[1] * across
    left = twists[0] * across + twists[1] * along
    return np.stack([*rotate_by_heading(ahead, left, heading), turn])


TIPPING_SPEED_CHANGE_M_S = 0.1
"""A change of speed that may tip over what can be tipped over by its wheels."""
NO_TWISTS = np.zeros((3, 0))
CLEARABLE_HEIGHT_M = 0.01
"""What is no higher than this over the ground of a robot does not stop it."""


@dataclass
class VehicleGroup:
    """Robots that are driven alike.

    Attributes:
        all_rows: Of the members.
        rows: Of those in the kinematic tier.
        joints: (n, j) where all their joints are in the pool.
        targets: (n, w) likewise.
        driven, told: (n, k) those of the driven wheels, and their targets.
        wheels: (n, m) those of all wheels.
        matrix: (3, k) root twists by wheel speeds.
        radii: (k,) of driven wheels [m].
    """

    vehicle: PlanarVehicle
    matrix: FloatArray
    radii: FloatArray
    members: set[int] = field(default_factory=set)
    all_rows: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    rows: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    joints: IntArray = field(default_factory=lambda: np.zeros((0, 0), np.intp))
    targets: IntArray = field(default_factory=lambda: np.zeros((0, 0), np.intp))
    driven: IntArray = field(default_factory=lambda: np.zeros((0, 0), np.intp))
    told: IntArray = field(default_factory=lambda: np.zeros((0, 0), np.intp))
    wheels: IntArray = field(default_factory=lambda: np.zeros((0, 0), np.intp))

    def gather(self, rows: TierBodyTable) -> None:
        """Find who of the members is in the kinematic tier."""
        members = self.all_rows = np.array(sorted(self.members), np.intp)
        self.rows = members[rows.tier[members] == Tier.KINEMATIC]
        counts = np.arange(self.vehicle.joint_count)
        self.joints = rows.joint_start[self.rows][:, None] + counts
        self.targets = rows.target_start[self.rows][:, None] + np.arange(self.vehicle.width)
        self.driven = self.joints[:, list(self.vehicle.driven.joints)]
        self.told = self.targets[:, list(self.vehicle.driven.places)]
        self.wheels = self.joints[:, [wheel.joint for wheel in self.vehicle.wheels]]


def make_vehicle_group(vehicle: PlanarVehicle) -> VehicleGroup:
    """Begin with nobody."""
    radii = [wheel.radius_m for wheel in vehicle.wheels[: len(vehicle.driven.joints)]]
    return VehicleGroup(vehicle, np.array(vehicle.matrix).reshape(3, -1), np.array(radii))


class KinematicRobots:
    """Robots in the plane, their joints and what they were told.

    Attributes:
        rows: In the kinematic tier, make by make.
    """

    def __init__(self, rows: TierBodyTable, dt_s: float) -> None:
        self.rows: IntArray = np.zeros(0, np.intp)
        self._at: RowSelection = self.rows
        self._has_offset_discs = False
        self.positions = ArrayPool()
        self.velocities: FloatArray = np.zeros(0)
        self.targets = ArrayPool()
        self._known = rows
        self._dt_s = dt_s
        self._makes: dict[PlanarVehicle, VehicleGroup] = {}
        self._vehicles: dict[int, PlanarVehicle] = {}

    def add(self, row: int, vehicle: PlanarVehicle) -> None:
        """Take a robot in, joints and targets at zero."""
        known = self._known
        known.joint_start[row] = self.positions.allocate(vehicle.joint_count)
        known.target_start[row] = self.targets.allocate(vehicle.width)
        if len(self.velocities) < len(self.positions.numbers):
            more = len(self.positions.numbers) - len(self.velocities)
            self.velocities = np.concatenate([self.velocities, np.zeros(more)])
        self.set_joints(row, np.zeros(vehicle.joint_count), np.zeros(vehicle.joint_count))
        self.set_targets(row, np.zeros(vehicle.width))
        if vehicle not in self._makes:
            self._makes[vehicle] = make_vehicle_group(vehicle)
        self._makes[vehicle].members.add(row)
        self._vehicles[row] = vehicle

    def remove(self, row: int) -> None:
        """Forget a robot."""
        vehicle = self._vehicles.pop(row)
        self._makes[vehicle].members.discard(row)
        self.positions.free(int(self._known.joint_start[row]), vehicle.joint_count)
        self.targets.free(int(self._known.target_start[row]), vehicle.width)

    def vehicle(self, row: int) -> PlanarVehicle:
        """Find how a robot is driven."""
        return self._vehicles[row]

    def gather(self) -> None:
        """Note that robots came, went, or changed tiers."""
        for make in self._makes.values():
            make.gather(self._known)
        self.rows = np.concatenate([self.rows[:0], *(m.rows for m in self._makes.values())])
        self._at = select_rows(self.rows)
        self._has_offset_discs = bool(self._known.centre[:, self._at].any())

    def joints(self, row: int) -> tuple[FloatArray, FloatArray]:
        """Find positions and velocities (j,) of the joints of a robot."""
        span = self._joints(row)
        return self.positions.numbers[span].copy(), self.velocities[span].copy()

    def set_joints(self, row: int, positions: FloatArray, velocities: FloatArray) -> None:
        """Set both."""
        self.positions.numbers[self._joints(row)] = positions
        self.velocities[self._joints(row)] = velocities

    def targets_of(self, row: int) -> FloatArray:
        """Find the targets (w,) of a robot."""
        start = int(self._known.target_start[row])
        return self.targets.numbers[start : start + int(self._known.width[row])]

    def set_targets(self, row: int, targets: FloatArray) -> None:
        """Tell a robot what to do."""
        self.targets_of(row)[:] = targets

    def twist(self, row: int) -> FloatArray:
        """Find the root twist (3,) that its joints and what it was told give a robot."""
        vehicle = self._vehicles[row]
        if vehicle.twist >= 0:
            return self.targets_of(row)[vehicle.twist : vehicle.twist + 3]
        positions, velocities = (numbers[None] for numbers in self.joints(row))
        speeds = velocities[:, list(vehicle.driven.joints)]
        if vehicle.matrix:
            return np.asarray(self._makes[vehicle].matrix @ speeds[0])
        angles = positions[:, list(vehicle.steering)]
        return compute_steered_twists(vehicle, speeds, angles)[:, 0]

    def update_speed_bounds(self) -> None:
        """Bound how fast each may become by what it is told: of all robots, in either tier."""
        known = self._known
        for make in self._makes.values():
            vehicle, rows = make.vehicle, make.all_rows
            if not len(rows):
                continue
            widths, counts = np.arange(vehicle.width), np.arange(vehicle.joint_count)
            told = self.targets.numbers[known.target_start[rows][:, None] + widths]
            now = self.velocities[known.joint_start[rows][:, None] + counts]
            ahead, aside, spin = np.abs(known.twist[:, rows])
            rims, change = _commanded_rim_speeds(vehicle, told, now)
            known.pace[rows] = np.maximum(np.hypot(ahead, aside) + spin * known.radius[rows], rims)
            is_pulled = vehicle.can_tip & (change > TIPPING_SPEED_CHANGE_M_S)
            known.exceeds_limits[rows] = is_pulled | (ahead * spin > vehicle.max_lateral_accel)

    def propose_motions(self) -> tuple[FloatArray, FloatArray]:
        """Turn motors for a step, and find root twists and ways (3, n) of `rows`."""
        twists = [self._driven(make) for make in self._makes.values() if len(make.rows)]
        found = twists[0] if len(twists) == 1 else np.concatenate([NO_TWISTS, *twists], axis=1)
        return found, integrate_arcs(self._known.headings(self._at), found, self._dt_s)

    def _driven(self, make: VehicleGroup) -> FloatArray:
        vehicle, positions = make.vehicle, self.positions.numbers
        if vehicle.twist >= 0:
            twists = self.targets.numbers[make.targets[:, vehicle.twist : vehicle.twist + 3]]
            return np.ascontiguousarray(twists.T)
        most = vehicle.max_rim_accel * self._dt_s / make.radii
        told = self.targets.numbers[make.told]
        speeds = ramp_towards(self.velocities[make.driven], told, most)
        self.velocities[make.driven] = speeds
        if vehicle.matrix:
            return np.asarray(make.matrix @ speeds.T)
        self._steer(make)
        angles = positions[make.joints[:, list(vehicle.steering)]]
        twists = compute_steered_twists(vehicle, speeds, angles)
        rolling = [wheel.joint for wheel in vehicle.wheels[len(vehicle.driven.joints) :]]
        self.velocities[make.joints[:, rolling]] = compute_rolling_speeds(vehicle, twists, angles)
        return twists

    def _steer(self, make: VehicleGroup) -> None:
        """Turn what is steered; it turns on the spot too, so that nothing holds it up."""
        vehicle, positions = make.vehicle, self.positions.numbers
        told = self.targets.numbers[make.targets]
        steered = make.joints[:, list(vehicle.steered.joints)]
        most = np.array(vehicle.steering_rad_s) * self._dt_s
        angles = ramp_towards(positions[steered], told[:, list(vehicle.steered.places)], most)
        self.velocities[steered] = (angles - positions[steered]) / self._dt_s
        by_speed = make.joints[:, list(vehicle.turned.joints)]
        self.velocities[by_speed] = told[:, list(vehicle.turned.places)]

    def disc_motions(
        self, way: FloatArray, discs: RowSelection, mine: RowSelection, unseen_s: float
    ) -> DiscMotions:
        """Say where discs want to go: those of `rows` by their ways, others are about where seen.

        Args:
            way: (3, n) of `rows`.
            discs: Rows of all d discs.
            mine: Where `rows` are among them.
            unseen_s: For how long nobody looks where the others are.
        """
        known = self._known
        radius = known.radius[discs]
        ways, may_stop = np.zeros((len(radius), 2)), np.zeros(len(radius), np.bool_)
        dx, dy, turn = way
        if self._has_offset_discs:
            x, y = known.centre[:, self._at]
            arm = rotate_by_heading(x, y, known.headings(self._at))
            swung = rotate_by_heading(*arm, (np.cos(turn), np.sin(turn)))
            dx, dy = dx + swung[0] - arm[0], dy + swung[1] - arm[1]
        ways[mine, 0], ways[mine, 1] = dx, dy
        bend = known.pace[discs] * unseen_s
        chord = np.hypot(dx, dy)
        bend[mine] = _bound_chord_deviation(chord, np.abs(turn))
        may_stop[mine] = True
        reach = radius + bend + STOPPING_GAP_M
        reach[mine] += chord
        return DiscMotions(known.discs(discs), ways, radius, bend, reach, may_stop)

    def commit(self, twists: FloatArray, way: FloatArray, shares: FloatArray) -> None:
        """Go so much of the way; who did not go all of it stands."""
        known, at = self._known, self._at
        held = np.flatnonzero(shares < 1.0)
        if len(held):
            heading = known.headings(self.rows[held])
            way[:, held] = integrate_arcs(heading, twists[:, held], self._dt_s * shares[held])
            twists[:, held] = 0.0
        known.place[0, at] += way[0]
        known.place[1, at] += way[1]
        known.turn_to(at, known.yaw[at] + way[2])
        known.twist[:, at] = twists
        self._roll_on(shares, is_free=not len(held))

    def _roll_on(self, shares: FloatArray, *, is_free: bool) -> None:
        at = 0
        for make in self._makes.values():
            count = len(make.rows)
            if count and make.vehicle.joint_count:
                self._roll_group(make, shares[at : at + count, None], is_free=is_free)
            at += count

    def _roll_group(self, make: VehicleGroup, share: FloatArray, *, is_free: bool) -> None:
        vehicle = make.vehicle
        wheels = make.wheels
        rolled = self.velocities[wheels]
        if is_free:
            self.positions.numbers[wheels] += rolled * self._dt_s
        else:
            self.positions.numbers[wheels] += rolled * (self._dt_s * share)
            self.velocities[wheels] = rolled * (share >= 1.0)
        steering = make.joints[:, [*vehicle.steered.joints, *vehicle.turned.joints]]
        if steering.shape[1]:
            self.positions.numbers[steering] += self.velocities[steering] * self._dt_s

    def _joints(self, row: int) -> slice:
        start = int(self._known.joint_start[row])
        return slice(start, start + int(self._known.joint_count[row]))


def _commanded_rim_speeds(
    vehicle: PlanarVehicle, told: FloatArray, velocities: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Find how fast [m/s] robots may become that are told so, and by how much this changes."""
    if vehicle.twist >= 0:
        twist = told[:, vehicle.twist : vehicle.twist + 3]
        return np.abs(twist).sum(axis=1), np.zeros(len(told))
    driven = list(vehicle.driven.joints)
    radii = np.array([wheel.radius_m for wheel in vehicle.wheels[: len(driven)]])
    wanted = told[:, list(vehicle.driven.places)] * radii
    now = velocities[:, driven] * radii
    fastest = np.maximum(np.abs(wanted), np.abs(now)).max(axis=1)
    return fastest, np.abs(wanted - now).max(axis=1)


def _bound_chord_deviation(chord: FloatArray, turn: FloatArray) -> FloatArray:
    """Bound how far [m] arcs leave their chords; of a turn by more than a radian, generously."""
    return np.where(turn < 1.0, chord * turn / 4.0, chord * (1.0 + turn))
