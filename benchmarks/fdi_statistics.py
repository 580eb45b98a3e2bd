"""The detector's statistics on clean simulated flights: chi-square per degree of freedom, p-values.

Run by hand: `python benchmarks/fdi_statistics.py [SEEDS]`. The demo's fixed wing and the examples'
quad fly 20 s with raw ranges as in `spoofed_flights.py`, SEEDS flights each, watched by the demo's
monitor with its noise model. Without a fault each statistic should have a mean of 1 per degree of
freedom. The prediction's share is what a test has beyond the parity test of the same measurements:
of ranges position, clock and the systems' offset, of rates velocity and drift. Errors of orbits and
multipath are the same from epoch to epoch, so one p-value of a flight, its last, is compared with
the uniform distribution (Kolmogorov and Smirnov). The bounds of a mean are three standard
deviations of what differs between the flights.
"""

import sys

import numpy as np

SEEDS = int(sys.argv[1]) if sys.argv[1:] else 40
sys.argv[1:] = ["ranges"]

import spoofed_flights  # noqa: E402
from scipy.stats import kstest  # noqa: E402

from analysis.detection.isolation.epoch_statistics import EpochStatistics  # noqa: E402
from analysis.detection.stages import assess  # noqa: E402
from analysis.monitor.monitor import Monitor  # noqa: E402
from analysis.results import Decision  # noqa: E402
from analysis.run.proxied_flight import ProxiedFlight  # noqa: E402
from analysis.run.run_setup import read_setup  # noqa: E402
from mavproxy_fault.schedule.entries import Schedule  # noqa: E402

SETTLED_S = 12.0
spoofed_flights.FLOWN_S = 20.0
NAMES = ("main test", "parity", "prediction", "rates", "their parity", "their prediction")


def rates_parity(statistics: EpochStatistics) -> float:
    """The statistic of the rates' residuals about their own velocity and drift."""
    rates = statistics.rates
    fitted = np.linalg.solve(rates.information, rates.b)
    return float(rates.total - rates.b @ fitted)


def statistics_of(vehicle: str, seed: int) -> tuple[list[tuple[float, ...]], list[Decision]]:
    """Of a clean flight: statistics and degrees of freedom at each epoch, and the decisions."""
    flight = ProxiedFlight(spoofed_flights.scenario_of(vehicle, seed), Schedule())
    monitor, rows, batch = Monitor(read_setup(None).monitor), [], bytearray()
    plain, found = assess.compute_statistics, []

    def kept(*given):
        rows.append(plain(*given))
        return rows[-1]

    assess.compute_statistics = kept
    while not flight.finished:
        batch += flight.advance([]).monitor
        if len(batch) >= spoofed_flights.BATCH_BYTES:
            found += monitor.push_bytes([bytes(batch)], datagrams=False)
            batch.clear()
    found += monitor.push_bytes([bytes(batch) + flight.finish().monitor], datagrams=False)
    assess.compute_statistics = plain
    decisions = [d for d in found if isinstance(d, Decision) and d.mode == "inertial"]
    decisions = [d for d in decisions if d.t_us * 1e-6 >= SETTLED_S]
    by_parity = {s.parity: s for s in rows}
    table = []
    for decision in decisions:
        s = by_parity[decision.parity_statistic]
        dof, rate_dof = s.ranges.v.size, s.rates.v.size
        own, parity = rates_parity(s), s.parity
        table.append((s.q, parity, s.q - parity, s.q_rate, own, s.q_rate - own))
        table[-1] += (dof, s.parity_dof, dof - s.parity_dof, rate_dof, rate_dof - 4, 4)
    return table, decisions


def main() -> None:
    """Print a row for each vehicle."""
    print(f"| vehicle | epochs | {' | '.join(NAMES)} | p uniform | alarms an hour (budget) |")
    print("|---" * (len(NAMES) + 4) + "|")
    for vehicle in ("fixed wing", "quad"):
        means, apart, alarms, epochs = [], [], 0, 0
        for seed in range(1, SEEDS + 1):
            table, decisions = statistics_of(vehicle, seed)
            sums = np.array(table).sum(axis=0)
            means.append(sums[: len(NAMES)] / sums[len(NAMES) :])
            apart.append(decisions[-1].p_value)
            alarms += sum(d.alarm for d in decisions)
            epochs += len(decisions)
        spread = 3.0 * np.std(means, axis=0) / np.sqrt(SEEDS)
        numbers = [
            f"{m:.2f} +- {s:.2f}" for m, s in zip(np.mean(means, axis=0), spread, strict=True)
        ]
        uniform = kstest(apart, "uniform").pvalue
        config = read_setup(None).monitor.detector
        budget = (config.p_false_alarm + config.p_slow + config.p_other) * 18_000
        numbers += [f"{len(apart)}, {uniform:.3f}"]
        print(
            f"| {vehicle} | {epochs} | {' | '.join(numbers)} | {18_000 * alarms / epochs:.1f}"
            f" ({budget:.1f}) |"
        )


if __name__ == "__main__":
    main()
