"""What is changed from the page, in a real browser, reaches a proxy that runs."""

from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.browser


def test_clicking_arms_a_fault_on_the_proxy_and_disarms_it(page: Any, loop: Any) -> None:
    page.select_option("#kind", "fault:bias")
    page.fill("[data-key=target]", "HIL_SENSOR.xgyro")
    page.fill("[data-key=value]", "0.1")
    page.wait_for_selector("#preview canvas")
    page.click("#arm")
    page.wait_for_selector("#faults li.active")
    (fault,) = loop.engine.state()["faults"]
    assert (fault["id"], fault["parameters"]) == ("bias", {"value": 0.1})
    page.click("#faults button")
    page.wait_for_selector("#faults li", state="detached")
    assert loop.engine.ids() == []
    assert page.complaints == []


def test_a_slider_changes_what_the_vehicle_is_sent_and_the_change_is_labelled(
    page: Any, loop: Any
) -> None:
    page.select_option("#kind", "fault:bias")
    page.fill("[data-key=target]", "HIL_SENSOR.xgyro")
    page.select_option("[data-key=shape]", "live")
    page.click("#arm")
    slider = page.wait_for_selector("#faults li.active input[type=range]")
    page.fill("#faults input[type=number]", "4")
    slider.focus()
    page.keyboard.press("End")  # the slider's reach is half as much again
    page.wait_for_selector(".signal .now:has-text('received 0.5, forwarded 6.5')")
    assert loop.xgyro == 6.5
    page.wait_for_selector("#events li:has-text('bias: value set to 6')")
    assert loop.labels[-1].value == 6.0
    page.click("#faults button[aria-pressed=true]")  # stop streaming: the healthy value passes
    page.wait_for_selector(".signal .now:has-text('received 0.5, forwarded 0.5')")
    assert page.complaints == []


def test_a_stream_stays_stopped_though_a_value_waited_to_be_sent(page: Any, loop: Any) -> None:
    page.select_option("#kind", "fault:bias")
    page.fill("[data-key=target]", "HIL_SENSOR.xgyro")
    page.select_option("[data-key=shape]", "live")
    page.click("#arm")
    page.wait_for_selector("#faults li.active input[type=range]")
    held: list[Any] = []  # a slow server: the first value waits for its answer
    page.route("**/value", lambda route: route.continue_() if held else held.append(route))
    page.fill("#faults input[type=number]", "4")
    with page.expect_request("**/value"):
        page.press("#faults input[type=number]", "Enter")
    page.fill("#faults input[type=number]", "6")
    page.press("#faults input[type=number]", "Enter")  # waits for the answer to the first
    page.click("#faults button[aria-pressed=true]")
    with page.expect_response("**/value"):
        held[0].continue_()
    page.wait_for_selector("#events li:has-text('bias: fault starts')")
    page.wait_for_selector(".signal .now:has-text('received 0.5, forwarded 0.5')")
    assert page.get_attribute("#faults button[aria-pressed]", "aria-pressed") == "false"
    assert [label.value for label in loop.labels if label.value is not None] == [4.0]


def test_a_link_fault_drops_what_it_should(page: Any, loop: Any) -> None:
    page.select_option("#kind", "fault:drop")
    page.fill("[data-key=target]", "HIL_SENSOR")
    page.fill("[data-key=for_s]", "0.2")
    page.click("#arm")
    page.wait_for_selector("#events li:has-text('drop: fault ended after')")
    begun, ended = loop.labels
    assert (begun.targets, ended.frames) == (("HIL_SENSOR",), 9)
    page.wait_for_selector("#links td:has-text('simulator')")


def test_a_schedule_is_saved_loaded_and_a_wrong_one_explained(
    page: Any, loop: Any, tmp_path: Path
) -> None:
    good, wrong = tmp_path / "good.yaml", tmp_path / "wrong.yaml"
    good.write_text("faults:\n- {id: still, fault: freeze, target: HIL_SENSOR.zacc}\n")
    wrong.write_text("faults:\n- {id: still, fault: freeez, target: HIL_SENSOR.zacc}\n")
    page.set_input_files("#load", good)
    page.wait_for_selector("#schedule-message.fine")
    page.set_input_files("#load", wrong)
    page.wait_for_selector("#schedule-message:not(.fine)")
    assert "freeez is unknown" in page.text_content("#schedule-message")
    assert loop.engine.ids() == ["still"]
    with page.expect_download() as saved:
        page.click("#save")
    assert "id: still" in Path(saved.value.path()).read_text()


# What the focus is on, and whether that can be seen.
FOCUS = """() => {
  const one = document.activeElement;
  const seen = [one, one.parentElement].some((it) => getComputedStyle(it).outlineStyle !== "none");
  return [one.id || one.getAttribute("aria-label") || one.textContent, seen];
}"""


def test_everything_can_be_done_by_keyboard_alone(page: Any, loop: Any) -> None:
    press = page.keyboard.press

    def tab_to(wanted: str) -> None:
        for _ in range(60):
            press("Tab")
            name, visible = page.evaluate(FOCUS)
            assert visible, f"the focus on {name} cannot be seen"
            if wanted in (name, page.evaluate("document.activeElement.dataset.key")):
                return
        raise AssertionError(f"{wanted} is not reached by Tab")

    tab_to("kind")
    page.keyboard.type("bias")
    tab_to("target")
    page.keyboard.type("HIL_SENSOR.xgyro")
    tab_to("value")
    page.keyboard.type("0.25")
    tab_to("arm")
    press("Enter")
    page.wait_for_selector("#faults li.active")
    tab_to("Disarm bias")
    tab_to("Value of bias, slider")
    press("ArrowRight")
    page.wait_for_selector("#events li:has-text('bias: value set to 0.2525')")
    for reached in ("stop", "save", "load", "scene", "field", "events", "csv"):
        tab_to(reached)
    page.focus("#stop")
    press("Space")
    page.wait_for_selector("#faults li", state="detached")
    assert page.complaints == []


def test_a_change_is_undone_and_a_fault_that_is_over_is_armed_again(page: Any, loop: Any) -> None:
    page.select_option("#kind", "fault:bias")
    page.fill("[data-key=target]", "HIL_SENSOR.xgyro")
    page.fill("[data-key=value]", "0.25")
    page.fill("[data-key=for_s]", "0.3")
    assert page.is_disabled("#undo")
    page.click("#arm")
    page.wait_for_selector("#faults li:has-text('finished')")
    page.click("[aria-label='Re-arm bias']")
    page.wait_for_selector("#faults li.active")
    page.wait_for_selector("#faults li:has-text('finished')")
    page.wait_for_selector("#schedule-message:has-text('armed again: bias')")
    assert len([label for label in loop.labels if label.end_us]) == 2
    page.click("#undo")
    page.wait_for_selector("#schedule-message:has-text('undone')")
    page.click("#undo")
    page.wait_for_selector("#faults li", state="detached")
    assert loop.engine.ids() == []
    page.wait_for_selector("#undo:disabled")
    assert page.complaints == []


def test_a_fault_with_blanks_in_its_name_is_disarmed(page: Any, loop: Any, tmp_path: Path) -> None:
    schedule = tmp_path / "blanks.yaml"
    schedule.write_text("faults:\n- {id: gyro x bias, fault: drop, target: HIL_GPS}\n")
    page.set_input_files("#load", schedule)
    page.click("[aria-label='Disarm gyro x bias']")
    page.wait_for_selector("#faults li", state="detached")
    assert loop.engine.ids() == []


def test_faults_can_be_searched(page: Any) -> None:
    shown = "[...document.querySelectorAll('#kind option:not([hidden])')].map((one) => one.value)"
    everything = page.evaluate(shown)
    page.fill("#find", "gyro stuck")
    found = page.evaluate(shown)
    assert 0 < len(found) < len(everything) / 10
    assert page.input_value("#kind") in found
    page.fill("#find", "")
    assert page.evaluate(shown) == everything
