"""Ways to find the unknowns: the genetic algorithm of 3.7 and the methods behind one interface.

Read `problem` (what a method is given), `outcome` (what it gives back, and a result keeps),
`methods`, `polish`; `genetic` stands alone.
"""
