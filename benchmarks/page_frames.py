"""The work of the page's frames with six noisy fields on show, over one minute and over ten.

    python -m benchmarks.page_frames

Ten minutes of samples at 50 Hz are put into the page, as after ten minutes of watching; new ones
come meanwhile from a bus. Chromium without a graphics card, which draws by the processor.
"""

import threading
import time

import msgspec

from analysis.web.page_server import serve_page
from mavproxy_fault.links.bus import Bus, open_bus
from mavproxy_fault.live.subscriptions import Watched
from tests.hardening.page_watcher import FRAME_COLUMNS, watched_page

SECONDS = 15.0
RATE_HZ = 50
ROWS = 30_000
FIELDS = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc")
FILL = """([fields, count]) => {
  const table = store.tables.get("HIL_SENSOR"), end_us = store.newest_us;
  const rows = (more) => Array.from({ length: count }, (_, k) => [end_us - (count - k) * 2e4,
    ...fields.map((_, n) => Math.sin(k / 50 + n) + more + 0.02 * (k * 7 % 11))]);
  Object.assign(table, { received: rows(0), sent: rows(0.1), faulted: true });
  for (const field of fields) signals.pick(`HIL_SENSOR.${field}`);
  for (let k = 0; k < count / 10; k++) {
    const t_us = end_us - (count / 10 - k) * 2e5;
    showDecision({ t_us, statistic: 5 + Math.sin(k / 9), threshold: 16, dof: 6, alarm: false,
      hypothesis: "none", excluded: [], satellites: ["G01", "G02"], normalised: [0.3, 0.4] });
    for (const sensor of ["baro", "mag", "airspeed", "gps-position", "gps-velocity", "imu"]) {
      showSensor({ sensor, t_us, statistic: 3 + Math.cos(k / 7), threshold: 10, alarm: false,
        isolated: false });
    }
    showError({ estimator: "ekf", t_us, angle: 1 + Math.sin(k / 5), roll: 0, pitch: 0, yaw: 0 });
  }
}"""


def publish(bus: Bus, over: threading.Event) -> None:
    """A sample of HIL_SENSOR fifty times a second, as a proxy sends them."""
    number = ROWS
    while not over.wait(1.0 / RATE_HZ):
        number += 1
        row = (number * 20_000, *(0.02 * (number * n % 11) for n in range(1, len(FIELDS) + 1)))
        sample = Watched(
            message="HIL_SENSOR", system=1, component=51, instance=0, fields=FIELDS,
            received=[row], sent=[(row[0], *(value + 0.1 for value in row[1:]))],
        )  # fmt: skip
        bus.put("proxy/watched", msgspec.json.encode([sample]))


def main() -> None:
    """Measure and print."""
    over = threading.Event()
    with open_bus("tcp/127.0.0.1:0", run="bench", router=True) as bus:
        bus.declare_alive("proxy")
        thread = threading.Thread(target=publish, args=(bus, over))
        thread.start()
        try:
            with serve_page(bus.url, port=0) as address, watched_page(address) as watcher:
                watcher.page.wait_for_function(
                    "() => store.tables.get('HIL_SENSOR')?.received.length"
                )
                watcher.page.evaluate(FILL, [FIELDS, ROWS])
                print("| on show |", " | ".join(FRAME_COLUMNS), "|")
                print("|---" * (1 + len(FRAME_COLUMNS)) + "|")
                for span_s in (60, 600):
                    watcher.page.select_option("#span", str(span_s))
                    time.sleep(3.0)
                    cells = watcher.frames(SECONDS).cells()
                    print(f"| {span_s} s |", " | ".join(cells), "|", flush=True)
        finally:
            over.set()
            thread.join()


if __name__ == "__main__":
    main()
