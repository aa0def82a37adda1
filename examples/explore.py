"""Robots with lidars explore a world, each by itself, with eclipse-zenoh and rosbags alone.

    zensim up --world maze --model box_bot_lidar --robots 10
    python examples/explore.py tcp/127.0.0.1:7447 60

Each scan is answered by one velocity command. A robot drives to where it sees far; where the way
ahead is blocked, it turns on the spot to the side that was more open, until it is free again.
The nearest approach to anything is printed at the end.
Needs: pip install eclipse-zenoh numpy rosbags
"""

import json
import sys
from dataclasses import dataclass, field

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_typestore

ENDPOINT = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
SECONDS = float(sys.argv[2]) if len(sys.argv) > 2 else 60.0
SPEED, TURN = 0.25, 0.9
"""Greatest velocities [m/s, rad/s]."""
STOP_M, FREE_M = 0.45, 0.75
"""Range ahead at which a robot stops, and at which it may drive again."""
HALF_WIDTH_M = 0.3
"""Of the lane that must be free ahead."""


@dataclass
class Explorer:
    """One robot: what it does with its scans."""

    turn: float = 0.0
    """Direction in which it turns on the spot; 0 while it drives."""
    nearest_m: float = np.inf
    start_s: float = field(default=-1.0)
    last_s: float = 0.0

    def steer(self, scan: object) -> tuple[float, float]:
        """Find forward speed [m/s] and turn rate [rad/s] from a LaserScan."""
        ranges = np.clip(scan.ranges, scan.range_min, scan.range_max)
        angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
        x, y = ranges * np.cos(angles), ranges * np.sin(angles)
        self.last_s = scan.header.stamp.sec + scan.header.stamp.nanosec * 1e-9
        if self.start_s < 0.0:
            self.start_s = self.last_s
        self.nearest_m = min(self.nearest_m, float(ranges.min()))
        ahead = x[(x > 0.0) & (np.abs(y) < HALF_WIDTH_M)].min(initial=scan.range_max)
        left = ranges[(angles > 0.2) & (angles < 1.6)].mean()
        right = ranges[(angles < -0.2) & (angles > -1.6)].mean()
        if ahead < STOP_M and not self.turn:
            self.turn = TURN if left > right else -TURN
        elif ahead > FREE_M:
            self.turn = 0.0
        if self.turn:
            return 0.0, self.turn
        speed = SPEED * min(1.0, (ahead - STOP_M) / FREE_M + 0.2)
        return speed, TURN * (left - right) / (left + right)


config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([ENDPOINT]))
config.insert_json5("scouting/multicast/enabled", "false")
types = get_typestore(Stores.ROS2_HUMBLE)
explorers: dict[str, Explorer] = {}

with zenoh.open(config) as session:
    scans = session.declare_subscriber("*/scan", zenoh.handlers.FifoChannel(4096))
    while not explorers or min(one.last_s - one.start_s for one in explorers.values()) < SECONDS:
        sample = scans.recv()
        robot = str(sample.key_expr).partition("/")[0]
        scan = types.deserialize_cdr(sample.payload.to_bytes(), "sensor_msgs/msg/LaserScan")
        vx, wz = explorers.setdefault(robot, Explorer()).steer(scan)
        command = json.dumps({"linear": {"x": float(vx)}, "angular": {"z": float(wz)}})
        session.put(f"{robot}/cmd_vel", command, encoding="application/json")
    for robot in explorers:
        session.put(f"{robot}/cmd_vel", "{}", encoding="application/json")
for robot, one in sorted(explorers.items()):
    print(f"{robot}: nearest {one.nearest_m:.2f} m in {one.last_s - one.start_s:.1f} s")
