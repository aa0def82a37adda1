"""Drive a robot with eclipse-zenoh alone: none of zensim's code, as any other program would.

Subscribes to the odometry of all robots, reads its CDR with rosbags, and sends one robot velocity
commands in JSON. Needs: pip install eclipse-zenoh rosbags

    python examples/plain_zenoh.py tcp/127.0.0.1:7447 box_bot3
"""

import json
import sys
import time

import zenoh
from rosbags.typesys import Stores, get_typestore

ENDPOINT = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
ROBOT = sys.argv[2] if len(sys.argv) > 2 else "box_bot3"
SECONDS = 3.0
OK = 1
"""Result of a successful request, as in simulation_interfaces/msg/Result."""

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([ENDPOINT]))
config.insert_json5("scouting/multicast/enabled", "false")
types = get_typestore(Stores.ROS2_HUMBLE)

with zenoh.open(config) as session:
    odometry = session.declare_subscriber("*/odom", zenoh.handlers.RingChannel(1024))
    command = {"linear": {"x": 0.2}, "angular": {"z": 0.1}}
    places: dict[str, tuple[float, float]] = {}
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        session.put(f"{ROBOT}/cmd_vel", json.dumps(command), encoding="application/json")
        while (sample := odometry.try_recv()) is not None:
            odom = types.deserialize_cdr(sample.payload.to_bytes(), "nav_msgs/msg/Odometry")
            position = odom.pose.pose.position
            places[str(sample.key_expr)] = (position.x, position.y)
        time.sleep(0.1)
    for key, (x, y) in sorted(places.items()):
        print(f"{key}: x={x:.3f} y={y:.3f}")

    replies = session.get(
        "sim/default/get_entity_state",
        payload=json.dumps({"entity": ROBOT}),
        encoding="application/json",
        timeout=5.0,
    )
    reply = next(iter(replies), None)
    if reply is None or reply.ok is None:
        sys.exit(f"no server of world 'default' replies at {ENDPOINT}")
    response = json.loads(reply.ok.payload.to_bytes())
    if response["result"]["result"] != OK:
        sys.exit(response["result"]["error_message"])
    print(response["state"]["pose"]["position"])
