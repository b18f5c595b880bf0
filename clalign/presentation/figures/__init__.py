"""The paper's figures, each drawn from a match and its truth, with the numbers beside it."""
