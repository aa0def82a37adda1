"""Meshes of a model for engine and viewer: hulls, split static meshes, decimated visuals.

A moving body collides by the convex hulls of its meshes, a static one by their triangles. A visual
becomes one mesh for each material of its file. The results are binary STL in the scale of the
file, images and texture coordinates, named by their sha256.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from hashlib import sha256
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import ReportEntry, Texture
from zensim.proto.stl import write_corners
from zensim.sim_server.description.meshes.convex_hull import find_exact_hull, find_hull
from zensim.sim_server.description.meshes.decimation import decimate, split_mesh
from zensim.sim_server.description.meshes.generated_solids import is_generated, list_corners
from zensim.sim_server.description.meshes.mesh_lookup import has_assets
from zensim.sim_server.description.meshes.mesh_reader import read_mesh
from zensim.sim_server.description.meshes.mesh_triangles import FindFile, MeshMaterial, Triangles
from zensim.sim_server.description.meshes.textures import (
    ImageError,
    make_textured_solid,
    reduce_image,
)
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from zensim.proto.messages.model_messages import Link, Model, Quat, Shape

MeshFiles = dict[str, tuple[str, bytes | None]]
"""SHA-256 and bytes of each mesh, by URI."""

MAX_STATIC_TRIANGLES = 20_000
"""Triangles of a static collision."""
MAX_STATIC_TRIANGLES_OF_MODEL = 300_000
"""Triangles of all static collisions of a model."""
MAX_PIECE_TRIANGLES = 2_500
"""The engine loads such a piece of a static mesh in a few milliseconds."""
MAX_VISUAL_TRIANGLES = 20_000
"""Triangles of a visual: 1 MB, which is sent in one message."""
ConversionKey = tuple[str, str, int]
"""sha256 of a file, the purpose, and the maximum count of triangles."""
MAX_SOURCE_PIXELS_IN_ALL = 1 << 27
"""Pixels that are decoded for a robot or a world: 6 s of CPU."""
MAX_IMAGE_BYTES_IN_ALL = 48 << 20
"""Bytes of the reduced images of a robot or a world; further ones become their mean colour."""
MAX_PARTS = 64
"""Parts of different materials of one visual."""


class ConvertedPart(NamedTuple):
    """A converted mesh by its sha256, and the colour and texture of its file."""

    mesh: str
    rgba: Quat | None = None
    texture: Texture | None = None


@dataclass
class MeshConversions:
    """Converted meshes and images, shared by models that share files.

    Attributes:
        meshes: Bytes of meshes, images and texture coordinates by sha256.
        known: Parts of each conversion.
        images: sha256 of each reduced image, and its mean colour, by the sha256 of its source.
        faults: Why images cannot be used, by the sha256 of their source.
    """

    meshes: dict[str, bytes] = field(default_factory=dict)
    known: dict[ConversionKey, tuple[ConvertedPart, ...]] = field(default_factory=dict)
    images: dict[str, tuple[str, Quat]] = field(default_factory=dict)
    faults: dict[str, str] = field(default_factory=dict)
    image_bytes: int = 0
    source_pixels: int = 0

    def store(self, data: bytes) -> str:
        """Add a result; return its sha256."""
        name = sha256(data).hexdigest()
        self.meshes[name] = data
        return name

    def convert_image(self, data: bytes) -> tuple[str, Quat]:
        """Reduce an image; return its sha256, empty without room for it, and its mean colour.

        Raises:
            ImageError: It cannot be used.
        """
        source = sha256(data).hexdigest()
        if source in self.faults:
            raise ImageError(self.faults[source])
        if source not in self.images:
            try:
                self.images[source] = self._reduce(data)
            except ImageError as error:
                self.faults[source] = str(error)
                raise
        return self.images[source]

    def _reduce(self, data: bytes) -> tuple[str, Quat]:
        if self.source_pixels > MAX_SOURCE_PIXELS_IN_ALL:
            raise ImageError(f"comes after {MAX_SOURCE_PIXELS_IN_ALL} pixels of others")
        reduced = reduce_image(data)
        self.source_pixels += reduced.pixels
        self.image_bytes += len(reduced.data)
        has_room = self.image_bytes <= MAX_IMAGE_BYTES_IN_ALL
        return (self.store(reduced.data) if has_room else ""), reduced.mean


@dataclass
class _ModelConversion:
    find_file: FindFile
    purpose: str
    """Purpose of the collisions: `static` or `hull`."""
    max_count: int
    """Triangles of a static collision."""
    conversions: MeshConversions
    overrides_materials: bool
    """Whether the colour of a visual replaces the materials of its file, as in SDF."""
    report: list[ReportEntry] = field(default_factory=list)
    read: dict[str, Triangles] = field(default_factory=dict)


def convert_meshes(
    model: Model,
    find_file: FindFile,
    conversions: MeshConversions,
    *,
    overrides_materials: bool = True,
) -> Model:
    """Convert the meshes of a model; URIs become sha256 of what is in `conversions`.

    Args:
        model: With URIs of meshes and images.
        find_file: Finds them, and the materials and images that meshes name.
        conversions: Gets the results.
        overrides_materials: Whether the colour of a visual replaces the materials of its file, as
            in SDF; else it is that of parts without a material, as in URDF.

    Raises:
        ModelError: A collision's mesh cannot be read.
    """
    if not has_assets(model):
        return model
    count = sum(shape.kind == "mesh" for link in model.links for shape in link.collisions)
    max_count = min(MAX_STATIC_TRIANGLES, MAX_STATIC_TRIANGLES_OF_MODEL // max(1, count))
    purpose = "static" if model.is_static else "hull"
    job = _ModelConversion(find_file, purpose, max_count, conversions, overrides_materials)
    links = tuple(_convert_link(link, job) for link in model.links)
    report = dict.fromkeys(job.report)
    return msgspec.structs.replace(model, links=links, report=(*model.report, *report))


def _convert_link(link: Link, job: _ModelConversion) -> Link:
    collisions = (_convert_collision(shape, job) for shape in link.collisions)
    visuals = (_convert_visual(link.name, shape, job) for shape in link.visuals)
    return msgspec.structs.replace(
        link,
        collisions=tuple(chain.from_iterable(collisions)),
        visuals=tuple(chain.from_iterable(visuals)),
    )


def _convert_collision(shape: Shape, job: _ModelConversion) -> tuple[Shape, ...]:
    if shape.kind != "mesh":
        return (shape,)
    parts = _convert_shape(shape, job.purpose, job)
    return tuple(msgspec.structs.replace(shape, mesh=part.mesh) for part in parts)


def _convert_visual(link: str, shape: Shape, job: _ModelConversion) -> tuple[Shape, ...]:
    shape = _convert_texture(shape, job)
    if shape.kind != "mesh":
        return (shape if shape.texture is None else _cover_solid(shape, shape.texture, job),)
    is_covered = shape.texture is not None
    is_plain = shape.rgba is not None and job.overrides_materials and not is_covered
    purpose = "covered" if is_covered else "plain" if is_plain else "visual"
    try:
        parts = _convert_shape(shape, purpose, job)
    except ModelError as error:
        job.report.append(
            ReportEntry("suspicious", f"link {quote(link)}", f"{error.message}; not drawn")
        )
        return ()
    return tuple(_paint(shape, part) for part in parts)


def _paint(shape: Shape, part: ConvertedPart) -> Shape:
    """Give a shape the mesh, colour and texture of a part of its file, or its own texture."""
    texture, rgba = part.texture, part.rgba or shape.rgba
    if shape.texture is not None:
        coordinates = part.texture.coordinates if part.texture else ""
        texture = Texture(shape.texture.image, coordinates) if coordinates else None
        rgba = shape.rgba
    return msgspec.structs.replace(shape, mesh=part.mesh, rgba=rgba, texture=texture)


def _convert_texture(shape: Shape, job: _ModelConversion) -> Shape:
    """Replace the URI of a shape's own image by that of its asset; left out if it is unusable."""
    if shape.texture is None:
        return shape
    uri = shape.texture.image
    found = job.find_file(uri)
    image = ""
    if found is None:
        _report_texture(uri, "is not on the server", job)
    else:
        image, mean = _convert_image(uri, found[1], job)
        if not image and mean is not None:
            return msgspec.structs.replace(shape, rgba=shape.rgba or mean, texture=None)
    return msgspec.structs.replace(shape, texture=Texture(image) if image else None)


def _convert_image(name: str, data: bytes, job: _ModelConversion) -> tuple[str, Quat | None]:
    """Convert an image; empty, and reported, if it cannot be used."""
    try:
        image, mean = job.conversions.convert_image(data)
    except ImageError as error:
        _report_texture(name, str(error), job)
        return "", None
    if not image:
        _report_texture(name, "is one too many; its mean colour is drawn", job)
    return image, mean


def _report_texture(name: str, fault: str, job: _ModelConversion) -> None:
    # A world is not refused for a colour.
    job.report.append(ReportEntry("ignored", f"texture {quote(name)}", fault))


def _cover_solid(shape: Shape, texture: Texture, job: _ModelConversion) -> Shape:
    """Replace a primitive by a mesh with texture coordinates."""
    solid = make_textured_solid(shape)
    coordinates = job.conversions.store(solid.coordinates.astype("<f4").tobytes())
    return msgspec.structs.replace(
        shape,
        kind="mesh",
        size=(1.0, 1.0, 1.0),
        mesh=job.conversions.store(write_corners(solid.corners)),
        texture=Texture(texture.image, coordinates),
    )


def _convert_shape(shape: Shape, purpose: str, job: _ModelConversion) -> tuple[ConvertedPart, ...]:
    if is_generated(shape.mesh):
        source, data, purpose = shape.mesh, b"", "generated"
    else:
        source, data = job.find_file(shape.mesh) or ("", b"")
    # Files of equal content may name different images beside them.
    place = shape.mesh if purpose == "visual" else ""
    key = (source + place, purpose, job.max_count if purpose == "static" else 0)
    if (parts := job.conversions.known.get(key)) is None:
        if source not in job.read:
            job.read[source] = read_mesh_or_generate(shape.mesh, data, job.find_file)
        if purpose == "static":
            _report_decimation(shape.mesh, len(job.read[source].faces), job)
        parts = job.conversions.known[key] = tuple(CONVERSIONS[purpose](job.read[source], job))
    return parts


def read_mesh_or_generate(uri: str, data: bytes, find_file: FindFile) -> Triangles:
    """Read a mesh file, or make the mesh of a generated solid.

    Raises:
        ModelError: The file is invalid.
    """
    if is_generated(uri):
        return Triangles(*find_exact_hull(np.array(list_corners(uri))))
    return read_mesh(uri, data, find_file)


def _report_decimation(uri: str, count: int, job: _ModelConversion) -> None:
    if count > job.max_count:
        fault = f"{count} triangles are reduced to {job.max_count} for collisions"
        job.report.append(ReportEntry("suspicious", f"mesh {quote(uri)}", fault))


def convex_hull(triangles: Triangles) -> Triangles:
    """Make the convex hull of the corners that triangles use."""
    is_used = np.zeros(len(triangles.vertices), dtype=bool)
    is_used[triangles.faces] = True
    return Triangles(*find_hull(triangles.vertices[is_used]))


def _store_meshes(meshes: Sequence[Triangles], job: _ModelConversion) -> Iterator[ConvertedPart]:
    for mesh in meshes:
        yield ConvertedPart(job.conversions.store(write_corners(mesh.corners)))


def _convert_static(triangles: Triangles, job: _ModelConversion) -> Iterator[ConvertedPart]:
    reduced = decimate(triangles, job.max_count)
    return _store_meshes(split_mesh(reduced, MAX_PIECE_TRIANGLES), job)


def _convert_plain(triangles: Triangles, job: _ModelConversion) -> Iterator[ConvertedPart]:
    return _store_meshes([decimate(triangles, MAX_VISUAL_TRIANGLES)], job)


def _convert_covered(triangles: Triangles, job: _ModelConversion) -> Iterator[ConvertedPart]:
    """Convert a mesh for the image of its visual; without coordinates it stays plain."""
    drawn = decimate(triangles, MAX_VISUAL_TRIANGLES)
    mesh, looks = job.conversions.store(write_corners(drawn.corners)), drawn.appearance
    if looks is None or not looks.coordinates.any():
        yield ConvertedPart(mesh)
        return
    yield ConvertedPart(mesh, texture=Texture("", _store_coordinates(looks.coordinates, job)))


def _convert_materials(triangles: Triangles, job: _ModelConversion) -> Iterator[ConvertedPart]:
    """Convert a mesh into a part for each of its materials."""
    drawn = decimate(triangles, MAX_VISUAL_TRIANGLES)
    looks = drawn.appearance
    if looks is None:
        yield from _store_meshes([drawn], job)
        return
    for name in looks.missing:
        _report_texture(name, "is not on the server", job)
    painted = [_convert_material(material, job) for material in looks.materials]
    groups: dict[ConvertedPart, list[int]] = {}
    for number in np.unique(looks.material_of).tolist():
        groups.setdefault(painted[number], []).append(number)
    for part, numbers in _limit_groups(groups):
        faces = np.flatnonzero(np.isin(looks.material_of, numbers))
        mesh = job.conversions.store(write_corners(drawn.vertices[drawn.faces[faces]]))
        texture = part.texture
        if texture is not None:
            texture = Texture(texture.image, _store_coordinates(looks.coordinates[faces], job))
        yield ConvertedPart(mesh, part.rgba, texture)


def _limit_groups(
    groups: dict[ConvertedPart, list[int]],
) -> Iterator[tuple[ConvertedPart, list[int]]]:
    """List the first groups; the last one has the materials of all others, too."""
    listed = list(groups.items())
    yield from listed[: MAX_PARTS - 1]
    if rest := listed[MAX_PARTS - 1 :]:
        yield rest[0][0], [number for _, numbers in rest for number in numbers]


def _convert_material(material: MeshMaterial, job: _ModelConversion) -> ConvertedPart:
    """Convert a material; the mesh of the result is still empty."""
    if not material.image:
        return ConvertedPart("", material.rgba)
    image, mean = _convert_image("in the mesh", material.image, job)
    if image:
        return ConvertedPart("", material.rgba, Texture(image))
    return ConvertedPart("", mean or material.rgba)


def _store_coordinates(coordinates: NDArray[np.float32], job: _ModelConversion) -> str:
    return job.conversions.store(coordinates.astype("<f4").tobytes())


CONVERSIONS: dict[str, Callable[[Triangles, _ModelConversion], Iterator[ConvertedPart]]] = {
    "hull": lambda triangles, job: _store_meshes([convex_hull(triangles)], job),
    "static": _convert_static,
    "plain": _convert_plain,
    "covered": _convert_covered,
    "visual": _convert_materials,
    "generated": lambda triangles, job: _store_meshes([triangles], job),
}
