"""Choice of the renderer of cameras by what is installed here."""

from functools import cache

from zensim.proto.sensor_libraries import ADVICE, find_library_fault
from zensim.sim_server.scene.camera_images import CameraRenderer, CamerasUnavailable, TextureFiles
from zensim.sim_server.scene.scene import SceneLayout


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
    if find_library_fault("embree"):
        raise CamerasUnavailable(f"{reason}; {ADVICE['opengl']}")
    from zensim.sim_server.scene.camera_casting import RayRenderer  # noqa: PLC0415

    return RayRenderer(layout)


@cache
def find_opengl_fault() -> str:
    """Find why OpenGL cannot be used here, by using it; empty if it can."""
    if fault := find_library_fault("opengl"):
        return fault
    # Optional; its import takes a while.
    from zensim.sim_server.scene.camera_rendering import find_context  # noqa: PLC0415

    try:
        find_context()
    except CamerasUnavailable as error:
        return str(error)
    return ""
