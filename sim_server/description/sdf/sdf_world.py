"""SDF worlds: placed models, ground, gravity, physics settings, lights, named poses.

```xml
<frame name="dock_1" xmlns:zensim="urn:zensim">
  <pose>1 2 0 0 0 1.57</pose>
  <zensim:description>beside the charging station</zensim:description>
  <zensim:tags>parking charging</zensim:tags>
  <zensim:size>0.8 0.6 1</zensim:size>
</frame>
```
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NoReturn

import msgspec
from lxml import etree

from zensim.proto.messages.asset_messages import normalize_model_name, parse_fuel_uri
from zensim.proto.messages.entity_messages import (
    MAX_DESCRIPTION_LENGTH,
    MAX_TAG_LENGTH,
    MAX_TAGS,
    Bounds,
    BoundsType,
)
from zensim.proto.messages.model_messages import IDENTITY, Model, Origin, Vec3
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.messages.sensing_messages import SphericalCoordinates
from zensim.proto.messages.spawn_messages import NamedPose
from zensim.proto.messages.standard_messages import Point, Pose, Quaternion, Vector3
from zensim.proto.messages.world_messages import Scene
from zensim.proto.rigid_transforms import compose, rotate
from zensim.sim_server.description.element_rules import check_element, find_name, zensim_tag
from zensim.sim_server.description.link_surfaces import read_rgba
from zensim.sim_server.description.meshes.mesh_lookup import MeshPolicy
from zensim.sim_server.description.meshes.mesh_triangles import find_no_file
from zensim.sim_server.description.parsed_model import MODEL_FRAME, WORLD_LINK, find_repeated
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.sdf.sdf_frames import SCOPE_SEPARATOR, PoseGraph
from zensim.sim_server.description.sdf.sdf_includes import (
    IncludeExpander,
    ResolveInclude,
    no_includes,
    parse_sdf,
)
from zensim.sim_server.description.sdf.sdf_model import (
    ModelPart,
    check_sibling_names,
    find_placement,
    flatten_model,
    read_model_parts,
    rename_repeated,
)
from zensim.sim_server.description.sdf.sdf_population import expand_populations
from zensim.sim_server.description.sdf.sdf_rules import (
    GROUND_INCLUDE,
    PHYSICS,
    SPHERICAL_CHOICES,
    SPHERICAL_LIMITS,
    SUN_INCLUDE,
    UNSUPPORTED_WORLD_TAGS,
    WORLD,
)
from zensim.sim_server.description.sdf.sdf_solids import (
    GROUND_SLAB_M,
    GROUND_SLAB_ORIGIN,
    read_light,
)
from zensim.sim_server.description.sdf.sdf_values import (
    RelativePose,
    read_name,
    read_pose,
    read_scalar,
    read_text,
)
from zensim.sim_server.description.strict_parsing import (
    MAX_QUOTED_NAMES,
    quote,
    quote_names,
    read_numbers,
)
from zensim.sim_server.description.world_model import (
    BoundedPose,
    PhysicsSettings,
    PlacedModel,
    WorldModel,
)
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat
    from zensim.sim_server.description.meshes.mesh_triangles import FindFile

GROUND_MODEL = b"""<model name="ground_plane"><static>true</static><link name="link">
<collision name="collision"><geometry><plane/></geometry></collision></link></model>"""
MIN_STEP_S, MAX_STEP_S = 1e-4, 1.0
MAX_REAL_TIME_FACTOR = 1000.0
MAX_GRAVITY = 1000.0
"""Gravity along an axis [m/s^2]: four times that of the sun."""
MAX_MAGNETIC_FIELD_T = 10.0
"""Field along an axis: ten times that of a strong magnet."""
UP: Vec3 = (0.0, 0.0, 1.0)
LEAST_UPRIGHT = 0.5
"""Height of the normal of a plane on which a robot may stand: at most 60 degrees of slope."""
MAX_MODELS = 5000
SUN, GROUND = "sun", "ground_plane"
"""Names of the models that need no file."""
MODEL_SCHEME = "model://"
XACRO_PREFIX = "{http://www.ros.org/wiki/xacro}"
SKIPPABLE_CODES = (SpawnCode.UNSUPPORTED_FORMAT, SpawnCode.MISSING_ASSETS)
"""Errors of models that are left out; other errors are those of the world."""
_NON_NAME_CHARACTERS = re.compile(r"[^A-Za-z0-9_]")
MAX_ENTITY_NAME_LENGTH = 56


def read_named_pose(frame: Element, name: str, origin: Origin) -> BoundedPose:
    """Read a <frame> of a world as a named pose.

    Raises:
        ModelError: Its size is not three positive numbers, or its texts are too long.
    """
    texts = {zensim_tag(child): (child.text or "").strip() for child in frame}
    tags = tuple(dict.fromkeys(texts.get("tags", "").replace(",", " ").split()))
    description = texts.get("description", "")
    is_long = len(description) > MAX_DESCRIPTION_LENGTH or any(
        len(tag) > MAX_TAG_LENGTH for tag in tags
    )
    if is_long or len(tags) > MAX_TAGS:
        raise ModelError(
            f"frame {quote(name)} has {len(tags)} tags and {len(description)} characters of "
            f"description; use at most {MAX_TAGS} of {MAX_TAG_LENGTH}, "
            f"and {MAX_DESCRIPTION_LENGTH}",
            slug="sdf.named_pose",
        )
    pose = Pose(Point(*origin.position), Quaternion(*origin.orientation))
    return BoundedPose(NamedPose(name, description, tags, pose), _read_bounds(texts, name))


def _read_bounds(texts: dict[str, str], name: str) -> Bounds:
    if not texts.get("size"):
        return Bounds()
    where = f"frame {quote(name)}, size"
    x, y, z = read_numbers(texts["size"], counts=(3,), where=where, slug="sdf.named_pose")
    if min(x, y, z) <= 0.0:
        raise ModelError(f"{where}: {x:g} {y:g} {z:g}; use metres > 0", slug="sdf.named_pose")
    upper = Vector3(x / 2.0, y / 2.0, z / 2.0)
    return Bounds(BoundsType.BOX, (upper, Vector3(-upper.x, -upper.y, -upper.z)))


def read_physics(physics: Element, report: ParseReport) -> PhysicsSettings:
    """Read the step [s] and the real-time factor of a <physics>.

    Raises:
        ModelError: One is not a number or out of range.
    """
    step = _read_in_range(physics, "max_step_size", (MIN_STEP_S, MAX_STEP_S))
    limits = (-MAX_REAL_TIME_FACTOR, MAX_REAL_TIME_FACTOR)
    factor = _read_in_range(physics, "real_time_factor", limits)
    if factor is not None and factor < 0.0:
        report.suspicious("physics: <real_time_factor>", f"{factor:g}: as fast as possible, as 0")
        factor = 0.0
    rate = _read_in_range(physics, "real_time_update_rate", (0.0, 1e6))
    if rate is not None:
        # Gazebo's steps per second of wall time override the factor; 0 is unlimited.
        factor = min(rate * (step or 0.001), MAX_REAL_TIME_FACTOR)
    for child in physics:
        if child.tag in PHYSICS.children:
            report.applied(f"physics: <{child.tag}>", (child.text or "").strip()[:40])
    return PhysicsSettings(step, factor)


def read_scene(scene: Element) -> Scene:
    """Read the colours of a <scene>.

    Raises:
        ModelError: One is not three or four numbers.
    """
    return Scene(_read_colour(scene, "ambient"), _read_colour(scene, "background"))


def _read_in_range(physics: Element, tag: str, bounds: tuple[float, float]) -> float | None:
    if not read_text(physics, tag):
        return None
    number = read_scalar(physics, tag, 0.0, "physics")
    if not bounds[0] <= number <= bounds[1]:
        raise ModelError(
            f"physics, {tag}: {number:g} is out of range; use {bounds[0]:g} to {bounds[1]:g}",
            slug="sdf.physics",
        )
    return number


def _read_colour(owner: Element, tag: str) -> Quat | None:
    text = read_text(owner, tag)
    if not text:
        return None
    return read_rgba(text, where=f"{owner.tag}, {tag}", slug="sdf.number", report=None)


@dataclass
class _WorldDraft:
    """State of reading a world."""

    world: WorldModel
    report: ParseReport
    policy: MeshPolicy
    allow_missing: bool
    frames: PoseGraph = field(default_factory=PoseGraph)
    taken: set[str] = field(default_factory=set)
    reserved: frozenset[str] = frozenset()
    """Names of models that are names of entities as they are."""
    models: list[PlacedModel] = field(default_factory=list)


def read_world(
    text: str,
    *,
    resolve: ResolveInclude = no_includes,
    find_mesh: FindFile = find_no_file,
    allow_missing: bool = False,
) -> WorldModel:
    """Read a world; unsupported models are reported and left out.

    Args:
        text: SDF with one <world>.
        resolve: Finds the text of an included model other than sun and ground_plane.
        find_mesh: Finds a mesh by its URI.
        allow_missing: Leave out included models and collisions whose file is missing.

    Raises:
        ModelError: The text is not a valid SDF world, or a file is missing.
    """
    report = ParseReport()
    world = _find_world(parse_sdf(text, report))
    draft = _WorldDraft(
        WorldModel(name=_read_world_name(world, report)),
        report,
        MeshPolicy(find_mesh, allow_missing=True),
        allow_missing,
    )
    expand_populations(world, report)
    _apply_builtin_includes(world, draft)
    IncludeExpander(resolve, report, allow_missing=allow_missing).expand(world)
    rename_repeated(world, report)
    _choose_physics(world, report)
    check_element(world, WORLD, "world", report)
    _add_frames(world, draft)
    for child in _list_read(world):
        _read_element(child, draft)
    if draft.policy.missing and not allow_missing:
        _refuse_missing_meshes(draft.policy.missing)
    if not draft.world.ground_plane and not any(map(_is_support, draft.models)):
        report.suspicious("world", "no ground_plane; robots will fall")
    return msgspec.structs.replace(draft.world, models=tuple(draft.models), report=report.entries())


def _choose_physics(world: Element, report: ParseReport) -> None:
    """Remove the <physics> besides that with default="true", if one has it."""
    listed = world.findall("physics")
    chosen = [one for one in listed if one.get("default") in ("true", "1")][:1]
    if chosen and len(listed) > 1:
        report.suspicious("physics", "given more than once; the one with default='true' is used")
        for one in listed:
            if one is not chosen[0]:
                world.remove(one)


def _list_read(world: Element) -> Iterator[Element]:
    """List the elements that are read: all of a tag that may repeat, else the first."""
    seen: set[str] = set()
    for child in world:
        if child.tag in WORLD.many or child.tag not in seen:
            yield child
        seen.add(child.tag)


def _read_world_name(world: Element, report: ParseReport) -> str:
    if (world.get("name") or "").strip() == WORLD_LINK:
        # Gazebo Classic loads such worlds.
        report.suspicious("world", f"its name {WORLD_LINK!r} is reserved by SDF")
        return WORLD_LINK
    return read_name(world, "world")


def _find_world(sdf: Element) -> Element:
    worlds = sdf.findall("world")
    if len(worlds) != 1 or len(sdf) != 1:
        if any(str(child.tag).startswith(XACRO_PREFIX) for child in sdf):
            raise ModelError(
                "the file is xacro; expand it first, as with 'xacro FILE > world.sdf'",
                code=SpawnCode.UNSUPPORTED_FORMAT,
                slug="sdf.world",
            )
        content = ", ".join(f"<{child.tag[:40]}>" for child in list(sdf)[:5]) or "nothing"
        raise ModelError(
            f"<sdf> contains {content}; a world file contains one <world> and nothing else",
            code=SpawnCode.UNSUPPORTED_FORMAT,
            slug="sdf.world",
        )
    return worlds[0]


def _refuse_missing_meshes(faults: list[str]) -> NoReturn:
    more = f"; and {len(faults) - MAX_QUOTED_NAMES} more" if len(faults) > MAX_QUOTED_NAMES else ""
    raise ModelError(
        f"{len(faults)} collisions lack their mesh: {'; '.join(faults[:MAX_QUOTED_NAMES])}{more}; "
        "add its folder to `model_path`, or allow missing meshes",
        code=SpawnCode.MISSING_ASSETS,
        slug="mesh.missing",
    )


def _apply_builtin_includes(world: Element, draft: _WorldDraft) -> None:
    replace = msgspec.structs.replace
    for include in world.findall("include"):
        uri = read_text(include, "uri")
        name = _find_builtin_name(uri)
        if not name:
            continue
        draft.report.applied(f"include {uri}", f"built-in {name}")
        rule = SUN_INCLUDE if name == SUN else GROUND_INCLUDE
        check_element(include, rule, f"include {uri}", draft.report)
        if name == SUN:
            draft.world = replace(draft.world, scene=replace(draft.world.scene, has_sun=True))
            world.remove(include)
        else:
            world.replace(include, _make_ground_model(include))


def _find_builtin_name(uri: str) -> str:
    """Find the built-in model of a URI, `model://NAME` or that of Gazebo Fuel; empty for others."""
    fuel = parse_fuel_uri(uri)
    if fuel is not None:
        name = "" if fuel.file else fuel.name
    else:
        name = uri.removeprefix(MODEL_SCHEME).strip("/") if uri.startswith(MODEL_SCHEME) else ""
    name = normalize_model_name(name)
    return name if name in (SUN, GROUND) else ""


def _make_ground_model(include: Element) -> Element:
    """Make the static model of a ground plane, with the name and the pose of its include."""
    model = etree.fromstring(GROUND_MODEL)
    model.set("name", read_text(include, "name") or GROUND)
    model.extend(include.findall("pose")[:1])
    return model


def _add_frames(world: Element, draft: _WorldDraft) -> None:
    models = world.findall("model")
    if len(models) > MAX_MODELS:
        raise ModelError(
            f"the world has {len(models)} models; use at most {MAX_MODELS}", slug="sdf.size"
        )
    names = [read_name(model, "model") for model in models]
    check_sibling_names(world, draft.report)
    if repeated := find_repeated(names):
        raise ModelError(
            f"model names {quote_names(repeated)} are used more than once; make them unique",
            slug="sdf.duplicate_name",
        )
    draft.reserved = frozenset(one for one in names if _to_name(one) == one)
    saved = {
        model.get("name"): model
        for model in world.findall("state/model")
        if model.find("pose") is not None
    }
    for name, model in zip(names, models, strict=True):
        if name in saved:
            draft.report.applied(f"state: model {quote(name)}", "the pose of the state is used")
        _add_frame(name, saved.get(name, model), MODEL_FRAME, draft)
    attachments: dict[str, str] = {}
    for frame in world.findall("frame"):
        where = f"frame {quote(frame.get('name'))}"
        parent = (frame.get("attached_to") or "").strip()
        implied = MODEL_FRAME if parent in ("", WORLD_LINK) else parent
        name = read_name(frame, where)
        attachments[name] = implied
        _add_frame(name, frame, implied, draft)
    _check_attachments(attachments, models)
    _add_nested_frames(world, models, draft)


def _add_nested_frames(world: Element, models: Sequence[Element], draft: _WorldDraft) -> None:
    """Add the frames of models that poses and frames of the world name, such as `arm::hand`."""
    named = {(pose.get("relative_to") or "").strip() for pose in world.findall("*/pose")}
    named |= {(frame.get("attached_to") or "").strip() for frame in world.findall("frame")}
    by_name = {model.get("name"): model for model in models}
    for name in sorted(named):
        model_name, _, inner = name.partition(SCOPE_SEPARATOR)
        if not inner or model_name not in by_name:
            continue
        model = by_name[model_name]
        with _naming_model(model_name):
            frames = flatten_model(model, ParseReport()).frames
            origin = compose(find_placement(model, Origin()), frames.pose(inner))
        draft.frames.add(name, RelativePose(origin), scope="", implied=model_name)


def _check_attachments(attachments: dict[str, str], models: Sequence[Element]) -> None:
    """Check that each frame of a world is attached to the world or a model."""
    names = {model.get("name") or "" for model in models}
    checked: set[str] = set()
    for name in attachments:
        at, seen = name, set[str]()
        while at in attachments and at not in seen and at not in checked:
            seen.add(at)
            at = attachments[at]
        if at in checked:
            checked |= seen
            continue
        checked |= seen
        if at in seen:
            raise ModelError(
                f"frame {quote(at)} is attached to itself; attach one of "
                f"{quote_names(sorted(seen))} to the world or a model",
                slug="sdf.attachment_cycle",
            )
        if at != MODEL_FRAME and at.partition(SCOPE_SEPARATOR)[0] not in names:
            raise ModelError(
                f"frame {quote(name)} is attached to {quote(at)}, which does not exist; "
                "use a model, a frame or the world",
                slug="sdf.unknown_frame",
            )


def _add_frame(name: str, owner: Element, implied: str, draft: _WorldDraft) -> None:
    pose = read_pose(owner, f"{owner.tag} {quote(name)}")
    if pose.frame == WORLD_LINK:
        pose = msgspec.structs.replace(pose, frame=MODEL_FRAME)
    draft.frames.add(name, pose, scope="", implied=implied)


def _read_element(child: Element, draft: _WorldDraft) -> None:
    replace, report = msgspec.structs.replace, draft.report
    if child.tag == "model":
        _read_model(child, draft)
    elif child.tag == "frame":
        _read_world_frame(child, draft)
    elif child.tag in FIELD_READERS:
        found = FIELD_READERS[child.tag](child, report)
        draft.world = replace(draft.world, **{child.tag: found})
    elif child.tag == "scene":
        colours = read_scene(child)
        scene = replace(draft.world.scene, ambient=colours.ambient, background=colours.background)
        draft.world = replace(draft.world, scene=scene)
    elif child.tag == "light":
        where = f"light {quote(child.get('name'))}"
        light = read_light(child, _find_light_pose(child, where, draft), report)
        scene = draft.world.scene
        if light is not None:
            scene = replace(scene, lights=(*scene.lights, light))
        draft.world = replace(draft.world, scene=scene)
    else:
        _report_element(child, report)


def _find_light_pose(light: Element, where: str, draft: _WorldDraft) -> Origin:
    pose = read_pose(light, where)
    if pose.frame in ("", WORLD_LINK):
        return pose.origin
    return compose(draft.frames.pose(pose.frame), pose.origin)


def _read_gravity(child: Element, report: ParseReport) -> Vec3:
    x, y, z = read_numbers(child.text, counts=(3,), where="gravity", slug="sdf.gravity")
    if max(abs(x), abs(y), abs(z)) > MAX_GRAVITY:
        raise ModelError(
            f"gravity {x:g} {y:g} {z:g} is out of range; use at most {MAX_GRAVITY:g} m/s^2",
            slug="sdf.gravity",
        )
    report.applied("world: <gravity>", f"{x:g} {y:g} {z:g} m/s^2")
    return (x, y, z)


def _read_magnetic_field(child: Element, report: ParseReport) -> Vec3:
    x, y, z = read_numbers(
        child.text, counts=(3,), where="magnetic_field", slug="sdf.magnetic_field"
    )
    if max(abs(x), abs(y), abs(z)) > MAX_MAGNETIC_FIELD_T:
        raise ModelError(
            f"magnetic_field {x:g} {y:g} {z:g} is out of range; use at most "
            f"{MAX_MAGNETIC_FIELD_T:g} tesla, as in 5.6e-6 2.3e-5 -4.2e-5",
            slug="sdf.magnetic_field",
        )
    report.applied("world: <magnetic_field>", f"{x:g} {y:g} {z:g} T")
    return (x, y, z)


def _read_spherical_coordinates(child: Element, report: ParseReport) -> SphericalCoordinates | None:
    where = "spherical_coordinates"
    for tag, known in SPHERICAL_CHOICES.items():
        if (text := read_text(child, tag) or known) != known:
            report.suspicious(
                f"world: <{where}>", f"left out: <{tag}> is {quote(text)}; use {known}"
            )
            return None
    found = SphericalCoordinates(
        *(_read_degrees(child, tag, limit) for tag, limit in SPHERICAL_LIMITS.items())
    )
    report.applied(
        f"world: <{where}>",
        f"{found.latitude_deg:g} N {found.longitude_deg:g} E, {found.elevation_m:g} m, "
        f"x points {found.heading_deg:g} degrees from east to north",
    )
    return found


def _read_degrees(child: Element, tag: str, limit: float) -> float:
    number = read_scalar(child, tag, 0.0, child.tag)
    if abs(number) > limit:
        raise ModelError(
            f"{child.tag}, {tag}: {number:g} is out of range; use {-limit:g} to {limit:g}",
            slug="sdf.spherical_coordinates",
        )
    return number


FIELD_READERS: dict[str, Callable[[Element, ParseReport], object]] = {
    "gravity": _read_gravity,
    "magnetic_field": _read_magnetic_field,
    "physics": read_physics,
    "spherical_coordinates": _read_spherical_coordinates,
}
"""Readers of fields of `WorldModel`, by tag."""


def _read_world_frame(frame: Element, draft: _WorldDraft) -> None:
    name = frame.get("name") or ""
    named_pose = read_named_pose(frame, name, draft.frames.pose(name))
    draft.report.applied(f"frame {quote(name)}", "a named pose")
    named_poses = (*draft.world.named_poses, named_pose)
    draft.world = msgspec.structs.replace(draft.world, named_poses=named_poses)


def _report_element(child: Element, report: ParseReport) -> None:
    if zensim_tag(child) and find_name(child) in WORLD.children:
        report.applied(f"world: <{find_name(child)}>")
    elif child.tag in UNSUPPORTED_WORLD_TAGS:
        name = quote(child.get("name"))
        report.suspicious(
            f"world: <{child.tag}> {name}", f"{UNSUPPORTED_WORLD_TAGS[child.tag]}; left out"
        )


def _read_model(element: Element, draft: _WorldDraft) -> None:
    written = read_name(element, "model")
    own, missing = ParseReport(), draft.policy.missing
    known = len(missing)
    with _naming_model(written):
        try:
            parts = read_model_parts(element, draft.policy, own)
        except ModelError as error:
            # A model without links is a place in the world, or all its includes are missing.
            if error.code not in SKIPPABLE_CODES and error.slug != "sdf.no_links":
                raise
            draft.report.suspicious(f"model {quote(written)}", f"left out: {error}")
            return
        origin = find_placement(element, draft.frames.pose(written))
    missing[known:] = [f"model {quote(written)}, {fault}" for fault in missing[known:]]
    for entry in own.entries():
        draft.report.repeat(entry, of=written[:80])
    for part in parts:
        _add_part(part, written, origin, own, draft)


@contextmanager
def _naming_model(name: str) -> Iterator[None]:
    """Name a model of the world in errors."""
    try:
        yield
    except ModelError as error:
        fault = f"model {quote(name)}: {error.fault}"
        raise ModelError(fault, code=error.code, slug=error.slug) from error


def _add_part(
    part: ModelPart, written: str, origin: Origin, own: ParseReport, draft: _WorldDraft
) -> None:
    is_first = not part.name
    model = msgspec.structs.replace(part.model, report=own.entries() if is_first else ())
    placement = compose(origin, part.origin)
    if _is_ground_plane(model, placement):
        friction = model.links[0].collisions[0].friction
        draft.world = msgspec.structs.replace(
            draft.world, ground_plane=True, ground_friction=friction
        )
        return
    name = _make_entity_name(written if is_first else model.name, draft)
    draft.models.append(PlacedModel(name, model, placement))


def _is_support(placed: PlacedModel) -> bool:
    """Whether a static model has a collision on which a robot may stand; a plane that is level."""
    return placed.model.is_static and any(
        solid.size != GROUND_SLAB_M
        or rotate(compose(placed.origin, solid.origin).orientation, UP)[2] > LEAST_UPRIGHT
        for link in placed.model.links
        for solid in link.collisions
    )


def _is_ground_plane(model: Model, origin: Origin) -> bool:
    """Whether a model is only a level plane at height 0."""
    solids = model.links[0].collisions
    return (
        model.is_static
        and origin.position[2] == 0.0
        and origin.orientation == IDENTITY
        and bool(solids)
        and all(
            (s.kind, s.size, s.origin) == ("box", GROUND_SLAB_M, GROUND_SLAB_ORIGIN) for s in solids
        )
    )


def _make_entity_name(written: str, draft: _WorldDraft) -> str:
    name = wanted = _to_name(written)
    number = 1
    while name in draft.taken or (name in draft.reserved and name != written):
        number += 1
        name = f"{wanted}_{number}"
    draft.taken.add(name)
    subject = f"model {quote(written)}"
    if number > 1:
        draft.report.suspicious(
            subject, f"renamed to {name!r}, as {wanted!r} is another; rename it"
        )
    elif name != written:
        draft.report.applied(subject, f"renamed to {name!r}")
    return name


def _to_name(written: str) -> str:
    """Make a name of an entity: letters, digits and underscores."""
    name = _NON_NAME_CHARACTERS.sub("_", written)[:MAX_ENTITY_NAME_LENGTH]
    return name if name[0].isalpha() else f"m{name}"
