import subprocess
import sys
from pathlib import Path

from mavproxy_fault.compiled.object_file import PACKAGE, sources


def test_every_file_that_is_compiled_in_is_among_the_sources() -> None:
    script = (
        "import sys, mavproxy_fault.compiled.sockets\n"
        "for module in list(sys.modules.values()):\n"
        "    print(getattr(module, '__file__', None))\n"
    )
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    files = {Path(line) for line in told.stdout.decode().splitlines()}
    ours = {str(file.relative_to(PACKAGE)) for file in files if file.is_relative_to(PACKAGE)}
    compiled_in = {name for name in ours if not name.endswith("__init__.py")}
    assert "proxy/sender_rules.py" in compiled_in
    assert compiled_in <= set(sources())
