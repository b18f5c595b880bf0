"""The page of a collection: every shape in one colouring, and a matrix of all pairs that links to their pages."""

from clalign.presentation.collection_page.page import write_collection_page, write_pair_page

__all__ = ["write_collection_page", "write_pair_page"]
