"""Selection of the proxy if a command names none."""

import pytest

from mavproxy_fault.app.running_proxy import only_run
from mavproxy_fault.documents.errors import ConfigError

ALIVE = "mavfault/v1/{}/alive/proxy"


def test_the_only_proxy_is_used_by_default() -> None:
    assert only_run([ALIVE.format("night")]) == "night"


@pytest.mark.parametrize(
    ("runs", "error"),
    [((), "no proxy runs; start one"),
     (("a", "b"), "2 proxies are running: a, b; choose one by --run")],
)  # fmt: skip
def test_no_proxy_or_several_proxies_are_an_error(runs: tuple[str, ...], error: str) -> None:
    with pytest.raises(ConfigError, match=f"^{error}$"):
        only_run([ALIVE.format(run) for run in runs])
