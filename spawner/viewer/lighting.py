"""The light and the sky of the page: the world's where it says, else the page's own."""

from typing import Final

import numpy as np
import viser

from zensim.proto.messages.model_messages import Quat
from zensim.proto.messages.world_messages import Light, Scene

SKY_TOP: Final = (24, 27, 33)
SKY_LOW: Final = (52, 57, 66)
SUN: Final = (-4.0, 5.0, 8.0)
"""Where the page's own light comes from."""
FAR_M: Final = 10.0
"""How far away a lamp without a place is put."""
BRIGHT: Final = {"directional": 2.2, "point": 12.0, "spot": 24.0}
"""How bright white is, by kind of lamp: SDF says colours only."""
AMBIENT: Final = 3.0
MAX_LIGHTS: Final = 8
"""More would make every page slow."""

Handle = viser.SceneNodeHandle


class Lighting:
    """What is lit how, changed only when another scene is shown."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._handles: list[Handle] = []
        self._shown: Scene | None = None

    def show(self, seen: Scene) -> None:
        """Light the page as a world says."""
        if seen == self._shown:
            return
        self._shown = seen
        for handle in self._handles:
            handle.remove()
        lamps = seen.lights[:MAX_LIGHTS]
        self._handles = [self._add_ambient(seen.ambient)]
        self._handles += [self._add(f"/light/{i}", lamp) for i, lamp in enumerate(lamps)]
        if seen.has_sun or not lamps:
            self._handles.append(self._add_sun())
        self._scene.set_background_image(sky(seen.background), format="png")

    def _add_ambient(self, colour: Quat | None) -> Handle:
        if colour is not None:
            return self._scene.add_light_ambient(
                "/light/ambient", color=_bytes_of(colour), intensity=AMBIENT
            )
        return self._scene.add_light_hemisphere(
            "/light/ambient", sky_color=(214, 226, 245), ground_color=(92, 94, 100), intensity=1.6
        )

    def _add_sun(self) -> Handle:
        return self._scene.add_light_directional(
            "/light/sun", intensity=BRIGHT["directional"], cast_shadow=True, position=SUN
        )

    def _add(self, path: str, lamp: Light) -> Handle:
        scene, colour, intensity = self._scene, _bytes_of(lamp.rgba), BRIGHT[lamp.kind]
        position = lamp.origin.position
        if lamp.kind == "point":
            return scene.add_light_point(path, color=colour, intensity=intensity, position=position)
        if lamp.kind == "spot":
            return scene.add_light_spot(
                path, color=colour, intensity=intensity, position=position, direction=lamp.direction
            )
        return scene.add_light_directional(
            path, color=colour, intensity=intensity, cast_shadow=True, position=against(lamp)
        )


def against(lamp: Light) -> tuple[float, float, float]:
    """Find a place to look from along a lamp's direction towards the origin [m]."""
    x, y, z = lamp.direction
    length = float(np.linalg.norm(lamp.direction))
    if not np.isfinite(length) or length == 0.0:
        return (0.0, 0.0, FAR_M)
    return (-x / length * FAR_M, -y / length * FAR_M, -z / length * FAR_M)


def sky(colour: Quat | None = None) -> np.ndarray:
    """Paint a sky of one colour, else one that is darker above, (rows, columns, 3) of uint8."""
    top, low = (SKY_TOP, SKY_LOW) if colour is None else (_bytes_of(colour),) * 2
    share = np.linspace(0.0, 1.0, 256)[:, None]
    column = np.asarray(top) * (1.0 - share) + np.asarray(low) * share
    picture: np.ndarray = np.repeat(column[:, None, :], 4, axis=1).round().astype(np.uint8)
    return picture


def _bytes_of(colour: Quat) -> tuple[int, int, int]:
    red, green, blue = (round(255 * min(max(channel, 0.0), 1.0)) for channel in colour[:3])
    return red, green, blue
