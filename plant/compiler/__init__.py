"""A casadi Function as machine code or C; knows nothing of arms.

`instructions` (what a function does, rewritten shorter) -> `translate` (to lines) -> `splitting` (into pieces) ->
`llvm` (what each operation emits) -> `intrinsics` (the text of a kernel) -> `kernel_cache` (compiled, and kept on disk)
-> `map_kernel` (a function over columns); `c_statements` (the same lines as C).
"""

__all__: list[str] = []
