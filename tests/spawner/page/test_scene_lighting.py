"""Lights and background of the page."""

import msgspec
import pytest

from zensim.proto.messages.model_messages import Light, Origin
from zensim.proto.messages.world_messages import Scene
from zensim.spawner.page.page_theme import DARK
from zensim.spawner.page.scene_lighting import (
    LAMP_DISTANCE_M,
    LAMP_INTENSITY,
    MAX_LIGHTS,
    SceneLighting,
    find_light_position,
    fit_attenuation,
    make_sky,
)

LAMP = Light("l", "point", Origin((1.0, 2.0, 3.0)), rgba=(1.0, 0.5, 2.0, 1.0))
OWN = ["/light/ambient", "/light/sun"]


class FakeHandle:
    """A node that can be moved and removed from its scene."""

    def __init__(self, nodes: dict[str, dict[str, object]], path: str) -> None:
        self._nodes, self._path = nodes, path

    def __setattr__(self, name: str, value: object) -> None:
        if not name.startswith("_"):
            self._nodes[self._path][name] = value
        super().__setattr__(name, value)

    def remove(self) -> None:
        del self._nodes[self._path]


class FakeScene:
    """Records nodes."""

    def __init__(self) -> None:
        self.nodes: dict[str, dict[str, object]] = {}

    def __getattr__(self, method: str) -> object:
        def add(path: str, **properties: object) -> FakeHandle:
            self.nodes[path] = {"kind": method.removeprefix("add_light_"), **properties}
            return FakeHandle(self.nodes, path)

        return add


def show_scenes(*scenes: Scene) -> FakeScene:
    fake = FakeScene()
    lighting = SceneLighting(fake)  # type: ignore[arg-type]
    for scene in scenes:
        lighting.show(scene)
    return fake


def test_page_has_default_lights() -> None:
    fake = show_scenes(Scene())

    assert [*fake.nodes] == OWN
    assert fake.nodes["/light/ambient"]["kind"] == "hemisphere"


def test_lights_of_a_world_are_shown() -> None:
    spot = msgspec.structs.replace(LAMP, kind="spot", direction=(0.0, 1.0, 0.0))

    fake = show_scenes(Scene(ambient=(0.2, 0.4, 1.0, 1.0), lights=(LAMP, spot)))

    assert [*fake.nodes] == ["/light/ambient", "/light/0", "/light/1"]
    ambient, point, cone = fake.nodes.values()
    assert (ambient["kind"], ambient["color"]) == ("ambient", (51, 102, 255))
    assert (point["color"], point["position"]) == ((255, 128, 255), (1.0, 2.0, 3.0))
    assert (cone["kind"], cone["direction"]) == ("spot", (0.0, 1.0, 0.0))


def test_lights_of_models_move_without_new_nodes() -> None:
    fake = FakeScene()
    lighting = SceneLighting(fake)  # type: ignore[arg-type]
    lighting.show(Scene(), (LAMP,))
    node = fake.nodes["/light/0"]

    lighting.show(Scene(), (msgspec.structs.replace(LAMP, origin=Origin((4.0, 5.0, 6.0))),))

    assert fake.nodes["/light/0"] is node
    assert node["position"] == (4.0, 5.0, 6.0)
    assert {*fake.nodes} == {*OWN, "/light/0"}
    lighting.show(Scene())
    assert {*fake.nodes} == {*OWN}


@pytest.mark.parametrize(
    ("attenuation", "decay"),
    [((1.0, 0.0, 0.0), 0.0), ((0.0, 1.0, 0.0), 1.0), ((0.0, 0.0, 0.5), 2.0)],
)
def test_attenuation_is_a_power_law(attenuation: tuple[float, float, float], decay: float) -> None:
    lamp = msgspec.structs.replace(LAMP, attenuation=attenuation, intensity=3.0)

    intensity, exponent = fit_attenuation(lamp)

    assert exponent == pytest.approx(decay)
    at_2_m = 3.0 * LAMP_INTENSITY / sum(k * 2.0**i for i, k in enumerate(attenuation))
    assert intensity * 2.0**-exponent == pytest.approx(at_2_m)


def test_number_of_lights_is_limited() -> None:
    fake = show_scenes(Scene(lights=(LAMP,) * 30, has_sun=True))

    assert "/light/sun" in fake.nodes
    assert len(fake.nodes) == MAX_LIGHTS + 2


def test_lights_change_only_with_the_scene() -> None:
    fake = show_scenes(Scene(lights=(LAMP,)), Scene(), Scene())

    assert [*fake.nodes] == OWN


@pytest.mark.parametrize(
    ("direction", "position"),
    [
        ((0.0, 0.0, -2.0), (0.0, 0.0, LAMP_DISTANCE_M)),
        ((3.0, 0.0, -4.0), (-0.6 * LAMP_DISTANCE_M, 0.0, 0.8 * LAMP_DISTANCE_M)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, LAMP_DISTANCE_M)),
        ((float("nan"), 0.0, 0.0), (0.0, 0.0, LAMP_DISTANCE_M)),
    ],
)
def test_directional_light_is_opposite_to_its_direction(
    direction: tuple[float, float, float], position: tuple[float, float, float]
) -> None:
    assert find_light_position(Light("sun", "directional", direction=direction)) == pytest.approx(
        position
    )


def test_default_sky_is_darker_above() -> None:
    picture = make_sky(DARK)

    assert picture[0].sum() < picture[-1].sum()


@pytest.mark.parametrize("kind", ["directional", "spot"])
@pytest.mark.parametrize("casts", [True, False])
def test_lamp_casts_shadows_if_it_says_so(kind: str, *, casts: bool) -> None:
    lamp = msgspec.structs.replace(LAMP, kind=kind, casts_shadows=casts)

    assert show_scenes(Scene(lights=(lamp,))).nodes["/light/0"]["cast_shadow"] is casts
