"""Reading mesh files with their vertex numbers kept: a module for each family of formats, their table in `files`."""

from clalign.mesh.reading.common import FileMesh
from clalign.mesh.reading.files import SUFFIXES, expanded, is_mesh_name, mesh_stem, read_mesh_file

__all__ = ["SUFFIXES", "FileMesh", "expanded", "is_mesh_name", "mesh_stem", "read_mesh_file"]
