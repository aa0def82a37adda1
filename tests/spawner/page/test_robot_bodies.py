"""Which parts of a robot get its colour."""

import numpy as np

from tests.spawner.page.builders import BLUE, make_models, make_robot, make_wall
from zensim.proto.messages.model_messages import Shape
from zensim.spawner.page.fleet_nodes import find_body_colour
from zensim.spawner.page.model_visuals import DEFAULT_RGBA, make_box, make_link_meshes
from zensim.spawner.page.render_state import make_fleet
from zensim.spawner.page.robot_colours import ROBOT_COLOURS, to_linear

RED = (0.9, 0.1, 0.1, 1.0)
FILES = {"f": make_box(5.0, 5.0, 5.0)}


def find_body(*links: tuple[Shape, ...]) -> object:
    return find_body_colour([make_link_meshes(shapes, FILES) for shapes in links])


def test_body_is_the_largest_part() -> None:
    large, small = Shape("box", (0.4, 0.3, 0.1), rgba=RED), Shape("sphere", (0.1, 0, 0), rgba=BLUE)

    assert find_body((small,), (large,)) == RED


def test_a_coloured_file_keeps_its_colour() -> None:
    file = Shape("mesh", (1.0, 1.0, 1.0), mesh="f", rgba=BLUE)

    assert find_body((file, Shape("box", (0.1, 0.1, 0.1), rgba=RED))) == RED
    assert find_body((file,)) is None


def test_a_file_without_a_colour_gets_one() -> None:
    assert find_body((Shape("mesh", (1.0, 1.0, 1.0), mesh="f"),)) == DEFAULT_RGBA


def test_robots_have_colours_and_other_entities_none() -> None:
    models = make_models(r0=make_robot(), w=make_wall(), r1=make_robot())

    robots, walls = make_fleet(("r0", "w", "r1"), models).groups

    assert robots.colours is not None
    assert robots.colours.tolist() == to_linear(ROBOT_COLOURS[:2]).tolist()
    assert walls.colours is None


def test_black_and_white_stay_and_middle_tones_become_darker() -> None:
    linear = to_linear(np.array([(0, 128, 255)], np.uint8))[0]

    assert linear.tolist() == [0, 56, 255]
