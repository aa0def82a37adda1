"""Choice of the renderer of cameras by what is installed here."""

from functools import cache
from importlib.util import find_spec

from zensim.sim_server.scene.camera_images import CameraRenderer, CamerasUnavailable, TextureFiles
from zensim.sim_server.scene.scene import SceneLayout

INSTALL_HINT = (
    "install the extra 'cameras' and the packages libegl1 and libgl1-mesa-dri, or embreex for "
    "plain shading"
)


def make_camera_renderer(layout: SceneLayout, files: TextureFiles) -> CameraRenderer:
    """Make the renderer of a scene: by OpenGL, else by rays.

    Args:
        layout: Of what cameras see.
        files: Of textures, which only OpenGL draws.

    Raises:
        CamerasUnavailable: Neither is possible here.
    """
    reason = find_opengl_fault()
    if not reason:
        from zensim.sim_server.scene.camera_rendering import OpenGlRenderer  # noqa: PLC0415

        return OpenGlRenderer(layout, files)
    if find_spec("embreex") is None:
        raise CamerasUnavailable(f"{reason}; {INSTALL_HINT}")
    from zensim.sim_server.scene.camera_casting import RayRenderer  # noqa: PLC0415

    return RayRenderer(layout)


def find_camera_fault() -> str:
    """Find why no camera image can be made here, and what to install; empty if it can."""
    reason = find_opengl_fault()
    return f"{reason}; {INSTALL_HINT}" if reason and find_spec("embreex") is None else ""


@cache
def find_opengl_fault() -> str:
    """Find why OpenGL cannot be used here; empty if it can."""
    if find_spec("moderngl") is None:
        return "moderngl is not installed"
    # Optional; its import takes a while.
    from zensim.sim_server.scene.camera_rendering import find_context  # noqa: PLC0415

    try:
        find_context()
    except CamerasUnavailable as error:
        return str(error)
    return ""
