"""Triangle meshes: reading, checking, repairing, writing, and their numbering in files."""
