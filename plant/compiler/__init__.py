"""A casadi Function as machine code or C; knows nothing of arms.

The pipeline: `translate` (a function's instructions, sorted by when they run; long code in pieces)
with `instructions` (rewritten shorter) -> `intrinsics` (the text of a kernel, or of a function over
columns) with `llvm` (the instructions of each operation) -> `kernel_cache` (compiled, in the
`background`, and stored in the `cache_folder`). `c_statements` writes the same instructions as C.
"""
