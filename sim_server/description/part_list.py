"""What a description lists, nothing merged yet."""

from __future__ import annotations

import msgspec

from zensim.proto.messages.model_messages import Joint, Link


class Parts(msgspec.Struct, frozen=True):
    """Links and joints of a description, in its order."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
