"""Tools of the page that run in the browser alone: help, link, picture, film, scale and names."""

from typing import Final

import msgspec

from zensim.proto.printable_text import to_html
from zensim.spawner.page.page_files import read_page_file

MOUSE: Final = (
    ("Drag", "turn the camera"),
    ("Drag with the right button, or with two fingers", "move the camera"),
    ("Wheel, or two fingers apart", "zoom"),
    ("Click on a robot", "select it"),
    ("Shift and click on a robot", "add it to the selection, or remove it"),
    ("Pointer over a robot", "its name"),
)
KEYS: Final = (("?", "this help"),)
LEGEND: Final = (
    ("Grid", "fine lines each metre, strong lines each 5 m"),
    ("Red and green line", "x and y of the world, 1 m long, from its origin"),
    ("Bar beside the tools", "length at the distance of the point that the camera turns about"),
    ("Colours of robots", "by name, also in the list; colour-blind people can distinguish them"),
    ("Green, amber and red dot", "the simulation plays, is paused, or no server replies"),
    ("Dots of the list", "green: moves; grey: stands; amber ring: no agent; red: blocked"),
)
Rows = tuple[tuple[str, str], ...]


def make_help_html(keys: Rows) -> str:
    """Make the content of the help: what mouse and keys do, and what is drawn.

    Args:
        keys: Keys and what they do, beside those of this module.
    """
    sections = (("Mouse and touch", MOUSE), ("Keys", (*keys, *KEYS)), ("What is drawn", LEGEND))
    return "".join(
        f"<h3>{title}</h3><dl>"
        + "".join(f"<dt>{to_html(key)}</dt><dd>{to_html(what)}</dd>" for key, what in rows)
        + "</dl>"
        for title, rows in sections
    )


def make_tools_script(keys: Rows = ()) -> str:
    """Make the script of the tools; see `make_help_html`."""
    texts = msgspec.json.encode(
        {"style": read_page_file("page_tools.css"), "help": make_help_html(keys)}
    ).decode()
    safe = texts.replace("</", r"<\/")  # "</script>" would end the script
    return f"((texts) => {{\n{read_page_file('page_tools.js')}}})({safe});"
