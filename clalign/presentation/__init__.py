"""What people see of a match: pictures, the page, notebooks, and files for other programs."""
