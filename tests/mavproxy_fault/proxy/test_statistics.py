import random

from mavproxy_fault.proxy.statistics import LatencyHistogram, format_endpoints


def test_percentiles_are_accurate_to_a_tenth() -> None:
    rng = random.Random(1)
    latencies = LatencyHistogram()
    values = sorted(rng.lognormvariate(10, 1) for _ in range(10_000))
    for value in values:
        latencies.add(round(value))
    for percent in (50, 99, 99.9):
        right_us = values[round(len(values) * percent / 100) - 1] * 1e-3
        found_us = latencies.percentile_us(percent)
        assert found_us is not None
        assert right_us <= found_us * 1.001
        assert found_us <= right_us * 1.14 + 0.1


def test_without_frames_there_is_no_percentile() -> None:
    assert LatencyHistogram().summary() == {"p50_us": None, "p99_us": None, "p99.9_us": None}


def test_the_table_has_a_line_per_endpoint() -> None:
    lines = format_endpoints([{"name": "udpin:1", "frames_in": 12, "p50_us": None}]).splitlines()
    assert len(lines) == 2
    assert lines[1].split()[:3] == ["udpin:1", "-", "12"]
