"""From two prepared shapes to R and the maps: search, objective, optimiser, read-out."""
