"""Test sequences composed on the page, and commands to the vehicle, in a real browser."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from analysis.web.page_server import serve_page
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.schedule.entries import read_schedule

pytestmark = pytest.mark.browser

SEQUENCE = """
faults:
- {id: up, fault: command, do: take-off, height_m: 15, at_s: 0.1}
- id: still
  fault: freeze
  target: HIL_SENSOR.zacc
  for_s: 0.2
  after: {id: up, delay_s: 0.1}
  when: count(HIL_SENSOR) > 3
- {id: down, fault: command, do: land, after: still}
"""


@pytest.fixture
def address(loop: Any, tmp_path: Path) -> Iterator[str]:
    with serve_page(loop.bus.url, port=0, commands=True, sequences=tmp_path) as found:
        yield found


def compose(page: Any, for_s: str = "0.3") -> None:
    """Arm, a bias once a condition holds, land half a second after its end, or start without."""
    page.click("#sequence summary")
    page.select_option("#deed", "arm")
    page.click("#add-step")
    page.select_option("#kind", "fault:bias")
    page.fill("[data-key=target]", "HIL_SENSOR.xgyro")
    page.fill("[data-key=value]", "0.25")
    page.fill("[data-key=for_s]", for_s)
    page.click("#add-fault")
    page.fill("[aria-label='until of bias']", "count(HIL_SENSOR) > 5")
    page.select_option("#deed", "land")
    page.click("#add-step")
    page.fill("[aria-label='wait, s of land']", "0.5")


def test_no_click_is_lost_while_the_list_of_faults_grows(
    page: Any, loop: Any, address: str, open_page: Callable[[str], Any]
) -> None:
    """The list stands above the button: a row that came between press and release moved it."""
    other = open_page(address)
    page.click("#sequence summary")
    button = page.locator("#add-step")
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    page.mouse.move(box["x"] + 5, box["y"] + 5)
    page.mouse.down()
    bias = {"fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 0.1}
    for number in range(4):
        key = f"@ctl/fault/f{number}/arm"
        loop.live.query(key, json.dumps(bias).encode())
    other.wait_for_selector("#faults li >> nth=3")  # each batch goes to all viewers at once
    page.mouse.up()
    page.wait_for_selector("#steps li b:text-is('arm')")
    page.wait_for_selector("#faults li >> nth=3")  # what was held back is shown


def test_a_sequence_is_composed_run_and_watched(page: Any, loop: Any) -> None:
    compose(page, for_s="")  # without an end: the condition stays true
    page.click("#run-sequence")
    page.wait_for_selector("#sequence-state:has-text('2 of 3 steps done; running: bias')")
    page.wait_for_selector("#steps li.active[aria-current=step] b:text-is('bias')")
    assert loop.commands == [(400, 0.0), (21, 0.0)]
    assert loop.engine.active == ["bias"]
    page.wait_for_selector("#events li:has-text('command arm or disarm: accepted')")
    assert page.complaints == []


def test_a_sequence_is_downloaded_stored_and_opened_again(
    page: Any, loop: Any, tmp_path: Path
) -> None:
    compose(page)
    with page.expect_download() as saved:
        page.click("#download-sequence")
    text = Path(saved.value.path()).read_text()
    page.fill("#kept-name", "night.yaml")
    page.click("#keep")
    page.wait_for_selector("#sequence-message:has-text('night.yaml is stored')")
    kept = tmp_path / "night.yaml"
    assert kept.read_text() == text
    arm, bias, land = read_schedule(kept).faults
    assert (arm.name, bias.when, bias.after.id) == ("command", "count(HIL_SENSOR) > 5", "arm")
    assert (land.after.id, land.after.delay_s) == ("bias", 0.5)
    page.click("[aria-label='Remove bias']")
    assert page.input_value("[aria-label='begins of land']") == "end:arm"  # the chain closes
    page.click("#open-kept")
    page.wait_for_selector("#steps li >> nth=2")
    assert page.input_value("[aria-label='until of bias']") == "count(HIL_SENSOR) > 5"
    assert page.complaints == []


def test_a_sequence_from_a_file_keeps_all_its_keys(page: Any, loop: Any, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(SEQUENCE)
    page.click("#sequence summary")
    page.set_input_files("#open-sequence", file)
    page.wait_for_selector("#steps li >> nth=2")
    with page.expect_download() as saved:
        page.click("#download-sequence")
    again = tmp_path / "again.yaml"
    again.write_bytes(Path(saved.value.path()).read_bytes())

    def essence(path: Path) -> list[tuple[Any, ...]]:
        return [
            (one.id, one.name, one.at_s, one.for_s, one.when, one.after, one.parameters)
            for one in read_schedule(path).faults
        ]

    assert essence(again) == essence(file)
    page.click("#run-sequence")
    page.wait_for_selector("#sequence-state:has-text('the sequence is done')")
    assert loop.commands == [(22, 15.0), (21, 0.0)]


def test_a_wrong_step_is_explained_and_nothing_runs(page: Any, loop: Any) -> None:
    compose(page)
    page.fill("[aria-label='until of bias']", "altitud_m > 5")
    page.wait_for_selector("#sequence-message:has-text('altitud_m is unknown')")
    page.click("#run-sequence")
    page.wait_for_selector("#sequence-message:not(.fine):has-text('faults[1].when')")
    assert loop.engine.ids() == []


def test_a_button_commands_the_vehicle_until_it_accepts(page: Any, loop: Any) -> None:
    page.fill("#height", "25")
    page.click("#commands button:has-text('take off')")
    page.wait_for_selector("#faults li.done:has-text('command-take-off')")
    assert loop.commands == [(22, 25.0)]
    assert page.complaints == []


def test_without_the_option_commands_are_refused(
    loop: Any, open_page: Callable[[str], Any]
) -> None:
    with serve_page(loop.bus.url, port=0) as address:
        page = open_page(address)
        assert page.is_hidden("#commands")
        assert page.is_hidden("#command-step")
        page.select_option("#kind", "fault:command")
        page.select_option("[data-key=do]", "arm")
        page.click("#arm")
        page.wait_for_selector("#form-message:has-text('start the page with --allow-commands')")
        page.set_input_files(
            "#load", {"name": "a.yaml", "mimeType": "", "buffer": SEQUENCE.encode()}
        )
        page.wait_for_selector("#schedule-message:has-text('start the page with --allow-commands')")
        page.close()
    assert loop.engine.ids() == []


def test_a_folder_of_sequences_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with (
        pytest.raises(ConfigError, match=r"--sequences .*is not a folder"),
        serve_page("tcp/127.0.0.1:1", port=0, sequences=tmp_path / "none"),
    ):
        pass


def test_a_sequence_is_stored_in_its_folder_only(page: Any, loop: Any, tmp_path: Path) -> None:
    (tmp_path / "link.yaml").symlink_to(tmp_path.parent / "target.yaml")
    compose(page)
    for name in ("../out.yaml", ".hidden.yaml", "no-yaml.txt", "link.yaml"):
        page.fill("#kept-name", name)
        with page.expect_response("**/sequence/write/**") as answered:
            page.click("#keep")
        assert answered.value.status in (400, 404), name
        page.wait_for_selector("#sequence-message:not(.fine)")
    assert {one.name for one in tmp_path.iterdir()} == {"link.yaml"}
    assert not (tmp_path.parent / "target.yaml").exists()
    assert not (tmp_path.parent / "out.yaml").exists()
