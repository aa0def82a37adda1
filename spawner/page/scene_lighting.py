"""Scenery of the page: ground, background and lights."""

from typing import Final

import msgspec
import numpy as np
import viser

from zensim.proto.messages.model_messages import DOWNWARD, Light, Origin, Quat
from zensim.proto.messages.world_messages import Scene
from zensim.spawner.page.page_theme import DARK, PageTheme, make_axes

CELL_M, SECTION_M = 1.0, 5.0
"""Distances of the fine and of the strong lines of the ground."""
AXIS_LINE_M: Final = 0.01
"""Width of the axes."""
FADE_DISTANCE_M: Final = 140.0
"""Distance at which the ground fades out."""
FADE_STRENGTH: Final = 4.0
START_CAMERA: Final = ((-1.6, -1.0, 0.8), (1.6, 0.6, 0.0))
"""Position and target of the camera before there is a robot."""
FOV_RAD: Final = float(np.radians(45.0))


def set_up_scene(server: viser.ViserServer) -> None:
    """Set up an empty page."""
    set_controls_theme(server.gui, DARK)
    server.scene.configure_default_lights(enabled=False)
    server.scene.configure_environment_map(hdri=None)
    server.initial_camera.fov = FOV_RAD
    server.initial_camera.position, server.initial_camera.look_at = START_CAMERA
    server.gui.main_panel.dock_right()
    add_ground(server.scene, DARK)


def set_controls_theme(gui: viser.GuiApi, theme: PageTheme) -> None:
    """Set the colours of the controls."""
    gui.configure_theme(
        dark_mode=theme.is_dark, show_logo=False, show_share_button=False, brand_color=theme.brand
    )


def add_ground(scene: viser.SceneApi, theme: PageTheme) -> list[viser.SceneNodeHandle]:
    """Add the ground with a grid, and the axes of the world on it."""
    grid = scene.add_grid(
        "/ground",
        infinite_grid=True,
        plane_color=theme.ground,
        plane_opacity=1.0,
        cell_color=theme.metres,
        cell_size=CELL_M,
        section_color=theme.sections,
        section_size=SECTION_M,
        fade_distance=FADE_DISTANCE_M,
        fade_strength=FADE_STRENGTH,
        shadow_opacity=theme.shadow_opacity,
    )
    points, colours = make_axes()
    return [grid, scene.add_line_segments("/axes", points, colours, thickness=AXIS_LINE_M)]


class Scenery:
    """Ground, background and colours of the controls of one visitor.

    Attributes:
        theme: What is shown.
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._ground: list[viser.SceneNodeHandle] = []
        self._background: tuple[PageTheme, Quat | None] | None = None
        self.theme = DARK

    def switch(self, theme: PageTheme) -> None:
        """Show another theme; the dark one is that of the page."""
        self.theme = theme
        for handle in self._ground:
            handle.remove()
        self._ground = [] if theme == DARK else add_ground(self._client.scene, theme)
        set_controls_theme(self._client.gui, theme)

    def keep(self, background: Quat | None) -> None:
        """Show the background of the world, or that of the theme; call periodically."""
        if (self.theme, background) != self._background:
            self._background = self.theme, background
            self._client.scene.set_background_image(make_sky(self.theme, background), format="png")


SUN_POSITION: Final = (-2.5, -7.0, 6.5)
"""Position of the default light: beside the camera of first views, so that the faces which it sees
are lit, and shadows are seen beside the robots."""
LAMP_DISTANCE_M: Final = 10.0
"""Distance of directional lamps from the origin."""
LAMP_INTENSITY: Final = 2.2
"""Intensity for viser of a white lamp of intensity 1 where its attenuation is 1."""
FIT_DISTANCES_M: Final = (0.5, 5.0)
"""Least and greatest distance at which the attenuation of a lamp is fitted: half of its range."""
SPOT_ANGLE_RAD: Final = 0.8
"""Half angle of the cone of a spot light without an angle."""
AMBIENT_INTENSITY: Final = 3.0
HAZE_SHARE: Final = 0.1
"""Share of the height of the picture in which the sky turns into haze; below, the ground fades."""
MAX_LIGHTS: Final = 8
"""Limit for the sake of frame rate."""

LightHandle = viser.SceneNodeHandle


class SceneLighting:
    """Lights of all visitors; changed only when the lights change."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._handles: list[LightHandle] = []
        self._lamps: tuple[Light, ...] = ()
        self._lamp_handles: list[LightHandle] = []
        self._shown: tuple[Scene, list[Light]] | None = None

    def show(self, scene: Scene, lights: tuple[Light, ...] = ()) -> None:
        """Show the lights of a world.

        Args:
            scene: Of the world.
            lights: Of its models, in the world frame; they may move.
        """
        lamps = (*scene.lights, *lights)[:MAX_LIGHTS]
        shown = (
            scene,
            [msgspec.structs.replace(lamp, origin=Origin(), direction=DOWNWARD) for lamp in lamps],
        )
        if shown == self._shown:
            self._move_lamps(lamps)
            return
        self._shown, self._lamps = shown, lamps
        for handle in (*self._handles, *self._lamp_handles):
            handle.remove()
        self._handles = [self._add_ambient(scene.ambient)]
        self._lamp_handles = [self._add(f"/light/{i}", lamp) for i, lamp in enumerate(lamps)]
        if scene.has_sun or not scene.lights:
            self._handles.append(self._add_sun())

    def _move_lamps(self, lamps: tuple[Light, ...]) -> None:
        for handle, old, lamp in zip(self._lamp_handles, self._lamps, lamps, strict=True):
            if lamp == old:
                continue
            is_far = lamp.kind == "directional"
            handle.position = find_light_position(lamp) if is_far else lamp.origin.position
            if isinstance(handle, viser.SpotLightHandle):
                handle.direction = lamp.direction
        self._lamps = lamps

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
            "/light/sun", intensity=LAMP_INTENSITY, cast_shadow=True, position=SUN_POSITION
        )

    def _add(self, path: str, lamp: Light) -> LightHandle:
        scene, colour, position = self._scene, _to_rgb(lamp.rgba), lamp.origin.position
        if lamp.kind == "directional":
            return scene.add_light_directional(
                path,
                color=colour,
                intensity=LAMP_INTENSITY * lamp.intensity,
                cast_shadow=lamp.casts_shadows,
                position=find_light_position(lamp),
            )
        intensity, decay = fit_attenuation(lamp)
        if lamp.kind == "point":
            return scene.add_light_point(
                path,
                color=colour,
                intensity=intensity,
                decay=decay,
                distance=lamp.range_m,
                position=position,
            )
        return scene.add_light_spot(
            path,
            color=colour,
            intensity=intensity,
            decay=decay,
            distance=lamp.range_m,
            angle=min(lamp.outer_angle_rad / 2.0 or SPOT_ANGLE_RAD, float(np.pi) / 2.0),
            penumbra=0.3,
            cast_shadow=lamp.casts_shadows,
            position=position,
            direction=lamp.direction,
        )


def fit_attenuation(lamp: Light) -> tuple[float, float]:
    """Find intensity and exponent of a power law with the attenuation of a lamp and its slope."""
    near, far = FIT_DISTANCES_M
    distance = min(max(lamp.range_m / 2.0, near), far)
    constant, linear, quadratic = lamp.attenuation
    terms = (constant, linear * distance, quadratic * distance**2)
    whole = max(sum(terms), 1e-3)
    decay = (terms[1] + 2.0 * terms[2]) / whole
    return LAMP_INTENSITY * lamp.intensity * distance**decay / whole, decay


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


def make_sky(theme: PageTheme, colour: Quat | None = None) -> np.ndarray:
    """Make a background image (rows, columns, 3), uint8: one colour, or the gradient of a theme."""
    top, low = (theme.sky, theme.haze) if colour is None else (_to_rgb(colour),) * 2
    weight = np.clip(np.linspace(0.0, 1.0 / HAZE_SHARE, 256), 0.0, 1.0)[:, None]
    column = np.asarray(top) * (1.0 - weight) + np.asarray(low) * weight
    image: np.ndarray = np.repeat(column[:, None, :], 4, axis=1).round().astype(np.uint8)
    return image


def _to_rgb(colour: Quat) -> tuple[int, int, int]:
    red, green, blue = (round(255 * min(max(channel, 0.0), 1.0)) for channel in colour[:3])
    return red, green, blue
