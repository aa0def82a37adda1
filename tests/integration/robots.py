"""Robots commanded over the network, and their odometry."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from tests.integration.processes import Server, eventually
from zensim.proto.bus.bus_session import Bus, BusPublisher, BusSubscription
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import (
    NANOSECONDS,
    Odometry,
    Twist,
    Vector3,
    ns_from_time,
)
from zensim.proto.topic_catalog import CMD_VEL, ODOM
from zensim.spawner.client.sim_client import SimClient

SEND_EVERY_S = 0.1
"""Simulation time between two commands; agents stop a robot after 0.5 s without one."""
STOP_S = 1.0
"""Simulation time in which a robot comes to rest."""


@dataclass
class Robot:
    """One robot's topics."""

    namespace: str
    odom: BusSubscription
    cmd_vel: BusPublisher
    last: Odometry | None = None
    turned_rad: float = 0.0
    """Accumulated turn over all received odometry."""
    _heading: float | None = None

    def read(self) -> list[Odometry]:
        """Take the received odometry."""
        samples = self.odom.take()
        found = [decode(Odometry, sample.payload, sample.encoding) for sample in samples]
        for odom in found:
            before = yaw(odom) if self._heading is None else self._heading
            self._heading = yaw(odom)
            self.turned_rad += _turn(before, self._heading)
            self.last = odom
        return found

    def command(self, linear: float, angular: float = 0.0) -> None:
        """Publish one velocity command."""
        twist = Twist(Vector3(x=linear), Vector3(z=angular))
        self.cmd_vel.send(encode(twist, Format.CDR))

    def newest(self) -> Odometry:
        """Take the received odometry and return the newest."""
        self.read()
        assert self.last is not None, f"no odometry of {self.namespace}"
        return self.last

    def now(self) -> Odometry:
        """Wait for the next odometry."""
        self.last = None

        def fresh() -> Odometry | None:
            self.read()
            return self.last

        return eventually(fresh, 20.0, f"odom of {self.namespace}")


def robot(bus: Bus, namespace: str) -> Robot:
    """Subscribe to a robot's odometry and create a publisher of its commands."""
    found = Robot(
        namespace,
        bus.subscribe(ODOM.key(namespace), 100_000),
        bus.advertise(CMD_VEL.key(namespace), make_encoding(Twist, Format.CDR)),
    )
    eventually(lambda: found.cmd_vel.is_matched, 20.0, f"a listener on {namespace}/cmd_vel")
    return found


def speed(server: Server, name: str) -> float:
    """Speed on the ground [m/s], without direction of turns."""
    twist = server.client.entity_state(name).twist
    return abs(twist.linear.x) + abs(twist.linear.y)


def last_motion(server: Server, names: Sequence[str], *, least_m_s: float) -> int:
    """Wait until robots are slower than a limit; return the last step at which one was not.

    It is never later than the truth, however seldom a busy machine lets us look.
    """
    last = 0

    def have_stopped() -> bool:
        nonlocal last
        now = server.steps()
        is_moving = any(speed(server, name) >= least_m_s for name in names)
        last = now if is_moving else last
        return not is_moving

    eventually(have_stopped, 20.0, "stopping")
    return last


def stamp_s(odom: Odometry) -> float:
    """Get the simulation time of an odometry message."""
    return ns_from_time(odom.header.stamp) * 1e-9


def place(odom: Odometry) -> tuple[float, float]:
    """Position x, y [m]."""
    point = odom.pose.pose.position
    return point.x, point.y


def yaw(odom: Odometry) -> float:
    """Heading [rad]."""
    q = odom.pose.pose.orientation
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


@dataclass(frozen=True)
class DriveResult:
    """Displacement in the initial base frame, and accumulated turn."""

    forward_m: float
    sideways_m: float
    turned_rad: float


def drive_for(
    client: SimClient, robots: Sequence[Robot], *, linear: float, angular: float, sim_s: float
) -> list[DriveResult]:
    """Drive robots simultaneously for some simulation time, then stop them.

    Time is paused at each command, so that load of the machine has no effect.
    """
    with pausing(client):
        _advance_time(client, SEND_EVERY_S)
        starts = [found.newest() for found in robots]
        turns = [found.turned_rad for found in robots]
        for twist, duration_s in (((linear, angular), sim_s), ((0.0, 0.0), STOP_S)):
            for _ in range(round(duration_s / SEND_EVERY_S)):
                for found in robots:
                    found.command(*twist)
                _advance_time(client, SEND_EVERY_S)
        return [
            _make_result(start, found.newest(), found.turned_rad - turn)
            for start, found, turn in zip(starts, robots, turns, strict=True)
        ]


@contextmanager
def pausing(client: SimClient) -> Iterator[None]:
    """Pause the world inside the block; restore playing afterwards."""
    is_playing = client.simulation_state() == State.PLAYING
    if is_playing:
        client.set_simulation_state(State.PAUSED)
    yield
    if is_playing:
        client.set_simulation_state(State.PLAYING)


def _advance_time(client: SimClient, sim_s: float) -> None:
    client.run_to(round((client.info().sim_time_s + sim_s) * NANOSECONDS))


def _turn(before: float, after: float) -> float:
    return (after - before + math.pi) % (2.0 * math.pi) - math.pi


def _make_result(start: Odometry, finish: Odometry, turned: float) -> DriveResult:
    (x0, y0), (x1, y1), heading = place(start), place(finish), yaw(start)
    dx, dy = x1 - x0, y1 - y0
    return DriveResult(
        dx * math.cos(heading) + dy * math.sin(heading),
        dy * math.cos(heading) - dx * math.sin(heading),
        turned,
    )
