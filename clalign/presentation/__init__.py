"""What people see of a match: pictures, the page, notebooks, and files for other programs."""

PAGE_FILE = "report.html"
PICTURE_FILE = "match.png"
"""Names of the page and the picture of a match, in its folder."""
