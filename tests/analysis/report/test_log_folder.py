"""A folder of logs: one report per log and an index page; only new logs are read."""

import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mavproxy_fault.cli import main

Flight = Callable[..., Path]


@pytest.fixture
def folder(flight: Flight, tmp_path: Path) -> Path:
    found = tmp_path / "logs"
    (found / "day2").mkdir(parents=True)
    flight("good").rename(found / "good.tlog")
    jumpy = flight("jumpy", jump_at_s=10.0)
    (found / "day2" / "jumpy.tlog.gz").write_bytes(gzip.compress(jumpy.read_bytes()))
    (found / "notes.txt").write_text("no log")
    return found


def test_a_folder_gets_an_index_and_the_second_time_only_what_is_new(
    folder: Path, flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["report", str(folder), "--out", str(out)]) == 1
    assert "2 flights (2 new)" in capsys.readouterr().out
    rows = {
        name: entry["row"] for name, entry in json.loads((out / "index.json").read_text()).items()
    }
    assert {name: row["verdict"] for name, row in rows.items()} == {
        "good.tlog": "PASS",
        "day2/jumpy.tlog.gz": "FAIL",
    }
    assert (out / rows["day2/jumpy.tlog.gz"]["report"]).is_file()
    written = (out / rows["good.tlog"]["report"]).stat().st_mtime_ns
    flight("later").rename(folder / "later.tlog")
    (folder / "broken.ulg").write_bytes(b"not a log")
    assert main(["report", str(folder), "--out", str(out)]) == 2
    assert "4 flights (2 new)" in capsys.readouterr().out
    assert (out / rows["good.tlog"]["report"]).stat().st_mtime_ns == written


def test_a_folder_without_logs_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "no logs in the folder; it may hold .tlog" in capsys.readouterr().err


@pytest.mark.browser
def test_the_index_sorts_and_filters(folder: Path, tmp_path: Path, browser: Any) -> None:
    out = tmp_path / "out"
    main(["report", str(folder), "--out", str(out)])
    page = browser.new_page()
    errors: list[str] = []
    page.on("console", lambda message: errors.append(message.text))
    page.goto((out / "index.html").as_uri())
    names = (
        "[...document.querySelectorAll('#flights tbody tr:not([hidden])')]"
        ".map((row) => row.cells[1].textContent)"
    )
    assert page.evaluate(names) == ["day2/jumpy.tlog.gz", "good.tlog"]
    page.click("text=verdict")
    page.click("text=verdict")
    assert page.evaluate(names) == ["good.tlog", "day2/jumpy.tlog.gz"]
    page.fill("#filter", "jump fail")
    assert page.evaluate(names) == ["day2/jumpy.tlog.gz"]
    assert page.inner_text("#shown") == "1 of 2"
    page.click("text=day2/jumpy.tlog.gz")
    page.wait_for_selector("html[data-ready=yes]", state="attached")
    assert errors == []
    page.close()
