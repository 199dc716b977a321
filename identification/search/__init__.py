"""Methods of identification: the genetic algorithm of 3.7, and Gauss-Newton from good starts.

Read `problem` (their input), `outcome` (their output), `methods`, `polish` (start and fit), then
`memory` (laws with a memory), `elastic` (elastic gears) and `predictive` (does the model explain
the log?). `genetic` stands alone.
"""
