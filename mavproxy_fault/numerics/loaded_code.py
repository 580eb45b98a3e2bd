"""Loads machine code from disk without parsing its bitcode.

numba stores the bitcode of each function with its machine code, for other functions to inline, and
parses it whenever the machine code is loaded, which takes four fifths of the loading time. Here it
is parsed only when other code that calls the function is compiled.
"""

from typing import Any, cast

from llvmlite.binding import parse_bitcode  # type: ignore[import-untyped]
from numba.core.caching import CompileResultCacheImpl
from numba.core.codegen import JITCodeLibrary


class LoadedLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The code of one function in this process."""

    _bitcode: bytes
    _shared_module: Any

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> "LoadedLibrary":
        name, _, (machine_code, bitcode) = state
        library = cls(codegen, name)
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._bitcode = bitcode
        library._finalize_final_module()
        return library

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            self._shared_module = parse_bitcode(self._bitcode)
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return self._shared_module

    def get_pointer_to_function(self, name: str) -> int:
        """The address of one of its functions, which numba's list of symbols lacks."""
        return cast(int, self._codegen._engine.get_function_address(name))


class LoadedCode(CompileResultCacheImpl):  # type: ignore[misc]
    """Stores and loads the machine code of a function; under numba's lock."""

    def rebuild(self, context: Any, payload: Any) -> Any:
        """The function as numba has it, but for its library."""
        codegen = context.codegen()
        usual = codegen._library_class
        codegen._library_class = LoadedLibrary
        try:
            return super().rebuild(context, payload)
        finally:
            codegen._library_class = usual
