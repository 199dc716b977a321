"""Robots to start from: `puma560` (the paper's two links, complete) and `catalogue` (chains and rigs of others)."""

__all__: list[str] = []
