"""Ways to find the unknowns: the genetic algorithm of 3.7 and the methods behind one interface."""

__all__: list[str] = []
