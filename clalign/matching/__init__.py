"""One match from two meshes to a result: stages over a frozen state."""
