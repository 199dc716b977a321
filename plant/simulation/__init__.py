"""The closed loop as one symbolic step, the kernels made of it, `simulate` and `replay`.

Reading order: `layout` (state and numbers), `sub_step`, `closed_loop` (the step) -> `loop_source`,
`loop_kernel` (compiled), `logged_run` (by casadi, the reference) -> `clock`, `followed_path`,
`time_tables` (its inputs in time) -> `simulator` (with `cautions`), `population` (many loops at
once, on `executors`), `stepped_arm` (for scripts), `law_run` (a law along a log), `jacobians`.
"""
