"""A casadi Function as machine code or C; knows nothing of arms.

The pipeline: `translate` (a function's instructions, sorted by when they run; long code in pieces)
with `instructions` (rewritten shorter) -> `intrinsics` (the text of a kernel, or of a function over
columns) with `llvm` (the instructions of each operation) -> `kernel_cache` (compiled, in the
`background`, and stored in the `cache_folder`). `c_statements` writes the same instructions as C.
"""

from plant.compiler.background import cores, in_background, shared_out
from plant.compiler.c_statements import (
    braced,
    comment,
    constant,
    helpers,
    literal,
    paragraph,
    statements,
)
from plant.compiler.cache_folder import CACHE_VARIABLE, cache_folder, prune
from plant.compiler.instructions import LANE, STATE, TIME, UNIFORM
from plant.compiler.intrinsics import (
    MODULES,
    MapKernel,
    call_by_number,
    head,
    in_kernel,
    inlined,
    intrinsic,
    joined,
    switch,
)
from plant.compiler.kernel_cache import AVX512_VARIABLE, Kernel
from plant.compiler.llvm import COSINE, OPERATIONS, SINE, STEPS
from plant.compiler.python_to_c import CFunction, CNames
from plant.compiler.translate import Line, Names, cut, translate

__all__ = [
    "AVX512_VARIABLE",
    "CACHE_VARIABLE",
    "COSINE",
    "LANE",
    "MODULES",
    "OPERATIONS",
    "SINE",
    "STATE",
    "STEPS",
    "TIME",
    "UNIFORM",
    "CFunction",
    "CNames",
    "Kernel",
    "Line",
    "MapKernel",
    "Names",
    "braced",
    "cache_folder",
    "call_by_number",
    "comment",
    "constant",
    "cores",
    "cut",
    "head",
    "helpers",
    "in_background",
    "in_kernel",
    "inlined",
    "intrinsic",
    "joined",
    "literal",
    "paragraph",
    "prune",
    "shared_out",
    "statements",
    "switch",
    "translate",
]
