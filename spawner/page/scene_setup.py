"""Ground, colours, initial camera, lights and sky of the page."""

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
"""Colour of buttons without effect on the simulation."""
FADE_DISTANCE_M: Final = 45.0
"""Distance at which the ground fades out."""
START_CAMERA: Final = ((-1.5, -1.6, 1.1), (3.0, 0.2, 0.0))
"""Position and target of the camera before there is a robot."""
FOV_RAD: Final = float(np.radians(45.0))


def set_up_scene(server: viser.ViserServer) -> None:
    """Set up an empty page."""
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
"""Position of the default light."""
LAMP_DISTANCE_M: Final = 10.0
"""Distance of directional lamps from the origin."""
LAMP_INTENSITIES: Final = {"directional": 2.2, "point": 12.0, "spot": 24.0}
"""Intensity of white by kind of lamp; SDF has colours only."""
AMBIENT_INTENSITY: Final = 3.0
MAX_LIGHTS: Final = 8
"""Limit for the sake of frame rate."""

LightHandle = viser.SceneNodeHandle


class SceneLighting:
    """Lights and background; changed only when the scene changes."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._handles: list[LightHandle] = []
        self._shown: Scene | None = None

    def show(self, scene: Scene) -> None:
        """Show the lights and background of a world."""
        if scene == self._shown:
            return
        self._shown = scene
        for handle in self._handles:
            handle.remove()
        lamps = scene.lights[:MAX_LIGHTS]
        self._handles = [self._add_ambient(scene.ambient)]
        self._handles += [self._add(f"/light/{i}", lamp) for i, lamp in enumerate(lamps)]
        if scene.has_sun or not lamps:
            self._handles.append(self._add_sun())
        self._scene.set_background_image(make_sky(scene.background), format="png")

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
    """Find a position [m] from which a directional lamp points to the origin."""
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
    """Make a background image (rows, columns, 3), uint8: one colour, or a gradient."""
    top, low = (SKY_TOP, SKY_BOTTOM) if colour is None else (_to_rgb(colour),) * 2
    weight = np.linspace(0.0, 1.0, 256)[:, None]
    column = np.asarray(top) * (1.0 - weight) + np.asarray(low) * weight
    image: np.ndarray = np.repeat(column[:, None, :], 4, axis=1).round().astype(np.uint8)
    return image


def _to_rgb(colour: Quat) -> tuple[int, int, int]:
    red, green, blue = (round(255 * min(max(channel, 0.0), 1.0)) for channel in colour[:3])
    return red, green, blue
