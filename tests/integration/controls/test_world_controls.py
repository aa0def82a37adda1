"""The tabs Plots, Edit and Time in Chromium."""

import functools

import pytest

from tests.integration.controls.opened_page import (
    CHARTS,
    MORE,
    NUMBER_OF_CHARTS,
    PAUSE,
    SENSOR,
    WITHIN_S,
    Page,
    a_button,
    a_checkbox,
    a_choice,
    a_field,
    uses,
)
from tests.integration.page_controls import Control
from tests.integration.processes import eventually
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import Imu
from zensim.proto.messages.telemetry_messages import Info
from zensim.sim_server.description.builtin_models import list_builtin_models

pytestmark = pytest.mark.browser

# The tab "Plots".


@uses(
    *(a_checkbox("Plots", title) for title in CHARTS),
    *(a_button("Plots", title) for title in CHARTS),
    a_button("Plots", "Save as CSV"),
)
def test_charts_are_drawn_folded_and_saved(page: Page) -> None:
    page.select("r1")
    for number, title in enumerate(CHARTS):
        page.controls.click(a_checkbox("Plots", title))
        page.controls.until(f"{NUMBER_OF_CHARTS} === {number + 1}")
    page.controls.click(a_button("Plots", "Save as CSV"))
    assert page.until_file("zensim_plot*.csv").read_text().startswith("simulation time [s]")
    for title in CHARTS:
        page.controls.click(a_button("Plots", title))
    page.controls.until(f"{NUMBER_OF_CHARTS} === 0")
    for title in CHARTS:
        page.controls.click(a_checkbox("Plots", title))
        page.controls.until(
            f"![...document.querySelectorAll('.zensim-fold')]"
            f".some(o => o.innerText === '{title}' && o.checkVisibility())"
        )


@uses(SENSOR, a_button("Plots", "Sensor"))
def test_sensor_is_plotted_as_chosen(page: Page) -> None:
    page.select("r2")
    with page.publishing(keys.robot("r2", "imu"), Imu) as publisher:
        page.controls.choose(SENSOR, "imu")
        eventually(lambda: publisher.is_matched, WITHIN_S, "a subscription")

        def is_drawn() -> bool:
            publisher.send(encode(Imu(), Format.CDR))
            return bool(page.tab.evaluate(f"{NUMBER_OF_CHARTS} === 1"))

        eventually(is_drawn, WITHIN_S, "a chart")
        page.controls.click(a_button("Plots", "Sensor"))
        page.controls.until(f"{NUMBER_OF_CHARTS} === 0")
        page.controls.choose(SENSOR, "none")
        eventually(lambda: not publisher.is_matched, WITHIN_S, "its end")


ALONG_HANDLES = """
(() => {
  const {camera, canvas, nodeRefFromName} = window.__viserMutable;
  if (!nodeRefFromName["/handles"]) return null; // in the scene's tree, but not drawn yet
  const box = canvas.getBoundingClientRect(), at = (metres) => {
    const seen = camera.position.clone().set(metres, 0, 0)
      .applyMatrix4(nodeRefFromName["/handles"].matrixWorld).project(camera);
    return [box.left + (seen.x + 1) / 2 * box.width, box.top + (1 - seen.y) / 2 * box.height];
  };
  return [at(0.5), at(1.0)];
})()
"""
"""Places on the screen along the x axis of an entity's handles; null while they are not drawn."""

# The tab "Edit".

PLACE, TARGET = "Place x, y [m]", "Move to x, y [m], heading [deg]"


@uses(
    MORE,
    a_choice("Edit", "Model"),
    a_field("Edit", "Name"),
    a_field("Edit", "Count"),
    a_choice("Edit", "Layout"),
    a_field("Edit", "Spacing [m]"),
    a_field("Edit", PLACE),
    a_field("Edit", PLACE, 1),
    a_field("Edit", "Heading [deg]"),
    a_button("Edit", "Spawn", 1),
)
def test_robots_are_spawned_as_the_form_says(page: Page) -> None:
    page.controls.choose(a_choice("Edit", "Model"), "car_bot")
    page.controls.click(MORE)
    page.controls.write(a_field("Edit", "Name"), "made")
    page.controls.write(a_field("Edit", "Count"), "2")
    page.controls.choose(a_choice("Edit", "Layout"), "row")
    page.controls.write(a_field("Edit", "Spacing [m]"), "3")
    page.controls.write(a_field("Edit", PLACE), "-6")
    page.controls.write(a_field("Edit", PLACE, 1), "4")
    page.controls.write(a_field("Edit", "Heading [deg]"), "90")

    page.controls.click(a_button("Edit", "Spawn", 1))
    page.controls.click(MORE)

    page.controls.until_text("spawned made")
    places = [page.state_of(name).pose.position for name in ("made0", "made1")]
    assert [(one.x, one.y) for one in places] == [
        pytest.approx((-6.0, 4.0), abs=0.1),
        pytest.approx((-6.0, 7.0), abs=0.1),
    ]
    for name in ("made0", "made1"):
        page.server.client.delete(name)


@uses(*(a_button("Edit", model) for model in list_builtin_models()))
def test_model_is_that_of_a_picture(page: Page) -> None:
    for model in list_builtin_models():
        page.controls.click(a_button("Edit", model))
        is_chosen = functools.partial(has_value, page, a_choice("Edit", "Model"), model)
        eventually(is_chosen, WITHIN_S, model)


def has_value(page: Page, control: Control, value: str) -> bool:
    return page.controls.value_of(control) == value


@pytest.mark.parametrize("by_finger", [False, True], ids=["mouse", "finger"])
@uses(a_button("Edit", "Place by click"))
def test_place_is_that_of_a_click(page: Page, by_finger: bool) -> None:  # noqa: FBT001
    field, picks = a_field("Edit", PLACE), "document.body.classList.contains('zensim-picks')"
    page.controls.write(field, "77")
    page.controls.click(a_button("Edit", "Place by click"))
    page.controls.until(picks)
    page.click_scene_until(
        lambda: page.controls.value_of(field) != "77", "a place", by_finger=by_finger
    )
    page.controls.until("!" + picks)


@uses(a_checkbox("Edit", "Handles"))
def test_entity_is_moved_by_handles_in_the_scene(page: Page) -> None:
    page.select("r3")
    before = page.state_of("r3").pose.position
    page.controls.click(a_checkbox("Edit", "Handles"))
    page.until_node("/handles")

    def drag() -> bool:
        if not (places := page.tab.evaluate(ALONG_HANDLES)):
            return False
        page.controls.drag(*places)
        page.tab.evaluate(PAUSE % 1000)
        now = page.state_of("r3").pose.position
        return abs(now.x - before.x) + abs(now.y - before.y) > 0.05

    eventually(drag, WITHIN_S, "another place")
    page.controls.click(a_checkbox("Edit", "Handles"))
    page.until_no_node("/handles")


@uses(*(a_field("Edit", TARGET, number) for number in range(3)), a_button("Edit", "Move"))
def test_entity_is_moved_to_numbers(page: Page) -> None:
    page.select("r3")
    for number, text in enumerate(("2.5", "-2", "90")):
        page.controls.write(a_field("Edit", TARGET, number), text)

    page.controls.click(a_button("Edit", "Move"))

    def is_there() -> bool:
        pose = page.state_of("r3").pose
        place = (pose.position.x, pose.position.y, pose.orientation.z)
        return place == pytest.approx((2.5, -2.0, 0.707), abs=0.1)

    eventually(is_there, WITHIN_S, "the place")


@uses(a_button("", "Close"))
def test_notification_is_closed(page: Page) -> None:
    page.controls.click(a_button("Edit", "Undo"))
    page.controls.until_text("nothing is being deleted")
    page.controls.click(a_button("", "Close"))
    page.controls.until_no_text("nothing is being deleted")


# The tab "Time".


@uses(*(a_button("Time", label) for label in ("1 step", "10 steps", "1 s")))
@pytest.mark.smoke
def test_world_is_stepped(page: Page) -> None:
    page.server.client.set_simulation_state(State.PAUSED)
    page.controls.until_text("paused")
    for label, steps in {"1 step": 1, "10 steps": 10, "1 s": 240}.items():
        goal = page.server.client.info().steps + steps
        page.controls.click(a_button("Time", label))
        page.until_info(functools.partial(has_steps, goal), label)


def has_steps(goal: int, info: Info) -> bool:
    return info.steps == goal


FACTOR, FACTOR_FIELD = Control("Time", "slider", "Speed"), a_field("Time", "Speed")


@uses(FACTOR, FACTOR_FIELD)
@pytest.mark.smoke
def test_real_time_factor_is_set(page: Page) -> None:
    def find_factor() -> float:
        page.tab.evaluate(PAUSE % 500)
        return page.server.client.info().target_real_time_factor

    def slide() -> bool:
        page.controls.slide(FACTOR, 0.2)
        return 1.5 < find_factor() < 2.5

    def write() -> bool:
        page.controls.write(FACTOR_FIELD, "1")
        return find_factor() == 1.0

    eventually(slide, WITHIN_S, "about 2")
    eventually(write, WITHIN_S, "1")  # the field follows the server, once a second


GOAL = a_field("Time", "Time [s]")


@uses(GOAL, a_button("Time", "Run to this time"), a_button("Time", "Cancel run"))
def test_world_runs_to_a_time_and_a_run_is_canceled(page: Page) -> None:
    page.server.client.set_simulation_state(State.PAUSED)
    goal = round(page.server.client.info().sim_time_s + 1.0, 1)
    page.controls.write(GOAL, f"{goal}")
    page.controls.click(a_button("Time", "Run to this time"))
    info = page.until_info(
        lambda info: info.state == "paused" and info.sim_time_s > goal - 0.01, "the goal"
    )
    assert info.sim_time_s == pytest.approx(goal, abs=0.01)

    page.controls.write(GOAL, "9999")
    page.controls.click(a_button("Time", "Run to this time"))
    page.controls.until_text("Running to 9999 s")
    page.controls.click(a_button("Time", "Cancel run"))
    page.controls.until_no_text("Running to 9999 s")
    page.until_info(lambda info: info.state == "paused", "its end")
