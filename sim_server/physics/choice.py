"""What a server is told of the physics of its worlds."""

from typing import Literal

import msgspec

Clustering = Literal["auto", "on", "off"]


class EngineChoice(msgspec.Struct, frozen=True, kw_only=True):
    """Which engines stand for each world of a server."""

    clusters: Clustering = "auto"
    """Whether bodies that cannot touch are stepped apart; auto = when there are enough of them."""
