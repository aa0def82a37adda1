"""Orders of twists, as a session publishes them."""

import numpy as np
import pytest

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.agent_messages import TwistCommands, split_orders
from zensim.proto.network_protocols import MAX_FLEET_COMMAND_BYTES


@pytest.mark.parametrize("count", [0, 1, 2500, 2501, 10_000])
def test_orders_of_a_fleet_are_split_to_pass_the_router(count: int) -> None:
    names = tuple(f"{number:064d}" for number in range(count))
    twists = np.arange(3.0 * count).astype("<f8").tobytes()

    parts = list(split_orders(TwistCommands("c", names, twists)))

    assert [name for part in parts for name in part.entities] == list(names)
    assert b"".join(part.twists for part in parts) == twists
    assert {part.client for part in parts} == {"c"}
    assert all(len(part.twists) == 24 * len(part.entities) for part in parts)
    assert max(len(encode(part, Format.MSGPACK)) for part in parts) <= MAX_FLEET_COMMAND_BYTES
