"""An agent of a two-wheeled robot: eclipse-zenoh and JSON, none of zensim's code.

It claims the robot, obeys `cmd_vel` and ordered twists, and prints the pose once a second.

    python examples/plain_agent.py tcp/127.0.0.1:7447 r1
"""

import base64
import json
import struct
import sys
import time

import zenoh

ENDPOINT, ROBOT = sys.argv[1], sys.argv[2]
AGENT, JSON = f"plain_{ROBOT}", "application/json"


def call(session: zenoh.Session, service: str, request: dict) -> dict:
    """Call a service of the world `default`."""
    payload = json.dumps(request)
    reply = next(iter(session.get(f"sim/default/{service}", payload=payload, encoding=JSON)))
    return json.loads(reply.ok.payload.to_bytes())


config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([ENDPOINT]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    token = session.liveliness().declare_token(f"sim/default/alive/agent/{AGENT}")
    states = session.declare_subscriber(
        f"sim/default/drive/{AGENT}/state", zenoh.handlers.RingChannel(1)
    )
    cmd_vel = session.declare_subscriber(f"{ROBOT}/cmd_vel", zenoh.handlers.RingChannel(1))
    claim = {"agent": AGENT, "entities": [ROBOT], "state_format": "json"}
    while not (granted := call(session, "claim_entity", claim)).get("grants"):
        time.sleep(0.1)  # the server has not received the token, or another agent drives it
    pair = granted["models"][0]["drive"]["pairs"][0]
    radius, half_track = pair["diameter_m"] / 2, pair["separation_m"] / 2
    forward, turn, shown_s = 0.0, 0.0, -1.0
    while True:
        state = json.loads(states.recv().payload.to_bytes())
        if not state["claims"]:
            continue  # the robot was deleted, or the claim has ended
        if (sample := cmd_vel.try_recv()) is not None:
            twist = json.loads(sample.payload.to_bytes())
            forward, turn = twist["linear"].get("x", 0.0), twist["angular"].get("z", 0.0)
        ordered = struct.unpack("<3d", base64.b64decode(state.get("twists") or "") or b"\xff" * 24)
        v, w = (ordered[0], ordered[2]) if ordered[0] == ordered[0] else (forward, turn)
        wheels = [(v - w * half_track) / radius, (v + w * half_track) / radius]
        targets = base64.b64encode(struct.pack("<2d", *wheels)).decode()
        command = {key: state.get(key, 0) for key in ("epoch", "step", "claims", "order")}
        key = f"sim/default/drive/{AGENT}/command"
        session.put(key, json.dumps({**command, "targets": targets}), encoding=JSON)
        if state["time_ns"] * 1e-9 >= shown_s + 1.0:
            shown_s = state["time_ns"] * 1e-9
            x, y = struct.unpack("<2d", base64.b64decode(state["base"])[:16])
            print(f"{shown_s:.2f} s: x={x:.3f} y={y:.3f}", flush=True)
