"""Measurements of accuracy and speed, and their tables."""
