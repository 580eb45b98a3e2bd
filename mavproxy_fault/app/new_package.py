"""`mavproxy-fault new`: write a package with an estimator, a detector or a fault, and its test."""

import argparse
import re
from importlib.resources import files
from pathlib import Path
from string import Template

from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.documents.errors import ConfigError, users_path

NAME = re.compile("[a-z][a-z0-9]*(-[a-z0-9]+)*")  # also a name in schedules and result files


def main(args: argparse.Namespace) -> int:
    """Write the package into a new folder.

    Raises
    ------
    ConfigError
        If the name cannot be used, or the folder exists.
    """
    kind, name = args.kind, args.name
    if not NAME.fullmatch(name):
        raise ConfigError(f"new {kind}: {name} is no name; use small letters, digits and hyphens")
    folder = Path(args.out or name)
    module = name.replace("-", "_")
    cls = "".join(word.capitalize() for word in name.split("-"))
    templates = files("mavproxy_fault.app") / "templates"
    written = {"pyproject.toml": "pyproject.toml", f"{kind}.py": f"{module}.py"}
    written[f"test_{kind}.py"] = f"test_{module}.py"
    if kind == "estimator":
        written |= {"scenario.yaml": "scenario.yaml", "campaign.yaml": "campaign.yaml"}
    with users_path(f"new {kind}: {folder}", "give --out DIR"):
        folder.mkdir(parents=True)
    for template, path in written.items():
        text = Template((templates / f"{template}.txt").read_text("utf-8"))
        made = text.substitute(kind=kind, name=name, module=module, cls=cls)
        (folder / path).write_text(made, "utf-8")
    paths = [folder / path for path in written.values()]
    steps = f"try it: pip install -e {folder} && pytest {folder}"
    print_result(args, {"files": paths}, "\n".join([*map(str, paths), steps]))
    return 0
