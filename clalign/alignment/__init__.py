"""The paper: the objective over the banded R, its terms, the optimiser, and the read-out."""
