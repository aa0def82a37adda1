"""Light and sky of the page are the world's where it says, else the page's own."""

import msgspec
import pytest

from zensim.proto.messages.model_messages import Origin
from zensim.proto.messages.world_messages import Light, Scene
from zensim.spawner.page.scene_setup import (
    LAMP_DISTANCE_M,
    MAX_LIGHTS,
    SceneLighting,
    find_light_position,
    make_sky,
)

LAMP = Light("l", "point", Origin((1.0, 2.0, 3.0)), rgba=(1.0, 0.5, 2.0, 1.0))
OWN = ["/light/ambient", "/light/sun"]


class FakeHandle:
    """A node that takes itself out of its scene."""

    def __init__(self, nodes: dict[str, dict[str, object]], path: str) -> None:
        self._nodes, self._path = nodes, path

    def remove(self) -> None:
        del self._nodes[self._path]


class FakeScene:
    """A scene that keeps what it is told."""

    def __init__(self) -> None:
        self.nodes: dict[str, dict[str, object]] = {}
        self.skies: list[tuple[int, ...]] = []

    def __getattr__(self, method: str) -> object:
        def add(path: str, **properties: object) -> FakeHandle:
            self.nodes[path] = {"kind": method.removeprefix("add_light_"), **properties}
            return FakeHandle(self.nodes, path)

        return add

    def set_background_image(self, image: object, format: str) -> None:
        assert format == "png"
        self.skies.append(tuple(image[0, 0].tolist()))  # type: ignore[index]


def lit(*scenes: Scene) -> FakeScene:
    fake = FakeScene()
    lighting = SceneLighting(fake)  # type: ignore[arg-type]
    for scene in scenes:
        lighting.show(scene)
    return fake


def test_page_has_its_own_light_when_the_world_says_nothing() -> None:
    fake = lit(Scene())

    assert [*fake.nodes] == OWN
    assert fake.nodes["/light/ambient"]["kind"] == "hemisphere"


def test_lamps_of_a_world_are_where_it_has_them() -> None:
    spot = msgspec.structs.replace(LAMP, kind="spot", direction=(0.0, 1.0, 0.0))

    fake = lit(Scene(ambient=(0.2, 0.4, 1.0, 1.0), lights=(LAMP, spot)))

    assert [*fake.nodes] == ["/light/ambient", "/light/0", "/light/1"]
    ambient, point, cone = fake.nodes.values()
    assert (ambient["kind"], ambient["color"]) == ("ambient", (51, 102, 255))
    assert (point["color"], point["position"]) == ((255, 128, 255), (1.0, 2.0, 3.0))
    assert (cone["kind"], cone["direction"]) == ("spot", (0.0, 1.0, 0.0))


def test_sun_of_a_world_shines_beside_its_lamps_of_which_few_are_lit() -> None:
    fake = lit(Scene(lights=(LAMP,) * 30, has_sun=True))

    assert "/light/sun" in fake.nodes
    assert len(fake.nodes) == MAX_LIGHTS + 2


def test_light_changes_with_the_world_and_only_then() -> None:
    fake = lit(Scene(background=(0.0, 0.0, 1.0, 1.0), lights=(LAMP,)), Scene(), Scene())

    assert [*fake.nodes] == OWN
    assert len(fake.skies) == 2
    assert fake.skies[0] == (0, 0, 255)


@pytest.mark.parametrize(
    ("direction", "place"),
    [
        ((0.0, 0.0, -2.0), (0.0, 0.0, LAMP_DISTANCE_M)),
        ((3.0, 0.0, -4.0), (-0.6 * LAMP_DISTANCE_M, 0.0, 0.8 * LAMP_DISTANCE_M)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, LAMP_DISTANCE_M)),
        ((float("nan"), 0.0, 0.0), (0.0, 0.0, LAMP_DISTANCE_M)),
    ],
)
def test_directional_light_comes_from_against_its_direction(
    direction: tuple[float, float, float], place: tuple[float, float, float]
) -> None:
    assert find_light_position(Light("sun", "directional", direction=direction)) == pytest.approx(
        place
    )


def test_sky_is_darker_above_when_it_has_no_colour() -> None:
    picture = make_sky()

    assert picture[0].sum() < picture[-1].sum()
