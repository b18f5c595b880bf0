"""Memory and time of a match, predicted before it starts."""
