"""Claims, states and messages of pools in tests."""

from collections.abc import Sequence

import numpy as np

from zensim.proto.codec.message_codec import decode
from zensim.proto.memory_bus import MemorySubscription
from zensim.proto.messages.agent_messages import STATE_COLUMNS, Claim, DriveState
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import TFMessage

PERIOD_NS = 12_500_000


def claims_of(models: Sequence[Model]) -> list[Claim]:
    """Claim robots r1, r2, and so on, of these models."""
    return [
        Claim(number, f"r{number}", f"r{number}", model, "<robot/>")
        for number, model in enumerate(models, 1)
    ]


def a_state(claims: Sequence[Claim], step: int) -> DriveState:
    """Make a state with random motions of claimed robots."""
    rng, joints = np.random.default_rng(step), sum(len(one.model.joints) for one in claims)
    base = rng.uniform(-2.0, 2.0, (len(claims), STATE_COLUMNS))
    base[:, 3:7] /= np.linalg.norm(base[:, 3:7], axis=1, keepdims=True)
    numbers = np.array([claim.claim for claim in claims], dtype="<u4").tobytes()
    positions = rng.uniform(-3.0, 3.0, joints).tobytes()
    time_ns = step * PERIOD_NS
    return DriveState(0, time_ns, time_ns, numbers, base.tobytes(), positions, positions)


def messages(received: MemorySubscription) -> list[TFMessage]:
    """Take the transforms received."""
    return [decode(TFMessage, sample.payload, sample.encoding) for sample in received.take()]


def roots(message: TFMessage) -> set[str]:
    """List the first parts of the parent frames."""
    return {edge.header.frame_id.split("/")[0] for edge in message.transforms}
