"""A part of a surface on the whole: search, growth and what the part covers."""
