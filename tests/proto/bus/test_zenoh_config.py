"""Configuration of sessions, as Zenoh reads it."""

import json

from tests.chaos.chaos_stopped import DOWN_S
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.zenoh_config import to_zenoh_json


def test_client_does_not_give_up_a_handshake_while_its_router_is_suspended() -> None:
    config = json.loads(to_zenoh_json(BusConfig()))

    assert config["transport"]["unicast"]["open_timeout"] > 1000.0 * DOWN_S
