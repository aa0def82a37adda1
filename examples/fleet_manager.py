"""A fleet manager of VDA 5050 sends every vehicle one metre ahead, and prints who has arrived.

    zensim up --robots 50
    python examples/fleet_manager.py 1883
    zensim vda5050 --broker mqtt://127.0.0.1:1883

The number is the port of a broker on this host.
Needs: pip install paho-mqtt
"""

import json
import math
import sys
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

PORT = int(sys.argv[1]) if len(sys.argv) > 1 else 1883
ROOT = "uagv/v2/zensim"
FIELDS = {"version": "2.1.0", "timestamp": "2026-01-01T00:00:00.000Z", "headerId": 0}
GIVEN: set[str] = set()
ARRIVED: set[str] = set()


def make_node(number: int, place: dict[str, Any]) -> dict[str, Any]:
    """Make a node of the base."""
    node = {"nodeId": f"n{number}", "sequenceId": number, "released": True, "actions": []}
    return node | {"nodePosition": {name: place[name] for name in ("x", "y", "mapId")}}


def make_order(robot: str, place: dict[str, Any]) -> dict[str, Any]:
    """Make the order of a vehicle that stands at a place."""
    ahead = {"x": place["x"] + math.cos(place["theta"]), "y": place["y"] + math.sin(place["theta"])}
    nodes = [make_node(0, place), make_node(2, place | ahead)]
    edge = {"edgeId": "e1", "sequenceId": 1, "released": True, "actions": []}
    edge |= {"startNodeId": "n0", "endNodeId": "n2"}
    header = FIELDS | {"manufacturer": "zensim", "serialNumber": robot}
    name = {"orderId": f"{robot}-first", "orderUpdateId": 0}
    return header | name | {"nodes": nodes, "edges": [edge]}


def handle_state(client: Client, _: object, message: MQTTMessage) -> None:
    """Send the order to a vehicle that is new; note one that has arrived."""
    robot, state = message.topic.split("/")[3], json.loads(message.payload)
    if robot not in GIVEN:
        GIVEN.add(robot)
        order = make_order(robot, state["agvPosition"])
        client.publish(f"{ROOT}/{robot}/order", json.dumps(order))
    elif state["lastNodeId"] == "n2" and not state["driving"] and robot not in ARRIVED:
        ARRIVED.add(robot)
        print(robot, "has arrived;", len(ARRIVED), "in all", flush=True)


master = Client(CallbackAPIVersion.VERSION2)
master.on_message = handle_state
master.on_connect = lambda client, *_: client.subscribe(f"{ROOT}/+/state")
master.connect("127.0.0.1", PORT)
master.loop_forever()
