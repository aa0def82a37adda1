"""Worlds are read with what comes with the server, and with nothing fetched."""

import pytest

from proto.result import SpawnCode
from sim_server.description.library import world_text
from sim_server.description.sdf import read_world
from sim_server.errors import ModelError
from tests.sim_server.description.robots import reasons

GROUND = "<include><uri>model://ground_plane</uri></include>"


def a_world(*parts: str, attributes: str = 'name="w"', version: str = "1.6") -> str:
    return f'<sdf version="{version}"><world {attributes}>{"".join(parts)}</world></sdf>'


def test_empty_world_has_sun_ground_and_gravity() -> None:
    world = read_world(world_text("empty"))

    assert (world.name, world.sun, world.ground_plane) == ("default", True, True)
    assert world.gravity == (0.0, 0.0, -9.8)
    assert world.models == ()


def test_world_is_called_default_when_it_has_no_name() -> None:
    assert read_world(a_world(attributes="")).name == "default"


def test_gravity_is_that_of_the_file() -> None:
    assert read_world(a_world("<gravity>0 0 -1.62</gravity>")).gravity == (0.0, 0.0, -1.62)


@pytest.mark.parametrize("gravity", ["0 0", "0 0 nan", "down", ""])
def test_gravity_is_refused_when_it_is_no_vector(gravity: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_world(a_world(f"<gravity>{gravity}</gravity>"))

    assert caught.value.slug == "sdf.gravity"


def test_world_without_ground_is_noted() -> None:
    world = read_world(a_world())

    assert not world.ground_plane
    assert reasons(world.report, "suspicious") == [
        "world: no ground_plane is included; robots will fall"
    ]


@pytest.mark.parametrize(
    "uri", ["model://house", "file:///etc/passwd", "https://example.org/sun", ""]
)
def test_include_is_refused_by_name_when_it_does_not_come_with_the_server(uri: str) -> None:
    with pytest.raises(ModelError, match="model://sun, model://ground_plane") as caught:
        read_world(a_world(f"<include><uri>{uri}</uri></include>"))

    assert (caught.value.code, caught.value.slug) == (SpawnCode.MISSING_ASSETS, "sdf.include")


@pytest.mark.parametrize("tag", ["model", "actor", "road", "population"])
def test_world_is_refused_when_it_holds_what_is_not_read(tag: str) -> None:
    with pytest.raises(ModelError, match=f"<{tag}> 'x'") as caught:
        read_world(a_world(f'<{tag} name="x"/>'))

    assert caught.value.slug == f"sdf.{tag}"


@pytest.mark.parametrize(
    "text",
    [
        '<sdf version="1.6"/>',
        '<sdf version="1.6"><model name="m"/></sdf>',
        '<sdf version="1.6"><world name="a"/><world name="b"/></sdf>',
    ],
)
def test_file_is_refused_when_it_is_not_one_world(text: str) -> None:
    with pytest.raises(ModelError, match="one <world>") as caught:
        read_world(text)

    assert (caught.value.code, caught.value.slug) == (SpawnCode.UNSUPPORTED_FORMAT, "sdf.world")


@pytest.mark.parametrize("text", ["<robot/>", "<sdf>", "<!DOCTYPE sdf><sdf/>", ""])
def test_file_is_refused_when_it_is_no_sdf(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_world(text)

    assert caught.value.slug.startswith(("sdf.", "xml."))


def test_world_notes_what_has_no_effect() -> None:
    world = read_world(
        a_world(
            GROUND,
            "<physics><max_step_size>0.001</max_step_size><ode/></physics>",
            "<scene><shadows>1</shadows></scene><gravty>0</gravty><zebra/>",
            "<include><uri>model://sun</uri><pose>0 0 9</pose></include>",
            version="9.9",
        )
    )

    assert reasons(world.report, "ignored") == [
        "physics: <max_step_size>: asks for '0.001'; the server runs at its own step and factor",
        "physics: <ode>: for other engines",
        "world: <scene>: the page has its own light",
        "include model://sun: <pose>: sun stays as it is",
    ]
    assert reasons(world.report, "unknown") == ["world: <zebra>: not read"]
    assert reasons(world.report, "suspicious") == [
        "sdf: version '9.9'; read as one of 1.4, 1.5, 1.6, 1.7",
        "world: <gravty>: not read; did you mean <gravity>?",
    ]
