"""Rendering of camera images by OpenGL: colour, depth and labels in one pass.

The only importer of moderngl. Without a display and without a GPU it runs on Mesa's llvmpipe.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, TypeAlias

import moderngl
import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Shape
from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.se3 import FloatArray, cross, rotate, to_matrix
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.camera_images import (
    CameraImages,
    CamerasUnavailable,
    TextureFiles,
    find_focal_length,
    find_principal_point,
    find_rgba,
)
from zensim.sim_server.scene.ray_casting import NO_ENTITY, PlacedShapes, ShapeGeometry
from zensim.sim_server.scene.scene import SceneLayout
from zensim.sim_server.scene.scene_lights import (
    DARKNESS,
    MAX_LIGHTS,
    MIN_ATTENUATION,
    MIN_DISTANCE_M,
    Lighting,
)

Numbers: TypeAlias = npt.NDArray[np.float64 | np.int32]
GL_VERSION = 330
CIRCLE_SEGMENTS = 32
SPHERE_RINGS = 16
"""Steps in half a turn, as fine as `CIRCLE_SEGMENTS` in a full one."""
FLATTENING = math.cos(math.pi / CIRCLE_SEGMENTS)
CYLINDER_SCALE, SPHERE_SCALE = 2.0 / (1.0 + FLATTENING), 2.0 / (1.0 + FLATTENING**2)
"""Scales that put edges and corners as far outside of a round surface as faces are inside: 0.24 %
of the radius of a cylinder, 0.48 % of that of a sphere."""
GROUND_HALF_M = 2000.0
"""Half side of what is drawn of a plane."""
CULLING_MARGIN = 1.02
"""Factor by which the field of view is widened where shapes out of sight are left out."""
MAX_FRAMES = 8
"""Sizes of images whose buffers are kept."""

VERTEX_SHADER = """
uniform mat3 to_optical;
uniform vec4 pinhole;  // scale of x and y, shift of x and y
uniform vec2 clipping;
in vec3 vertex;
in vec3 normal;
#ifdef TEXTURED
in vec2 place;
out vec2 texel;
#endif
in vec3 position;  // from the eye
in vec4 turn;
in vec3 size;
in vec3 colour;
in int label;
out vec3 at;
out vec3 facing;
out float depth;
flat out vec3 surface;
flat out int entity;

vec3 rotate(vec4 q, vec3 v) {
    return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v);
}

void main() {
    at = position + rotate(turn, vertex * size);
    facing = rotate(turn, normal / size);
    vec3 optical = to_optical * at;
    depth = optical.z;
#ifdef TEXTURED
    texel = place;
#endif
    surface = colour;
    entity = label;
    gl_Position = vec4(
        optical.xy * pinhole.xy + optical.z * pinhole.zw,
        optical.z * clipping.x + clipping.y,
        optical.z
    );
}
"""
FRAGMENT_SHADER = f"""
uniform vec3 ambient;
uniform int suns;
uniform int lights;
uniform vec4 light_at[{MAX_LIGHTS}];
uniform vec3 light_colour[{MAX_LIGHTS}];
uniform vec4 light_fade[{MAX_LIGHTS}];
uniform vec4 light_cone[{MAX_LIGHTS}];
in vec3 at;
in vec3 facing;
in float depth;
flat in vec3 surface;
flat in int entity;
layout(location = 0) out vec4 seen_colour;
layout(location = 1) out float seen_depth;
layout(location = 2) out int seen_label;
#ifdef TEXTURED
in vec2 texel;
uniform sampler2D picture;
#endif

float find_share(int i, vec3 normal) {{
    vec3 path = light_at[i].xyz - at;
    float away = max(length(path), {MIN_DISTANCE_M});
    vec3 towards = path / away;
    vec4 fade = light_fade[i];
    vec4 cone = light_cone[i];
    float attenuation = max(fade.x + away * (fade.y + away * fade.z), {MIN_ATTENUATION});
    float inside = clamp((-dot(towards, cone.xyz) - cone.w) / (1.0 - cone.w), 0.0, 1.0);
    return dot(towards, normal) * step(away, fade.w) * inside / attenuation;
}}

void main() {{
    vec3 normal = normalize(facing);
    normal = dot(normal, at) > 0.0 ? -normal : normal;
    vec3 light = ambient;
    for (int i = 0; i < suns; ++i) {{
        light += light_colour[i] * max(dot(light_at[i].xyz, normal), 0.0);
    }}
    for (int i = suns; i < lights; ++i) {{
        light += light_colour[i] * max(find_share(i, normal), 0.0);
    }}
    vec3 colour = surface;
#ifdef TEXTURED
    colour *= texture(picture, texel).rgb;
#endif
    seen_colour = vec4(min(colour * light, vec3(1.0)), 1.0);
    seen_depth = depth;
    seen_label = entity;
}}
"""
BACKGROUND_VERTEX_SHADER = """
#version 330
in vec2 corner;
void main() {
    gl_Position = vec4(corner, 1.0, 1.0);
}
"""
BACKGROUND_FRAGMENT_SHADER = f"""
#version 330
uniform vec3 background;
uniform float nothing;
layout(location = 0) out vec4 seen_colour;
layout(location = 1) out float seen_depth;
layout(location = 2) out int seen_label;

void main() {{
    seen_colour = vec4(background, 1.0);
    seen_depth = nothing;
    seen_label = {NO_ENTITY};
}}
"""
INSTANCE = np.dtype(
    [
        ("position", "<f4", 3),
        ("turn", "<f4", 4),
        ("size", "<f4", 3),
        ("colour", "<f4", 3),
        ("label", "<i4"),
    ]
)


@dataclass(frozen=True)
class _Solid:
    """A triangulated solid that is drawn at many places.

    Attributes:
        corners: (3 f, 3).
        normals: (3 f, 3).
        places: (3 f, 2) of the corners in an image; 0 where there is none.
        image: Name of that image, or empty.
    """

    corners: FloatArray
    normals: FloatArray
    places: npt.NDArray[np.float32] | None = None
    image: str = ""


@dataclass(frozen=True)
class _Batch:
    """A solid in OpenGL, and its instances.

    Attributes:
        rows: Of `INSTANCE`.
        picture: On it.
    """

    array: moderngl.VertexArray
    instances: moderngl.Buffer
    rows: slice
    picture: moderngl.Texture | None


@dataclass(frozen=True)
class _Part:
    """What is drawn of a geometry: a solid, its scale and its height along z."""

    solid: str
    size: tuple[float, float, float]
    rise_m: float = 0.0


def _list_parts(shape: Shape) -> list[_Part]:
    radius, length, _ = shape.size
    if shape.kind == "capsule":
        ball = (radius, radius, radius)
        ends = [_Part("sphere", ball, side * length / 2.0) for side in (-1.0, 1.0)]
        return [_Part("cylinder", (radius, radius, length)), *ends]
    if shape.kind == "cylinder":
        return [_Part("cylinder", (radius, radius, length))]
    if shape.kind == "sphere":
        return [_Part("sphere", (radius, radius, radius))]
    if shape.kind == "plane":
        return [_Part("plane", (GROUND_HALF_M, GROUND_HALF_M, 1.0))]
    if shape.kind == "mesh":
        return [_Part(f"{shape.mesh} {shape.size} {shape.texture}", (1.0, 1.0, 1.0))]
    return [_Part("box", shape.size)]


def _make_solid(name: str, geometry: ShapeGeometry, files: TextureFiles) -> _Solid:
    if name == "sphere":
        return _make_sphere()
    if name == "cylinder":
        return _make_cylinder()
    if name == "plane":
        square = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], dtype=np.float64)
        return _make_flat(square[[0, 1, 2, 0, 2, 3]])
    if name == "box":
        return _make_box()
    mesh, texture = _make_flat(geometry.triangles.reshape(-1, 3)), geometry.shape.texture
    if texture is None:
        return mesh
    places = files.find_places(texture.coordinates)
    fits = len(places) == len(mesh.corners)
    return replace(mesh, places=places, image=texture.image) if fits else mesh


def _make_flat(corners: FloatArray) -> _Solid:
    """Make a solid of triangle corners (3 f, 3) with flat faces."""
    first, second, third = np.moveaxis(corners.reshape(-1, 3, 3), 1, 0)
    normals = cross(second - first, third - first)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return _Solid(corners, np.repeat(normals, 3, axis=0))


def _make_box() -> _Solid:
    square = np.array([(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)])[[0, 1, 2, 0, 2, 3]] / 2.0
    faces = [np.roll(square, shift, axis=1) * sign for shift in range(3) for sign in (1.0, -1.0)]
    return _make_flat(np.concatenate(faces))


def _make_grid(points: FloatArray) -> FloatArray:
    """Join points (rows, columns, 3) of a closed strip to triangle corners."""
    rows, columns = points.shape[:2]
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    after = (column + 1) % columns
    quads = [(row, column), (row, after), (row + 1, after)]
    quads += [(row, column), (row + 1, after), (row + 1, column)]
    return np.stack([points[i, j] for i, j in quads], axis=2).reshape(-1, 3)


def _make_sphere() -> _Solid:
    turns = np.arange(CIRCLE_SEGMENTS) * (2.0 * np.pi / CIRCLE_SEGMENTS)
    rise = np.linspace(-np.pi / 2.0, np.pi / 2.0, SPHERE_RINGS + 1)[:, None]
    points = np.stack(
        [np.cos(rise) * np.cos(turns), np.cos(rise) * np.sin(turns), np.sin(rise) + 0.0 * turns],
        axis=-1,
    )
    corners = _make_grid(points)
    return _Solid(SPHERE_SCALE * corners, corners)


def _make_cylinder() -> _Solid:
    turns = np.arange(CIRCLE_SEGMENTS) * (2.0 * np.pi / CIRCLE_SEGMENTS)
    ring = np.stack([np.cos(turns), np.sin(turns), np.zeros(CIRCLE_SEGMENTS)], axis=1)
    ring *= CYLINDER_SCALE
    half = np.array([0.0, 0.0, 0.5])
    side = _make_grid(np.stack([ring - half, ring + half]))
    caps = [
        np.stack([ring + end, np.roll(ring, -1, axis=0) + end, 0.0 * ring + end], axis=1)
        for end in (half, -half)
    ]
    ends = _make_flat(np.concatenate(caps).reshape(-1, 3))
    # Two-sided light makes the direction of normals irrelevant.
    return _Solid(
        np.concatenate([side, ends.corners]), np.concatenate([side * (1.0, 1.0, 0.0), ends.normals])
    )


class _Frame:
    """Buffers for images of one size."""

    def __init__(self, context: moderngl.Context, width: int, height: int) -> None:
        size = (width, height)
        self._textures = [
            context.texture(size, 4, dtype="f1"),
            context.texture(size, 1, dtype="f4"),
            context.texture(size, 1, dtype="i4"),
        ]
        self._depth = context.depth_renderbuffer(size)
        self.buffer = context.framebuffer(self._textures, self._depth)
        self._shape = height, width

    def read(self) -> CameraImages:
        """Copy the images."""
        parts = [
            self.buffer.read(components=count, attachment=number, dtype=kind, alignment=1)
            for number, (count, kind) in enumerate(((3, "f1"), (1, "f4"), (1, "i4")))
        ]
        return CameraImages(
            np.frombuffer(parts[0], np.uint8).reshape(*self._shape, 3),
            np.frombuffer(parts[1], np.float32).reshape(self._shape),
            np.frombuffer(parts[2], np.int32).reshape(self._shape),
        )

    def release(self) -> None:
        """Free the buffers."""
        self.buffer.release()
        self._depth.release()
        for texture in self._textures:
            texture.release()


class OpenGlRenderer:
    """A `CameraRenderer` by OpenGL.

    Raises:
        CamerasUnavailable: There is no OpenGL here.
    """

    def __init__(self, layout: SceneLayout, files: TextureFiles) -> None:
        """Upload the solids.

        Args:
            layout: Of what cameras see.
            files: Of textures.
        """
        self._context = find_context()
        self._lighting = DARKNESS
        self._files = files
        self._pictures: dict[str, moderngl.Texture | None] = {}
        self._programs: dict[str, moderngl.Program] = {}
        self._background = self._context.program(
            BACKGROUND_VERTEX_SHADER, BACKGROUND_FRAGMENT_SHADER
        )
        corners = np.array([[-1, -1], [3, -1], [-1, 3]], "<f4")
        self._screen = self._context.vertex_array(
            self._background, [(self._context.buffer(corners.tobytes()), "2f", "corner")]
        )
        self._frames: dict[tuple[int, int], _Frame] = {}
        self._batches: list[_Batch] = []
        self._add_instances(layout.unplaced)

    def _add_instances(self, shapes: PlacedShapes) -> None:
        """Sort what is drawn by solids, and upload these."""
        parts = [_list_parts(geometry.shape) for geometry in shapes.geometries]
        listed = [
            (part, number, geometry)
            for number, geometry in enumerate(shapes.geometry.tolist())
            for part in parts[geometry]
        ]
        listed.sort(key=lambda one: one[0].solid)
        self._shape = np.array([number for _, number, _ in listed], dtype=np.intp)
        self._rises = np.array([(0.0, 0.0, part.rise_m) for part, _, _ in listed]).reshape(-1, 3)
        self._instances = np.zeros(len(listed), INSTANCE)
        solids = [geometry.shape for geometry in shapes.geometries]
        self._instances["size"] = [part.size for part, _, _ in listed] or np.zeros((0, 3))
        self._instances["colour"] = [
            find_rgba(solids[geometry])[:3] for *_, geometry in listed
        ] or (np.zeros((0, 3)))
        self._instances["label"] = shapes.entity[self._shape]
        radii = np.array([geometry.radius_m for geometry in shapes.geometries])
        self._radii = radii[shapes.geometry[self._shape]] if listed else np.zeros(0)
        self._centres = np.zeros((len(listed), 3))
        self._positions = np.zeros((len(listed), 3))
        for name, first, last in _find_runs([part.solid for part, _, _ in listed]):
            geometry = shapes.geometries[listed[first][2]]
            self._upload(_make_solid(name, geometry, self._files), slice(first, last))

    def _upload(self, solid: _Solid, rows: slice) -> None:
        picture = self._find_picture(solid.image)
        parts: list[tuple[npt.NDArray[np.floating], str, str]] = [
            (solid.corners, "3f", "vertex"),
            (solid.normals, "3f", "normal"),
        ]
        if picture is not None and solid.places is not None:
            parts.append((solid.places, "2f", "place"))
        vertices = np.concatenate([part for part, _, _ in parts], axis=1).astype("<f4")
        formats, names = " ".join(kind for _, kind, _ in parts), [name for _, _, name in parts]
        instances = self._context.buffer(reserve=INSTANCE.itemsize * (rows.stop - rows.start))
        array = self._context.vertex_array(
            self._find_program("" if picture is None else "#define TEXTURED"),
            [
                (self._context.buffer(vertices.tobytes()), formats, *names),
                (instances, "3f 4f 3f 3f 1i/i", *(INSTANCE.names or ())),
            ],
        )
        self._batches.append(_Batch(array, instances, rows, picture))

    def _find_program(self, definition: str) -> moderngl.Program:
        """Find the program of solids with or without an image, which costs more."""
        if definition not in self._programs:
            head = f"#version 330\n{definition}\n"
            self._programs[definition] = self._context.program(
                head + VERTEX_SHADER, head + FRAGMENT_SHADER
            )
        return self._programs[definition]

    def _find_picture(self, name: str) -> moderngl.Texture | None:
        """Find an image in OpenGL; None if there is none that can be read."""
        if name not in self._pictures:
            pixels = self._files.find_picture(name) if name else None
            self._pictures[name] = None if pixels is None else _upload(self._context, pixels)
        return self._pictures[name]

    def place(self, shapes: PlacedShapes, lighting: Lighting) -> None:
        """See `CameraRenderer`."""
        self._lighting = lighting
        poses = shapes.poses[self._shape]
        self._positions = poses[:, :3] + rotate(poses[:, 3:], self._rises)
        self._instances["turn"] = poses[:, 3:]
        self._centres = shapes.bounding_spheres()[0][self._shape]

    def render(self, settings: CameraSensor, pose: FloatArray) -> CameraImages:
        """See `CameraRenderer`."""
        frame = self._find_frame(settings.width, settings.height)
        frame.buffer.use()
        self._context.enable_only(moderngl.DEPTH_TEST)
        frame.buffer.clear()
        self._context.depth_func = "<="
        _set_uniform(self._background, "background", self._lighting.background)
        _set_uniform(self._background, "nothing", np.array(np.inf))
        self._screen.render()
        uniforms = {
            **_list_camera_uniforms(settings, pose),
            **_list_light_uniforms(self._lighting.choose_brightest(pose[:3]), pose[:3]),
        }
        for program in self._programs.values():
            for name, values in uniforms.items():
                _set_uniform(program, name, values)
        is_visible = self._find_visible(settings, pose)
        for batch in self._batches:
            chosen = batch.rows.start + np.flatnonzero(is_visible[batch.rows])
            if len(chosen):
                self._draw(batch, chosen, pose)
        return frame.read()

    def _draw(self, batch: _Batch, chosen: IntArray, pose: FloatArray) -> None:
        instances = self._instances[chosen]
        instances["position"] = self._positions[chosen] - pose[:3]
        batch.instances.write(instances.tobytes())
        if batch.picture is not None:
            batch.picture.use()
        batch.array.render(instances=len(chosen))

    def _find_frame(self, width: int, height: int) -> _Frame:
        if (width, height) not in self._frames:
            if len(self._frames) >= MAX_FRAMES:
                self._frames.pop(next(iter(self._frames))).release()
            self._frames[width, height] = _Frame(self._context, width, height)
        return self._frames[width, height]

    def _find_visible(self, settings: CameraSensor, pose: FloatArray) -> npt.NDArray[np.bool_]:
        """Find which shapes (i,) may be in the field of view, by their bounding spheres."""
        x, y, z = _find_optical_axes(pose) @ (self._centres - pose[:3]).T
        focal = find_focal_length(settings)
        is_visible = (z + self._radii >= settings.near_m) & (z - self._radii <= settings.far_m)
        for across, pixels in ((x, settings.width), (y, settings.height)):
            slope = CULLING_MARGIN * (pixels / 2.0 + 1.0) / focal
            outside = (np.abs(across) - slope * z) / np.hypot(1.0, slope)
            is_visible &= ~(outside > self._radii)
        return np.asarray(is_visible)


def _list_camera_uniforms(settings: CameraSensor, pose: FloatArray) -> dict[str, Numbers]:
    focal, (cx, cy) = find_focal_length(settings), find_principal_point(settings)
    width, height, near, far = settings.width, settings.height, settings.near_m, settings.far_m
    # Rows of OpenGL's buffers go up, those of images down: y down is up for OpenGL.
    scales = 2.0 * focal / width, 2.0 * focal / height
    shifts = (2.0 * cx + 1.0) / width - 1.0, (2.0 * cy + 1.0) / height - 1.0
    depths = (far + near) / (far - near), -2.0 * far * near / (far - near)
    return {
        "pinhole": np.array([*scales, *shifts]),
        "clipping": np.array(depths),
        # Matrices of OpenGL are column by column.
        "to_optical": _find_optical_axes(pose).T,
    }


def _list_light_uniforms(lighting: Lighting, eye: FloatArray) -> dict[str, Numbers]:
    places = lighting.places.copy()
    places[:, :3] -= places[:, 3:] * eye
    lights = {
        "light_at": places,
        "light_colour": lighting.colours,
        "light_fade": lighting.fades,
        "light_cone": lighting.cones,
    }
    count = len(places)
    padded = {
        name: np.concatenate([values, np.zeros((MAX_LIGHTS - count, values.shape[1]))])
        for name, values in lights.items()
    }
    suns = np.count_nonzero(places[:, 3] == 0.0)
    counts = {"suns": np.array(suns, "<i4"), "lights": np.array(count, "<i4")}
    return {**padded, **counts, "ambient": lighting.ambient}


def _upload(context: moderngl.Context, pixels: npt.NDArray[np.uint8]) -> moderngl.Texture:
    """Upload an image (h, w, 3), which repeats."""
    height, width, _ = pixels.shape
    # Rows of textures go up, as v does.
    texture = context.texture((width, height), 3, pixels[::-1].tobytes(), alignment=1)
    texture.build_mipmaps()
    texture.filter = moderngl.LINEAR_MIPMAP_NEAREST, moderngl.LINEAR
    return texture


def _find_optical_axes(pose: FloatArray) -> FloatArray:
    """Find the optical axes x, y and z (3, 3) of a camera in the world, row by row."""
    forward, left, up = to_matrix(pose[3:]).T
    return np.stack([-left, -up, forward])


def _find_runs(names: list[str]) -> Iterator[tuple[str, int, int]]:
    """Find the runs of equal names: name, first index, and index after the last."""
    first = 0
    for number in range(1, len(names) + 1):
        if number == len(names) or names[number] != names[first]:
            yield names[first], first, number
            first = number


def _set_uniform(program: moderngl.Program, name: str, values: Numbers) -> None:
    uniform = program[name]
    assert isinstance(uniform, moderngl.Uniform), name
    kind = "<i4" if values.dtype == np.int32 else "<f4"
    uniform.write(values.astype(kind).tobytes())


@cache
def find_context() -> moderngl.Context:
    """Find the context of this process; what is drawn with it belongs to the thread that made it.

    Raises:
        CamerasUnavailable: OpenGL cannot be used.
    """
    # Its stubs have another type for the name of a backend.
    settings: Any = {"backend": "egl"}
    try:
        context = moderngl.create_context(GL_VERSION, standalone=True, **settings)
    except Exception as error:
        raise CamerasUnavailable(f"OpenGL cannot be used by EGL ({error})") from error
    context.gc_mode = "auto"  # renderers are made anew when the entities change
    return context
