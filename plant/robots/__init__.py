"""Robots to start from: the paper's two links (`puma560`), and others (`catalogue`)."""
