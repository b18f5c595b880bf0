"""Meshes, and everything that is computed from one mesh: operators, spectra and geodesic distances."""
