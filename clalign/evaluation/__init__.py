"""Measuring maps: truth, errors, distances on the target, coverage and smoothness, and alignment of eigenfunctions."""
