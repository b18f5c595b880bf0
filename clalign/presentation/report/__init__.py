"""The page of a match: one HTML file that shows it in 3D and opens without a network."""

from clalign.presentation.report.page import write_report

__all__ = ["write_report"]
