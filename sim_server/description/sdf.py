"""SDF worlds: what comes with the server, and gravity. No include is ever fetched."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from proto.model import Model, Origin, ReportEntry, Vec3
from proto.result import SpawnCode
from sim_server.description.decimals import read_numbers
from sim_server.description.report import Report
from sim_server.description.strict_xml import parse_xml
from sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

EARTH: Vec3 = (0.0, 0.0, -9.8)
"""Gravity [m/s^2] of a world that does not give its own, as SDF has it."""
VERSIONS = ("1.4", "1.5", "1.6", "1.7")
UNUSED = {
    "atmosphere": "there is no air",
    "audio": "there is no sound",
    "gui": "the page has its own view",
    "light": "the page has its own light",
    "magnetic_field": "there is no magnetic field",
    "plugin": "plug-ins of worlds are not loaded; services are built in",
    "scene": "the page has its own light",
    "spherical_coordinates": "there is no globe",
    "state": "a world begins empty",
    "wind": "there is no air",
}
OWN_STEP = "the server runs at its own step and factor"
PHYSICS = {
    "max_step_size": OWN_STEP,
    "real_time_factor": OWN_STEP,
    "real_time_update_rate": OWN_STEP,
}
REFUSED = {
    "actor": "actors are not simulated",
    "model": "models inside a world are not read; spawn them one by one",
    "population": "populations are not read; spawn them one by one",
    "road": "roads are not simulated",
}
KNOWN = ("include", "gravity", "physics", *UNUSED)


class WorldModel(msgspec.Struct, frozen=True):
    """A world before anything is spawned into it."""

    name: str
    gravity: Vec3 = EARTH
    ground_plane: bool = False
    sun: bool = False
    models: tuple[tuple[str, Model, Origin], ...] = ()
    report: tuple[ReportEntry, ...] = ()


def read_world(text: str) -> WorldModel:
    """Read a world.

    Raises:
        ModelError: The text is no SDF world, or holds what is not served here.
    """
    report = Report()
    sdf = parse_xml(text, root_tag="sdf", slug="sdf")
    world = _only_world(sdf, report)
    model = WorldModel(name=world.get("name") or "default")
    for child in world:
        model = _with_child(model, child, report)
    if not model.ground_plane:
        report.suspicious("world", "no ground_plane is included; robots will fall")
    return msgspec.structs.replace(model, report=report.entries())


def _only_world(sdf: Element, report: Report) -> Element:
    version = sdf.get("version") or ""
    if version not in VERSIONS:
        report.suspicious("sdf", f"version {version[:20]!r}; read as one of {', '.join(VERSIONS)}")
    worlds = sdf.findall("world")
    if len(worlds) != 1 or len(sdf) != 1:
        held = ", ".join(f"<{child.tag[:40]}>" for child in list(sdf)[:5]) or "nothing"
        raise ModelError(
            f"the <sdf> holds {held}; a world file holds one <world> and nothing else",
            code=SpawnCode.UNSUPPORTED_FORMAT,
            slug="sdf.world",
        )
    return worlds[0]


def _with_child(model: WorldModel, child: Element, report: Report) -> WorldModel:
    if child.tag == "include":
        return _with_include(model, child, report)
    if child.tag == "gravity":
        x, y, z = read_numbers(child.text, counts=(3,), where="gravity", slug="sdf.gravity")
        report.applied("world: <gravity>", f"{x:g} {y:g} {z:g} m/s^2")
        return msgspec.structs.replace(model, gravity=(x, y, z))
    if child.tag in REFUSED:
        raise ModelError(
            f"the world holds <{child.tag}> {(child.get('name') or '')[:80]!r}; "
            f"{REFUSED[child.tag]}",
            code=SpawnCode.UNSUPPORTED_FORMAT,
            slug=f"sdf.{child.tag}",
        )
    if child.tag == "physics":
        _report_physics(child, report)
    elif child.tag in UNUSED:
        report.ignored(f"world: <{child.tag}>", UNUSED[child.tag])
    else:
        report.unread_tag("world", child.tag, KNOWN)
    return model


def _with_include(model: WorldModel, include: Element, report: Report) -> WorldModel:
    uri = (include.findtext("uri") or "").strip()
    served = {"model://sun": "sun", "model://ground_plane": "ground_plane"}
    if uri not in served:
        raise ModelError(
            f"the world includes {uri[:200]!r}, which does not come with the server; "
            f"include one of {', '.join(served)}",
            code=SpawnCode.MISSING_ASSETS,
            slug="sdf.include",
        )
    for child in include:
        if child.tag != "uri":
            report.ignored(f"include {uri}: <{child.tag[:80]}>", f"{served[uri]} stays as it is")
    report.applied(f"include {uri}")
    return msgspec.structs.replace(model, **{served[uri]: True})


def _report_physics(physics: Element, report: Report) -> None:
    for child in physics:
        subject = f"physics: <{child.tag[:80]}>"
        if child.tag in PHYSICS:
            written = (child.text or "").strip()[:40]
            report.ignored(subject, f"asks for {written!r}; {PHYSICS[child.tag]}")
        else:
            report.ignored(subject, "for other engines")
