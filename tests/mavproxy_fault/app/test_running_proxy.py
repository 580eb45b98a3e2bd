"""Which proxy a command speaks to where none is named."""

import pytest

from mavproxy_fault.app.running_proxy import only_run
from mavproxy_fault.documents.errors import ConfigError

ALIVE = "mavfault/v1/{}/alive/proxy"


def test_the_only_proxy_is_meant_where_none_is_named() -> None:
    assert only_run([ALIVE.format("night")]) == "night"


@pytest.mark.parametrize(
    ("runs", "told"),
    [((), "no proxy runs; start one"),
     (("a", "b"), "2 proxies are running: a, b; choose one by --run")],
)  # fmt: skip
def test_none_and_several_are_told_and_nobody_is_asked(runs: tuple[str, ...], told: str) -> None:
    with pytest.raises(ConfigError, match=f"^{told}$"):
        only_run([ALIVE.format(run) for run in runs])
