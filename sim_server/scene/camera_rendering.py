"""Rendering of camera images by OpenGL: colour, depth and labels in one pass.

The only importer of moderngl. Without a display and without a GPU it runs on Mesa's llvmpipe.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import moderngl
import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Shape
from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.se3 import FloatArray, cross, rotate, to_matrix
from zensim.sim_server.scene.camera_images import (
    MAX_LIGHTS,
    CameraImages,
    CamerasUnavailable,
    Lighting,
    find_focal_length,
    find_principal_point,
    find_rgba,
)
from zensim.sim_server.scene.ray_casting import NO_ENTITY, PlacedShapes, ShapeGeometry
from zensim.sim_server.scene.scene import SceneLayout

GL_VERSION = 330
CIRCLE_SEGMENTS = 32
SPHERE_RINGS = 16
GROUND_HALF_M = 2000.0
"""Half side of what is drawn of a plane."""
CULLING_MARGIN = 1.02
"""By which the field of view is widened where shapes out of sight are left out."""
MAX_FRAMES = 8
"""Sizes of images whose buffers are kept."""

VERTEX_SHADER = """
#version 330
uniform mat3 to_optical;
uniform vec4 pinhole;  // scale of x and y, shift of x and y
uniform vec2 clipping;
in vec3 vertex;
in vec3 normal;
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
#version 330
uniform vec3 ambient;
uniform int lights;
uniform vec4 light_at[{MAX_LIGHTS}];
uniform vec3 light_colour[{MAX_LIGHTS}];
in vec3 at;
in vec3 facing;
in float depth;
flat in vec3 surface;
flat in int entity;
layout(location = 0) out vec4 seen_colour;
layout(location = 1) out float seen_depth;
layout(location = 2) out int seen_label;

void main() {{
    vec3 normal = normalize(facing);
    normal = dot(normal, at) > 0.0 ? -normal : normal;
    vec3 light = ambient;
    for (int i = 0; i < lights; ++i) {{
        vec3 towards = normalize(light_at[i].xyz - light_at[i].w * at);
        light += light_colour[i] * max(dot(towards, normal), 0.0);
    }}
    seen_colour = vec4(min(surface * light, vec3(1.0)), 1.0);
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
    """

    corners: FloatArray
    normals: FloatArray


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
        return [_Part(_name_mesh(shape), (1.0, 1.0, 1.0))]
    return [_Part("box", shape.size)]


def _name_mesh(shape: Shape) -> str:
    return f"{shape.mesh} {shape.size}"


def _make_solid(name: str, geometry: ShapeGeometry) -> _Solid:
    if name == "sphere":
        return _make_sphere()
    if name == "cylinder":
        return _make_cylinder()
    if name == "plane":
        square = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], dtype=np.float64)
        return _make_flat(square[[0, 1, 2, 0, 2, 3]])
    if name == "box":
        return _make_box()
    return _make_flat(geometry.triangles.reshape(-1, 3))


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
    return _Solid(corners, corners)


def _make_cylinder() -> _Solid:
    turns = np.arange(CIRCLE_SEGMENTS) * (2.0 * np.pi / CIRCLE_SEGMENTS)
    ring = np.stack([np.cos(turns), np.sin(turns), np.zeros(CIRCLE_SEGMENTS)], axis=1)
    half = np.array([0.0, 0.0, 0.5])
    side = _make_grid(np.stack([ring - half, ring + half]))
    caps = [
        np.stack([ring + end, np.roll(ring, -1, axis=0) + end, 0.0 * ring + end], axis=1)
        for end in (half, -half)
    ]
    ends = _make_flat(np.concatenate(caps).reshape(-1, 3))
    # Two-sided light makes the direction of normals irrelevant.
    return _Solid(
        np.concatenate([side, ends.corners]),
        np.concatenate([side * (1.0, 1.0, 0.0), ends.normals]),
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

    def __init__(self, layout: SceneLayout, lighting: Lighting) -> None:
        """Upload the solids.

        Args:
            layout: Of what cameras see.
            lighting: Of the world.
        """
        self._context = find_context()
        self._lighting = lighting
        self._program = self._context.program(VERTEX_SHADER, FRAGMENT_SHADER)
        self._background = self._context.program(
            BACKGROUND_VERTEX_SHADER, BACKGROUND_FRAGMENT_SHADER
        )
        corners = np.array([[-1, -1], [3, -1], [-1, 3]], "<f4")
        self._screen = self._context.vertex_array(
            self._background, [(self._context.buffer(corners.tobytes()), "2f", "corner")]
        )
        self._frames: dict[tuple[int, int], _Frame] = {}
        self._solids: list[tuple[moderngl.VertexArray, moderngl.Buffer, slice]] = []
        self._add_instances(layout.unplaced)
        self._set_uniforms()

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
            self._upload(_make_solid(name, geometry), slice(first, last))

    def _upload(self, solid: _Solid, rows: slice) -> None:
        vertices = np.concatenate([solid.corners, solid.normals], axis=1).astype("<f4")
        instances = self._context.buffer(reserve=INSTANCE.itemsize * (rows.stop - rows.start))
        array = self._context.vertex_array(
            self._program,
            [
                (self._context.buffer(vertices.tobytes()), "3f 3f", "vertex", "normal"),
                (instances, "3f 4f 3f 3f 1i/i", *(INSTANCE.names or ())),
            ],
        )
        self._solids.append((array, instances, rows))

    def _set_uniforms(self) -> None:
        lighting = self._lighting
        colours = np.zeros((MAX_LIGHTS, 3))
        colours[: len(lighting.colours)] = lighting.colours
        _set_uniform(self._program, "light_colour", colours)
        _set_uniform(self._program, "lights", np.array(len(lighting.colours), "<i4"))
        _set_uniform(self._program, "ambient", lighting.ambient)
        _set_uniform(self._background, "background", lighting.background)
        _set_uniform(self._background, "nothing", np.array(np.inf))

    def place(self, shapes: PlacedShapes) -> None:
        """See `CameraRenderer`."""
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
        self._screen.render()
        self._point_camera(settings, pose)
        is_visible = self._find_visible(settings, pose)
        for array, buffer, rows in self._solids:
            chosen = rows.start + np.flatnonzero(is_visible[rows])
            if len(chosen):
                instances = self._instances[chosen]
                instances["position"] = self._positions[chosen] - pose[:3]
                buffer.write(instances.tobytes())
                array.render(instances=len(chosen))
        return frame.read()

    def _find_frame(self, width: int, height: int) -> _Frame:
        if (width, height) not in self._frames:
            if len(self._frames) >= MAX_FRAMES:
                self._frames.pop(next(iter(self._frames))).release()
            self._frames[width, height] = _Frame(self._context, width, height)
        return self._frames[width, height]

    def _point_camera(self, settings: CameraSensor, pose: FloatArray) -> None:
        focal, (cx, cy) = find_focal_length(settings), find_principal_point(settings)
        width, height, near, far = settings.width, settings.height, settings.near_m, settings.far_m
        program = self._program
        # Rows of OpenGL's buffers go up, those of images down: y down is up for OpenGL.
        scales = 2.0 * focal / width, 2.0 * focal / height
        shifts = (2.0 * cx + 1.0) / width - 1.0, (2.0 * cy + 1.0) / height - 1.0
        _set_uniform(program, "pinhole", np.array([*scales, *shifts]))
        depths = (far + near) / (far - near), -2.0 * far * near / (far - near)
        _set_uniform(program, "clipping", np.array(depths))
        # Matrices of OpenGL are column by column.
        _set_uniform(program, "to_optical", _find_optical_axes(pose).T)
        places = np.zeros((MAX_LIGHTS, 4))
        found = self._lighting.places
        places[: len(found)] = found
        places[: len(found), :3] -= found[:, 3:] * pose[:3]
        _set_uniform(program, "light_at", places)

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


def _set_uniform(
    program: moderngl.Program, name: str, values: npt.NDArray[np.float64 | np.int32]
) -> None:
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
