"""Tools of the page that run in the browser."""

import re

from zensim.spawner.page.edit_panel import make_pictures_html
from zensim.spawner.page.page_files import read_page_file
from zensim.spawner.page.page_theme import MUTED_BUTTON
from zensim.spawner.page.page_tools import make_help_html, make_tools_script


def test_help_lists_given_keys_as_text() -> None:
    text = make_help_html((("Shift+X", "stop <all>"),))

    assert "<dt>Shift+X</dt><dd>stop &lt;all&gt;</dd>" in text
    assert text.count("<dt>") == text.count("</dd>")


def test_script_cannot_end_its_element() -> None:
    script = make_tools_script((("a", "</script>"),))

    assert not re.search("</", script)
    assert "#zensim-tools" in script


def test_style_knows_the_colour_of_muted_buttons() -> None:
    colour = "#" + "".join(f"{part:02x}" for part in MUTED_BUTTON)

    assert f'[style*="{colour}"]' in read_page_file("page_tools.css")


def test_names_of_models_break_after_underscores_and_are_read_as_one() -> None:
    html = make_pictures_html(("box_bot_lidar",))

    assert "<span>box_<wbr>bot_<wbr>lidar</span>" in html
    assert 'aria-label="box_bot_lidar"' in html
