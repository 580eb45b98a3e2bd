from types import SimpleNamespace

from simvehicle.app.battery_warnings import BatteryWarnings


def test_a_low_and_an_empty_battery_are_reported_once() -> None:
    reported: list[str] = []
    warnings = BatteryWarnings(reported.append)
    for second, left in enumerate((1.0, 0.5, 0.19, 0.1, 0.0, 0.0)):
        warnings.update(SimpleNamespace(t_us=second * 1_000_000, battery_remaining=left))
    assert [line.split(" s ")[0].strip() for line in reported] == ["2.0", "4.0"]
    assert "20 %" in reported[0]
    assert "empty" in reported[1]
