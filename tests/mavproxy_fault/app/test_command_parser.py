"""Help shows defaults, errors suggest corrections, and shells complete commands."""

import argparse
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from mavproxy_fault.app.command_result import open_console, plain_table, print_result
from mavproxy_fault.cli import SHELLS, build_parser, main


def parsers(one: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield one
    for action in one._actions:
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                yield from parsers(sub)


def test_the_help_of_every_option_with_a_value_shows_its_default() -> None:
    every = list(parsers(build_parser()))
    assert len(every) > 20
    for one in every:
        formatter = one._get_formatter()
        for action in one._actions:
            if action.option_strings and action.nargs != 0 and not action.required:
                formatter.add_argument(action)
                text = " ".join(one._get_formatter()._format_action(action).split())
                assert "(default: " in text, (one.prog, text)


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("injct",), "did you mean inject?"),
        (("halp",), "did you mean help?"),
        (("fly",), "fly: is not a command; known: ardupilot, campaign, "),
        (("--verson",), "option --verson does not exist; did you mean --version"),
        (("schedule", "--rum=x", "state"), "option --rum does not exist"),
        (("proxy", "--mastr=x"), "option --mastr does not exist; did you mean --master?"),
        (("run", "--sped", "3"), "option --sped does not exist; did you mean --speed"),
        (("schedule", "laod"), "laod does not exist; did you mean load?"),
        (("faults", "chek", "x.yaml"), "chek does not exist; did you mean check"),
        (("inject", "bias", "--through", "mavsdkk"), "did you mean mavsdk?"),
        (("replay", "a", "--schedule", "b", "--sched=c"), "option --schedule is given twice"),
        (("schedule", "state", "--run", "a", "--run", "b"), "option --run is given twice"),
    ],
)
def test_a_misspelt_argument_gets_a_suggestion(
    words: tuple[str, ...], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    # argparse exits, ours returns.
    try:
        code: object = main(words)
    except SystemExit as left:
        code = left.code
    assert code == 2
    assert meant in capsys.readouterr().err


def test_the_proxy_accepts_mavproxys_option_without_showing_it() -> None:
    words = ["proxy", "--master", "udpin:127.0.0.1:1", "--to", "a", "--out", "b"]
    assert build_parser("proxy").parse_args(words).to == ["a", "b"]
    assert "--out EP" not in build_parser("proxy").format_help()


@pytest.fixture(scope="module")
def bash_completion() -> str:
    return subprocess.run(
        [sys.executable, "-m", "mavproxy_fault.cli", "--completion", "bash"],
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
@pytest.mark.parametrize(
    ("typed", "offered"),
    [("inj", ["inject"]), ("schedule lo", ["load"]), ("proxy --mas", ["--master"]),
     ("faults check a", ["a_schedule.yaml", "a_folder"]), ("report a", ["a.tlog", "a_folder"]),
     ("faults show gyro-b", ["gyro-bias"]), ("inject gyro-b", ["gyro-bias"]),
     ("inject x --target HIL_SENS", ["HIL_SENSOR"]), ("search x --method so", ["sobol"]),
     ("run --estimators com", ["complementary"]),
     ("search x --violate knows_its_p", ["knows_its_place"])],
)  # fmt: skip
def test_bash_completes_a_partial_argument(
    tmp_path: Path, bash_completion: str, typed: str, offered: list[str]
) -> None:
    for name in ("a_schedule.yaml", "a.tlog", "a.txt"):
        (tmp_path / name).touch()
    (tmp_path / "a_folder").mkdir()
    words = ["mavproxy-fault", *typed.split()]
    script = (
        f"{bash_completion}\nCOMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}; "
        f"_shtab_mavproxy_fault mavproxy-fault {words[-1]} {words[-2]}; "
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.split() == offered


@pytest.mark.parametrize("words", [(), ("faults",), ("schedule",)])
def test_a_command_without_its_subcommand_shows_the_help(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main(words)
    assert left.value.code == 2
    bare = capsys.readouterr().out
    with pytest.raises(SystemExit) as left:
        main(("help", *words))
    assert not left.value.code
    assert capsys.readouterr().out == bare


def test_every_command_with_a_result_prints_it_as_json() -> None:
    # They run until they are ended, serve, or print nothing but their progress or JSON.
    others = {"sim", "ui", "ardupilot", "warm-up", "schema"}
    every = [one for one in parsers(build_parser()) if one._subparsers is None]
    without = {one.prog.split()[-1] for one in every if "--json" not in one._option_string_actions}
    assert without == others


def test_a_result_as_json_is_one_line_with_its_paths(capsys: pytest.CaptureFixture[str]) -> None:
    result = {"folder": Path("out"), "error_m": float("nan"), "flights": [{"n": 1}]}
    print_result(argparse.Namespace(json=True), result, "text")
    line = capsys.readouterr().out
    assert line == '{"folder":"out","error_m":null,"flights":[{"n":1}]}\n'
    print_result(argparse.Namespace(json=False), result, "text")
    assert capsys.readouterr().out == "text\n"


def test_a_table_off_a_terminal_is_not_cut(capsys: pytest.CaptureFixture[str]) -> None:
    table = plain_table("name", "number", right=("number",))
    table.add_row("x" * 300, "1")
    console = open_console()
    console.print(table)
    console.print("y" * 300)
    title, row, line = capsys.readouterr().out.splitlines()
    assert title.split() == ["name", "number"]
    assert row == "x" * 300 + "       1"
    assert line == "y" * 300


def test_every_shell_gets_its_script(capsys: pytest.CaptureFixture[str]) -> None:
    for shell in SHELLS:
        with pytest.raises(SystemExit) as left:
            main(("--completion", shell))
        assert not left.value.code
        assert "mavproxy-fault" in capsys.readouterr().out
