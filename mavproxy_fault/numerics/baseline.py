"""The oldest processors of each architecture that machine code in a wheel is made for.

x86-64-v3 [1]_ is Intel's Haswell (2013), AMD's Excavator (2015) and what came after, but the
smallest. Older ones lack fused multiply-add, which then is a call and slow (docs/compiled.md).
Those, and architectures that are not named here, get code of their own at first use.

References
----------
.. [1] System V application binary interface, AMD64 supplement, section 3.1.1.
"""

import platform
from functools import cache

_NEEDS = {
    "x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"),
    "generic": (),  # any 64-bit ARM
}
_OF_MACHINE = {"x86_64": "x86-64-v3", "AMD64": "x86-64-v3", "aarch64": "generic"}

BASELINE = _OF_MACHINE.get(platform.machine(), "")  # as LLVM calls it


@cache
def runs_baseline() -> bool:
    """Whether this processor runs code for its architecture's baseline."""
    # Here: a proxy that only needs a folder would pay for it at each start.
    import llvmlite.binding as llvm  # type: ignore[import-untyped]

    features = llvm.get_host_cpu_features()
    return BASELINE in _NEEDS and all(features.get(name) for name in _NEEDS[BASELINE])
