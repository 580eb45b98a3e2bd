"""Machine code of the compiled form: made once by numba, kept on disk, loaded without numba.

Importing numba takes a second of work in Python, during which the interpreted way would lose frames
of dense traffic. So an object file is made, while a wheel is built or else once by another process,
and the proxy links that into itself by llvmlite within milliseconds.
"""

import ctypes
import hashlib
import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm  # type: ignore[import-untyped]

from mavproxy_fault.numerics.baseline import BASELINE, runs_baseline
from mavproxy_fault.numerics.code_cache import (
    alone,
    installed,
    note_use,
    place,
    source_digest,
)

PACKAGE = Path(__file__).parents[1]
# What is compiled, the rules of all faults, and this file, which compiles them
ROOTS = PACKAGE / "compiled/sockets.py", Path(__file__), *(PACKAGE / "faults").glob("*.py")
NAME = "mavproxy_fault_forward"
COUNTING = re.compile(r"^ *call void @NRT_(?:in|de)cref.*$", re.MULTILINE)
PYTHON = ("Py", "numba_", "NRT_")  # beginnings of names that only exceptions need

Forward = Callable[..., int]


@cache
def _target() -> tuple[Any, str, str]:
    """The machine that code is made for: the baseline, this one if it is older."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    cpu, features = BASELINE, ""
    if not runs_baseline():
        cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=cpu, features=features, opt=3, reloc="pic", codemodel="jitdefault"
    )
    return machine, cpu, features


def object_path() -> Path:
    """The path of the object file for these sources and this processor; it may not exist yet."""
    _, cpu, features = _target()
    code = source_digest(*ROOTS)
    name = f"forward-{hashlib.sha256(f'{code} {cpu} {features}'.encode()).hexdigest()[:16]}.o"
    ready = installed() / name
    return ready if ready.is_file() else place() / name


def make() -> None:
    """Compile `sockets.forward` and keep the object file; takes seconds, but for those who wait."""
    path = object_path()
    with alone(path.with_suffix(".lock")):
        if not path.is_file():
            fresh = path.with_suffix(".new")
            fresh.write_bytes(_compiled())
            fresh.replace(path)


def _compiled() -> bytes:
    """The object file's bytes."""
    from numba import cfunc, config, types
    from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
    from numba.core.compiler_lock import global_compiler_lock

    from mavproxy_fault.compiled.kernel import SHARED
    from mavproxy_fault.compiled.sockets import forward

    # Each function is only translated, as it is; all are optimised together below. Otherwise numba
    # emits the machine code of each with all that it calls, which takes longer than all else here.
    instead: list[tuple[Any, str, Any]] = [
        (config, "OPT", type(config.OPT)(0)),
        (JITCodeLibrary, "_finalize_final_module", lambda one: setattr(one, "_finalized", True)),
        (JITCPUCodegen, "set_env", lambda *_: None),  # of functions that have no machine code
    ]
    with global_compiler_lock:
        before = [getattr(owner, name) for owner, name, _ in instead]
        try:
            for owner, name, value in instead:
                setattr(owner, name, value)
            compiled = cfunc(types.int64(SHARED), error_model="numpy")(forward)
        finally:
            for (owner, name, _), value in zip(instead, before, strict=True):
                setattr(owner, name, value)
    # All arrays are borrowed; calls that count references would take most of a frame's time.
    module = llvm.parse_assembly(COUNTING.sub("", compiled.inspect_llvm()))
    for function in module.functions:
        if function.name == compiled.native_name:
            function.name = NAME
    module.link_in(llvm.parse_assembly(_without_python(module)))
    machine, _, _ = _target()
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=3))
    passes.getModulePassManager().run(module, passes)
    data: bytes = machine.emit_object(module)
    return data


def _without_python(module: Any) -> str:
    """Definitions of what numba's code calls to raise exceptions: ours never does, it aborts."""
    lines = ["declare void @abort()"]
    for function in module.functions:
        if function.is_declaration and function.name.startswith(PYTHON):
            lines.append(f"define void @{function.name}() {{ call void @abort() unreachable }}")
    for variable in module.global_variables:
        if variable.is_declaration:
            lines.append(f"@{variable.name} = global ptr null")
    return "\n".join(lines)


def load() -> Forward | None:
    """The compiled `forward`, which gives up the interpreter's lock while it runs; None yet."""
    path = object_path()
    note_use(path, "forward-*.o")
    return _linked(path) if path.is_file() else None


@cache
def _linked(path: Path) -> Forward:
    """Load the function of an object file, until the process ends."""
    machine, _, _ = _target()
    empty = llvm.parse_assembly("")
    empty.triple = llvm.get_process_triple()
    engine = llvm.create_mcjit_compiler(empty, machine)
    engine.add_object_file(llvm.ObjectFileRef.from_path(str(path)))
    engine.finalize_object()
    address = engine.get_function_address(NAME)
    kind = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)
    found = kind(address)
    found.engine = engine  # type: ignore[attr-defined]  # lives as long as the function
    return found


if __name__ == "__main__":
    os.nice(10)
    make()
