"""Variations of a scenario: values, combinations, and mistakes with their keys."""

from pathlib import Path

import pytest

from zensim.scenario.scenario_nodes import ScenarioInvalid
from zensim.scenario.scenario_reader import read_scenario
from zensim.scenario.scenario_variations import Variations

HEAD = """zensim: 1
robots:
  - {name: cart, model: box_bot, count: 2, layout: {kind: circle, radius: 3 m}}
behaviours:
  - {name: cross, robots: cart0, do: circle, speed: 0.3}
  - {name: mine, robots: cart1, do: python, call: "team:Avoid", args: {gain: 1.5}}
checks:
  - {name: slow, robots: cart*, that: speed, below: 1}
"""


def read(folder: Path, vary: str) -> Variations:
    file = folder / "a.scenario.yaml"
    file.write_text(f"{HEAD}vary: {vary}\n")
    (folder / "team.py").touch()
    return read_scenario(str(file)).variations


def test_scenario_without_variations_is_one_combination(tmp_path: Path) -> None:
    found = read(tmp_path, "{}")

    assert (found.combinations, found.seeds, found.repeats) == (1, None, 1)
    assert list(found.combine(0)) == [{}]


def test_grid_has_every_combination_of_its_values(tmp_path: Path) -> None:
    found = read(tmp_path, "{robots.cart.count: [1, 2], behaviours.cross.speed: [0.2, 0.4, 0.6]}")

    combined = [tuple(one.values()) for one in found.combine(0)]

    assert len(set(combined)) == found.combinations == 6
    assert combined[0] == (1, 0.2)
    assert combined[-1] == (2, 0.6)


@pytest.mark.parametrize(
    ("vary", "values"),
    [
        ("{behaviours.cross.speed: {from: 0.2, to: 0.6, steps: 3}}", [0.2, 0.4, 0.6]),
        ("{behaviours.cross.speed: {from: 0.2, to: 0.6, steps: 1}}", [0.2]),
        ("{robots.cart.count: {from: 2, to: 8, steps: 4}}", [2, 4, 6, 8]),
        ("{robots.cart.layout.radius: [3 m, 400 cm]}", [3.0, 4.0]),
        (
            "{robots.cart.yaw: [{uniform: [0, 180 deg]}]}",
            [{"uniform": [0.0, pytest.approx(3.14159)]}],
        ),
        ("{behaviours.mine.args.gain: [1, two]}", [1, "two"]),
        ("{world.load: [empty, walls]}", ["empty", "walls"]),
        ("{checks.slow.below: [1.8 km/h]}", [pytest.approx(0.5)]),
    ],
)
def test_values_have_the_type_and_unit_of_their_key(
    vary: str, values: list[object], tmp_path: Path
) -> None:
    found = read(tmp_path, vary)

    assert [next(iter(one.values())) for one in found.combine(0)] == values


def test_entries_of_a_list_belong_together(tmp_path: Path) -> None:
    found = read(
        tmp_path,
        "{list: [{robots.cart.count: 2, behaviours.cross.speed: 0.2}, {robots.cart.count: 4}]}",
    )

    assert list(found.combine(0)) == [
        {"robots.cart.count": 2, "behaviours.cross.speed": 0.2},
        {"robots.cart.count": 4},
    ]
    assert found.paths == ["robots.cart.count", "behaviours.cross.speed"]


def random_of(samples: int) -> str:
    return (
        f"{{random: {{samples: {samples}, behaviours.cross.speed: {{uniform: [0.2, 0.6]}}, "
        "robots.cart.count: {uniform: [2, 5]}, robots.cart.yaw: {normal: [0, 10 deg]}, "
        "world.load: {choice: [empty, walls]}}}"
    )


def test_samples_are_in_their_range_and_whole_where_the_key_is(tmp_path: Path) -> None:
    drawn = list(read(tmp_path, random_of(200)).combine(3))

    speeds = [one["behaviours.cross.speed"] for one in drawn]
    assert all(0.2 <= one < 0.6 for one in speeds)
    assert {one["robots.cart.count"] for one in drawn} == {2, 3, 4, 5}
    assert {one["world.load"] for one in drawn} == {"empty", "walls"}
    assert sum(one["robots.cart.yaw"] for one in drawn) / 200 == pytest.approx(0.0, abs=0.05)


def test_more_samples_keep_the_first_ones(tmp_path: Path) -> None:
    few, many = (list(read(tmp_path, random_of(count)).combine(3)) for count in (3, 6))

    assert many[:3] == few
    assert list(read(tmp_path, random_of(3)).combine(4)) != few


@pytest.mark.parametrize(
    ("vary", "path"),
    [
        ("{robots.cart.cout: [1]}", "vary.robots.cart.cout"),
        ("{robots.nobody.count: [1]}", "vary.robots.nobody.count"),
        ("{robots.².count: [1]}", "vary.robots.².count"),
        ("{robots.cart.yaw: {from: -1e308, to: 1e308, steps: 3}}", "vary.robots.cart.yaw"),
        ("{robots.cart.count: [two]}", "vary.robots.cart.count[0]"),
        ("{robots.cart.count: 3}", "vary.robots.cart.count"),
        ("{robots.cart.count: {from: 1, to: 2}}", "vary.robots.cart.count"),
        ("{robots.cart.count: {from: 1, to: 4, steps: 3}}", "vary.robots.cart.count"),
        ("{robots.cart.count: {from: 1, to: 4, steps: 0}}", "vary.robots.cart.count"),
        ("{world.load: {from: empty, to: walls, steps: 2}}", "vary.world.load"),
        ("{behaviours.cross.speed: [3 s]}", "vary.behaviours.cross.speed[0]"),
        ("{behaviours.cross.v: [3]}", "vary.behaviours.cross.v"),
        ("{checks.slow.below: [1 m]}", "vary.checks.slow.below[0]"),
        ("{seeds: 0}", "vary.seeds"),
        ("{repeats: many}", "vary.repeats"),
        ("{seeds: 3, time.seed: [1, 2]}", "vary"),
        ("{seeds: 100001}", "vary"),
        ("{include: [[a.yaml]]}", "vary.include"),
        ("{zensim: [1]}", "vary.zensim"),
        ("{random: {samples: 3}}", "vary.random"),
        ("{random: {robots.cart.count: {uniform: [1, 2]}}}", "vary.random.samples"),
        ("{random: {samples: 3, robots.cart.count: [1]}}", "vary.random.robots.cart.count"),
        ("{random: {samples: 3, world.load: {uniform: [1, 2]}}}", "vary.random.world.load"),
        (
            "{random: {samples: 3, robots.cart.count: {uniform: [5, 2]}}}",
            "vary.random.robots.cart.count",
        ),
        (
            "{random: {samples: 3, robots.cart.yaw: {normal: [0, -1]}}}",
            "vary.random.robots.cart.yaw",
        ),
        (
            "{random: {samples: 3, robots.cart.yaw: {uniform: [{uniform: [0, 1]}, 2]}}}",
            "vary.random.robots.cart.yaw",
        ),
        (
            "{random: {samples: 3, robots.cart.count: {uniform: [1]}}}",
            "vary.random.robots.cart.count",
        ),
        ("{list: [1]}", "vary.list"),
        ("{list: [{robots.cart.count: two}]}", "vary.list[0].robots.cart.count"),
        (
            "{robots.cart.count: [1], list: [{robots.cart.count: 2}]}",
            "vary.list[0].robots.cart.count",
        ),
    ],
)
def test_mistake_of_a_variation_names_its_key_and_line(
    vary: str, path: str, tmp_path: Path
) -> None:
    with pytest.raises(ScenarioInvalid) as caught:
        read(tmp_path, vary)

    assert [issue.path for issue in caught.value.issues] == [path]
    assert {issue.place.line for issue in caught.value.issues} == {9}
