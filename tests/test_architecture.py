"""The drawing of the rooms, and what the house rules say of files, against the sources."""

import ast
import re
import runpy
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("mavproxy_fault", "simvehicle", "analysis")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
ONE_CONCEPT = {"__init__.py", "commands.py"}  # names that may stand in every package
MANY_OF_A_KIND = {ROOT / "mavproxy_fault" / "faults"}
MOST_FILES, MOST_IN_A_ROOT, MOST_LINES, MOST_PARAMETERS = 16, 5, 60, 8


def test_the_drawing_shows_the_rooms_as_they_are() -> None:
    drawing = runpy.run_path(str(ROOT / "docs" / "draw_architecture.py"))
    shown = (ROOT / "docs" / "architecture.svg").read_text(encoding="utf-8")
    assert drawing["picture"]() == shown, "run python docs/draw_architecture.py"


def test_every_room_is_in_a_layer_and_says_what_it_is() -> None:
    drawing = runpy.run_path(str(ROOT / "docs" / "draw_architecture.py"))
    placed = {
        (package, room)
        for package, rooms in drawing["layers"]().items()
        for layer in rooms
        for room in layer
    }
    folders = {
        (package, path.parent.name)
        for package in PACKAGES
        for path in (ROOT / package).glob("*/__init__.py")
    }
    assert folders <= placed
    assert all(len(drawing["sentence"](room)) > 20 for room in placed)


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    # Within one round every module goes whose imports have gone; a circle stays.
    left = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    while free := {name for name, imported in left.items() if not imported & left.keys()}:
        left = {name: imported for name, imported in left.items() if name not in free}
    assert sorted(left) == []


def test_no_folder_is_full() -> None:
    files = Counter(path.parent for path in SOURCES if path.name != "__init__.py")
    for folder, count in files.items():
        most = MOST_IN_A_ROOT if folder.parent == ROOT else MOST_FILES
        assert count <= most or folder in MANY_OF_A_KIND, f"{folder} holds {count} files"


def test_file_names_are_unique() -> None:
    names = Counter(path.name for path in SOURCES if path.name not in ONE_CONCEPT)
    assert [name for name, count in names.items() if count > 1] == []


CALLS_OF_COMMANDS = {ROOT / "mavproxy_fault" / "api" / "command_calls.py"}


def functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


@pytest.mark.parametrize("package", PACKAGES)
def test_functions_are_small(package: str) -> None:
    large = []
    for path in SOURCES:
        if path.is_relative_to(ROOT / package):
            for node in functions(path):
                names = [one.arg for one in (*node.args.args, *node.args.kwonlyargs)]
                count = len([name for name in names if name not in ("self", "cls")])
                if path in CALLS_OF_COMMANDS:  # keywords as the command has options
                    count = len(node.args.args)
                lines = (node.end_lineno or 0) - node.lineno + 1
                if count > MOST_PARAMETERS or lines > MOST_LINES:
                    where = f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
                    large.append(f"{where}: {lines} lines, {count} parameters")
    assert large == []


NUMBERS = (
    ast.Constant, ast.BinOp, ast.UnaryOp, ast.Tuple, ast.Name, ast.operator, ast.unaryop, ast.Load,
)  # fmt: skip


def is_number(value: ast.expr | None) -> bool:
    """Whether a number, an arithmetic expression or a tuple of them, also with a logarithm."""
    if isinstance(value, ast.Call) and ast.unparse(value.func) == "np.log":
        value = value.args[0]
    nodes = [] if value is None else list(ast.walk(value))
    literals = [node.value for node in nodes if isinstance(node, ast.Constant)]
    numeric = all(type(one) in (int, float) for one in literals)
    return bool(literals) and numeric and all(isinstance(node, NUMBERS) for node in nodes)


@pytest.mark.parametrize("room", ["detection", "monitor", "scoring"])
def test_every_number_of_a_detector_states_its_source(room: str) -> None:
    silent = []
    for path in (ROOT / "analysis" / room).rglob("*.py"):
        lines = path.read_text(encoding="utf-8").splitlines()
        for node in ast.parse("\n".join(lines)).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and is_number(node.value):
                target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                around = lines[max(node.lineno - 2, 0) : node.end_lineno]
                # A comment above, or one in the assignment itself.
                says = around[0].startswith("#") or any("#" in line for line in around[1:])
                if ast.unparse(target).strip("(").split(",")[0].isupper() and not says:
                    silent.append(f"{path.relative_to(ROOT)}:{node.lineno} {ast.unparse(target)}")
                if any(re.search(r"\bchosen\b(?! on benchmarks/)", line) for line in around):
                    silent.append(f"{path.relative_to(ROOT)}:{node.lineno} is only chosen")
    assert silent == []
