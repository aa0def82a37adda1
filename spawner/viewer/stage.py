"""What stands around the robots: sky, ground and colours, whatever the world says."""

from typing import Final

import numpy as np
import viser

GROUND: Final = (40, 44, 51)
CELLS: Final = (58, 63, 72)
METRES: Final = (84, 91, 103)
BRAND: Final = (64, 132, 214)
QUIET: Final = (66, 71, 80)
"""Of buttons that do not act on the simulation."""
SIGHT_M: Final = 45.0
"""Where the ground fades away."""
START: Final = ((-1.5, -1.6, 1.1), (3.0, 0.2, 0.0))
"""Where the camera is and what it looks at before there is a robot."""
FOV_RAD: Final = float(np.radians(45.0))


def build(server: viser.ViserServer) -> None:
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
        cell_color=CELLS,
        cell_size=0.25,
        section_color=METRES,
        section_size=1.0,
        fade_distance=SIGHT_M,
        fade_strength=2.0,
        shadow_opacity=0.45,
    )
    server.initial_camera.fov = FOV_RAD
    server.initial_camera.position, server.initial_camera.look_at = START
