"""Colours by name: a URDF's own materials, and those that Gazebo ships."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.sim_server.description.decimals import read_numbers

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat
    from zensim.sim_server.description.report import Report

GAZEBO_COLOURS: dict[str, Quat] = {
    "Black": (0.0, 0.0, 0.0, 1.0),
    "Blue": (0.0, 0.0, 1.0, 1.0),
    "BlueGlow": (0.0, 0.0, 1.0, 1.0),
    "BlueTransparent": (0.0, 0.0, 1.0, 0.5),
    "DarkGrey": (0.175, 0.175, 0.175, 1.0),
    "DarkYellow": (0.7, 0.7, 0.0, 1.0),
    "FlatBlack": (0.1, 0.1, 0.1, 1.0),
    "Gold": (0.8, 0.65, 0.1, 1.0),
    "Gray": (0.7, 0.7, 0.7, 1.0),
    "Green": (0.0, 1.0, 0.0, 1.0),
    "GreenGlow": (0.0, 1.0, 0.0, 1.0),
    "GreenTransparent": (0.0, 1.0, 0.0, 0.5),
    "Grey": (0.7, 0.7, 0.7, 1.0),
    "Indigo": (0.33, 0.0, 0.5, 1.0),
    "Orange": (1.0, 0.5, 0.05, 1.0),
    "Purple": (1.0, 0.0, 1.0, 1.0),
    "Red": (1.0, 0.0, 0.0, 1.0),
    "RedBright": (0.87, 0.26, 0.07, 1.0),
    "RedGlow": (1.0, 0.0, 0.0, 1.0),
    "RedTransparent": (1.0, 0.0, 0.0, 0.5),
    "SkyBlue": (0.13, 0.44, 0.7, 1.0),
    "Turquoise": (0.0, 1.0, 1.0, 1.0),
    "White": (1.0, 1.0, 1.0, 1.0),
    "WhiteGlow": (1.0, 1.0, 1.0, 1.0),
    "Wood": (0.6, 0.42, 0.22, 1.0),
    "Yellow": (1.0, 1.0, 0.0, 1.0),
    "YellowGlow": (1.0, 1.0, 0.0, 1.0),
    "ZincYellow": (0.97, 0.95, 0.21, 1.0),
}


RGB = 3


def gazebo_colour(name: str) -> Quat | None:
    """Find the colour (r, g, b, a) that Gazebo calls `Gazebo/<name>`; None when it is not known."""
    return GAZEBO_COLOURS.get(name.strip().removeprefix("Gazebo/"))


def named_colours(robot: Element, report: Report) -> dict[str, Quat]:
    """List the materials of a URDF that have a colour, also those inside a visual.

    Of two with one name the first counts, those of the robot itself before those of visuals.
    """
    colours: dict[str, Quat] = {}
    for path in ("material", "link/visual/material"):
        for material in robot.findall(path):
            colour, name = material.find("color"), material.get("name")
            if colour is not None and name:
                colours.setdefault(name, _rgba(colour, name, report))
    return colours


def colour_of(visual: Element, colours: dict[str, Quat], report: Report) -> Quat | None:
    """Find the colour of a visual: its own, else that of its material's name."""
    material = visual.find("material")
    if material is None:
        return None
    name = material.get("name") or ""
    colour = material.find("color")
    if colour is not None:
        return _rgba(colour, name, report)
    if name not in colours and material.find("texture") is None:
        report.suspicious(f"material {name[:80]!r}", "no <material> of this name has a colour")
    return colours.get(name)


def _rgba(colour: Element, name: str, report: Report) -> Quat:
    where = f"material {name[:80]!r}"
    written = read_numbers(
        colour.get("rgba", "1 1 1 1"), counts=(3, 4), where=where, slug="urdf.number"
    )
    if len(written) == RGB:
        report.suspicious(where, "its colour has three numbers; opaque")
        written = (*written, 1.0)
    r, g, b, a = (min(max(part, 0.0), 1.0) for part in written)
    if (r, g, b, a) != written:
        report.suspicious(where, "colours lie in 0 to 1; cut to it")
    return (r, g, b, a)
