"""What a world says of its light and its colours, for pages that show it."""

from typing import Literal

import msgspec

from zensim.proto.model import Origin, Quat, Vec3

LightKind = Literal["point", "spot", "directional"]
DOWN: Vec3 = (0.0, 0.0, -1.0)


class Light(msgspec.Struct, frozen=True):
    """A lamp of a world; `direction` is in the world."""

    name: str
    kind: LightKind
    origin: Origin = Origin()
    direction: Vec3 = DOWN
    rgba: Quat = (1.0, 1.0, 1.0, 1.0)


class Scene(msgspec.Struct, frozen=True):
    """Colours and lamps of a world; None where it does not say."""

    ambient: Quat | None = None
    background: Quat | None = None
    lights: tuple[Light, ...] = ()
    has_sun: bool = False
    """Whether it includes `model://sun`."""
