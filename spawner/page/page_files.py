"""Scripts and styles of the page, which are files beside this module."""

from functools import cache
from importlib.resources import files


@cache
def read_page_file(name: str) -> str:
    """Read a file such as `front_end.js`; OSError if there is none."""
    return (files("zensim.spawner.page") / name).read_text("utf-8")
