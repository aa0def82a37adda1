"""SDF worlds: models with their places, ground, gravity, pace and light. Nothing is fetched."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import IDENTITY, Model, Origin, ReportEntry, Vec3
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.messages.world_messages import Scene
from zensim.sim_server.description.assets import HasMesh, no_meshes
from zensim.sim_server.description.decimals import read_numbers
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.sdf_frames import MODEL, Frames
from zensim.sim_server.description.sdf_includes import Includes, Resolve, marked, no_includes
from zensim.sim_server.description.sdf_model import model_of, placement_of
from zensim.sim_server.description.sdf_places import (
    PREFIX,
    WORDS_OF_WORLDS,
    NamedPlace,
    own_word,
    read_place,
)
from zensim.sim_server.description.sdf_scene import Pace, read_light, read_pace, read_scene
from zensim.sim_server.description.sdf_shapes import LOWERED, SLAB_M
from zensim.sim_server.description.sdf_values import read_name, read_pose, read_text
from zensim.sim_server.description.shapes import MeshRule
from zensim.sim_server.description.strict_xml import parse_xml
from zensim.sim_server.description.wording import listed, shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

EARTH: Vec3 = (0.0, 0.0, -9.8)
"""Gravity [m/s^2] of a world that does not give its own, as SDF has it."""
STRONGEST = 1000.0
"""Gravity along an axis [m/s^2]: four times the sun's."""
MAX_MODELS = 2000
SUN, GROUND = "model://sun", "model://ground_plane"
UNUSED = {
    "atmosphere": "there is no air",
    "audio": "there is no sound",
    "gui": "the page has its own view",
    "magnetic_field": "there is no magnetic field",
    "plugin": "plug-ins of worlds are not loaded; services are built in",
    "spherical_coordinates": "there is no globe",
    "wind": "there is no air",
}
UNSUPPORTED = {
    "actor": "actors are not simulated",
    "joint": "joints between models are not simulated",
    "population": "populations are not read; write the models out",
    "road": "roads are not simulated",
}
READ = ("include", "gravity", "physics", "model", "frame", "light", "scene", "state")
LEFT_OUT = (SpawnCode.UNSUPPORTED_FORMAT, SpawnCode.MISSING_ASSETS)
"""Codes of models that a world does without; any other fault is the world's own."""
_NO_NAME = re.compile(r"[^A-Za-z0-9_]")
LONGEST_NAME = 56


class Placed(msgspec.Struct, frozen=True):
    """A model of a world, under a name that an entity can have, and where it stands."""

    name: str
    model: Model
    origin: Origin = Origin()


class WorldModel(msgspec.Struct, frozen=True):
    """A world before anything is spawned into it."""

    name: str
    gravity: Vec3 = EARTH
    ground_plane: bool = False
    ground_friction: float = 1.0
    pace: Pace = Pace()
    models: tuple[Placed, ...] = ()
    scene: Scene = Scene()
    places: tuple[NamedPlace, ...] = ()
    report: tuple[ReportEntry, ...] = ()


@dataclass
class _Draft:
    """A world while it is read."""

    world: WorldModel
    report: Report
    rule: MeshRule
    frames: Frames = field(default_factory=Frames)
    taken: set[str] = field(default_factory=set)


def read_world(
    text: str,
    *,
    resolve: Resolve = no_includes,
    has_mesh: HasMesh = no_meshes,
    allow_missing: bool = False,
) -> WorldModel:
    """Read a world; models that are not supported are listed and left out.

    Args:
        text: SDF with one <world>.
        resolve: Finds the text of an included model; sun and ground_plane need none.
        has_mesh: Whether a mesh URI is here.
        allow_missing: Leave included models out that are not here.

    Raises:
        ModelError: The text is no SDF world, or describes what cannot be.
    """
    report = Report()
    world = _only_world(marked(parse_xml(text, root_tag="sdf", slug="sdf"), report))
    draft = _Draft(
        WorldModel(name=world.get("name") or "default"),
        report,
        MeshRule(has_mesh, allow_missing=True),
    )
    _take_shipped(world, draft)
    Includes(resolve, report, allow_missing=allow_missing).expand(world)
    _place_frames(world, draft)
    for child in world:
        _take(child, draft)
    if not draft.world.ground_plane:
        report.suspicious("world", "no ground_plane is included; robots will fall")
    return msgspec.structs.replace(draft.world, report=report.entries())


def _only_world(sdf: Element) -> Element:
    worlds = sdf.findall("world")
    if len(worlds) != 1 or len(sdf) != 1:
        held = ", ".join(f"<{child.tag[:40]}>" for child in list(sdf)[:5]) or "nothing"
        raise ModelError(
            f"the <sdf> holds {held}; a world file holds one <world> and nothing else",
            code=SpawnCode.UNSUPPORTED_FORMAT,
            slug="sdf.world",
        )
    return worlds[0]


def _take_shipped(world: Element, draft: _Draft) -> None:
    served = {SUN: "sun", GROUND: "ground_plane"}
    replace = msgspec.structs.replace
    for include in world.findall("include"):
        uri = read_text(include, "uri").rstrip("/")
        if uri not in served:
            continue
        for child in include:
            if child.tag not in ("uri", "name"):
                draft.report.ignored(
                    f"include {uri}: <{child.tag[:80]}>", f"{served[uri]} stays as it is"
                )
        draft.report.applied(f"include {uri}")
        if uri == SUN:
            draft.world = replace(draft.world, scene=replace(draft.world.scene, has_sun=True))
        else:
            draft.world = replace(draft.world, ground_plane=True)
        world.remove(include)


def _place_frames(world: Element, draft: _Draft) -> None:
    models = world.findall("model")
    if len(models) > MAX_MODELS:
        raise ModelError(
            f"the world holds {len(models)} models; at most {MAX_MODELS} are simulated",
            slug="sdf.size",
        )
    names = [read_name(model, "model") for model in models]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ModelError(
            f"model names {listed(twice)} are used more than once; make them unique",
            slug="sdf.duplicate_name",
        )
    states = {model.get("name"): model for model in world.findall("state/model")}
    for name, model in zip(names, models, strict=True):
        saved = states.get(name)
        is_saved = saved is not None and saved.find("pose") is not None
        if is_saved:
            draft.report.applied(f"state: model {shown(name)}", "stands where the state has it")
        owner = saved if saved is not None and is_saved else model
        _place(name, owner, MODEL, draft)
    for frame in world.findall("frame"):
        where = f"frame {shown(frame.get('name'))}"
        holder = (frame.get("attached_to") or "").strip()
        implied = MODEL if holder in ("", "world") else holder
        _place(read_name(frame, where), frame, implied, draft)


def _place(name: str, owner: Element, implied: str, draft: _Draft) -> None:
    pose = read_pose(owner, f"{owner.tag} {shown(name)}")
    if pose.frame == "world":
        pose = msgspec.structs.replace(pose, frame=MODEL)
    draft.frames.add(name, pose, scope="", implied=implied)


def _take(child: Element, draft: _Draft) -> None:
    replace, report = msgspec.structs.replace, draft.report
    if child.tag == "model":
        _take_model(child, draft)
    elif child.tag == "frame":
        _take_frame(child, draft)
    elif child.tag == "gravity":
        draft.world = replace(draft.world, gravity=_gravity(child, report))
    elif child.tag == "physics":
        draft.world = replace(draft.world, pace=read_pace(child, report))
    elif child.tag == "scene":
        seen = read_scene(child, report)
        scene = replace(draft.world.scene, ambient=seen.ambient, background=seen.background)
        draft.world = replace(draft.world, scene=scene)
    elif child.tag == "light":
        light = read_light(child, report)
        scene = draft.world.scene
        if light is not None:
            scene = replace(scene, lights=(*scene.lights, light))
        draft.world = replace(draft.world, scene=scene)
    else:
        _note(child, report)


def _gravity(child: Element, report: Report) -> Vec3:
    x, y, z = read_numbers(child.text, counts=(3,), where="gravity", slug="sdf.gravity")
    if max(abs(x), abs(y), abs(z)) > STRONGEST:
        raise ModelError(
            f"gravity {x:g} {y:g} {z:g} is out of range; use at most {STRONGEST:g} m/s^2",
            slug="sdf.gravity",
        )
    report.applied("world: <gravity>", f"{x:g} {y:g} {z:g} m/s^2")
    return (x, y, z)


def _take_frame(frame: Element, draft: _Draft) -> None:
    name = frame.get("name") or ""
    place = read_place(frame, name, draft.frames.pose(name))
    draft.report.applied(f"frame {shown(name)}", "a named pose")
    places = (*draft.world.places, place)
    draft.world = msgspec.structs.replace(draft.world, places=places)


def _note(child: Element, report: Report) -> None:
    if own_word(child) in WORDS_OF_WORLDS:
        report.applied(f"world: <{PREFIX}{own_word(child)}>")
    elif child.tag in UNSUPPORTED:
        name = shown(child.get("name"))
        report.suspicious(f"world: <{child.tag}> {name}", f"{UNSUPPORTED[child.tag]}; left out")
    elif child.tag in UNUSED:
        report.ignored(f"world: <{child.tag}>", UNUSED[child.tag])
    elif child.tag not in READ:
        report.unread_tag("world", child.tag, (*READ, *UNUSED))


def _take_model(element: Element, draft: _Draft) -> None:
    written = read_name(element, "model")
    own = Report()
    try:
        model = model_of(element, draft.rule, own)
    except ModelError as error:
        if error.code not in LEFT_OUT:
            raise
        draft.report.suspicious(f"model {shown(written)}", f"left out: {error}")
        return
    for entry in own.entries():
        draft.report.repeat(entry, of=written[:80])
    model = msgspec.structs.replace(model, report=own.entries())
    origin = placement_of(element, draft.frames.pose(written))
    if _is_ground(model, origin):
        friction = model.links[0].collisions[0].friction
        draft.world = msgspec.structs.replace(
            draft.world, ground_plane=True, ground_friction=friction
        )
        return
    name = _entity_name(written, draft)
    models = (*draft.world.models, Placed(name, model, origin))
    draft.world = msgspec.structs.replace(draft.world, models=models)


def _is_ground(model: Model, origin: Origin) -> bool:
    """Whether a model is level ground at height 0 and nothing else."""
    solids = model.links[0].collisions
    return (
        model.is_static
        and origin.position[2] == 0.0
        and origin.orientation == IDENTITY
        and bool(solids)
        and all((s.kind, s.size, s.origin) == ("box", SLAB_M, LOWERED) for s in solids)
    )


def _entity_name(written: str, draft: _Draft) -> str:
    name = _NO_NAME.sub("_", written)[:LONGEST_NAME]
    if not name[0].isalpha():
        name = f"m{name}"
    number = 1
    wish = name
    while name in draft.taken:
        number += 1
        name = f"{wish}_{number}"
    draft.taken.add(name)
    if name != written:
        draft.report.applied(f"model {shown(written)}", f"called {name!r} here")
    return name
