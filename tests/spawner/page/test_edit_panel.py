"""Spawn orders of the page's form, and points of the floor."""

import math

import pytest

from zensim.sim_server.description.builtin_models import list_builtin_models
from zensim.spawner.page.edit_panel import (
    SpawnForm,
    make_mark_html,
    make_pictures_html,
    make_spawn_order,
    select_order,
)
from zensim.spawner.page.floor_picking import MAX_DISTANCE_M, find_floor_point

UP, DOWN, AHEAD = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)


def test_each_model_of_the_server_has_a_picture() -> None:
    models = list_builtin_models()

    html = make_pictures_html(models)

    assert html.count("<img") == len(models)
    assert all(f'data-zensim-model="{model}"' in html for model in models)
    assert all(f'[data-zensim-model="{model}"]' in make_mark_html(model) for model in models)


@pytest.mark.parametrize("model", ["", "unknown", "../pictures/box_bot", "<b>"])
def test_other_models_have_none(model: str) -> None:
    assert "<button" not in make_pictures_html([model])
    assert make_mark_html(model) == ""


def places_of(form: SpawnForm) -> list[tuple[float, float]]:
    poses = [one.initial_pose.pose.position for one in make_spawn_order(form).spawn_requests]
    return [(pose.x, pose.y) for pose in poses]


def test_one_robot_has_the_name_of_the_form_and_several_get_numbers() -> None:
    one = make_spawn_order(SpawnForm(model="box_bot", name="r"))
    three = make_spawn_order(SpawnForm(model="box_bot", name="r", count=3))

    assert [order.name for order in one.spawn_requests] == ["r"]
    assert [order.name for order in three.spawn_requests] == ["r0", "r1", "r2"]
    assert not any(order.allow_renaming for order in three.spawn_requests)


def test_order_of_one_robot_is_that_of_several() -> None:
    form = SpawnForm(model="box_bot", name="r", place=(1.0, 2.0), heading_rad=0.5)
    several = make_spawn_order(form)

    one = select_order(several)

    assert one.name == "r"
    assert one.initial_pose == several.spawn_requests[0].initial_pose
    assert (one.entity_resource.uri, one.snap_to_ground) == ("zensim://box_bot", True)
    assert not one.allow_renaming


def test_robots_without_a_name_are_named_by_the_server() -> None:
    order = make_spawn_order(SpawnForm(model="box_bot", count=2))

    assert [one.name for one in order.spawn_requests] == ["", ""]
    assert all(one.allow_renaming for one in order.spawn_requests)
    assert order.common.entity_resource.uri == "zensim://box_bot"


def test_a_layout_begins_at_its_place_and_is_turned_by_its_heading() -> None:
    form = SpawnForm(
        model="box_bot", count=3, spacing_m=2.0, place=(1.0, 5.0), heading_rad=math.pi / 2.0
    )

    assert places_of(form) == [pytest.approx(p) for p in ((1.0, 5.0), (1.0, 7.0), (1.0, 9.0))]


@pytest.mark.parametrize("layout", ["row", "grid", "circle"])
def test_robots_of_a_layout_keep_their_distance(layout: str) -> None:
    form = make_form(layout)
    places = places_of(form)

    nearest = min(math.dist(a, b) for i, a in enumerate(places) for b in places[i + 1 :])
    assert nearest == pytest.approx(form.spacing_m)


def make_form(layout: str) -> SpawnForm:
    return SpawnForm(
        model="box_bot",
        count=7,
        layout=layout,  # type: ignore[arg-type]
        spacing_m=1.5,
    )


def test_a_ray_meets_the_floor_where_it_points() -> None:
    assert find_floor_point((1.0, 2.0, 3.0), DOWN) == (1.0, 2.0)
    assert find_floor_point((0.0, 0.0, 1.0), (3.0, 4.0, -1.0)) == (3.0, 4.0)
    assert find_floor_point((0.0, 0.0, 5.0), (1.0, 0.0, -1.0), height_m=2.0) == (3.0, 0.0)


@pytest.mark.parametrize(
    ("origin", "direction"),
    [
        ((0.0, 0.0, 1.0), UP),
        ((0.0, 0.0, 1.0), AHEAD),
        ((0.0, 0.0, -1.0), DOWN),
        ((0.0, 0.0, 1.0), (1.0, 0.0, -0.1 / MAX_DISTANCE_M)),
        ((0.0, 0.0, 1.0), (0.0, 0.0, -math.inf)),
    ],
    ids=["up", "level", "below", "far", "infinite"],
)
def test_a_ray_that_misses_the_floor_is_refused(
    origin: tuple[float, float, float], direction: tuple[float, float, float]
) -> None:
    with pytest.raises(ValueError, match="floor"):
        find_floor_point(origin, direction)
