"""Benchmarks: data sets, methods that run over their pairs, measurements of accuracy and speed, and their tables."""
