"""Draw docs/architecture.svg from the sources: the rooms of the packages and who imports whom.

    python docs/draw_architecture.py

A room is a folder of a package; its sentence is the first of the folder's docstring. The order of
the rooms is that of the layers in pyproject.toml, which import-linter holds: within a package, a
room imports only rooms below it. Lines are imports across packages; how many there are does not
show, so that the drawing changes with the rooms alone.
"""

import ast
import re
import tomllib
from html import escape
from pathlib import Path
from textwrap import wrap

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs" / "architecture.svg"
PACKAGES = ("simvehicle", "mavproxy_fault", "analysis")
COLOURS = {"simvehicle": "#2a7f4f", "mavproxy_fault": "#b3541e", "analysis": "#2b5fa8"}
WIDTH, GAP, MARGIN = 330, 130, 30  # of a column, between columns, around all, px
HEIGHT, STEP, TOP = 50, 62, 96  # of a room, from room to room, above the first, px
WORDS = 50  # characters of a line in a room

Room = tuple[str, str]  # package, room


def layers() -> dict[str, list[list[str]]]:
    """The rooms of each package, from the top layer down."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    return {
        contract["containers"][0]: [re.split(" [:|] ", layer) for layer in contract["layers"]]
        for contract in contracts
        if contract["type"] == "layers" and contract["containers"][0] in PACKAGES
    }


def room_of(module: str) -> Room | None:
    """The room of a module of ours; None for a package itself."""
    parts = module.split(".")
    return (parts[0], parts[1]) if parts[0] in PACKAGES and len(parts) > 1 else None


def imports() -> set[tuple[Room, Room]]:
    """From which room imports lead to which."""
    found: set[tuple[Room, Room]] = set()
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            inside = path.relative_to(ROOT).with_suffix("").parts
            here = room_of(".".join(inside).removesuffix(".__init__"))
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module and here:
                    there = room_of(node.module)
                    if there and there != here:
                        found.add((here, there))
    return found


def sentence(room: Room) -> str:
    """The first sentence of what a room says of itself."""
    folder = ROOT / room[0] / room[1]
    path = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return text.split("\n\n")[0].replace("\n", " ")


def places(order: dict[str, list[list[str]]]) -> dict[Room, tuple[float, float, float]]:
    """Left edge, top and width of every room; rooms of one layer share its line."""
    found = {}
    for column, package in enumerate(PACKAGES):
        left = MARGIN + column * (WIDTH + GAP)
        for line, rooms in enumerate(order[package]):
            width = (WIDTH - 10 * (len(rooms) - 1)) / len(rooms)
            for at, room in enumerate(rooms):
                found[package, room] = (left + at * (width + 10), TOP + line * STEP, width)
    return found


def drawn_room(room: Room, place: tuple[float, float, float]) -> list[str]:
    """A box with the room's name and its sentence."""
    left, top, width = place
    lines = wrap(sentence(room), int(WORDS * width / WIDTH))
    shown = lines if len(lines) <= 2 else [lines[0], lines[1].rstrip(" ,.;:") + " …"]
    text = "".join(
        f'<text x="{left + 8:.0f}" y="{top + 29 + 13 * n:.0f}" class="says">{escape(line)}</text>'
        for n, line in enumerate(shown)
    )
    return [
        f'<rect x="{left:.0f}" y="{top:.0f}" width="{width:.0f}" height="{HEIGHT}" rx="5" '
        f'fill="#fff" stroke="{COLOURS[room[0]]}"/>',
        f'<text x="{left + 8:.0f}" y="{top + 16:.0f}" class="room">{room[1]}</text>{text}',
    ]


def drawn_line(
    start: tuple[float, float, float], end: tuple[float, float, float], colour: str
) -> str:
    """A curve from the near side of one room to the near side of another."""
    rightwards = end[0] > start[0]
    x0 = start[0] + (start[2] if rightwards else 0)
    x1 = end[0] + (0 if rightwards else end[2])
    y0, y1 = start[1] + HEIGHT / 2, end[1] + HEIGHT / 2
    bend = GAP * 0.6 if rightwards else -GAP * 0.6
    return (
        f'<path d="M{x0:.0f} {y0:.0f}C{x0 + bend:.0f} {y0:.0f} {x1 - bend:.0f} {y1:.0f} '
        f'{x1:.0f} {y1:.0f}" stroke="{colour}" stroke-width="1.5"/>'
    )


def picture() -> str:
    """The whole drawing as SVG."""
    order = layers()
    where = places(order)
    width = 2 * MARGIN + len(PACKAGES) * WIDTH + (len(PACKAGES) - 1) * GAP
    height = TOP + STEP * max(len(rooms) for rooms in order.values()) + MARGIN
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" font-family="sans-serif">',
        "<style>.title{font-size:19px;font-weight:bold}.room{font-size:13px;font-weight:bold}"
        ".says{font-size:11px;fill:#444}.how{font-size:12px;fill:#444}</style>",
        f'<rect width="{width}" height="{height}" fill="#fbfbf9"/>',
        f'<text x="{MARGIN}" y="30" class="how">Rooms import rooms below them in their own '
        "package. Lines: imports of other packages, in the colour of the importer.</text>",
    ]
    for column, package in enumerate(PACKAGES):
        x = MARGIN + column * (WIDTH + GAP)
        colour = COLOURS[package]
        parts.append(f'<text x="{x}" y="76" class="title" fill="{colour}">{package}</text>')
    parts.append('<g fill="none" stroke-opacity="0.35">')
    for here, there in sorted(imports()):
        if here[0] != there[0] and here in where and there in where:
            parts.append(drawn_line(where[here], where[there], COLOURS[here[0]]))
    parts.append("</g>")
    for room, place in where.items():
        parts += drawn_room(room, place)
    return "\n".join([*parts, "</svg>", ""])


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
