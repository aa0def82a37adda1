"""Reading scenario files: values, units, draws, includes, settings, and every mistake at once."""

import os
import pickle
import time
from pathlib import Path

import msgspec
import pytest

from zensim.scenario.quantities import Draw, make_uniforms
from zensim.scenario.scenario_format import FollowWaypoints, RandomWalk
from zensim.scenario.scenario_nodes import Issue, ScenarioInvalid, read_nodes, resolve_scalar
from zensim.scenario.scenario_reader import Scenario, read_scenario

HEAD = "zensim: 1\nrobots:\n  - {name: cart, model: box_bot, count: 3}\n"
BROKEN: dict[str, tuple[str, list[tuple[int, int, str]]]] = {
    "unknown_key": ("zensim: 1\nwrld: {}\n", [(2, 1, "wrld")]),
    "missing_version": ("name: run\n", [(1, 1, "zensim")]),
    "wrong_version": ("zensim: 2\n", [(1, 9, "zensim")]),
    "empty_file": ("", [(1, 1, "zensim")]),
    "list_at_the_root": ("- 1\n", [(1, 1, "")]),
    "double_key": ("zensim: 1\nname: a\nname: b\n", [(3, 1, "name")]),
    "tab": ("zensim: 1\n\tname: b\n", [(2, 1, "")]),
    "open_bracket": ("zensim: 1\nname: [a\nworld: {}\n", [(3, 6, "")]),
    "tag": ("zensim: 1\nname: !!set a\n", [(2, 7, "")]),
    "merge_key": ("zensim: 1\nworld: {<<: 1}\n", [(2, 9, "<<")]),
    "control_character": ("zensim: 1\nname: a\x01\n", [(1, 1, "")]),
    "unit_of_another_dimension": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, layout: {radius: 3 s}}\n",
        [(3, 48, "robots[0].layout.radius")],
    ),
    "wrong_unit": ("zensim: 1\nengine: {step_rate: 240 m}\n", [(2, 21, "engine.step_rate")]),
    "unknown_unit": ("zensim: 1\nend: {at: 3 fortnights}\n", [(2, 11, "end.at")]),
    "text_for_number": ("zensim: 1\nend: {at: soon}\n", [(2, 11, "end.at")]),
    "boolean_for_number": ("zensim: 1\nend: {at: true}\n", [(2, 11, "end.at")]),
    "number_for_text": ("zensim: 1\nname: 5\n", [(2, 7, "name")]),
    "text_for_boolean": ("zensim: 1\nworld: {strict: yes}\n", [(2, 17, "world.strict")]),
    "fraction_for_whole_number": ("zensim: 1\ntime: {seed: 1.5}\n", [(2, 14, "time.seed")]),
    "negative_seed": ("zensim: 1\ntime: {seed: -1}\n", [(2, 14, "time.seed")]),
    "zero_rate": ("zensim: 1\nengine: {step_rate: 0}\n", [(2, 21, "engine.step_rate")]),
    "not_a_number": ("zensim: 1\nend: {at: .nan}\n", [(2, 11, "end.at")]),
    "infinite": ("zensim: 1\nend: {at: .inf}\n", [(2, 11, "end.at")]),
    "unknown_choice": ("zensim: 1\ntime: {mode: lock}\n", [(2, 14, "time.mode")]),
    "map_for_list": ("zensim: 1\nrobots: {name: a}\n", [(2, 9, "robots")]),
    "missing_model": ("zensim: 1\nrobots:\n  - {name: a}\n", [(3, 5, "robots[0].model")]),
    "unknown_model": (
        "zensim: 1\nrobots:\n  - {name: a, model: nope}\n",
        [(3, 22, "robots[0].model")],
    ),
    "missing_model_file": (
        "zensim: 1\nrobots:\n  - {name: a, model: no/such.urdf}\n",
        [(3, 22, "robots[0].model")],
    ),
    "missing_module": (
        HEAD + "behaviours:\n  - {name: b, robots: cart1, do: python, call: 'nomod:Go'}\n"
        "checks:\n  - {name: c, that: python, call: 'nomod:Num'}\n",
        [(5, 48, "behaviours[0].call"), (7, 35, "checks[0].call")],
    ),
    "file_for_a_module": (
        HEAD + "checks:\n  - {name: c, that: python, call: 'json.py:Num'}\n"
        "  - {name: d, that: python, call: 'bisect.py:Num'}\n",
        [(6, 35, "checks[1].call")],
    ),
    "unknown_world": ("zensim: 1\nworld: {load: nope}\n", [(2, 15, "world.load")]),
    "bad_name": (
        "zensim: 1\nrobots:\n  - {name: 1a, model: box_bot}\n",
        [(3, 12, "robots[0].name")],
    ),
    "same_robot_twice": (HEAD + "  - {name: cart1, model: box_bot}\n", [(4, 12, "robots[1].name")]),
    "same_namespace_twice": (
        HEAD.replace("count", "namespace: cart9, count")
        + "  - {name: a, model: box_bot, namespace: /cart9}\n",
        [(4, 42, "robots[1].namespace")],
    ),
    "namespace_of_a_name": (
        HEAD + "  - {name: a, model: box_bot, namespace: cart1}\n",
        [(4, 42, "robots[1].namespace")],
    ),
    "reserved_namespace": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, namespace: sim/a}\n",
        [(3, 42, "robots[0].namespace")],
    ),
    "zero_spacing": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, layout: {spacing: 0}}\n",
        [(3, 49, "robots[0].layout.spacing")],
    ),
    "zero_robots": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, count: 0}\n",
        [(3, 38, "robots[0].count")],
    ),
    "layout_and_poses": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, layout: {kind: row}, poses: [{x: 1}]}\n",
        [(3, 59, "robots[0].poses")],
    ),
    "count_and_poses": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, count: 2, poses: [{x: 1}]}\n",
        [(3, 38, "robots[0].count")],
    ),
    "missing_pose_file": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, poses: no.csv}\n",
        [(3, 38, "robots[0].poses")],
    ),
    "positional_pose": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, poses: [[1, 2]]}\n",
        [(3, 39, "robots[0].poses[0]")],
    ),
    "draw_with_one_number": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, yaw: {uniform: [1]}}\n",
        [(3, 46, "robots[0].yaw.uniform")],
    ),
    "highest_below_lowest": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, yaw: {uniform: [2, 1]}}\n",
        [(3, 46, "robots[0].yaw.uniform")],
    ),
    "negative_deviation": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, yaw: {normal: [0, -1]}}\n",
        [(3, 45, "robots[0].yaw.normal")],
    ),
    "draw_that_is_never_in_range": (
        "zensim: 1\nend: {at: {normal: [-9, 1]}}\n",
        [(2, 20, "end.at.normal")],
    ),
    "unknown_draw": (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, yaw: {gamma: [1, 2]}}\n",
        [(3, 36, "robots[0].yaw")],
    ),
    "selector_without_match": (
        HEAD + "behaviours:\n  - {name: b, robots: truck*, do: stand}\n",
        [(5, 23, "behaviours[0].robots")],
    ),
    "selector_with_bad_pattern": (
        HEAD + "behaviours:\n  - {name: b, robots: 'cart{1}', do: stand}\n",
        [(5, 23, "behaviours[0].robots")],
    ),
    "missing_kind": (
        HEAD + "behaviours:\n  - {name: b, robots: cart*}\n",
        [(5, 5, "behaviours[0]")],
    ),
    "unknown_behaviour": (
        HEAD + "behaviours:\n  - {name: b, robots: cart*, do: fly}\n",
        [(5, 34, "behaviours[0].do")],
    ),
    "unsupported_fault": (
        HEAD + "faults:\n  - {name: f, at: 1, robots: cart0, do: net_loss}\n",
        [(5, 41, "faults[0].do")],
    ),
    "fault_of_the_server": (
        HEAD + "faults:\n  - {name: f, at: 1, do: server_kill}\n",
        [(5, 26, "faults[0].do")],
    ),
    "unknown_part_of_a_sensor_fault": (
        HEAD
        + "faults:\n  - {name: f, at: 1, robots: cart0, do: sensor_slow, sensor: a, "
        + "every_nth: 1}\n",
        [(5, 76, "faults[0].every_nth")],
    ),
    "rate_without_limit": (
        HEAD + "checks:\n  - {name: c, that: rate, topic: cart0/scan}\n",
        [(5, 5, "checks[0]")],
    ),
    "fault_without_start": (
        HEAD + "faults:\n  - {name: f, robots: cart0, do: command_loss}\n",
        [(5, 5, "faults[0]")],
    ),
    "unknown_agent": (
        HEAD + "faults:\n  - {name: f, at: 1, do: agent_kill, agent: nav}\n",
        [(5, 45, "faults[0].agent")],
    ),
    "distance_of_one": (
        HEAD + "checks:\n  - {name: c, robots: cart0, that: distance, above: 1}\n",
        [(5, 23, "checks[0].robots")],
    ),
    "check_without_limit": (HEAD + "checks:\n  - {name: c, that: speed}\n", [(5, 5, "checks[0]")]),
    "reached_without_time": (
        HEAD + "checks:\n  - {name: c, that: reached, point: [1, 2]}\n",
        [(5, 5, "checks[0]")],
    ),
    "check_after_nothing": (
        HEAD + "checks:\n  - {name: c, that: speed, below: 1, after: f, within: 1}\n",
        [(5, 45, "checks[0].after")],
    ),
    "check_of_itself": (
        HEAD + "checks:\n  - {name: c, that: all_of, checks: [c]}\n",
        [(5, 37, "checks[0].checks")],
    ),
    "checks_of_each_other": (
        HEAD
        + "checks:\n  - {name: c, that: speed, below: 1}\n"
        + "  - {name: d, that: all_of, checks: [c, e]}\n"
        + "  - {name: e, that: any_of, checks: [d]}\n",
        [(6, 37, "checks[1].checks")],
    ),
    "end_without_checks": (HEAD + "end: {when: {}}\n", [(4, 13, "end.when")]),
    "end_with_no_check": (HEAD + "end: {when: {all: []}}\n", [(4, 13, "end.when")]),
    "follower_of_itself": (
        HEAD + "behaviours:\n  - {name: b, robots: cart*, do: follow, target: cart0}\n",
        [(5, 50, "behaviours[0].target")],
    ),
    "near_itself": (
        HEAD
        + "faults:\n  - {name: f, do: command_loss, robots: cart0, "
        + "when: {near: [cart0, cart0], below: 1}}\n",
        [(5, 61, "faults[0].when.near")],
    ),
    "length_of_what_is_at_once": (
        HEAD + "faults:\n  - {name: f, do: kidnap, at: 1, for: 2, robots: cart0, x: 1, y: 2}\n",
        [(5, 39, "faults[0].for")],
    ),
    "unknown_check_at_the_end": (
        HEAD + "end: {when: {all: [nope]}}\n",
        [(4, 20, "end.when.all[0]")],
    ),
    "unknown_word_of_a_recording": (
        HEAD + "record: {to: 'runs/{run}.mcap'}\n",
        [(4, 14, "record.to")],
    ),
    "varied_key_that_is_not_there": (
        HEAD + "vary: {robots.cart.cout: [1]}\n",
        [(4, 8, "vary.robots.cart.cout")],
    ),
    "varied_value_of_another_type": (
        HEAD + "vary: {robots.cart.count: [two]}\n",
        [(4, 28, "vary.robots.cart.count[0]")],
    ),
    "file_name_that_is_too_long": (
        f"zensim: 1\nworld: {{load: {'w' * 5000}}}\ninclude: [{'i' * 5000}]\n",
        [(3, 11, "include")],
    ),
    "world_name_that_is_too_long": (
        f"zensim: 1\nworld: {{load: {'w' * 5000}}}\n",
        [(2, 15, "world.load")],
    ),
    "missing_include": ("zensim: 1\ninclude: [no.yaml]\n", [(2, 11, "include")]),
    "too_deep": ("zensim: " + "[" * 40 + "]" * 40 + "\n", [(1, 38, "")]),
}
FULL = """
zensim: 1
name: crossing
world: {load: warehouse, name: lab}
time: {mode: lockstep, speed: 0, seed: 7, on_miss: fail}
robots:
  - name: cart
    model: box_bot_lidar
    count: 4
    layout: {kind: circle, radius: 3 m}
    yaw: {uniform: [-10 deg, 10 deg]}
  - {name: truck, model: car_bot, poses: [{x: 5, y: 0, yaw: 90 deg}]}
behaviours:
  - {name: cross, robots: cart0, do: waypoints, points: [[3, 0], [-3, 0]], speed: 1.8 km/h}
  - {name: wander, robots: "cart[1-2]", do: random_walk, speed: {uniform: [0.2, 0.4]}}
faults:
  - {name: deaf, when: {near: [cart0, truck], below: 1}, for: 2, robots: cart0, do: command_loss}
checks:
  - {name: safe, robots: cart*, that: no_collision}
  - {name: apart, robots: cart*, that: distance, above: 0.3 m, from: 1 s, except: deaf}
end: {at: 30 s, when: {all: [safe]}}
vary: {robots.cart.count: [2, 4], behaviours.cross.speed: {from: 0.2, to: 0.6, steps: 3}, seeds: 5}
"""


def read(folder: Path, text: str, *settings: str) -> Scenario:
    file = folder / "run.scenario.yaml"
    file.write_text(text, encoding="utf-8")
    return read_scenario(str(file), settings)


def issues_of(folder: Path, text: str, *settings: str) -> tuple[Issue, ...]:
    with pytest.raises(ScenarioInvalid) as caught:
        read(folder, text, *settings)
    return caught.value.issues


@pytest.mark.parametrize("name", BROKEN)
def test_mistake_has_its_place_and_key(name: str, tmp_path: Path) -> None:
    text, expected = BROKEN[name]

    found = issues_of(tmp_path, text)

    assert [(one.place.line, one.place.column, one.path) for one in found] == expected
    assert all(one.place.file.endswith("run.scenario.yaml") for one in found)


def test_broken_files_are_many() -> None:
    assert len(BROKEN) >= 40


def test_all_mistakes_are_found_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = (
        "zensim: 1\ntime: {mode: lock, seed: -3}\nrobots:\n"
        "  - {name: cart, modell: box_bot, cuont: 3}\nbehaviours:\n"
        "  - {name: x, robots: cat*, do: fly}\n  - {name: y, robots: cat*, do: drive, v: .nan}\n"
    )

    found = issues_of(tmp_path, text)

    assert [one.path for one in found] == [
        "time.mode",
        "time.seed",
        "robots[0].model",
        "robots[0].modell",
        "robots[0].cuont",
        "behaviours[0].do",
        "behaviours[1].robots",
        "behaviours[1].v",
    ]


@pytest.mark.parametrize(
    ("key", "near"), [("cuont", "count"), ("modl", "model"), ("layuot", "layout")]
)
def test_unknown_key_gets_a_near_one_as_advice(key: str, near: str, tmp_path: Path) -> None:
    found = issues_of(tmp_path, f"zensim: 1\nrobots:\n  - {{name: a, model: box_bot, {key}: 3}}\n")

    assert f"`{near}`" in found[-1].message


def test_number_in_quotes_is_called_text(tmp_path: Path) -> None:
    (found,) = issues_of(tmp_path, "zensim: '1'\n")

    assert "text" in found.message
    assert "did you mean" not in found.message


def test_quantities_are_converted_to_si(tmp_path: Path) -> None:
    scenario = read(tmp_path, FULL)

    first = scenario.resolve_behaviour(0, "cart0")
    assert isinstance(first, FollowWaypoints)
    assert first.speed == pytest.approx(0.5)
    assert scenario.robots[4].yaw == pytest.approx(1.5707963)


def test_robots_are_named_and_placed(tmp_path: Path) -> None:
    scenario = read(tmp_path, FULL)

    assert scenario.robot_names == ["cart0", "cart1", "cart2", "cart3", "truck"]
    assert [(one.x, one.y) for one in scenario.robots[:2]] == [
        pytest.approx((3.0, 0.0)),
        pytest.approx((0.0, 3.0)),
    ]


def test_draws_differ_by_robot_and_stay_in_range(tmp_path: Path) -> None:
    scenario = read(tmp_path, FULL)

    speeds = [scenario.resolve_behaviour(1, name) for name in ("cart1", "cart2")]

    assert all(isinstance(one, RandomWalk) and 0.2 <= one.speed < 0.4 for one in speeds)
    assert speeds[0] != speeds[1]


def test_draws_of_others_stay_when_a_robot_is_added(tmp_path: Path) -> None:
    before = read(tmp_path, FULL)

    more = "robots:\n  - {name: new, model: box_bot, yaw: {uniform: [0, 1]}}"
    after = read(tmp_path, FULL.replace("robots:", more, 1))

    kept = {one.name: one.yaw for one in after.robots if one.name != "new"}
    assert kept == {one.name: one.yaw for one in before.robots}


def test_order_of_keys_changes_neither_draws_nor_digest(tmp_path: Path) -> None:
    lines = FULL.splitlines()
    moved = "\n".join([*lines[:2], lines[-2], *lines[2:-2], lines[-1]]) + "\n"

    before, after = read(tmp_path, FULL), read(tmp_path, moved)

    assert after.robots == before.robots
    assert after.sha256 == before.sha256


def test_normal_draws_have_mean_and_deviation() -> None:
    draw = Draw("normal", (5.0, 2.0))

    drawn = [draw.draw(1, "path", str(robot)) for robot in range(4000)]

    mean = sum(drawn) / len(drawn)
    assert mean == pytest.approx(5.0, abs=0.1)
    deviation = (sum((one - mean) ** 2 for one in drawn) / len(drawn)) ** 0.5
    assert deviation == pytest.approx(2.0, abs=0.1)


def test_normal_draws_beyond_the_range_of_the_key_are_repeated(tmp_path: Path) -> None:
    patrol = "behaviours:\n  - {name: b, robots: cart*, do: waypoints, points: [[3, 0]], speed: "
    text = HEAD.replace("3}", "100}") + patrol + "{normal: [0, 0.3]}}\n"

    scenario = read(tmp_path, text)

    robots = scenario.robot_names
    found = [msgspec.structs.asdict(scenario.resolve_behaviour(0, one))["speed"] for one in robots]
    free = Draw("normal", (0.0, 0.3))
    first = [free.draw(0, "behaviours.b.speed", one) for one in robots]
    assert min(found) > 0.0 > min(first)
    assert len(set(found)) == len(robots)
    assert all(one == old for one, old in zip(found, first, strict=True) if old > 0.0)


def test_choices_are_drawn_alike() -> None:
    draw = Draw("choice", (1.0, 2.0, 4.0))

    drawn = [draw.draw(1, "path", str(robot)) for robot in range(3000)]

    assert all(900 < drawn.count(one) < 1100 for one in draw.values)


def test_streams_are_fixed_by_seed_and_key() -> None:
    assert make_uniforms(1, "a", "b") == make_uniforms(1, "a", "b")
    assert len({make_uniforms(1, "a"), make_uniforms(2, "a"), make_uniforms(1, "b")}) == 3


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("no", "no"),
        ("010", 10),
        ("0o10", 8),
        ("0xff", 255),
        ("12:30:00", "12:30:00"),
        ("1e3", 1000.0),
        ("2026-11-22", "2026-11-22"),
        ("~", None),
        ("True", True),
        (".5", 0.5),
        ("1_000", "1_000"),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text: str, value: object) -> None:
    assert resolve_scalar(text) == value


def test_anchors_work(tmp_path: Path) -> None:
    text = HEAD + (
        "behaviours:\n  - {name: a, robots: cart0, do: waypoints, points: &way [[1, 2], [3, 4]]}\n"
        "  - {name: b, robots: cart1, do: waypoints, points: *way}\n"
    )

    scenario = read(tmp_path, text)

    assert scenario.resolve_behaviour(1, "cart1").points == ((1.0, 2.0), (3.0, 4.0))  # type: ignore[union-attr]


def test_alias_bomb_is_refused_quickly(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 9)]
    began = time.process_time()

    found = issues_of(tmp_path, "zensim: 1\n" + "\n".join(lines) + "\n")

    assert len(found) == 1
    assert time.process_time() - began < 1.0


def test_alias_of_itself_is_refused() -> None:
    with pytest.raises(ScenarioInvalid):
        read_nodes("a: &a [*a]", "f")


def test_include_merges_maps_and_named_entries(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text(
        "zensim: 1\nworld: {load: walls, name: lab}\nrobots:\n"
        "  - {name: a, model: box_bot, count: 2}\n  - {name: b, model: car_bot}\n"
    )
    text = (
        "zensim: 1\ninclude: [base.yaml]\nworld: {load: maze}\n"
        "robots:\n  - {name: a, count: 3}\n  - {name: c, model: box_bot}\n"
    )

    scenario = read(tmp_path, text)

    assert (scenario.format.world.load, scenario.format.world.name) == ("maze", "lab")
    assert scenario.robot_names == ["a0", "a1", "a2", "b", "c"]


def test_mistake_in_an_included_file_is_reported_there(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text("zensim: 1\ntime: {mode: lock}\n")

    found = issues_of(tmp_path, "zensim: 1\ninclude: [base.yaml]\n")

    assert [(Path(one.place.file).name, one.place.line) for one in found] == [("base.yaml", 2)]


@pytest.mark.parametrize("what", ["device", "pipe", "large"])
def test_include_that_is_no_scenario_is_refused_before_it_is_read(
    tmp_path: Path, what: str
) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").touch()
    os.truncate(tmp_path / "large", 1 << 40)
    file = "/dev/zero" if what == "device" else what

    found = issues_of(tmp_path, f"zensim: 1\ninclude: [{file}]\n")

    assert [(one.place.line, one.place.column, one.path) for one in found] == [(2, 11, "include")]


def test_include_loop_is_refused(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text("zensim: 1\ninclude: [run.scenario.yaml]\n")

    found = issues_of(tmp_path, "zensim: 1\ninclude: [base.yaml]\n")

    assert [(Path(one.place.file).name, one.path) for one in found] == [("base.yaml", "include")]


def test_setting_wins_over_the_file(tmp_path: Path) -> None:
    scenario = read(
        tmp_path, FULL, "robots.cart.count=6", "time.seed=9", "behaviours[0].speed=1 m/s"
    )

    assert len(scenario.robots) == 7
    assert scenario.seed == 9
    assert scenario.resolve_behaviour(0, "cart0").speed == 1.0  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "setting", ["robots.nope.count=1", "nonsense", "robots.cart.cout=1", "time.seed=x", "name.x=1"]
)
def test_wrong_setting_is_reported_as_such(setting: str, tmp_path: Path) -> None:
    found = issues_of(tmp_path, FULL, setting)

    assert {one.place.file for one in found} == {f"--set {setting}"}


def test_poses_of_a_file_are_read(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("name,x,y,yaw\nfirst,1,2,0.5\n,3,4,0\n")
    (tmp_path / "p.json").write_text('[{"x": 1, "y": 2, "yaw": "90 deg"}]')
    text = (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, poses: p.csv}\n"
        "  - {name: b, model: box_bot, poses: p.json}\n"
    )

    robots = read(tmp_path, text).robots

    assert [(one.name, one.x, one.y) for one in robots] == [
        ("first", 1.0, 2.0),
        ("a1", 3.0, 4.0),
        ("b", 1.0, 2.0),
    ]


def test_mistake_in_a_pose_file_is_reported_there(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("x,y\n1,2\n3,north\n")

    found = issues_of(tmp_path, "zensim: 1\nrobots:\n  - {name: a, model: box_bot, poses: p.csv}\n")

    assert [(Path(one.place.file).name, one.place.line) for one in found] == [("p.csv", 3)]


def test_robots_of_a_random_layout_keep_their_distance(tmp_path: Path) -> None:
    text = (
        "zensim: 1\nrobots:\n  - {name: a, model: box_bot, count: 20, "
        "layout: {kind: random, radius: 5 m, spacing: 0.8 m}}\n"
    )

    robots = read(tmp_path, text).robots

    pairs = [(one, other) for one in robots for other in robots if one.name < other.name]
    gaps = [((one.x - other.x) ** 2 + (one.y - other.y) ** 2) ** 0.5 for one, other in pairs]
    assert min(gaps) >= 0.8


@pytest.mark.parametrize(
    "layout", ["{kind: grid, radius: 3}", "{radius: 3}", "{kind: circle, radius: 3, spacing: 1}"]
)
def test_key_of_a_layout_without_effect_is_refused(layout: str, tmp_path: Path) -> None:
    text = f"zensim: 1\nrobots:\n  - {{name: a, model: box_bot, count: 4, layout: {layout}}}\n"

    (found,) = issues_of(tmp_path, text)

    assert found.path == "robots[0].layout"
    assert "radius" in found.message


def test_fifty_lines_are_read_in_ten_milliseconds(tmp_path: Path) -> None:
    more = "".join(
        f"  - {{name: b{n}, robots: cart*, do: waypoints, points: [[1, 0], [2, 0]]}}\n"
        for n in range(46)
    )
    read(tmp_path, HEAD + "behaviours:\n" + more)

    times = []
    for _ in range(5):
        began = time.process_time()
        read(tmp_path, HEAD + "behaviours:\n" + more)
        times.append(time.process_time() - began)

    assert min(times) < 0.03


def test_error_of_a_file_can_be_pickled(tmp_path: Path) -> None:
    with pytest.raises(ScenarioInvalid) as caught:
        read(tmp_path, "zensim: 3\n")

    copied = pickle.loads(pickle.dumps(caught.value))
    assert copied.issues == caught.value.issues


@pytest.mark.parametrize(
    ("section", "has_code"),
    [
        ("behaviours: [{name: go, robots: r, do: drive, v: 0.3}]", False),
        ("behaviours: [{name: go, robots: r, do: python, call: 'team:Go'}]", True),
        ("checks: [{name: own, that: python, call: 'team:Check'}]", True),
    ],
)
def test_scenario_with_code_of_its_author_says_so(
    section: str, *, has_code: bool, tmp_path: Path
) -> None:
    text = f"zensim: 1\nrobots: [{{name: r, model: box_bot}}]\n{section}\n"
    (tmp_path / "team.py").write_text("raise SystemExit  # it is not imported")

    assert read(tmp_path, text).has_code == has_code


def test_digest_changes_with_a_value(tmp_path: Path) -> None:
    assert read(tmp_path, FULL).sha256 != read(tmp_path, FULL, "time.seed=8").sha256


def test_values_are_frozen(tmp_path: Path) -> None:
    scenario = read(tmp_path, FULL)

    with pytest.raises(AttributeError):
        scenario.format.time.seed = 3
    assert msgspec.structs.replace(scenario.format.time, seed=3).seed == 3


def test_list_of_robots_of_a_launch_file_is_read_as_poses(tmp_path: Path) -> None:
    (tmp_path / "robots.yaml").write_text(
        'robots:\n  - {name: tb1, x_pose: "-1.5", y_pose: "0.5", z_pose: 0.01, enabled: true}\n'
        '  - {name: tb2, x_pose: "1.5", y_pose: "0.5", z_pose: 0.01, enabled: false}\n'
        "  - {name: tb3, x_pose: 2, y_pose: -3, yaw: 0.5}\n"
    )
    text = "zensim: 1\nrobots:\n  - {name: a, model: box_bot, poses: robots.yaml}\n"

    robots = read(tmp_path, text).robots

    assert [(one.name, one.x, one.y, one.z, one.yaw) for one in robots] == [
        ("tb1", -1.5, 0.5, 0.01, 0.0),
        ("tb3", 2.0, -3.0, None, 0.5),
    ]


def test_unknown_key_of_a_list_of_robots_is_reported_there(tmp_path: Path) -> None:
    (tmp_path / "robots.yaml").write_text("robots:\n  - {name: tb1, x_posse: 1, y_pose: 2}\n")
    text = "zensim: 1\nrobots:\n  - {name: a, model: box_bot, poses: robots.yaml}\n"

    found = issues_of(tmp_path, text)

    assert any(one.place.line == 2 and one.place.file.endswith("robots.yaml") for one in found)
