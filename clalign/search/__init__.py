"""The search for the isometry that the alignment starts from."""

from clalign.search.find import SearchResult, find_isometry

__all__ = ["SearchResult", "find_isometry"]
