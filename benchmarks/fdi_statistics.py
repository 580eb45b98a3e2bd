"""The detector's statistics on clean simulated flights: chi-square per degree of freedom, p-values.

Run by hand: `python benchmarks/fdi_statistics.py [SEEDS]`. The demo's fixed wing and the examples'
quad fly 50 s with raw ranges as in `spoofed_flights.py`, SEEDS flights each, watched by the demo's
monitor with its noise model. Without a fault each statistic should have a mean of 1 per degree of
freedom. The prediction's share is what the main test has beyond the parity test: position, clock
and the systems' offset. The p-values of the main test are taken every 10 s and compared with the
uniform distribution (Kolmogorov and Smirnov).
"""

import sys

import numpy as np

SEEDS = int(sys.argv[1]) if sys.argv[1:] else 6
sys.argv[1:] = ["ranges"]

from scipy.stats import kstest  # noqa: E402
from spoofed_flights import BATCH_BYTES, scenario_of  # noqa: E402

from analysis.monitor.monitor import Monitor  # noqa: E402
from analysis.results import Decision, Result, SensorDecision  # noqa: E402
from analysis.run.proxied_flight import ProxiedFlight  # noqa: E402
from analysis.run.run_setup import read_setup  # noqa: E402
from mavproxy_fault.schedule.entries import Schedule  # noqa: E402

SETTLED_S, APART_S = 12.0, 10.0


def results_of(vehicle: str, seed: int) -> list[Result]:
    """The results of a clean flight."""
    flight, monitor = (
        ProxiedFlight(scenario_of(vehicle, seed), Schedule()),
        Monitor(read_setup(None).monitor),
    )
    found, batch = [], bytearray()
    while not flight.finished:
        batch += flight.advance([]).monitor
        if len(batch) >= BATCH_BYTES:
            found += monitor.push_bytes([bytes(batch)], datagrams=False)
            batch.clear()
    return found + monitor.push_bytes([bytes(batch) + flight.finish().monitor], datagrams=False)


def main() -> None:
    """Print a row for each vehicle."""
    print("| vehicle | epochs | main test | parity | prediction | rates | alarms | p uniform, p |")
    print("|---" * 8 + "|")
    for vehicle in ("fixed wing", "quad"):
        rows, rates, apart, alarms = [], [], [], 0
        for seed in range(1, SEEDS + 1):
            due_s = SETTLED_S
            for result in results_of(vehicle, seed):
                if isinstance(result, SensorDecision) and result.sensor == "imu" and result.dof:
                    rates.append((result.statistic, result.dof))
                elif isinstance(result, Decision) and result.mode == "inertial":
                    alarms += result.alarm
                    statistics = result.statistic, result.dof
                    rows.append((*statistics, result.parity_statistic, result.parity_dof))
                    if result.t_us * 1e-6 >= due_s:
                        apart.append(result.p_value)
                        due_s += APART_S
        q, dof, parity, parity_dof = np.array(rows, dtype=float).T.sum(axis=1)
        rate, rate_dof = np.array(rates, dtype=float).T.sum(axis=1)
        shares = q / dof, parity / parity_dof, (q - parity) / (dof - parity_dof), rate / rate_dof
        numbers = " | ".join(f"{share:.2f}" for share in shares)
        uniform = kstest(apart, "uniform").pvalue
        print(f"| {vehicle} | {len(rows)} | {numbers} | {alarms} | {len(apart)}, {uniform:.3f} |")


if __name__ == "__main__":
    main()
