"""Whole sets of shapes: pairs matched in parallel, and the set's own redundancy used to make the maps better."""
