"""The scene around the robots: ground, colours, initial camera, lights and sky."""

from typing import Final

import numpy as np
import viser

from zensim.proto.messages.model_messages import Quat
from zensim.proto.messages.world_messages import Light, Scene

GROUND: Final = (40, 44, 51)
GRID_CELLS: Final = (58, 63, 72)
GRID_METRES: Final = (84, 91, 103)
BRAND: Final = (64, 132, 214)
MUTED_BUTTON: Final = (66, 71, 80)
"""Of buttons that do not act on the simulation."""
FADE_DISTANCE_M: Final = 45.0
"""Where the ground fades away."""
START_CAMERA: Final = ((-1.5, -1.6, 1.1), (3.0, 0.2, 0.0))
"""Where the camera is and what it looks at before there is a robot."""
FOV_RAD: Final = float(np.radians(45.0))


def set_up_scene(server: viser.ViserServer) -> None:
    """Furnish an empty page."""
    server.gui.configure_theme(
        dark_mode=True, show_logo=False, show_share_button=False, brand_color=BRAND
    )
    scene = server.scene
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(hdri=None)
    scene.add_grid(
        "/ground",
        infinite_grid=True,
        plane_color=GROUND,
        plane_opacity=1.0,
        cell_color=GRID_CELLS,
        cell_size=0.25,
        section_color=GRID_METRES,
        section_size=1.0,
        fade_distance=FADE_DISTANCE_M,
        fade_strength=2.0,
        shadow_opacity=0.45,
    )
    server.initial_camera.fov = FOV_RAD
    server.initial_camera.position, server.initial_camera.look_at = START_CAMERA


SKY_TOP: Final = (24, 27, 33)
SKY_BOTTOM: Final = (52, 57, 66)
SUN_POSITION: Final = (-4.0, 5.0, 8.0)
"""Where the page's own light comes from."""
LAMP_DISTANCE_M: Final = 10.0
"""How far away a lamp without a place is put."""
LAMP_INTENSITIES: Final = {"directional": 2.2, "point": 12.0, "spot": 24.0}
"""How bright white is, by kind of lamp: SDF says colours only."""
AMBIENT_INTENSITY: Final = 3.0
MAX_LIGHTS: Final = 8
"""More would make every page slow."""

LightHandle = viser.SceneNodeHandle


class SceneLighting:
    """What is lit how, changed only when another scene is shown."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._handles: list[LightHandle] = []
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
        self._scene.set_background_image(make_sky(seen.background), format="png")

    def _add_ambient(self, colour: Quat | None) -> LightHandle:
        if colour is not None:
            return self._scene.add_light_ambient(
                "/light/ambient", color=_to_rgb(colour), intensity=AMBIENT_INTENSITY
            )
        return self._scene.add_light_hemisphere(
            "/light/ambient", sky_color=(214, 226, 245), ground_color=(92, 94, 100), intensity=1.6
        )

    def _add_sun(self) -> LightHandle:
        return self._scene.add_light_directional(
            "/light/sun",
            intensity=LAMP_INTENSITIES["directional"],
            cast_shadow=True,
            position=SUN_POSITION,
        )

    def _add(self, path: str, lamp: Light) -> LightHandle:
        scene, colour, intensity = self._scene, _to_rgb(lamp.rgba), LAMP_INTENSITIES[lamp.kind]
        position = lamp.origin.position
        if lamp.kind == "point":
            return scene.add_light_point(path, color=colour, intensity=intensity, position=position)
        if lamp.kind == "spot":
            return scene.add_light_spot(
                path, color=colour, intensity=intensity, position=position, direction=lamp.direction
            )
        return scene.add_light_directional(
            path,
            color=colour,
            intensity=intensity,
            cast_shadow=True,
            position=find_light_position(lamp),
        )


def find_light_position(lamp: Light) -> tuple[float, float, float]:
    """Find a place to look from along a lamp's direction towards the origin [m]."""
    x, y, z = lamp.direction
    length = float(np.linalg.norm(lamp.direction))
    if not np.isfinite(length) or length == 0.0:
        return (0.0, 0.0, LAMP_DISTANCE_M)
    return (
        -x / length * LAMP_DISTANCE_M,
        -y / length * LAMP_DISTANCE_M,
        -z / length * LAMP_DISTANCE_M,
    )


def make_sky(colour: Quat | None = None) -> np.ndarray:
    """Paint a sky of one colour, else one that is darker above, (rows, columns, 3) of uint8."""
    top, low = (SKY_TOP, SKY_BOTTOM) if colour is None else (_to_rgb(colour),) * 2
    share = np.linspace(0.0, 1.0, 256)[:, None]
    column = np.asarray(top) * (1.0 - share) + np.asarray(low) * share
    picture: np.ndarray = np.repeat(column[:, None, :], 4, axis=1).round().astype(np.uint8)
    return picture


def _to_rgb(colour: Quat) -> tuple[int, int, int]:
    red, green, blue = (round(255 * min(max(channel, 0.0), 1.0)) for channel in colour[:3])
    return red, green, blue
