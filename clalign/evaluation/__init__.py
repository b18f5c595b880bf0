"""Measuring maps: truth files, errors, data-set layouts, benchmark runs and their tables."""
