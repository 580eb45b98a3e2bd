"""Data of a proxy and a monitor on the page, in a real browser."""

import csv
import math
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from analysis.web.feed import Feed
from analysis.web.page_server import announce_end, serve_page
from mavproxy_fault.links.bus import open_bus

pytestmark = pytest.mark.browser


def test_an_isolated_satellite_is_marked_and_listed(page: Any, loop: Any) -> None:
    for step in range(10):
        loop.epoch(10 + step / 5)
    loop.epoch(12.0, excluded=("G12",))
    page.wait_for_selector(".sat.out")
    assert page.text_content(".sat.out").startswith("G12")
    assert "fault in satellite G12" in page.text_content("#events")
    page.wait_for_selector("#statistic canvas")
    assert page.complaints == []


def test_autopilot_and_estimator_say_how_they_are(page: Any) -> None:
    page.wait_for_selector("#status li.bad:has-text('magnetometer test: 1.50 fails')")
    said = [item.text_content() for item in page.query_selector_all("#status li")]
    assert said == [
        "armed", "mode: custom mode 0", "state: active", "estimator: no horizontal position",
        "velocity test: 0.20", "magnetometer test: 1.50 fails",
    ]  # fmt: skip


def test_a_stopped_recording_is_shown_and_its_losses_stay_visible(page: Any, loop: Any) -> None:
    assert page.is_hidden("#recording")
    loop.recording = "[Errno 28] No space left on device", 0
    page.wait_for_selector("#recording.gone:has-text('Recording has stopped: [Errno 28] No')")
    loop.recording = None, 17
    page.wait_for_selector("#recording.note:has-text('17 records are missing in the logs.')")


def test_what_was_received_is_saved_by_time(page: Any, loop: Any) -> None:
    loop.epoch(2.0)
    page.wait_for_selector("#now:has-text('4.0 is below 16.8')")
    page.wait_for_selector(".signal .now:has-text('received 0.5')")
    with page.expect_download() as saved:
        page.click("#csv")
    with Path(saved.value.path()).open() as file:
        rows = list(csv.DictReader(file))
    times = [float(row["t_s"]) for row in rows]
    assert times == sorted(times)
    values = [row for row in rows if row["HIL_SENSOR.xgyro"]]
    assert len(values) > 1
    assert {(row["HIL_SENSOR.xgyro"], row["HIL_STATE_QUATERNION.rollspeed"]) for row in values} == {
        ("0.5", "0.5")
    }
    (epoch,) = [row for row in rows if row["gnss.statistic"]]
    assert (epoch["t_us"], epoch["gnss.statistic"]) == ("2000000", "4")
    assert float(epoch["attitude error ekf.angle_deg"]) == 0.3


def test_a_proxy_that_restarts_is_shown_and_followed(
    open_page: Callable[[str], Any], new_loop: Callable[..., Any]
) -> None:
    first = new_loop()
    with serve_page(first.bus.url, port=0) as address:
        page = open_page(address)
        first.close()
        page.wait_for_selector("#connection:has-text('The proxy has disconnected')")
        second = new_loop(first.bus.url)
        try:
            page.wait_for_selector("#connection.there")
            page.wait_for_selector(".signal .now:has-text('received 0.5')")
        finally:
            second.close()


def test_the_faults_of_a_lost_proxy_can_be_restored(
    open_page: Callable[[str], Any], new_loop: Callable[..., Any]
) -> None:
    first = new_loop()
    with serve_page(first.bus.url, port=0) as address:
        page = open_page(address)
        page.select_option("#kind", "fault:bias")
        page.fill("[data-key=target]", "HIL_SENSOR.xgyro")
        page.fill("[data-key=value]", "0.25")
        with page.expect_response("**/schedule/save"):  # for undo
            page.click("#arm")
        with page.expect_response("**/schedule/save"):  # in case the proxy dies
            page.wait_for_selector("#faults li.active")
        first.close()
        page.wait_for_selector("#connection:has-text('The proxy has disconnected')")
        second = new_loop(first.bus.url)
        try:
            page.click("#adopt button:has-text('Restore them here')")
            page.wait_for_selector("#faults li.active:has-text('bias')")
            assert second.engine.active == ["bias"]
            page.wait_for_selector("#adopt", state="hidden")
        finally:
            second.close()


def test_of_several_runs_each_has_a_row_and_the_viewer_chooses_one(page: Any, loop: Any) -> None:
    assert not page.is_visible("#runs")
    with open_bus(loop.bus.url, run="other") as other:
        other.declare_alive("proxy")
        page.click("#runs button:has-text('other: 0 faults')")
        page.wait_for_selector("#connection:has-text('connected to other')")
        page.wait_for_selector("#runs button[aria-pressed=true]:has-text('other')")
        # What the other run does is seen while this one is looked at.
        loop.live.query("@ctl/fault/still/arm", b'{"fault": "freeze", "target": "HIL_SENSOR.zacc"}')
        page.wait_for_selector("#runs button:has-text('flight-1: still active')")
        loop.epoch(12.0, excluded=("G12",))
        page.wait_for_selector("#runs button.bad:has-text('flight-1: still active, ⚠ G12')")
        page.click("#runs button:has-text('flight-1')")
        page.wait_for_selector("#connection:has-text('connected to flight-1')")
        page.wait_for_selector("#adopt", state="hidden")  # the other one is alive
    page.wait_for_selector("#runs", state="hidden")
    assert page.complaints == []


def test_a_narrow_screen_shows_all_without_scrolling_sideways(page: Any, loop: Any) -> None:
    page.set_viewport_size({"width": 380, "height": 800})
    loop.epoch(2.0)
    page.wait_for_selector(".signal canvas")
    assert page.evaluate("document.documentElement.scrollWidth") <= 380


def test_a_table_that_scrolls_sideways_can_be_reached_by_keys(still_page: Any) -> None:
    tables = still_page.locator(".wide").all()
    assert len(tables) == 2
    for table in tables:
        table.focus()
        assert table.evaluate("(box) => box === document.activeElement")


GAPS = """() => {
  for (const t of [1, 2, 3, 40, 41]) {
    others.add(t, { threshold: 1, ...t === 2 ? {} : { IMU: 0.5 } });
  }
  others.draw();
  const { plot } = others;
  return [1, 2].map((n) => plot.series[n].gaps(plot, n, 0, 4).length);
}"""


def test_a_curve_is_interrupted_where_its_sensor_was_not_tested(still_page: Any) -> None:
    # A sample that only the other curve has is no interruption; half a minute without any is.
    assert still_page.evaluate(GAPS) == [1, 1]


SPIKE = """() => {
  shown.span_s = 600;
  const kept = [];
  extremes(30000, (i) => i / 50, (i) => i === 12345 ? 9 : i === 12346 ? null : Math.sin(i / 40),
    (i) => kept.push(i));
  return [kept.includes(12345), kept.length, kept.every((i, n) => !n || i > kept[n - 1])];
}"""


def test_of_ten_minutes_a_spike_of_one_sample_is_drawn(still_page: Any) -> None:
    seen, count, in_order = still_page.evaluate(SPIKE)
    assert seen
    assert count <= 2 * 401  # of each bin the least and the greatest
    assert in_order


ISOLATED = """() => {
  const show = (t_s, statistic, isolated) => showSensor({ sensor: "mag", t_us: 1e9 + t_s * 1e6,
    statistic, threshold: statistic === null ? null : 10, alarm: isolated, isolated });
  show(1, 5, false);
  show(2, 20, true);
  show(3, null, true);
  show(4, null, true);
  show(5, 4, false);
  others.draw();
  return others.names.map((name, i) => [name, others.rows.get(name).filter((y) => y !== null),
    others.plot.series[i + 1].dash?.length]).filter(([name]) => name.startsWith("magnetometer"));
}"""


def test_the_curve_of_an_isolated_sensor_goes_on_dashed(still_page: Any) -> None:
    # Also where there is nothing to test, as of a sensor that is silent.
    assert still_page.evaluate(ISOLATED) == [
        ["magnetometer", [0.5, 2, 0.4], None],
        ["magnetometer, isolated", [2, 2, 2], 2],
    ]


def test_the_header_shows_when_an_isolation_ended_and_why(page: Any, loop: Any) -> None:
    loop.steps_left = 0  # or the isolation ends by itself on a slow machine
    loop.epoch(10.0)
    loop.epoch(12.0, excluded=("G12",))
    page.wait_for_selector("#verdict:has-text('fault in satellite G12')")
    loop.epoch(14.0, excluded=("G12",))
    loop.epoch(15.0)
    page.wait_for_selector("#verdict:has-text('it is consistent with the others again')")
    stretch = re.search(r"from ([\d.]+) to ([\d.]+) s;", page.text_content("#verdict"))
    assert stretch is not None
    assert float(stretch[2]) - float(stretch[1]) == pytest.approx(2.0, abs=0.11)
    assert "isolation ended: fault in satellite G12" in page.text_content("#events")


def test_an_isolation_begins_with_its_own_fault(page: Any, loop: Any) -> None:
    loop.steps_left = 0
    loop.sensor(10.0, "baro", 40.0, bad=True)
    page.wait_for_selector("#verdict.alarm:has-text('fault in barometer')")
    loop.sensor(12.0, "mag", 40.0, bad=True)
    page.wait_for_selector("#verdict.alarm:has-text('fault in barometer, magnetometer')")
    loop.sensor(12.5, "baro", 2.0)
    page.wait_for_selector("#verdict.alarm:text-is('⚠ fault in magnetometer')")
    loop.sensor(12.8, "mag", 40.0, bad=True)
    # Another one alone ends the isolation before it.
    loop.sensor(13.0, "mag", 2.0)
    loop.sensor(13.0, "airspeed", 40.0, bad=True)
    page.wait_for_selector("#verdict.alarm:has-text('fault in airspeed')")
    page.wait_for_selector("#events li:has-text('isolation ended: fault in magnetometer')")
    ended = page.text_content("#events li:has-text('isolation ended: fault in magnetometer')")
    stretch = re.search(r"from ([\d.]+) to ([\d.]+) s;", ended)
    assert stretch is not None
    assert float(stretch[2]) - float(stretch[1]) == pytest.approx(0.8, abs=0.11)


def test_a_fault_that_acts_undetected_is_not_under_a_green_verdict(page: Any, loop: Any) -> None:
    loop.sensor(10.0, "mag", 2.0)
    page.wait_for_selector("#verdict.calm:has-text('no fault found')")
    off = {"fault": "bias", "target": "HIL_SENSOR.xmag", "value": 0.5}
    loop.live.query("@ctl/fault/off/arm", msgspec.json.encode(off))
    loop.sensor(11.0, "mag", 2.0)
    page.wait_for_selector("#injected:has-text('injected: off')")
    page.wait_for_selector("#verdict:not(.calm):has-text('no fault found')")


def test_the_page_stays_with_the_verdict_when_its_flight_ends(
    loop: Any, open_page: Any, tmp_path: Path
) -> None:
    (tmp_path / "report.html").write_text("<p>the report</p>")
    (tmp_path / "summary.json").write_text('{"verdict": "FAIL"}')
    feed = Feed()
    with serve_page(loop.bus.url, port=0, feed=feed) as address:
        page = open_page(address)
        announce_end(feed, tmp_path)
    with page.expect_download() as saved:
        page.click("#connection a[download]")
    assert Path(saved.value.path()).read_text() == "<p>the report</p>"
    time.sleep(1.5)  # longer than until the page would try to reconnect
    assert page.text_content("#connection").startswith("The flight has ended: FAIL. Report: /")
    assert "Fly again: mavproxy-fault" in page.text_content("#connection")
    assert page.get_attribute("#connection", "class") == "there"
    assert page.complaints == []


def test_nobody_is_kept_from_the_page(
    page: Any, loop: Any, find_barriers: Callable[[Any], list[str]]
) -> None:
    loop.epoch(10.0, excluded=("G12",))
    loop.sensor(10.0, "mag", 40.0, bad=True)
    page.wait_for_selector("#verdict.alarm:has-text('magnetometer')")
    page.wait_for_selector("#preview canvas")
    assert find_barriers(page) == []


def test_isolation_is_shown_without_any_satellite_epoch(page: Any, loop: Any) -> None:
    # As where there is no receiver: verdicts on sensors alone.
    loop.steps_left = 0
    loop.sensor(10.0, "baro", 2.0)
    page.wait_for_selector("#verdict.calm:has-text('no fault found')")
    loop.sensor(11.0, "baro", 40.0, bad=True)
    page.wait_for_selector("#verdict.alarm:has-text('fault in barometer')")
    page.wait_for_selector("#sensors li.bad:has-text('barometer: isolated')")
    loop.sensor(14.0, "baro", 3.0)
    page.wait_for_selector("#verdict.calm:has-text('it is consistent with the others again')")
    page.wait_for_selector("#events li:has-text('isolation ended: fault in barometer from')")
    assert not page.is_visible("#quiet")
    assert page.complaints == []


INTERVALS = """() => {
  const at = (t_s) => 1e9 + t_s * 1e6, said = [];
  store.t0_us = 1e9;
  const decide = (t_s, alarm, hypothesis, excluded) => showDecision({ t_us: at(t_s), statistic: 1,
    threshold: 2, alarm, hypothesis, excluded, satellites: [], normalised: [] });
  const sense = (t_s, sensor, statistic, bad) => showSensor({ sensor, t_us: at(t_s), statistic,
    threshold: statistic && 10, alarm: bad, isolated: bad });
  const see = (t_s) => { store.newest_us = at(t_s); verdicts.update(); showVerdict();
    said.push($("verdict").textContent.replace(/ \\(last.*/, "")); };
  decide(21.4, true, "imu", []); sense(21.4, "imu", 60, true); see(22);
  for (let t_s = 21.6; t_s < 31.4; t_s += 0.2) decide(t_s, false, "imu", []);
  see(30);  // the alarm is over, and the IMU still excluded
  decide(31.4, false, "none", []); sense(33.6, "imu", 9, false); see(34);
  sense(108.5, "mag", null, true); sense(108.5, "imu", null, true); see(108.6);
  sense(110.2, "mag", null, false); see(110.3);  // not tested: nothing ends
  see(112);
  return [said, [...$("events").children].map((one) => one.textContent)
    .filter((text) => text.includes("isolation ended")).reverse()];
}"""


def test_each_sensor_has_the_interval_of_its_own_decisions(still_page: Any) -> None:
    said, ended = still_page.evaluate(INTERVALS)
    both = "⚠ fault in magnetometer, IMU"
    assert said == [
        "⚠ fault in IMU", "⚠ fault in IMU", "✓ no fault found", both, both,
        "– no fault found, nothing tested now",
    ]  # fmt: skip
    assert [re.search(r"fault in (.*?);", text)[1] for text in ended] == [
        "IMU from 21.4 to 31.4 s", "magnetometer from 108.5 to 108.5 s",
        "IMU from 108.5 to 108.5 s",
    ]  # fmt: skip


STREAMS = """() => {
  const at = (t_s) => 1e9 + t_s * 1e6;
  store.t0_us = 1e9;
  const decide = (t_s, hypothesis) => showDecision({ t_us: at(t_s), statistic: 1, threshold: 2,
    alarm: hypothesis !== "none", hypothesis, excluded: [], satellites: [], normalised: [] });
  const sense = (t_s, sensor, statistic, alarm, isolated) => showSensor({ sensor, t_us: at(t_s),
    statistic, threshold: statistic && 10, alarm, isolated });
  const see = (t_s) => { store.newest_us = at(t_s); verdicts.update(); };
  faultIntervals.set("ramp 1", [40, 55]);
  sense(46, "baro", 20, true, false); see(46.2);
  sense(46.4, "baro", 30, true, true); see(46.6);
  sense(65.2, "baro", 1, false, false); see(65.4);
  faultIntervals.set("silence 2", [70, null]);
  decide(70.2, "imu"); decide(70.4, "none");  // one batch: the monitor's streams one by one
  sense(70.2, "imu", null, true, true); see(70.6);
  sense(71, "mag", 20, true, false); sense(71.2, "mag", 1, false, false); see(72);
  sense(72.4, "imu", 1, false, false); see(73);
  return [...$("events").children].map((one) => one.textContent)
    .filter((text) => text.includes("ended: ")).map((text) => text.replace(/^.* s(?=iso|ala)/, ""))
    .reverse();
}"""


def test_an_interval_is_that_of_the_isolation_and_ends_with_its_own_fault(
    still_page: Any,
) -> None:
    assert still_page.evaluate(STREAMS) == [
        "isolation ended: fault in barometer from 46.4 to 46.4 s; ramp ended at 55.0 s",
        "alarm ended: fault in magnetometer from 71.0 to 71.0 s; "
        "it is consistent with the others again",
        "isolation ended: fault in IMU from 70.2 to 70.2 s; it is consistent with the others again",
    ]


def test_a_finding_that_is_not_repeated_ends(page: Any, loop: Any) -> None:
    # A stream monitor reports only silence, never that the stream is back.
    loop.steps_left = 0
    loop.sensor(10.0, "mag", bad=True)
    page.wait_for_selector("#verdict.alarm:has-text('fault in magnetometer')")
    loop.sensor(12.0, "baro", 2.0)
    page.wait_for_selector("#sensors li:has-text('barometer: consistent')")
    assert page.is_visible("#verdict.alarm")
    loop.sensor(13.5, "baro", 2.0)
    page.wait_for_selector("#verdict.calm:has-text('no fault was found in it for 3 s')")
    page.wait_for_selector("#sensors li:not(.bad):has-text('magnetometer: no fault found now')")


def test_an_isolation_ends_without_further_verdicts(page: Any, loop: Any) -> None:
    # Without a receiver nothing is tested, and what watches the streams is silent again.
    loop.steps_left = 0
    loop.sensor(loop.now_s, "mag", bad=True)
    page.wait_for_selector("#verdict.alarm:has-text('fault in magnetometer')")
    loop.steps_left = math.inf
    page.wait_for_selector("#verdict:not(.alarm):has-text('no fault found, nothing tested now')")
    assert "no fault was found in it for 3 s" in page.text_content("#verdict")
    page.wait_for_selector("#sensors li:not(.bad):has-text('magnetometer: no fault found now')")
    page.wait_for_selector("#events li:has-text('isolation ended: fault in magnetometer')")


def test_the_end_of_a_fault_explains_that_of_an_isolation_without_satellites(
    page: Any, loop: Any
) -> None:
    off = {"fault": "bias", "target": "HIL_SENSOR.xmag", "value": 0.5}
    loop.live.query("@ctl/fault/off/arm", msgspec.json.encode(off))
    page.wait_for_selector("#events li:has-text('off: fault starts')")
    loop.steps_left = 0
    loop.sensor(500.0, "mag", 40.0, bad=True)
    page.wait_for_selector("#verdict.alarm")
    loop.live.query("@ctl/fault/off/disarm", b"")
    loop.steps_left = 5
    page.wait_for_selector("#events li:has-text('off: fault ended')")
    (label,) = [one for one in loop.labels if one.end_us is not None]
    loop.sensor(label.end_us / 1e6 + 1.0, "mag", 3.0)
    page.wait_for_selector("#verdict.calm:has-text('off ended at')")


FILLED = """(canvas) => {
  const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  let filled = 0;
  for (let i = 3; i < data.length; i += 4) filled += data[i] > 0;
  return filled / (data.length / 4);
}"""


def test_horizon_and_space_are_drawn_after_a_change_of_size_and_theme(page: Any) -> None:
    page.wait_for_selector("#status li")
    page.wait_for_function(f"() => ({FILLED})(document.getElementById('horizon')) > 0.9")
    page.evaluate("requestAnimationFrame = () => 0")  # as in a page that is only captured
    page.emulate_media(color_scheme="dark")
    page.set_viewport_size({"width": 900, "height": 3000})
    page.wait_for_timeout(100)
    for name in ("horizon", "scene"):
        canvas = page.query_selector(f"#{name}")
        assert canvas.evaluate("(one) => one.width") == canvas.evaluate("(one) => one.clientWidth")
        assert canvas.evaluate(FILLED) > 0.02


def test_all_plots_show_the_same_stretch_of_time(page: Any, loop: Any) -> None:
    for step in range(10):
        loop.epoch(1 + step / 5)
    page.wait_for_selector("#statistic canvas")
    page.wait_for_selector(".signal canvas")
    page.select_option("#span", "30")
    ranges = """() => {
      const fields = [...signals.shown.values()].map((signal) => signal.plot);
      const plots = [statistic.plot, attitude.plot, ...fields];
      const found = plots.map((plot) => [plot.scales.x.min, plot.scales.x.max]);
      return found.every(([from, to]) => Math.abs(to - found[0][1]) < 0.3 && to - from === 30);
    }"""
    page.wait_for_function(ranges)
    assert page.complaints == []
