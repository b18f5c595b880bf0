"""The search for the isometry that the alignment starts from."""
